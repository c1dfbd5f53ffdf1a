"""Recordings run with many configurations."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from calib.errors import InputError
from planview.api.arguments import in_range, path_of
from planview.api.result import Result
from planview.progress import Progress, unseen
from planview.studies.results import JobResult, means_of, table_of
from planview.studies.study import study_of
from planview.studies.work import run_study
from planview.studies.workers import workers

log = logging.getLogger(__name__)


def sweep(
    *sources: Path | str,
    out: Path | str | None = None,
    vary: Sequence[str] = (),
    config: Path | str | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    progress: Progress = unseen,
) -> Result[list[JobResult]]:
    """Run several settings or recordings and compare them.

    Runs that have truth are scored. Writes summary.csv (a row per run) and a folder per run; runs that fail are
    reported at the end, when all others are done.

    ```python
    runs = planview.sweep("rec1", "rec2", out="tried", vary=["foreground.beta=6,12", "seed=1,2"])
    runs.to_dataframe().groupby("foreground.beta").mota.mean()
    ```

    Args:
        sources: A study file (.toml), or recordings: stereo, single-camera, or maps.h5 of earlier runs.
        out: Folder for results; a study file's own name without .toml by default. What an earlier study there has done
            with the same input, configuration and version is not repeated.
        vary: Without a study file: a parameter and its values, e.g. foreground.beta=6,12; can be repeated.
        config: Without a study file: TOML file with parameters common to all runs.
        jobs: Runs at the same time, each in a process of its own on one core.
        cluster: Address of a Dask scheduler (tcp://HOST:PORT) whose workers share this file system, instead of
            processes here.
        progress: Called after every run.

    Returns:
        Every run; ``error`` is why one failed, and then ``ok`` is false.

    Raises:
        InputError: a study or recording that cannot be read, or parameters that do not exist.
    """
    if not sources:
        raise InputError("sweep needs a study file or recordings")
    in_range("jobs", jobs, 1, 10_000)
    study, names, folder = study_of([Path(source) for source in sources], path_of(out), vary, path_of(config))
    log.debug("runs")
    runs = run_study(study, names, folder, workers(jobs, cluster), progress)
    failed = [run for run in runs if run.error]
    values = {"out": str(folder), "failed": len(failed), "runs": [run.to_json() for run in runs]}
    rows = table_of(runs).to_dict("records")
    means = means_of(runs).to_string(float_format="%.4g")
    return Result(runs, values, rows, [folder / "summary.csv"], not failed, means)
