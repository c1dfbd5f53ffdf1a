"""Text files of PeTrack, PedPy and the Pedestrian Dynamics Data Archive: id, frame, x, y, z.

Comments begin with ``#``; one gives the frame rate (``# framerate: 25 fps``), one the unit (``# id frame x/m y/m z/m``
or ``x/cm``, older files ``(in m)``). z is a position in space or the height of the person; columns after z are ignored.
"""

from __future__ import annotations

import re
from itertools import takewhile
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.io import reason
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, checked_rate, replaced
from planview.trajectories.rows import read_numbers, sorted_rows
from planview.trajectories.table import positions_table

METRES = {"m": 1.0, "cm": 0.01}
_RATE = re.compile(r"framerate\s*[:=]?\s*([^\s,;]+)", re.IGNORECASE)
_CENTIMETRES = re.compile(r"x\s*[/\[(]\s*cm\b|\bin\s+cm\b", re.IGNORECASE)
_METRES = re.compile(r"x\s*[/\[(]\s*m\b|\bin\s+(m\b|met)", re.IGNORECASE)
_COMMENTS_MAX = 1000


def read_petrack(path: Path) -> TrajectoryFile:
    """Read a text file whose comments tell the unit and, usually, the frame rate.

    A z of 0 or less, or none, is no height.

    Raises:
        InputError: no unit in the comments, fewer than 4 columns, or values that are not numbers.
    """
    rate, scale = _comments(path)
    table = read_numbers(path, None, "rows of id frame x y z")
    if not len(table):
        table = np.empty((0, 5))
    if table.shape[1] < 4:
        raise InputError(f"{path}: expected the columns id frame x y z, found {table.shape[1]} columns")
    table = sorted_rows(path, table, frame=1, track_id=0)
    track_id, frame = table[:, :2].astype(np.int64).T
    height_m = scale * table[:, 4] if table.shape[1] > 4 else np.full(len(table), np.nan)
    rows = positions_table(frame, track_id, scale * table[:, 2:4], np.where(height_m > 0, height_m, np.nan))
    return TrajectoryFile(rows, rate)


def write_petrack(path: Path, file: TrajectoryFile, unit: str = "m") -> None:
    """Write rows with known positions by id, then frame, to 0.1 mm; an unknown height is ``nan``.

    Args:
        unit: "m" or "cm".
    Raises:
        WorkError: the file cannot be written.
    """
    table = file.table
    order = np.lexsort((table.frame, table.track_id))
    values = np.column_stack([table.x_m, table.y_m, table.height_m])[order] / METRES[unit]
    rows: F64 = np.column_stack([table.track_id[order], table.frame[order], values])
    digits = "%.4f" if unit == "m" else "%.2f"
    header = f"# framerate: {file.fps:g} fps\n# id frame x/{unit} y/{unit} z/{unit}"
    with replaced(path) as part:
        np.savetxt(part, rows, ["%d", "%d", digits, digits, digits], header=header, comments="")


def _comments(path: Path) -> tuple[float | None, float]:
    """Frames per second (None without a comment) and metres per unit."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            lines = [line for line, _ in zip(file, range(_COMMENTS_MAX), strict=False)]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected rows of id frame x y z, found {reason(error)}") from error
    text = "".join(takewhile(lambda line: line.startswith("#") or not line.strip(), lines))
    rate = _RATE.search(text)
    if _CENTIMETRES.search(text):
        scale = METRES["cm"]
    elif _METRES.search(text):
        scale = METRES["m"]
    else:
        raise InputError(f"{path}: expected a comment with the unit (x/m or x/cm) before the rows, found none")
    return (checked_rate(path, rate.group(1)) if rate else None), scale
