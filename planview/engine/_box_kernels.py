"""Compiled kernel of image boxes; ``tests/reference/boxes.py`` defines it in plain numpy."""

import math

from numba import njit

from calib.types import F64

NEAREST_M = 0.1
"""Corners nearer to the camera's plane than this are left out [m]."""


@njit(cache=True, nogil=True)
def extent_of_prism(  # type: ignore[no-untyped-def]
    projection: F64, x_m: float, y_m: float, radius_m: float, height_m: float
):
    """Smallest and largest u, then v [px] of the corners of an upright prism before the camera.

    ``projection`` (3, 4): world to image. Infinite, the smallest above the largest, where no corner is in front.
    """
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for corner in range(8):
        x = x_m + (radius_m if corner & 1 else -radius_m)
        y = y_m + (radius_m if corner & 2 else -radius_m)
        z = height_m if corner & 4 else 0.0
        depth = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
        if depth <= NEAREST_M:
            continue
        u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / depth
        v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / depth
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    return left, right, top, bottom
