"""Places of the rows of tables, in units of what counts as near, and how many rows of one table are near another's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calib.types import F64, I64
from planview.evaluation.metrics import pairs_in_frames
from planview.trajectories.table import Trajectories

CLOSE_M = 0.4
"""Rows that are nearer than this are near on the floor [m]: a torso's width."""
CLOSE_BOX = 0.3
"""The same in the image, in heights of the median box."""
FRAME_APART = 10.0
"""Rows of different frames are so far from each other."""
VOTES_MIN = 20
"""Fewest pairs of rows that vote for an offset."""


@dataclass(frozen=True, eq=False)
class Places:
    """Frames (N,) and places (N, D), in units of what is near: (x, y) on the floor, or all four edges of boxes."""

    frame: F64
    at: F64

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def size(self) -> float:
        """The longest side of a box around all places."""
        return float(np.ptp(self.at, axis=0).max()) if len(self) else 0.0

    @property
    def in_space(self) -> F64:
        """(N, D + 1) points at which rows of different frames are far from each other."""
        return np.column_stack([self.at, FRAME_APART * self.frame])

    @cached_property
    def tree(self) -> Any:
        return tree_of(self.in_space)

    def spread(self, most: int) -> Places:
        """So many rows at most, spread over the whole."""
        if len(self) <= most:
            return self
        rows = np.linspace(0, len(self) - 1, most).astype(int)
        return Places(self.frame[rows], self.at[rows])


def tree_of(points: F64) -> Any:
    """A tree to search the neighbours of (N, D) points in."""
    from scipy.spatial import cKDTree  # a quarter of a second

    return cKDTree(points)


def near_unit(tracks: Trajectories, on_floor: bool) -> float:
    """The distance that counts as near: metres on the floor, pixels of all edges of a box together."""
    if on_floor or not len(tracks):
        return CLOSE_M
    height_px = float(np.median(tracks.box_px[:, 3]))
    return math.sqrt(2.0) * CLOSE_BOX * height_px


def places_of(table: Trajectories, on_floor: bool, unit: float) -> Places:
    frame = table.frame.astype(np.float64)
    if on_floor:
        return Places(frame, np.column_stack([table.x_m, table.y_m]) / unit)
    first = table.box_px[:, :2]
    last = first + table.box_px[:, 2:]
    return Places(frame, np.column_stack([first, last]) / unit)


def with_places(table: Trajectories, on_floor: bool) -> Trajectories:
    """The rows that have a place: a position on the floor, or a box."""
    needed = np.column_stack([table.x_m, table.y_m]) if on_floor else table.box_px
    return table.where(np.asarray(np.isfinite(needed).all(axis=1)))


def nearest_rows(rows: Places, others: Places) -> I64:
    """(N,) index of the nearest other row of the same frame; -1 where none is near."""
    if not len(others):
        return np.full(len(rows), -1)
    _, nearest = others.tree.query(rows.in_space, distance_upper_bound=1.0)
    return np.where(nearest < len(others), nearest, -1)


def share_near(rows: Places, others: Places) -> float:
    """Share of rows with another one near, each of which serves one; of the rows in frames that the others cover,
    unless these are few."""
    if not (len(rows) and len(others)):
        return 0.0
    nearest = nearest_rows(rows, others)
    served = len(np.unique(nearest[nearest >= 0]))
    covered = (rows.frame >= others.frame.min()) & (rows.frame <= others.frame.max())
    return served / max(1, int(np.count_nonzero(covered)), len(rows) // 3)


def vote_shift(rows: Places, others: Places) -> int:
    """Frames by which the others are later, by the votes of pairs of rows at about one place; 0 without any."""
    pairs = tree_of(rows.at).sparse_distance_matrix(tree_of(others.at), 0.5, output_type="coo_matrix")
    later = np.round(others.frame[pairs.col] - rows.frame[pairs.row]).astype(np.int64)
    if len(later) == 0:
        return 0
    votes = np.bincount(later - later.min(), (1.0 - 2.0 * pairs.data) ** 2)
    # Pairs of longer shifts are fewer, since both tables end.
    smooth = np.convolve(votes, (0.25, 0.5, 1.0, 0.5, 0.25), "same")
    return int(smooth.argmax() + later.min())


def vote_offset(rows: Places, others: Places) -> F64:
    """(D,) from the rows to the others, by the votes of pairs of rows of one frame [units of what is near]."""
    by_frame = np.argsort(others.frame, kind="stable")
    blocks = [np.stack(pairs) for pairs in pairs_in_frames(rows.frame, others.frame[by_frame])]
    first, second = np.concatenate(blocks, axis=1)
    if len(first) < VOTES_MIN:
        return np.zeros(rows.at.shape[1])
    offsets = others.at[by_frame[second]] - rows.at[first]
    tree = tree_of(offsets)
    votes = tree.query_ball_point(offsets, 0.5, return_length=True)
    agreeing = tree.query_ball_point(offsets[np.argmax(votes)], 0.5)
    return np.asarray(np.median(offsets[agreeing], axis=0))
