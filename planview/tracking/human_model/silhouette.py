"""The human model's soft silhouette: how probably a walking person covers a ray (Zhang et al. 2008, section 3.1)."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from calib.types import F32
from planview.tracking.body import (
    ANGLE_MIN_DEG,
    ANGLE_STEP_DEG,
    ANGLES,
    CELL_M,
    FINE_M,
    U_CELLS,
    W_CELLS,
    BodyTable,
    cylinders,
)

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


@lru_cache(maxsize=1)
def silhouette() -> BodyTable:
    """The table of all depression angles; its ``front`` is not known from a mask, and 0."""
    fine = round(CELL_M / FINE_M)
    u = (np.arange(-U_CELLS * fine, U_CELLS * fine) + 0.5) * FINE_M
    w = (np.arange(W_CELLS * fine) + 0.5 - W_CELLS * fine / 2) * FINE_M
    across, up = np.meshgrid(u, w, indexing="ij")
    cover: F32 = np.zeros((ANGLES, U_CELLS, W_CELLS), np.float32)
    for a in range(ANGLES):
        depression = float(np.deg2rad(ANGLE_MIN_DEG + a * ANGLE_STEP_DEG))
        whole = np.zeros(across.shape)
        for low, high, half_m, depth, share in PARTS:
            hit, _ = cylinders(depression, across, up, ((low, high, half_m, depth),))
            whole = np.maximum(whole, share * cv2.GaussianBlur(hit.astype(np.float64), (0, 0), BLUR_M / FINE_M))
        cover[a] = whole[U_CELLS * fine :].reshape(U_CELLS, fine, W_CELLS, fine).mean(axis=(1, 3))
    step, low_rad = float(np.deg2rad(ANGLE_STEP_DEG)), float(np.deg2rad(ANGLE_MIN_DEG))
    return BodyTable(cover, np.zeros_like(cover), low_rad, step, CELL_M, -W_CELLS * CELL_M / 2)
