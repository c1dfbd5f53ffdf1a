"""Compiled evidence for a set of ellipses; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64
from planview.tracking.ellipse_particle.fit._lm import EDGE, Match, inside_of, window_of


@njit(cache=True, nogil=True)
def explained(mask: F32, ellipses: F64, match: Match) -> float:
    """Half the weighted squared residual of the mask without any ellipse, less that with the union of soft ellipses.

    Residuals and weights are those of ``_lm.normal_equations``: a foreground cell well inside gains 1/2, a background
    cell there loses ``match.background`` / 2, and cells that no ellipse reaches count nothing.
    """
    n_rows, n_cols = mask.shape
    windows = np.empty((len(ellipses), 4), dtype=np.int64)
    for k in range(len(ellipses)):
        windows[k, 0], windows[k, 1], windows[k, 2], windows[k, 3] = window_of(ellipses, k, match.soft, n_rows, n_cols)
    r0, r1, c0, c1 = n_rows, -1, n_cols, -1
    for k in range(len(ellipses)):
        r0, r1 = min(r0, windows[k, 0]), max(r1, windows[k, 1])
        c0, c1 = min(c0, windows[k, 2]), max(c1, windows[k, 3])
    free = np.ones((max(0, r1 - r0 + 1), max(0, c1 - c0 + 1)))
    for k in range(len(ellipses)):
        x, y, a, b, angle = ellipses[k]
        s, c = math.sin(angle), math.cos(angle)
        far2 = 1.000001 * (1.0 + EDGE * match.soft / b) ** 2
        for r in range(windows[k, 0], windows[k, 1] + 1):
            dy = r - y
            for col in range(windows[k, 2], windows[k, 3] + 1):
                dx = col - x
                u, v = (dx * s + dy * c) / a, (dx * c - dy * s) / b
                inside, _ = inside_of(u * u + v * v, b, match.soft, far2)
                free[r - r0, col - c0] *= 1.0 - inside
    total = 0.0
    for i in range(free.shape[0]):
        for j in range(free.shape[1]):
            f = mask[r0 + i, c0 + j]
            residual = f - (1.0 - free[i, j])
            total += 0.5 * (f + match.background * (1.0 - f)) * (f * f - residual * residual)
    return total
