"""``timestamps.csv``: when each frame was taken."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import F64


def load_timestamps(path: Path) -> F64:
    """Times by frame index.

    Args:
        path: CSV with the columns ``frame,timestamp_s``; frames count from 0.
    Returns:
        (last frame + 1,) float64 [s] since the first row; NaN for frames without a row.
    Raises:
        InputError: unreadable, columns missing, not a number, or times that do not increase with the frame.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [_row(path, row) for row in csv.DictReader(file)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected the columns frame,timestamp_s, found {error}") from error
    if not rows:
        raise InputError(f"{path}: expected rows of frame,timestamp_s, found none")
    rows.sort()
    for (frame, time), (next_frame, next_time) in itertools.pairwise(rows):
        if frame == next_frame or not next_time > time:
            raise InputError(
                f"{path}: expected times that increase, found frame {frame} at {time:g} s "
                f"and frame {next_frame} at {next_time:g} s"
            )
    if rows[-1][0] > 100 * len(rows) + 1000:
        raise InputError(f"{path}: expected frames counted from 0, found frame {rows[-1][0]} in {len(rows)} rows")
    times = np.full(rows[-1][0] + 1, np.nan)
    for frame, time in rows:
        times[frame] = time - rows[0][1]
    return times


def _row(path: Path, row: dict[str, str]) -> tuple[int, float]:
    try:
        frame, time = int(row["frame"]), float(row["timestamp_s"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: expected the columns frame,timestamp_s with numbers, found {row}") from error
    if frame < 0 or not np.isfinite(time):
        raise InputError(f"{path}: expected frames from 0 and finite times, found {row}")
    return frame, time
