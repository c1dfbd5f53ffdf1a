"""Plain numpy twin of planview/engine/_box_kernels.py; it defines what the compiled loop computes."""

import numpy as np

from calib.types import F64
from planview.engine._box_kernels import NEAREST_M


def extent_of_prism(
    projection: F64, x_m: float, y_m: float, radius_m: float, height_m: float
) -> tuple[float, float, float, float]:
    r = radius_m
    corners = [(x_m + x, y_m + y, z, 1.0) for x in (-r, r) for y in (-r, r) for z in (0.0, height_m)]
    u, v, depth = projection @ np.array(corners).T
    front = depth > NEAREST_M
    if not front.any():
        return np.inf, -np.inf, np.inf, -np.inf
    u, v = u[front] / depth[front], v[front] / depth[front]
    return float(u.min()), float(u.max()), float(v.min()), float(v.max())
