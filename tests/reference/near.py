"""Plain numpy twin of planview/tracking/_near_kernels.py."""

import numpy as np

from calib.types import F64, I64


def people_within(people: F64, reach_m: float, x_m: float, y_m: float) -> I64:
    """Indices of all people nearer than ``reach_m`` to a point, which must be among those that its cell lists."""
    return np.flatnonzero(np.hypot(people[:, 0] - x_m, people[:, 1] - y_m) < reach_m)
