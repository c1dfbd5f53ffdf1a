"""Compiled sums over regions; ``tests/reference/ellipses.py`` defines them in plain numpy."""

import numpy as np
from numba import njit

from calib.types import F64, I32, Bool


@njit(cache=True, nogil=True)
def region_sums(labels: I32, moving: Bool, sums: F64, moved: F64) -> None:
    """Add to each region's row of sums its number of cells and the sums of their x, y, x^2, x y, y^2.

    labels: (R, C), 0 for the background; moving: (R, C) cells that move, or (0, 0) where that is not known.
    sums: (N, 6), moved: (N,) how many of its cells move; both zero before.
    """
    n_rows, n_cols = labels.shape
    for r in range(n_rows):
        row = labels[r]
        for c in range(np.uintp(n_cols)):
            k = row[c]
            if k > 0:
                x, y = float(c), float(r)
                sums[k, 0] += 1.0
                sums[k, 1] += x
                sums[k, 2] += y
                sums[k, 3] += x * x
                sums[k, 4] += x * y
                sums[k, 5] += y * y
                if moving.size and moving[r, c]:
                    moved[k] += 1.0
