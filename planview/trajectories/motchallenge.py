"""Rows of MOTChallenge and PETS: ground truth and results, with or without world coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import F64, Bool
from planview.trajectories.file import TrajectoryFile, replaced
from planview.trajectories.rows import read_numbers, sorted_rows
from planview.trajectories.table import IGNORED, Trajectories, positions_table

_PEDESTRIAN = 1
_DISTRACTORS = (2, 7, 8, 12)
"""Person on a vehicle, static person, distractor, reflection: tracks on them are no errors (Milan et al. 2016, MOT16,
section 3.2); all other classes and rows with flag 0 are left out."""
_CLASS_MAX = 13


def read_motchallenge(path: Path, *, truth: bool) -> Trajectories:
    """Rows of frame (from 1), id, left, top, width, height and, where present, three or four more columns.

    Nine columns whose values are a flag (0 or 1), a class (1 to 13) and a visibility (0 to 1) in every row are the
    ground truth of MOT16 and later: distractors get the visibility IGNORED, other classes and flag 0 are left out.
    Otherwise the columns are confidence, X, Y (and Z) as in MOT15 results and ground truth and in PETS: X and Y are
    metres on the floor, unknown where all are -1, and ground truth with the confidence 0 is left out.

    Args:
        truth: the file is ground truth; every row of results counts, whatever its confidence.
    Raises:
        InputError: a row of another length, or values that are not numbers.
    """
    table = read_numbers(path, ",", "rows of numbers (frame,id,left,top,width,height,...)")
    if not 6 <= table.shape[1] <= 10 or not np.isfinite(table[:, :6]).all():
        raise InputError(f"{path}: expected 6 to 10 columns, the first 6 finite, found {table.shape[1]} columns")
    table = sorted_rows(path, table, frame=0, track_id=1)
    if _has_classes(table):
        return _with_classes(table)
    if truth and table.shape[1] > 6:
        table = table[table[:, 6] != 0]
    return _positions(table, _floor(table))


def write_motchallenge(path: Path, file: TrajectoryFile) -> None:
    """Write rows of frame (from 1), id, box, confidence 1 and world X, Y, Z [m] with Z 0 on the floor.

    An unknown box or position is -1 throughout. Heights and times have no column.

    Raises:
        WorkError: the file cannot be written.
    """
    table = file.table
    world = np.column_stack([table.x_m, table.y_m, np.zeros(len(table))])
    columns = [table.frame + 1, table.track_id, _or_minus_one(table.box_px), np.ones(len(table)), _or_minus_one(world)]
    rows = np.column_stack(columns)
    formats = ["%d", "%d", *["%.1f"] * 4, "%d", *["%.4f"] * 3]
    with replaced(path) as part:
        np.savetxt(part, rows, formats, delimiter=",")


def _or_minus_one(values: F64) -> F64:
    """The rows of an (N, M) array, -1 throughout where a value is unknown."""
    known = np.isfinite(values).all(axis=1, keepdims=True)
    return np.where(known, values, -1.0)


def _has_classes(table: F64) -> Bool | bool:
    """Columns 7 to 9 are flag, class and visibility; X and Y in metres are not integers and fractions throughout."""
    if table.shape[1] != 9 or not len(table):
        return False
    flag, kind, visible = table[:, 6:9].T
    classes = (kind == np.floor(kind)) & (kind >= 1) & (kind <= _CLASS_MAX)
    return bool((np.isin(flag, (0, 1)) & classes & (visible >= 0) & (visible <= 1)).all())


def _with_classes(table: F64) -> Trajectories:
    distractor = np.isin(table[:, 7], _DISTRACTORS)
    kept = distractor | ((table[:, 7] == _PEDESTRIAN) & (table[:, 6] == 1))
    visible = np.where(distractor, IGNORED, table[:, 8])
    return _positions(table[kept], np.full((int(kept.sum()), 2), np.nan), visible[kept])


def _floor(table: F64) -> F64:
    """(N, 2) floor positions [m]; NaN where the columns are missing or -1."""
    if table.shape[1] < 9:
        return np.full((len(table), 2), np.nan)
    unknown = (table[:, 7:] == -1).all(axis=1)
    return np.where(unknown[:, None], np.nan, table[:, 7:9])


def _positions(table: F64, floor_m: F64, visible: F64 | None = None) -> Trajectories:
    frame, track_id = table[:, :2].astype(np.int64).T
    return positions_table(frame - 1, track_id, floor_m, box_px=table[:, 2:6], visible=visible)
