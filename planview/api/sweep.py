"""Recordings run with many configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.errors import InputError, printable
from calib.io import parse_toml
from planview.api.arguments import in_range, path_of
from planview.output.progress import PlainConsole
from planview.studies.results import JobResult, means_of, table_of
from planview.studies.study import RecordingEntry, Study, load_study
from planview.studies.work import run_study
from planview.studies.workers import workers

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class Swept:
    """Results of a study; printed, the mean figures of each configuration.

    Attributes:
        runs: every run; ``error`` says why one failed.
    """

    out: Path
    runs: Sequence[JobResult]

    @property
    def failed(self) -> list[JobResult]:
        """Runs that failed."""
        return [run for run in self.runs if run.error]

    @property
    def table(self) -> DataFrame:
        """A row per run, as in summary.csv."""
        return table_of(self.runs)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"out": str(self.out), "failed": len(self.failed), "runs": [run.to_json() for run in self.runs]}

    def __repr__(self) -> str:
        lines = []
        for configuration, means in means_of(self.runs).iterrows():
            figures = [f"{name} {value:.4g}" for name, value in means.dropna().items()]
            lines += [printable(str(configuration)), f"   {', '.join(figures)}"]
        return "\n".join(lines)


def sweep(
    *sources: Path | str,
    out: Path | str | None = None,
    vary: Sequence[str] = (),
    config: Path | str | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    quiet: bool = False,
) -> Swept:
    """Run recordings with many configurations and seeds, and score the runs that have truth.

    Writes summary.csv (a row per run) and a folder per run. Runs that fail are reported at the end, when all others are
    done, and make the exit status 1.

    Example: planview sweep STUDY.toml --jobs 4

    Example of STUDY.toml:
        recordings = ["hall/*"]
        seeds = [0, 1]
        [parameters]
        foreground.beta = [6, 12, 24]
        joint.birth_evidence = [4, 8]

    Example without a file: planview sweep rec1 rec2 --out tried --vary foreground.beta=6,12 --vary seed=1,2

    Args:
        sources: A study file (.toml), or recordings: stereo, single-camera, or maps.h5 that planview run --maps wrote.
        out: Folder for results; a study file's own name without .toml by default. What an earlier study there has done
            with the same input, configuration and version is not repeated.
        vary: Without a study file: a parameter and its values, e.g. foreground.beta=6,12; can be repeated.
        config: Without a study file: TOML file with parameters common to all runs.
        jobs: Runs at the same time, each in a process of its own on one core.
        cluster: Address of a Dask scheduler (tcp://HOST:PORT) whose workers share this file system, instead of
            processes here.
        quiet: Show no progress.

    Raises:
        InputError: a study or recording that cannot be read, or parameters that do not exist.
    """
    if not sources:
        raise InputError("sweep needs a study file or recordings")
    study, names, folder = _study([Path(source) for source in sources], path_of(out), vary, path_of(config))
    in_range("jobs", jobs, 1, 10_000)
    console = PlainConsole(stderr=True, highlight=False, soft_wrap=True, quiet=quiet)
    return Swept(folder, run_study(study, names, folder, workers(jobs, cluster), console))


def _study(
    sources: Sequence[Path], out: Path | None, vary: Sequence[str], config: Path | None
) -> tuple[Study, list[str], Path]:
    """The study with absolute paths, names of its recordings, and the folder for results."""
    if len(sources) == 1 and sources[0].suffix == ".toml":
        if vary or config:
            raise InputError(f"vary and config cannot be combined with a study file; write them into {sources[0]}")
        study = load_study(sources[0])
        folder = sources[0].parent
        out = out or sources[0].with_suffix("")
    else:
        if out is None:
            raise InputError("recordings without a study file need a folder for the results", argument="out")
        parameters, seeds = varied(vary)
        entries = [RecordingEntry(path=path) for path in sources]
        study = Study(recordings=entries, config=config, parameters=parameters, seeds=seeds)
        folder = Path()
    paths = [entry.path for entry in study.recordings]
    names = [str(path.relative_to(folder) if path.is_relative_to(folder) else path) for path in paths]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"expected every recording once, found {twice[0]} twice")
    # Workers may have another current folder.
    entries = [entry.model_copy(update={n: p and p.absolute() for n, p in entry}) for entry in study.recordings]
    absolute = study.config and study.config.absolute()
    return study.model_copy(update={"recordings": entries, "config": absolute}), names, out.absolute()


def varied(options: Sequence[str]) -> tuple[dict[str, list[Any]], list[int]]:
    """Values per parameter, and the seeds where the parameter is ``seed``."""
    parameters: dict[str, list[Any]] = {}
    for text in options:
        name, equals, values = text.partition("=")
        listed = [_value(value) for value in values.split(",")]
        if not equals or not values:
            raise InputError(f"expected table.key=value,value, found {text!r}", argument="vary")
        if len(set(map(repr, listed))) < len(listed) or name in parameters:
            raise InputError(f"expected different settings for every run, found one twice in {text!r}", argument="vary")
        parameters[name.strip()] = listed
    seeds = parameters.pop("seed", [0])
    if not all(isinstance(seed, int) and seed >= 0 for seed in seeds):
        raise InputError(f"expected whole numbers from 0 for seed, found {seeds}", argument="vary")
    return parameters, seeds


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text.strip()
