"""The cheapest one-to-one assignment of a few rows to columns.

``scipy.optimize`` has the same, and takes half a second and 60 MB to import: before the first frame of every run, or as
a pause in a run in real time when people first meet.
"""

from __future__ import annotations

import numpy as np

from calib.types import F64, I64


def assign(cost: F64) -> list[int]:
    """The column of every row, all different, at the smallest sum of costs.

    Shortest augmenting paths with row and column prices (Crouse 2016, "On implementing 2D rectangular assignment
    algorithms", algorithm 1).

    Args:
        cost: (R, C) finite, R <= C.
    Raises:
        ValueError: more rows than columns, or a cost that is not finite.
    """
    rows, columns = cost.shape
    if rows > columns or not np.isfinite(cost).all():
        raise ValueError(f"expected a finite cost of at most as many rows as columns, found {rows}x{columns}")
    row_price, column_price = np.zeros(rows), np.zeros(columns)
    owner: I64 = np.full(columns, -1)
    for row in range(rows):
        _augment(cost, row, owner, row_price, column_price)
    return [int(np.flatnonzero(owner == row)[0]) for row in range(rows)]


def _augment(cost: F64, start: int, owner: I64, row_price: F64, column_price: F64) -> None:
    """Give a row a column, in place, along the cheapest path over columns that change their owners."""
    reached: F64 = np.full(len(owner), np.inf)
    via: I64 = np.full(len(owner), -1)
    done = np.zeros(len(owner), dtype=np.bool_)
    rows, row, length = [start], start, 0.0
    while True:
        through = length + cost[row] - row_price[row] - column_price
        better = ~done & (through < reached)
        reached[better], via[better] = through[better], row
        column = int(np.argmin(np.where(done, np.inf, reached)))
        length, done[column] = float(reached[column]), True
        if owner[column] < 0:
            break
        row = int(owner[column])
        rows.append(row)
    row_price[start] += length
    for other in rows[1:]:
        row_price[other] += length - reached[owner == other][0]
    column_price[done] -= length - reached[done]
    while True:
        row = int(via[column])
        previous = np.flatnonzero(owner == row)
        owner[column] = row
        if row == start:
            return
        column = int(previous[previous != column][0])
