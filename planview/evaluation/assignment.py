"""One-to-one assignment of sparse pairs: most rows have one candidate, and only the others need to be solved."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from calib.types import F64, I64, Bool


def best_pairs(rows: I64, cols: I64, weight: F64, group: I64) -> Bool:
    """The pairs whose weights have the largest sum, every row and column at most once.

    Args:
        rows, cols: (P,) each pair once.
        weight: (P,) above 0.
        group: (P,) ascending; rows and columns of different groups differ.
    """
    chosen = lone_pairs(rows, cols)
    for pairs in groups_of(group, ~chosen):
        chosen[pairs] = solved(rows[pairs], cols[pairs], weight[pairs])
    return chosen


def lone_pairs(rows: I64, cols: I64) -> Bool:
    """(P,) whether a pair is the only one of its row and of its column."""
    return np.asarray((np.bincount(rows)[rows] == 1) & (np.bincount(cols)[cols] == 1)) if len(rows) else rows > 0


def groups_of(group: I64, members: Bool) -> Iterator[I64]:
    """The indices of the members of each group, of those that have any."""
    indices = np.flatnonzero(members)
    cuts = np.flatnonzero(np.diff(group[indices])) + 1
    bounds = [0, *cuts.tolist(), len(indices)]
    return (indices[a:b] for a, b in pairwise(bounds) if b > a)


def solved(rows: I64, cols: I64, weight: F64) -> Bool:
    """As ``best_pairs``, of one group."""
    from scipy.optimize import linear_sum_assignment  # half a second and 60 MB, and only what is ambiguous needs it

    row_values, i = np.unique(rows, return_inverse=True)
    col_values, j = np.unique(cols, return_inverse=True)
    matrix = np.zeros((len(row_values), len(col_values)))
    matrix[i, j] = -weight
    partner = np.full(len(row_values), -1)
    a, b = linear_sum_assignment(matrix)
    partner[a] = b
    return np.asarray(partner[i] == j)
