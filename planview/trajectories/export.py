"""Writing trajectories in the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from planview.trajectories.file import TrajectoryFile, replaced, surrounding_area
from planview.trajectories.jsonl import write_jsonl
from planview.trajectories.jupedsim import write_jupedsim
from planview.trajectories.motchallenge import write_motchallenge
from planview.trajectories.parquet import write_parquet
from planview.trajectories.ped_data_archive import write_ped_data_archive
from planview.trajectories.petrack import write_petrack
from planview.trajectories.table import Trajectories, write_table
from planview.trajectories.timing import frame_period_s

ExportName = Literal["pedpy", "ped-data-archive", "jupedsim", "motchallenge", "parquet", "csv", "jsonl"]
RATE_DIGITS = 3
"""Decimals of a rate that is measured from times rounded to 0.1 ms."""


class ExportFormat(NamedTuple):
    """Its usual ending, its writer, and whether it keeps the state of a row (else it holds confirmed rows)."""

    suffix: str
    write: Callable[[Path, TrajectoryFile], None]
    keeps_state: bool
    needs_floor: bool = True


def _write_csv(path: Path, file: TrajectoryFile) -> None:
    with replaced(path) as part, part.open("w", encoding="utf-8") as out:
        write_table(out, file.table)


FORMATS: dict[ExportName, ExportFormat] = {
    "pedpy": ExportFormat(".txt", write_petrack, False),
    "ped-data-archive": ExportFormat(".h5", write_ped_data_archive, False),
    "jupedsim": ExportFormat(".sqlite", write_jupedsim, False),
    "motchallenge": ExportFormat(".txt", write_motchallenge, False, needs_floor=False),
    "parquet": ExportFormat(".parquet", write_parquet, True),
    "csv": ExportFormat(".csv", _write_csv, True),
    "jsonl": ExportFormat(".jsonl", write_jsonl, True),
}


def prepared(
    file: TrajectoryFile, name: ExportName, *, fps: float | None = None, area: str | None = None, lost: bool = False
) -> TrajectoryFile:
    """What an export of a file holds.

    A format without states gets the rows that are confirmed and, unless boxes do, have a floor position.

    Args:
        fps: in place of the file's own; where neither is known the rate that the timestamps have.
        area: in place of the file's own; where neither is known the rectangle around all positions.
        lost: rows that were only predicted count as confirmed.
    Raises:
        InputError: no frame rate anywhere, or no row with a floor position.
    """
    table = file.table
    if not FORMATS[name].keeps_state:
        table = _plain_rows(table, FORMATS[name].needs_floor, lost)
    rate = fps or file.fps or measured_rate(file.table)
    if rate is None and not FORMATS[name].keeps_state:
        raise InputError("expected timestamps or a frame rate in the trajectories, found neither; --fps gives it")
    return TrajectoryFile(table, rate, area or file.walkable_wkt or surrounding_area(table))


def measured_rate(table: Trajectories) -> float | None:
    """Frames per second over all timestamps; that of the median frame where the clock jumps; None without times."""
    period = frame_period_s(table, 0.0)
    if period <= 0:
        return None
    known = np.flatnonzero(np.isfinite(table.timestamp_s))
    first, last = int(known[0]), int(known[-1])
    mean = (table.timestamp_s[last] - table.timestamp_s[first]) / (table.frame[last] - table.frame[first])
    return round(1 / float(mean if abs(mean - period) < 0.01 * period else period), RATE_DIGITS)


def _plain_rows(table: Trajectories, needs_floor: bool, lost: bool) -> Trajectories:
    kept = (table.state == "confirmed") | (lost & (table.state == "lost"))
    floor = np.isfinite(table.x_m) & np.isfinite(table.y_m)
    usable = floor if needs_floor else floor | np.isfinite(table.box_px).all(axis=1)
    if len(table) and not usable.any():
        raise InputError("expected trajectories with floor positions, found none")
    return table.where(kept & usable)
