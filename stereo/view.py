"""The common view of a rectified pair: its orientation, field and where its pixels come from."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.camera import Camera
from calib.rig import StereoRig
from calib.types import F32, F64
from stereo.depth import RectifiedGeometry

MAX_RAY_TAN = math.tan(math.radians(60.0))
"""Rays farther than 60 degrees from the axis are left out: a plane image stretches them beyond use."""


def source_pixels(camera: Camera, rotation: F64, pixel_to_ray: F64, size: tuple[int, int]) -> F32:
    """Recorded pixels that rectified pixels show.

    Args:
        rotation: (3, 3) recorded camera frame to rectified frame.
        pixel_to_ray: (3, 3) homogeneous rectified pixel to rectified ray.
        size: (width, height) of the rectified image [px].
    Returns:
        (H, W, 2) float32 [px]; NaN behind the camera and where the lens model folds back on itself.
    """
    matrix, coefficients = np.linalg.inv(pixel_to_ray), camera.coefficients
    maps = cv2.fisheye.initUndistortRectifyMap if camera.model == "fisheye" else cv2.initUndistortRectifyMap
    u, v = maps(camera.matrix, coefficients, rotation, matrix, size, cv2.CV_32FC1)
    pixels = np.stack([u, v], axis=-1, dtype=np.float32)
    columns, rows = np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64)[:, None]
    x, y, z = (row[0] * columns + row[1] * rows + row[2] for row in rotation.T @ pixel_to_ray)
    limit = min(fold_radius(camera), 1e6)
    pixels[(z <= 0) | (x * x + y * y > (limit * z) ** 2)] = np.nan
    return pixels


def fold_radius(camera: Camera) -> float:
    """Tangent of the angle from the axis beyond which the lens model turns back into the image.

    Polynomials hold only where they were fitted; beyond, OAK-D's rational model for one maps the far outside back
    onto the image.
    """
    radius = np.linspace(0.0, 8.0, 4001)
    out = camera.project(np.column_stack([radius, np.zeros_like(radius), np.ones_like(radius)]))
    back = np.flatnonzero(np.diff(out[:, 0]) <= 0)
    return float(radius[back[0]]) if back.size else math.inf


def border_rays(camera: Camera, samples: int = 33) -> F64:
    """Rays through the four outer edges of an image.

    Returns:
        (4, samples, 3) float64 at unit z: left, right, top, bottom edge; where the lens model has no inverse, the
        outermost ray that it has in that direction.
    """
    w, h = camera.width - 0.5, camera.height - 0.5
    across, down = np.linspace(-0.5, w, samples), np.linspace(-0.5, h, samples)
    low = np.full(samples, -0.5)
    edges = [(low, down), (np.full(samples, w), down), (across, low), (across, np.full(samples, h))]
    pixels = np.concatenate([np.column_stack(edge) for edge in edges])
    limit = min(fold_radius(camera), MAX_RAY_TAN)
    rays = camera.unproject(pixels)
    good = np.isfinite(rays).all(axis=1) & (np.hypot(rays[:, 0], rays[:, 1]) <= limit)
    good &= np.hypot(*(camera.project(np.where(good[:, None], rays, 1.0)) - pixels).T) < 0.5
    towards = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    towards *= limit / np.linalg.norm(towards, axis=1, keepdims=True)
    rays[~good, :2] = towards[~good]
    rays[~good, 2] = 1.0
    return rays.reshape(4, samples, 3)


def common_geometry(rig: StereoRig, rotation: F64, working_px: int, field_quantile: float) -> RectifiedGeometry:
    """The rectified pinhole that shows the left camera's field of view at the working size."""
    return ideal_pinhole(rig.left, rotation, working_px, field_quantile, rig.baseline_m)


def ideal_pinhole(
    camera: Camera, rotation: F64, working_px: int, field_quantile: float, baseline_m: float
) -> RectifiedGeometry:
    """The pinhole without distortion that shows a turned camera's field of view at the working size."""
    left, right, top, bottom = _field(camera, rotation, field_quantile)
    width, height = camera.size
    if (right - left) * height < (bottom - top) * width and abs(rotation[0, 1]) > abs(rotation[0, 0]):
        width, height = height, width  # cameras one above the other: the rectified image lies on its side
    scale = min(1.0, working_px / max(width, height)) if working_px else 1.0
    width, height = max(16, round(width * scale)), max(16, round(height * scale))
    focal = min(width / (right - left), height / (bottom - top))
    cu, cv = (width - 1) / 2 - focal * (left + right) / 2, (height - 1) / 2 - focal * (top + bottom) / 2
    return RectifiedGeometry(width, height, focal, focal, cu, cv, baseline_m)


def _field(camera: Camera, rotation: F64, quantile: float) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of the field of view on the rectified plane at unit depth."""
    rays = border_rays(camera) @ rotation.T
    plane = rays[..., :2] / np.maximum(rays[..., 2:], 0.1)
    centre = rotation @ np.array([0.0, 0.0, 1.0])
    offsets = plane.mean(axis=1) - centre[:2] / centre[2]
    edges = *(f(offsets[:, 0]) for f in (np.argmin, np.argmax)), *(f(offsets[:, 1]) for f in (np.argmin, np.argmax))
    bounds = [
        sign * min(float(np.quantile(sign * plane[edge, :, axis], quantile)), MAX_RAY_TAN)
        for edge, axis, sign in zip(edges, (0, 0, 1, 1), (-1, 1, -1, 1), strict=True)
    ]
    return bounds[0], bounds[1], bounds[2], bounds[3]
