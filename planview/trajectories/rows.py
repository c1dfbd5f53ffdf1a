"""Tables of numbers without a header: reading, and order by frame and id."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.io import reason, require_file
from calib.types import F64, I64

KEY_MAX = 2**53
"""Largest frame number or id that a float64 holds exactly."""


def read_numbers(path: Path, delimiter: str | None, expected: str) -> F64:
    """(N, M) numbers of a text file; None for blanks as delimiter.

    Raises:
        InputError: unreadable, rows of different lengths, or values that are not numbers; ``expected`` is named.
    """
    require_file(path, expected)
    try:
        with warnings.catch_warnings():
            # A file with nothing but comments is an empty table.
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            return np.loadtxt(path, delimiter=delimiter, ndmin=2, dtype=np.float64, encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected {expected}, found {reason(error)}") from error


def sorted_rows(path: Path, table: F64, frame: int, track_id: int) -> F64:
    """Rows by frame, then id (given their columns).

    Raises:
        InputError: a frame or id that is not a whole number up to KEY_MAX, or two rows of one frame and id.
    """
    keys = table[:, [frame, track_id]]
    if not np.isfinite(keys).all() or (keys != np.floor(keys)).any():
        raise InputError(f"{path}: expected whole numbers for frame and id, found others")
    if (np.abs(keys) > KEY_MAX).any():
        raise InputError(f"{path}: expected frames and ids up to {KEY_MAX}, found {np.abs(keys).max():g}")
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    require_unique(path, keys[order][:, 0], keys[order][:, 1])
    return np.asarray(table[order])


def require_unique(path: Path, frame: F64 | I64, track_id: F64 | I64) -> None:
    """Refuse two rows of one frame and id, in (N,) columns sorted by frame, then id.

    Raises:
        InputError: there are two.
    """
    twice = np.flatnonzero((np.diff(frame) == 0) & (np.diff(track_id) == 0))
    if len(twice):
        first = int(twice[0])
        raise InputError(
            f"{path}: expected one row per frame and id, found two for frame {frame[first]:g}, id {track_id[first]:g}"
        )
