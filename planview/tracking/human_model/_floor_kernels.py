"""Compiled projection of floor points; ``GroundCamera.project`` defines it in plain numpy."""

import math
from typing import NamedTuple

from numba import njit

from calib.types import F64


class FloorView(NamedTuple):
    """A ``GroundCamera``: sine and cosine of its tilt and roll, height [m], focal length [px], distortion [1/px] and
    the image's centre [px]."""

    sin_tilt: float
    cos_tilt: float
    sin_roll: float
    cos_roll: float
    height_m: float
    focal_px: float
    distortion_k: float
    centre_u: float
    centre_v: float


@njit(cache=True, nogil=True)
def project_point(view: FloorView, x_m: float, y_m: float) -> tuple[float, float]:
    """Pixel of a floor point, NaN behind the camera."""
    depth = y_m * view.sin_tilt + view.height_m * view.cos_tilt
    if not depth > 1e-6:
        return math.nan, math.nan
    x = view.focal_px * x_m / depth
    y = view.focal_px * (view.height_m * view.sin_tilt - y_m * view.cos_tilt) / depth
    r, k = math.sqrt(x * x + y * y), view.distortion_k
    scale = 1.0 + k * r if 1.0 + 2.0 * k * r > 0.0 else math.nan
    x, y = x * scale, y * scale
    s, c = view.sin_roll, view.cos_roll
    return c * x - s * y + view.centre_u, s * x + c * y + view.centre_v


@njit(cache=True, nogil=True)
def project_floor(view: FloorView, xy_m: F64, step_m: float, pixels: F64, jacobian: F64) -> None:
    """Pixels (N, 2) of floor points (N, 2), and (N, 2, 2) their derivatives by x and y over a step [px/m]."""
    for i in range(len(xy_m)):
        x, y = xy_m[i, 0], xy_m[i, 1]
        u, v = project_point(view, x, y)
        pixels[i, 0], pixels[i, 1] = u, v
        for axis in range(2):
            at_u, at_v = project_point(view, x + step_m * (axis == 0), y + step_m * (axis == 1))
            jacobian[i, 0, axis], jacobian[i, 1, axis] = (at_u - u) / step_m, (at_v - v) / step_m
