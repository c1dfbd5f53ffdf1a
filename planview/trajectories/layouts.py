"""Trajectories in our own layout or in that of a public benchmark, told by the file's first line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from planview.trajectories.motchallenge import read_motchallenge
from planview.trajectories.rows import read_numbers, sorted_rows
from planview.trajectories.table import Trajectories, positions_table, read_tracks, read_truth


def load_truth(path: Path) -> Trajectories:
    """Truth in our layout (with a header), as PETS/MOTChallenge rows or as laboratory rows.

    Raises:
        InputError: unreadable or none of these.
    """
    return _load(path, truth=True)


def load_tracks(path: Path) -> Trajectories:
    """Tracks in our layout, or in one of those of ``load_truth``.

    Raises:
        InputError: unreadable or none of these.
    """
    return _load(path, truth=False)


def _load(path: Path, *, truth: bool) -> Trajectories:
    try:
        with path.open(encoding="utf-8") as file:
            first = file.readline(10_000)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected trajectories, found {error}") from error
    if not first.strip() or not _is_number(first.replace(",", " ").split()[0]):
        return read_truth(path) if truth else read_tracks(path)
    return read_motchallenge(path, truth=truth) if "," in first else read_laboratory(path)


def read_laboratory(path: Path, fps: float = 16.0) -> Trajectories:
    """Head positions of laboratory experiments (Juelich): id, frame, x cm, y cm, z cm, separated by blanks.

    Raises:
        InputError: a row of another length, or values that are not numbers.
    """
    table = read_numbers(path, None, "rows of id frame x_cm y_cm z_cm")
    if table.shape[1] != 5:
        raise InputError(f"{path}: expected 5 columns (id frame x_cm y_cm z_cm), found {table.shape[1]}")
    table = sorted_rows(path, table, frame=1, track_id=0)
    track_id, frame = table[:, :2].astype(np.int64).T
    return positions_table(frame, track_id, table[:, 2:4] / 100, table[:, 4] / 100, timestamp_s=frame / fps)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
