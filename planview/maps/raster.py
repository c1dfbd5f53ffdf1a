"""Points to maps on a grid: accumulate, smooth, mask (Harville 2002, section 3)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.types import F32
from planview.maps._kernels import accumulate
from planview.maps.grid import Grid


class Raster:
    """Height and occupancy of points on one grid.

    Args:
        height_min_m: lower points are left out [m].
        smoothing_m: deviation of the Gaussian on both maps [m].
        occupancy_min: theta_occ of this grid [m^2 per cell].
    """

    def __init__(self, grid: Grid, height_min_m: float, smoothing_m: float, occupancy_min: float) -> None:
        self.grid, self.occupancy_min = grid, occupancy_min
        self._height_min_m = height_min_m
        self._sigma = smoothing_m / grid.cell_m

    def accumulate(self, xyz: F32, area: F32) -> tuple[F32, F32]:
        """Highest point [m] and summed area [m^2] of every cell.

        Args:
            xyz: (N, 3) float32 world points [m].
            area: (N,) float32 [m^2].
        """
        height = np.empty(self.grid.shape, dtype=np.float32)
        total = np.empty(self.grid.shape, dtype=np.float32)
        g = self.grid
        accumulate(xyz, area, self._height_min_m, g.x_min_m, g.y_min_m, g.cell_m, height, total)
        return height, total

    def smooth(self, height_raw: F32, occupancy_raw: F32) -> tuple[F32, F32]:
        """H_masked and O_sm. The height is smoothed over occupied cells only, or edges would sink."""
        height, occupancy = np.zeros_like(height_raw), np.zeros_like(occupancy_raw)
        # Most of the floor is empty: only the part around occupied cells is worth smoothing.
        part = occupied_part(occupancy_raw, 2 * math.ceil(3 * self._sigma))
        raw = height_raw[part]
        if self._sigma > 0.0:
            occupancy[part] = _blur(occupancy_raw[part], self._sigma)
            share = _blur((raw > 0.0).astype(np.float32), self._sigma)
            smooth = np.divide(_blur(raw, self._sigma), np.maximum(share, 1e-3), dtype=np.float32)
        else:
            occupancy[part], smooth = occupancy_raw[part], raw
        np.copyto(height[part], smooth, where=occupancy[part] >= np.float32(self.occupancy_min))
        return height, occupancy


def occupied_part(occupancy: F32, margin: int) -> tuple[slice, slice]:
    """Bounding rectangle of the cells that are not zero, wider by a margin [cells]."""
    left, top, width, height = cv2.boundingRect((occupancy > 0.0).view(np.uint8))
    if width == 0:
        return slice(0, 0), slice(0, 0)
    return (
        slice(max(0, top - margin), top + height + margin),
        slice(max(0, left - margin), left + width + margin),
    )


def _blur(image: F32, sigma: float) -> F32:
    if image.size == 0:
        return image
    radius = max(1, round(3 * sigma))
    return np.asarray(
        cv2.GaussianBlur(image, (2 * radius + 1, 2 * radius + 1), sigma, borderType=cv2.BORDER_CONSTANT),
        dtype=np.float32,
    )
