"""Rectification: both images as if taken by one ideal pinhole, moved along its own x axis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from calib.camera import Camera
from calib.params import Params
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8
from stereo.depth import RectifiedGeometry
from stereo.vertical import VerticalModel

MAX_RAY_TAN = math.tan(math.radians(60.0))
"""Rays farther than 60 degrees from the axis are left out: a plane image stretches them beyond use."""


class RectifyParams(Params):
    """Rectification."""

    working_px: int = Field(default=640, ge=0, le=8192)
    """Longest side of the rectified images [px]; larger recordings are reduced to it, 0 keeps the full size. Harville
    2002, section 5, ran at 320x240; 640 keeps a head at 8 m some 10 px wide (our choice)."""
    field_quantile: float = Field(default=0.5, ge=0.0, le=1.0)
    """How much of a distorted border to keep: 0 the largest view without empty corners, 1 every pixel with many of
    them; between, that share of each border (our choice)."""


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """One rectified pair.

    Attributes:
        left: (H, W) or (H, W, 3) uint8, as recorded.
        left_grey, right_grey: (H, W) uint8 for matching; left_grey is left when that is grey.
    """

    left: U8
    left_grey: U8
    right_grey: U8


class Rectifier:
    """Maps recorded pairs to rectified ones.

    Attributes:
        geometry: the pinhole both rectified images share.
        rect_SE3_left: rotation from the recorded to the rectified left camera.
        mask: (H, W) uint8, 255 where the rectified left image shows something.
    """

    def __init__(
        self, rig: StereoRig, params: RectifyParams | None = None, vertical: VerticalModel | None = None
    ) -> None:
        """Prepare the maps.

        Args:
            rig: calibration at the recorded size.
            vertical: measured vertical residual to take out of the right image, at the rectified size.
        """
        self.rig = rig
        self.params = params or RectifyParams()
        self.vertical = vertical or VerticalModel()
        left_rotation, right_rotation = rectifying_rotations(rig)
        self.rect_SE3_left = SE3(left_rotation, np.zeros(3))
        self._reduced = _reduced_size(rig.left.size, self.params.working_px)
        self.geometry = _geometry(rig, left_rotation, self.params)
        u, v = _pixel_grid(self.geometry)
        self._left_maps, self.mask = self._maps(rig.left, left_rotation, u, v)
        self._right_maps, self.right_mask = self._maps(rig.right, right_rotation, u, v + self.vertical(u, v))

    def __call__(self, left: U8, right: U8) -> RectifiedPair:
        """Rectify one pair.

        Args:
            left, right: (h, w) or (h, w, 3) uint8 at the rig's size, BGR.
        Raises:
            ValueError: images of another size.
        """
        size = self.rig.left.size[::-1]
        if left.shape[:2] != size or right.shape[:2] != size:
            raise ValueError(f"expected images of shape {size}, got {left.shape} and {right.shape}")
        rectified = self._warp(left, self._left_maps)
        return RectifiedPair(rectified, grey(rectified), self._warp(grey(right), self._right_maps))

    def _maps(self, camera: Camera, rotation: F64, u: F64, v: F64) -> tuple[tuple[U8, U8], U8]:
        pixels = source_pixels(camera, rotation, self.geometry, u, v)
        inside = (
            (pixels[..., 0] >= 0)
            & (pixels[..., 0] <= camera.width - 1)
            & (pixels[..., 1] >= 0)
            & (pixels[..., 1] <= camera.height - 1)
        )
        shrink = np.array(self._reduced) / np.array(camera.size)
        reduced = ((np.where(inside[..., None], pixels, -1e4) + 0.5) * shrink - 0.5).astype(np.float32)
        fixed, fraction = cv2.convertMaps(reduced[..., 0], reduced[..., 1], cv2.CV_16SC2)
        return (fixed, fraction), np.where(inside, np.uint8(255), np.uint8(0))

    def _warp(self, image: U8, maps: tuple[U8, U8]) -> U8:
        if self._reduced != self.rig.left.size:
            image = np.asarray(cv2.resize(image, self._reduced, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), dtype=np.uint8)


def grey(image: U8) -> U8:
    """(H, W) of an image; itself when it is grey."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def rectifying_rotations(rig: StereoRig) -> tuple[F64, F64]:
    """Rotations from each recorded camera frame to the common rectified one.

    x points from the left to the right camera centre, z lies as near as it can to the mean of the two optical axes
    (Fusiello, Trucco, Verri 2000, with the mean axis instead of the old left one).

    Raises:
        ValueError: one camera in front of the other, where no common image plane exists.
    """
    right_SE3_left = rig.right_SE3_left
    x_axis = -right_SE3_left.rotation.T @ right_SE3_left.translation
    x_axis = x_axis / np.linalg.norm(x_axis)
    mean_axis = np.array([0.0, 0.0, 1.0]) + right_SE3_left.rotation[2]
    y_axis = np.cross(mean_axis, x_axis)
    if np.linalg.norm(y_axis) < 0.2 * np.linalg.norm(mean_axis) or np.linalg.norm(mean_axis) < 0.5:
        raise ValueError("expected cameras side by side that look the same way, got one in front of the other")
    y_axis /= np.linalg.norm(y_axis)
    left = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    return left, left @ right_SE3_left.rotation.T


def source_pixels(camera: Camera, rotation: F64, geometry: RectifiedGeometry, u: F64, v: F64) -> F64:
    """Recorded pixels that rectified pixels show.

    Args:
        rotation: (3, 3) recorded camera frame to rectified frame.
        u, v: (H, W) rectified pixels.
    Returns:
        (H, W, 2) float64 [px]; NaN behind the camera and where the lens model folds back on itself.
    """
    rays = np.stack(
        [(u - geometry.cu_px) / geometry.focal_u_px, (v - geometry.cv_px) / geometry.focal_v_px, np.ones_like(u)],
        axis=-1,
    )
    rays = rays.reshape(-1, 3) @ rotation
    folded = np.hypot(rays[:, 0], rays[:, 1]) > fold_radius(camera) * rays[:, 2]
    rays[folded, 2] = -1.0
    return np.asarray(camera.project(rays).reshape(*u.shape, 2), dtype=np.float64)


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


def _geometry(rig: StereoRig, rotation: F64, params: RectifyParams) -> RectifiedGeometry:
    """The rectified pinhole that shows the left camera's field of view at the working size."""
    left, right, top, bottom = _field(rig.left, rotation, params.field_quantile)
    width, height = rig.left.size
    if (right - left) * height < (bottom - top) * width and abs(rotation[0, 1]) > abs(rotation[0, 0]):
        width, height = height, width  # cameras one above the other: the rectified image lies on its side
    scale = min(1.0, params.working_px / max(width, height)) if params.working_px else 1.0
    width, height = max(16, round(width * scale)), max(16, round(height * scale))
    focal = min(width / (right - left), height / (bottom - top))
    cu, cv = (width - 1) / 2 - focal * (left + right) / 2, (height - 1) / 2 - focal * (top + bottom) / 2
    return RectifiedGeometry(width, height, focal, focal, cu, cv, rig.baseline_m)


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


def _reduced_size(size: tuple[int, int], working_px: int) -> tuple[int, int]:
    """Size to which recorded images are averaged before the warp: a whole fraction, which is the fast case.

    Up to 1.7 source pixels per rectified one the warp alone aliases little; averaging more would blur.
    """
    factor = max(1, math.floor(max(size) / working_px + 0.3)) if working_px else 1
    return max(1, size[0] // factor), max(1, size[1] // factor)


def _pixel_grid(geometry: RectifiedGeometry) -> tuple[F64, F64]:
    u, v = np.meshgrid(np.arange(geometry.width, dtype=np.float64), np.arange(geometry.height, dtype=np.float64))
    return u, v
