"""``planview sweep``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from planview.commands.options import JsonFlag
from planview.runs.sweep import Job, jobs_of, run_jobs


def sweep(
    recordings: Annotated[Sequence[Path], Parameter(consume_multiple=True)],
    *,
    out: Path,
    vary: Annotated[Sequence[str], Parameter(name="--vary")] = (),
    config: Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    json_output: JsonFlag = False,
) -> None:
    """Run every recording with every combination of settings; score those that have a truth.csv.

    Example: planview sweep rec1 rec2 --out sweeps --vary maps.cell_m=0.03,0.04 --vary seed=1,2

    Parameters
    ----------
    recordings
        Stereo recordings, or maps.h5 that planview run --save-maps wrote: for parameters of the tracker, many times as
        fast; truth.csv is looked for beside them.
    out
        Folder in which each run gets a folder of its own; finished runs found there are kept, not repeated.
    vary
        A parameter and its values, e.g. template.width_m=0.35,0.40,0.45; may be given several times.
    config
        TOML file with parameters common to all runs.
    jobs
        Runs at the same time, in processes of their own.
    cluster
        Address of a Dask scheduler (tcp://...) that shares this file system, instead of local processes.
    json_output
        Print one JSON object, a list of runs.
    """
    rows = run_jobs(jobs_of(recordings, vary, config, out), jobs, cluster)
    if json_output:
        print(json.dumps({"runs": [{"folder": str(job.folder), "settings": job.settings, **row} for job, row in rows]}))
        return
    Console(markup=False).print(_table(rows))


def _table(rows: Sequence[tuple[Job, dict[str, float]]]) -> Table:
    table = Table("recording", "settings", "people", "mota", "idf1", "position [m]", "significant errors")
    for job, row in rows:
        figures = (_text(row.get(key)) for key in ("people", "mota", "idf1", "position_error_mean_m", "errors"))
        table.add_row(job.folder.parent.name, " ".join(job.settings) or "defaults", *figures)
    return table


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:g}" if float(value).is_integer() else f"{value:.3f}"
