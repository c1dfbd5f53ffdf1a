"""The human model's soft silhouette: how probably a walking person covers a ray (Zhang et al. 2008, section 3.1)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planview.tracking.body import BodyTable, Part, table_of

PARTS = (
    (0.00, 0.27, 0.28, 1.0, 0.3),
    (0.00, 0.27, 0.13, 1.0, 0.5),
    (0.27, 0.48, 0.17, 0.8, 0.85),
    (0.45, 0.82, 0.23, 0.65, 1.0),
    (0.42, 0.80, 0.29, 0.8, 0.5),
    (0.82, 0.86, 0.16, 0.65, 1.0),
    (0.86, 0.98, 0.10, 1.0, 1.0),
    (0.98, 1.00, 0.07, 1.0, 1.0),
)
"""Striding legs, shins, thighs, torso, arms, shoulders, head, crown: from and to [of the height], half breadth [m] of a
body of 1.76 m, depth over breadth, and how often it covers (Zhang's cylinders, as wide as arms and a stride)."""
BLUR_M = 0.035
"""Deviation of the outline [m]: clothes and posture."""
SUREST = 0.999
"""No part covers for certain: in a mask the seams between parts are as unsure as the outline."""


@lru_cache(maxsize=1)
def silhouette() -> BodyTable:
    """The table of all depression angles; its ``front`` is not known from a mask, and 0."""
    table = table_of(
        [Part(((low, high, half_m, depth),), BLUR_M, min(covers, SUREST)) for low, high, half_m, depth, covers in PARTS]
    )
    return table._replace(front=np.zeros_like(table.front))
