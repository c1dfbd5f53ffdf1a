"""A file of trajectories in any format: its rows and what it says about all of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.errors import InputError, WorkError
from calib.io import reason, whole_file
from planview.trajectories.table import Trajectories

ROWS_MAX = 50_000_000
"""Most rows read of a file whose header claims its size: a month of one person at 20 Hz (our choice)."""
FPS_MAX = 10_000.0
AREA_MARGIN_M = 1.0
"""Between the outermost position and the walkable area where none is known [m] (our choice)."""
_WKT = re.compile(r"(POLYGON|MULTIPOLYGON|GEOMETRYCOLLECTION)[\s(),.\dA-Za-z+-]*", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class TrajectoryFile:
    """Trajectories and what their file says about all of them.

    Attributes:
        table: the rows.
        fps: frames per second; None where the file does not say.
        walkable_wkt: the floor where people may walk, a polygon in well-known text [m]; None where the file does not
            say.
    """

    table: Trajectories
    fps: float | None = None
    walkable_wkt: str | None = None


def timed_by_rate(file: TrajectoryFile) -> TrajectoryFile:
    """The file with times frame / fps [s] where its rows have none."""
    table = file.table
    if file.fps is None or np.isfinite(table.timestamp_s).any():
        return file
    return replace(file, table=replace(table, timestamp_s=table.frame / file.fps))


def checked_rate(path: Path, value: object) -> float:
    """A frame rate from a file [1/s].

    Raises:
        InputError: not a number above 0 and up to FPS_MAX.
    """
    try:
        fps = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        fps = float("nan")
    if not 0 < fps <= FPS_MAX:
        raise InputError(f"{path}: expected a frame rate above 0 and up to {FPS_MAX:g}, found {str(value)[:40]!r}")
    return fps


def checked_area(text: str, where: str) -> str:
    """Well-known text of a walkable area.

    Raises:
        InputError: not a POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION, or parentheses that do not pair up.
    """
    wkt = " ".join(text.split())
    if not _WKT.fullmatch(wkt) or wkt.count("(") != wkt.count(")") or "(" not in wkt:
        raise InputError(f"{where}: expected a walkable area like POLYGON ((0 0, 4 0, 4 3, 0 0)), found {wkt[:60]!r}")
    return wkt


def surrounding_area(table: Trajectories) -> str:
    """The upright rectangle AREA_MARGIN_M around all positions, as well-known text."""
    known = np.isfinite(table.x_m) & np.isfinite(table.y_m)
    xy = np.column_stack([table.x_m[known], table.y_m[known]]) if known.any() else np.zeros((1, 2))
    (x0, y0), (x1, y1) = xy.min(axis=0) - AREA_MARGIN_M, xy.max(axis=0) + AREA_MARGIN_M
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))
    return "POLYGON ((" + ", ".join(f"{x:.3f} {y:.3f}" for x, y in corners) + "))"


def refuse_many(path: Path, rows: int) -> None:
    """Refuse a table before memory is taken for it.

    Raises:
        InputError: more rows than ROWS_MAX.
    """
    if rows > ROWS_MAX:
        raise InputError(f"{path}: expected up to {ROWS_MAX} rows, found {rows}")


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """A path to write to, which becomes ``path`` in one step when all is written (see ``calib.io.whole_file``).

    Raises:
        WorkError: the file cannot be written; what was there is kept.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as part:
            yield part
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error
