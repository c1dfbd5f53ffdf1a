"""Compiled kernels that find people near a point or each other; ``tests/reference/near.py`` has them in plain numpy.

With many people hardly any is near a given point: the floor around them is divided into cells at least as wide as a
body reaches, so that only those in a point's own cell and in its neighbours are compared.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F64, I64

CELLS_MAX = 64
"""Along either axis: wider floors have wider cells."""


class NearPeople(NamedTuple):
    """Who may be within reach, by cell of the floor.

    Attributes:
        x_min_m, y_min_m: lower corner of the cells [m].
        side_m: of a cell [m].
        cols, rows: number of cells.
        starts: (rows * cols + 1,), where each cell's people begin in ``people``.
        people: indices of people, ascending within a cell.
    """

    x_min_m: float
    y_min_m: float
    side_m: float
    cols: int
    rows: int
    starts: I64
    people: I64


@njit(cache=True, nogil=True)
def near_people(people: F64, reach_m: float) -> NearPeople:
    """Cells of ``people`` (K, 2 or more: x, y [m]), for questions about points within ``reach_m`` of them."""
    x_min = y_min = math.inf
    x_max = y_max = -math.inf
    for k in range(len(people)):
        x_min, x_max = min(x_min, people[k, 0]), max(x_max, people[k, 0])
        y_min, y_max = min(y_min, people[k, 1]), max(y_max, people[k, 1])
    if len(people) == 0:
        return NearPeople(0.0, 0.0, 1.0, 0, 0, np.zeros(1, np.int64), np.zeros(0, np.int64))
    x_min, y_min, x_max, y_max = x_min - reach_m, y_min - reach_m, x_max + reach_m, y_max + reach_m
    side = max(reach_m, max(x_max - x_min, y_max - y_min) / (CELLS_MAX - 1))
    cols, rows = int((x_max - x_min) / side) + 1, int((y_max - y_min) / side) + 1
    starts = np.zeros(rows * cols + 1, np.int64)
    near = np.empty(9 * len(people), np.int64)
    for filling in range(2):
        for k in range(len(people)):
            col, row = int((people[k, 0] - x_min) / side), int((people[k, 1] - y_min) / side)
            for r in range(max(0, row - 1), min(rows, row + 2)):
                for c in range(max(0, col - 1), min(cols, col + 2)):
                    if filling:
                        near[starts[r * cols + c]] = k
                    starts[r * cols + c] += 1
        if filling == 0:
            before = 0
            for i in range(len(starts)):
                before, starts[i] = before + starts[i], before
    # Filling moved each start to the next one's place.
    for i in range(len(starts) - 1, 0, -1):
        starts[i] = starts[i - 1]
    starts[0] = 0
    return NearPeople(x_min, y_min, side, cols, rows, starts, near)


@njit(cache=True, nogil=True)
def cell_of(near: NearPeople, x_m: float, y_m: float) -> int:
    """The cell of a point: its people are those from ``starts`` of it to the next one's. -1 far from all people."""
    col = math.floor((x_m - near.x_min_m) / near.side_m)
    row = math.floor((y_m - near.y_min_m) / near.side_m)
    if col < 0 or row < 0 or col >= near.cols or row >= near.rows:
        return -1
    return int(row * near.cols + col)
