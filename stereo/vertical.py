"""Vertical residual of a rectified pair: how far matches lie off their row."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64


@dataclass(frozen=True)
class VerticalModel:
    """Row offset v_right - v_left of matching points, affine over the right image.

    Attributes:
        offset_px: at the image's pixel (0, 0) [px].
        per_u, per_v: change per pixel along a row and down a column.
    """

    offset_px: float = 0.0
    per_u: float = 0.0
    per_v: float = 0.0

    def __call__(self, u: F64, v: F64) -> F64:
        """Offsets [px] at pixels of any shape."""
        return np.asarray(self.offset_px + self.per_u * u + self.per_v * v, dtype=np.float64)
