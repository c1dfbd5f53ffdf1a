"""How much of a person's length shows: what is much shorter is a thing, or a part of a person."""

from __future__ import annotations

import numpy as np

from calib.types import F32, F64, I64
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit.prior import SizePrior

UNSURE = 0.4 / 1.4
"""Foreground share of what was removed as a shadow: it may be dark clothes just as well, so it speaks neither for nor
against a person: s - w (1 - s) = 0 for ``EllipseFitParams.background_weight`` w = 0.4."""
LIMB = 0.03
"""Least breadth of what shows in a row, over the length of a person: half a leg, 0.1 m of 1.7 m. Legs together, one
behind the other or walking towards the camera are no broader than one, whatever the breadth of the ellipse, which is
that of arms and stride; the bars of a suitcase's handle are thinner."""
ROW_FILLED = 0.4
"""Share of foreground that makes a row of an ellipse belong to a body where an older one has a limb of it too: less is
what sticks out of the older one. Our choice: two bodies side by side fill so much each."""


def visible_length(mask: F32, ellipses: F64, order: I64, prior: SizePrior) -> F64:
    """Rows of each ellipse in which a body shows, over the length of a person there inside the grid.

    Only what is surely foreground counts; a shadow label is long and may be a shadow.

    Args:
        mask: (R, C) foreground share of each cell.
        ellipses: (N, 5).
        order: (N,) indices; cells of an ellipse do not count for those after it.
        prior: size expected per row.
    Returns:
        (N,) float64, about 1 for a whole person, 0.3 for a suitcase.
    """
    out = np.zeros((len(ellipses), 2))
    sure = np.maximum((mask - np.float32(UNSURE)) / np.float32(1 - UNSURE), np.float32(0))
    lengths = 2 * prior.half_lengths(ellipses[:, 1])
    kernels.shown_rows(sure, ellipses, order, LIMB * lengths, ROW_FILLED, out)
    inside = out[:, kernels.ROWS] / (2 * ellipses[:, 2])
    return np.asarray(out[:, kernels.SHOWN] / np.maximum(1.0, inside * lengths))
