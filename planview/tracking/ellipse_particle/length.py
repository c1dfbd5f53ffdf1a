"""How much of a person's length shows: what is much shorter is a thing, or a piece of somebody."""

from __future__ import annotations

import numpy as np

from calib.types import F32, F64, I64
from planview import _ellipse_kernels as kernels
from planview.ellipses import SizePrior

ROW_FILLED = 0.4
"""Share of foreground that makes a row of an ellipse belong to a body: legs apart fill so much, a shadow less. Our
choice."""


def length_shown(mask: F32, ellipses: F64, order: I64, prior: SizePrior) -> F64:
    """Rows of each ellipse that foreground fills, over the length of a person there inside the grid.

    Args:
        mask: (R, C) foreground share of each cell.
        ellipses: (N, 5).
        order: (N,) indices; cells of an ellipse do not count for those after it.
        prior: size expected per row.
    Returns:
        (N,) float64, about 1 for a whole person, 0.3 for a suitcase.
    """
    out = np.zeros((len(ellipses), 2))
    kernels.shown_rows(mask, ellipses, order, ROW_FILLED, out)
    inside = out[:, 1] / (2 * ellipses[:, 2])
    return np.asarray(out[:, 0] / np.maximum(1.0, inside * 2 * prior.half_lengths(ellipses[:, 1])))
