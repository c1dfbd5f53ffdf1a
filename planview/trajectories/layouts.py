"""Trajectories in the layouts of public benchmarks, beside our own ``truth.csv``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.table import Trajectories, read_tracks, read_truth


def load_truth(path: Path) -> Trajectories:
    """Truth in our layout (with a header), as PETS/MOTChallenge rows or as laboratory rows, told by the first line.

    Raises:
        InputError: unreadable or none of these.
    """
    return _reader(path, read_truth)(path)


def load_tracks(path: Path) -> Trajectories:
    """Tracks in our layout, or in one of those of ``load_truth``.

    Raises:
        InputError: unreadable or none of these.
    """
    return _reader(path, read_tracks)(path)


def _reader(path: Path, own: Callable[[Path], Trajectories]) -> Callable[[Path], Trajectories]:
    try:
        with path.open(encoding="utf-8") as file:
            first = file.readline(10_000)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected trajectories, found {error}") from error
    if not first.strip() or not _is_number(first.replace(",", " ").split()[0]):
        return own
    return read_pets if "," in first else read_laboratory


def read_pets(path: Path) -> Trajectories:
    """Rows of frame (from 1), id, left, top, width, height, 1, X m, Y m[, 0]; X and Y may be missing.

    Raises:
        InputError: a row of another length, or values that are not numbers.
    """
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: expected rows of numbers (frame,id,left,top,width,height,...), found {error}"
        ) from error
    if table.shape[1] < 6 or not np.isfinite(table[:, :6]).all():
        raise InputError(f"{path}: expected at least 6 finite numbers per row, found {table.shape[1]} columns")
    table = _sorted(path, table, frame=0, track_id=1)
    floor = table[:, 7:9] if table.shape[1] >= 9 else np.full((len(table), 2), np.nan)
    return positions_table(table[:, 0].astype(np.int64) - 1, table[:, 1].astype(np.int64), floor, box_px=table[:, 2:6])


def read_laboratory(path: Path, fps: float = 16.0) -> Trajectories:
    """Head positions of laboratory experiments (Juelich): id, frame, x cm, y cm, z cm, separated by blanks.

    Raises:
        InputError: a row of another length, or values that are not numbers.
    """
    try:
        table = np.loadtxt(path, ndmin=2, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected rows of id frame x_cm y_cm z_cm, found {error}") from error
    if table.shape[1] != 5:
        raise InputError(f"{path}: expected 5 columns (id frame x_cm y_cm z_cm), found {table.shape[1]}")
    table = _sorted(path, table, frame=1, track_id=0)
    frame = table[:, 1].astype(np.int64)
    return positions_table(
        frame, table[:, 0].astype(np.int64), table[:, 2:4] / 100, table[:, 4] / 100, timestamp_s=frame / fps
    )


def _sorted(path: Path, table: F64, frame: int, track_id: int) -> F64:
    """Rows by frame, then id (given their columns); each pair may occur once."""
    keys = table[:, [frame, track_id]]
    if not np.isfinite(keys).all() or (keys != np.floor(keys)).any():
        raise InputError(f"{path}: expected whole numbers for frame and id, found others")
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    twice = (np.diff(keys[order], axis=0) == 0).all(axis=1)
    if twice.any():
        frame_found, id_found = keys[order][int(np.flatnonzero(twice)[0])]
        raise InputError(
            f"{path}: expected one row per frame and id, found two for frame {frame_found:g}, id {id_found:g}"
        )
    return np.asarray(table[order])


def positions_table(
    frame: I64,
    track_id: I64,
    xy_m: F64,
    height_m: F64 | None = None,
    timestamp_s: F64 | None = None,
    box_px: F64 | None = None,
) -> Trajectories:
    """A table of confirmed, visible rows from arrays of length N (sorted by frame, then id); the rest is NaN."""
    n = len(frame)
    unknown = np.full(n, np.nan)
    return Trajectories(
        frame=frame,
        track_id=track_id,
        timestamp_s=unknown if timestamp_s is None else timestamp_s,
        x_m=xy_m[:, 0],
        y_m=xy_m[:, 1],
        height_m=unknown if height_m is None else height_m,
        state=np.full(n, "confirmed"),
        visible=np.ones(n),
        box_px=np.full((n, 4), np.nan) if box_px is None else box_px,
        velocity_mps=np.full((n, 2), np.nan),
    )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
