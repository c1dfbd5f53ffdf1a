"""``planview sweep``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from calib.errors import InputError, WorkError, printable
from calib.io import parse_toml
from planview.commands.options import plural, say
from planview.commands.shell import Flag
from planview.output.progress import PlainConsole
from planview.sweep.results import JobResult, Ranked, why_no_intervals
from planview.sweep.study import FIGURES, FigureName, RecordingEntry, Space, Study, load_study
from planview.sweep.work import run_study
from planview.sweep.workers import workers

FAILED_MAX = 20
"""Failed runs that are printed; summary.csv has them all."""


@Parameter(name="*")
@dataclass(frozen=True)
class SweepOptions:
    """What is varied without a study file, and where runs take place."""

    out: Path | None = None
    """Folder for results; a study file's own name without .toml by default. What an earlier study there has done with
    the same input, configuration and version is not repeated."""
    vary: Annotated[Sequence[str], Parameter(name="--vary")] = ()
    """Without a study file: a parameter and its values, e.g. foreground.beta=6,12; can be repeated."""
    config: Path | None = None
    """Without a study file: TOML file with parameters common to all runs."""
    jobs: int = 1
    """Runs at the same time, each in a process of its own on one core."""
    cluster: str | None = None
    """Address of a Dask scheduler (tcp://HOST:PORT) whose workers share this file system, instead of processes here."""
    json: Annotated[Flag, Parameter(help="Print one JSON object to standard output.")] = False


def sweep(
    sources: Annotated[Sequence[Path], Parameter(consume_multiple=True)], /, *, options: SweepOptions = SweepOptions()
) -> None:
    """Run recordings with many configurations and seeds, score them against truth and rank the configurations.

    Writes summary.csv (a row per run), report.html (ranking with confidence intervals) and a folder per run. Runs that
    fail are reported at the end, when all others are done, and make the exit status 1.

    Example: planview sweep STUDY.toml --jobs 4

    Example of STUDY.toml:
        recordings = ["hall/*"]
        seeds = [0, 1]
        [parameters]
        foreground.beta = [6, 12, 24]
        joint.birth_evidence = [4, 8]

    Example without a file: planview sweep rec1 rec2 --out tried --vary foreground.beta=6,12 --vary seed=1,2

    Parameters
    ----------
    sources
        A study file (.toml), or recordings: stereo, single-camera, or maps.h5 that planview run --maps wrote.
    """
    study, names, out = _study(sources, options)
    console = PlainConsole(stderr=True, highlight=False, soft_wrap=True)
    if options.jobs < 1:
        raise InputError(f"--jobs: expected 1 or more, found {options.jobs}")
    runs, ranking = run_study(study, names, out, workers(options.jobs, options.cluster), console)
    failed = [run for run in runs if run.error]
    if options.json:
        found = {"out": str(out), "objective": study.objective, "failed": len(failed)}
        found |= {"runs": [run.to_json() for run in runs], "ranking": [row.to_json() for row in ranking]}
        print(json.dumps(found | {"no_intervals": why_no_intervals(runs) or None}))
    else:
        print_ranking(study.objective, runs, ranking, out)
    for run in failed[:FAILED_MAX]:
        say(f"failed: {run.recording}, {run.configuration.label}, seed {run.seed}: {run.error}")
    if len(failed) > FAILED_MAX:
        say(f"and {len(failed) - FAILED_MAX} more, in summary.csv")
    if failed:
        raise WorkError(f"{len(failed)} of {len(runs)} runs failed; the others are done")


def _study(sources: Sequence[Path], options: SweepOptions) -> tuple[Study, list[str], Path]:
    """The study with absolute paths, names of its recordings, and the folder for results."""
    if len(sources) == 1 and sources[0].suffix == ".toml":
        if options.vary or options.config:
            raise InputError(f"--vary and --config cannot be combined with a study file; write them into {sources[0]}")
        study, folder = load_study(sources[0]), sources[0].parent
        out = options.out or sources[0].with_suffix("")
    else:
        if options.out is None:
            raise InputError("sweep of recordings needs --out FOLDER for the results")
        parameters, seeds = varied(options.vary)
        entries = [RecordingEntry(path=path) for path in sources]
        study = Study(recordings=entries, config=options.config, parameters=parameters, seeds=seeds)
        folder, out = Path(), options.out
    paths = [entry.path for entry in study.recordings]
    names = [str(path.relative_to(folder) if path.is_relative_to(folder) else path) for path in paths]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"expected every recording once, found {twice[0]} twice")
    # Workers may have another current folder.
    entries = [entry.model_copy(update={n: p and p.absolute() for n, p in entry}) for entry in study.recordings]
    config = study.config and study.config.absolute()
    return study.model_copy(update={"recordings": entries, "config": config}), names, out.absolute()


def varied(options: Sequence[str]) -> tuple[dict[str, Space], list[int]]:
    """``--vary`` options: values per parameter, and the seeds where the parameter is ``seed``."""
    parameters: dict[str, Space] = {}
    for text in options:
        name, equals, values = text.partition("=")
        listed = [_value(value) for value in values.split(",")]
        if not equals or not values:
            raise InputError(f"--vary: expected table.key=value,value, found {text!r}")
        if len(set(map(repr, listed))) < len(listed) or name in parameters:
            raise InputError(f"--vary: expected different settings for every run, found one twice in {text!r}")
        parameters[name.strip()] = listed
    seeds = parameters.pop("seed", [0])
    if not isinstance(seeds, list) or not all(isinstance(seed, int) and seed >= 0 for seed in seeds):
        raise InputError(f"--vary: expected whole numbers from 0 for seed, found {seeds}")
    return parameters, seeds


def _value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text.strip()


def print_ranking(objective: FigureName, runs: Sequence[JobResult], ranking: Sequence[Ranked], out: Path) -> None:
    """Configurations with their whole names, best first."""
    known = [objective, *(name for name in FIGURES if name != objective)]
    before: list[str] = []
    for place, row in enumerate(ranking, 1):
        print(f"{place}. {printable(row.configuration.label)}")
        figures = [f"{FIGURES[n].label} {row.figures[n].text(FIGURES[n].digits)}" for n in known if n in row.figures]
        tracked = [figure for figure in figures if not figure.startswith(FIGURES["elapsed_s"].label)]
        equal = f"equal to {place - 1}: " if tracked and tracked == before else ""
        runs_text = plural(row.runs, "run") + (f", {row.failed} failed" if row.failed else "")
        print("   " + equal + ", ".join([*figures, runs_text]))
        before = tracked
    if ranking and (why := why_no_intervals(runs)):
        print(why)
    print(f"{out / 'report.html'}")
