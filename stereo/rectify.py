"""Rectification: both images as if taken by one ideal pinhole, moved along its own x axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from pydantic import Field

from calib.camera import Camera
from calib.images import as_grey
from calib.params import Params
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F32, F64, U8, AnyArray, Bool
from stereo.depth import RectifiedGeometry, middle_px
from stereo.matcher import disparity_range
from stereo.recording import Frame, Shot
from stereo.rig_correction import RigCorrection, measure_correction

MAX_RAY_TAN = math.tan(math.radians(60.0))
"""Rays farther than 60 degrees from the axis are left out: a plane image stretches them beyond use."""


def source_pixels(camera: Camera, rotation: F64, pixel_to_ray: F64, size: tuple[int, int]) -> F32:
    """Recorded pixels that rectified pixels show.

    (H, W, 2) float32 [px]; NaN behind the camera and where the lens model folds back on itself.

    Args:
        rotation: (3, 3) recorded camera frame to rectified frame.
        pixel_to_ray: (3, 3) homogeneous rectified pixel to rectified ray.
        size: (width, height) of the rectified image [px].
    """
    matrix = np.linalg.inv(pixel_to_ray)
    maps = cv2.fisheye.initUndistortRectifyMap if camera.model == "fisheye" else cv2.initUndistortRectifyMap
    u, v = maps(camera.matrix, camera.coefficients, rotation, matrix, size, cv2.CV_32FC1)
    pixels = np.stack([u, v], axis=-1, dtype=np.float32)
    columns = np.arange(size[0], dtype=np.float64)
    rows = np.arange(size[1], dtype=np.float64)[:, None]
    x, y, z = (row[0] * columns + row[1] * rows + row[2] for row in rotation.T @ pixel_to_ray)
    limit = min(fold_radius(camera), 1e6)
    is_folded = x * x + y * y > (limit * z) ** 2
    pixels[(z <= 0) | is_folded] = np.nan
    return pixels


def fold_radius(camera: Camera) -> float:
    """Tangent of the angle from the axis beyond which the lens model turns back into the image.

    Polynomials hold only where they were fitted: OAK-D's rational model for one maps the far outside onto the image.
    """
    radius = np.linspace(0.0, 8.0, 4001)
    out = camera.project(np.column_stack([radius, np.zeros_like(radius), np.ones_like(radius)]))
    back = np.flatnonzero(np.diff(out[:, 0]) <= 0)
    return float(radius[back[0]]) if back.size else math.inf


BORDER_RAYS = 33
"""Along each edge of an image."""


def border_rays(camera: Camera) -> F64:
    """(4, BORDER_RAYS, 3) float64 rays at unit z through the left, right, top and bottom edge of an image; where the
    lens model has no inverse, the outermost ray that it has in that direction."""
    right = camera.width - 0.5
    bottom = camera.height - 0.5
    across = np.linspace(-0.5, right, BORDER_RAYS)
    down = np.linspace(-0.5, bottom, BORDER_RAYS)
    edges: Any = [(-0.5, down), (right, down), (across, -0.5), (across, bottom)]
    pixels: F64 = np.concatenate([np.column_stack(np.broadcast_arrays(u, v)) for u, v in edges])
    limit = min(fold_radius(camera), MAX_RAY_TAN)
    rays = camera.unproject(pixels)
    good = np.isfinite(rays).all(axis=1) & (np.hypot(rays[:, 0], rays[:, 1]) <= limit)
    again = camera.project(np.where(good[:, None], rays, 1.0))
    good &= np.hypot(*(again - pixels).T) < 0.5
    towards = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    towards *= limit / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    rays[~good, :2] = towards[~good]
    rays[~good, 2] = 1.0
    return rays.reshape(4, BORDER_RAYS, 3)


def ideal_pinhole(
    camera: Camera, rotation: F64, working_px: int, field_quantile: float, baseline_m: float
) -> RectifiedGeometry:
    """The pinhole without distortion that shows a turned camera's field of view at the working size; of a pair that of
    the left camera, turned into the rectified frame."""
    rays = border_rays(camera) @ rotation.T
    plane = rays[..., :2] / np.maximum(rays[..., 2:], 0.1)  # at unit depth
    centre = rotation @ np.array([0.0, 0.0, 1.0])
    middles = plane.mean(axis=1) - centre[:2] / centre[2]

    def reach(axis: int, sign: int) -> float:
        """Reach of the border that is now farthest to the right (0, 1), the left (0, -1), down or up."""
        border = np.argmax(sign * middles[:, axis])
        outward = sign * plane[border, :, axis]
        return min(float(np.quantile(outward, field_quantile)), MAX_RAY_TAN)

    left = -reach(0, -1)
    right = reach(0, 1)
    top = -reach(1, -1)
    bottom = reach(1, 1)
    width, height = camera.size
    is_on_its_side = abs(rotation[0, 1]) > abs(rotation[0, 0])  # cameras one above the other
    if is_on_its_side and (right - left) * height < (bottom - top) * width:
        width, height = height, width
    scale = min(1.0, working_px / max(width, height)) if working_px else 1.0
    width = max(16, round(width * scale))
    height = max(16, round(height * scale))
    focal = min(width / (right - left), height / (bottom - top))
    cu = (width - 1) / 2 - focal * (left + right) / 2
    cv = (height - 1) / 2 - focal * (top + bottom) / 2
    return RectifiedGeometry(width, height, focal, focal, cu, cv, baseline_m)


class Warp:
    """Recorded images to those of a pinhole, averaged down first where they are much larger.

    Attributes:
        mask: (H, W) uint8, 255 where the pinhole's image shows something.
    """

    def __init__(
        self, camera: Camera, rotation: F64, pixel_to_ray: F64, size: tuple[int, int], working_px: int
    ) -> None:
        """Prepare the maps (arguments of ``source_pixels``).

        ``working_px`` is about the longest side that images are averaged down to before the warp [px], by a whole
        factor, which is the fast case; 0 keeps their size. Up to 1.7 source pixels per rectified one the warp alone
        aliases little; averaging more would blur.
        """
        factor = max(1, math.floor(max(camera.size) / working_px + 0.3)) if working_px else 1
        self._source_size = max(1, camera.width // factor), max(1, camera.height // factor)
        self._pixels = source_pixels(camera, rotation, pixel_to_ray, size)
        recorded = np.array(camera.size)
        averaged = np.array(self._source_size)
        inside: Bool = np.all((self._pixels > -0.5) & (self._pixels < recorded - 0.5), axis=-1)
        self.mask: U8 = np.where(inside, np.uint8(255), np.uint8(0))
        pixels = (self._pixels + 0.5) * (averaged / recorded) - 0.5
        pixels = np.clip(pixels, 0.0, averaged - 1.0)
        pixels[~inside] = -1e4  # outside, where nothing is
        # OpenCV's fixed-point maps: whole pixels (H, W, 2) int16 and fractions (H, W) uint16.
        u, v = cv2.split(pixels.astype(np.float32))
        fixed, fraction = cv2.convertMaps(u, v, cv2.CV_16SC2)
        self._maps: tuple[AnyArray, AnyArray] = np.asarray(fixed), np.asarray(fraction)

    def __call__(self, image: U8) -> U8:
        """(H, W) or (H, W, 3) uint8 of an image of the camera, or of its ``source``, by bilinear interpolation."""
        return np.asarray(cv2.remap(self.source(image), *self._maps, cv2.INTER_LINEAR), dtype=np.uint8)

    def grey(self, image: U8) -> U8:
        """(H, W) uint8: a call, of an image in grey."""
        return self(as_grey(image))

    def source(self, image: U8) -> U8:
        """An image of the camera, or what another warp of it needs, averaged down as this warp needs it."""
        if self._source_size == image.shape[1::-1]:
            return image
        return np.asarray(cv2.resize(image, self._source_size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def nearest(self, depth: F32) -> F32:
        """(H, W) float32 of a depth image of the camera: nearest pixels, as a mean over an edge is nowhere; else NaN.

        The depth along the optical axis stays what it is only when the pinhole has the camera's orientation.
        """
        u, v = cv2.split(self._pixels)
        found = cv2.remap(depth, u, v, cv2.INTER_NEAREST, borderValue=math.nan)
        return np.where(self.mask > 0, found, np.float32(np.nan))


class RectifyParams(Params):
    """Rectification."""

    working_px: int = Field(default=640, ge=0, le=8192)
    """Longest side of the rectified images [px]; larger recordings are reduced to it, 0 keeps the full size. Harville
    2002, section 5, ran at 320x240; 640 keeps a head at 8 m some 10 px wide."""
    field_quantile: float = Field(default=0.5, ge=0.0, le=1.0)
    """Share of a distorted border to keep: 0 the largest view without empty corners, 1 every pixel with many of
    them; between, that share of each border."""


class Rectified(NamedTuple):
    """One rectified pair: the left image, (H, W) or (H, W, 3) uint8 as recorded, or that of means between its pixels,
    (h, w[, 3]); both in (H, W) grey for matching; and what makes the (H, W[, 3]) left image."""

    image: U8
    left_grey: U8
    right_grey: U8
    picture: Callable[[], U8]


class Rectifier:
    """Maps recorded pairs to rectified ones.

    Attributes:
        geometry: the pinhole both rectified images share.
        rect_SE3_left: rotation from the recorded to the rectified left camera.
        mask: (H, W) uint8, 255 where the rectified left image shows something.
    """

    def __init__(self, rig: StereoRig, params: RectifyParams | None = None) -> None:
        """Prepare the maps; ``rig`` is the calibration at the recorded size."""
        self.rig = rig
        self._shape = rig.left.size[::-1]
        self.params = params or RectifyParams()
        left_rotation, right_rotation = rig.rectifying_rotations()
        self.rect_SE3_left = SE3(left_rotation, np.zeros(3))
        size_px = self.params.working_px
        quantile = self.params.field_quantile
        self.geometry = ideal_pinhole(rig.left, left_rotation, size_px, quantile, rig.baseline_m)
        to_ray = self.geometry.pixel_to_ray
        self._left = Warp(rig.left, left_rotation, to_ray, self.geometry.size, size_px)
        self._right = Warp(rig.right, right_rotation, to_ray, self.geometry.size, size_px)
        self._smaller = {1: self._left}
        self.mask = self._left.mask
        self.right_mask = self._right.mask

    def __call__(self, left: U8, right: U8) -> Rectified:
        """Rectify (h, w) or (h, w, 3) uint8 images at the rig's size, BGR. Raises ValueError: another size."""
        self._check(left, right)
        rectified = self._left(left)
        return Rectified(rectified, as_grey(rectified), self._right.grey(right), lambda: rectified)

    def reduce(self, left: U8, right: U8, step: int) -> Rectified:
        """Rectify a pair, its left image as recorded at an n-th of the size (arguments and errors as of a call)."""
        self._check(left, right)
        ours = self._left.source(left)
        image = self._smaller_left(step)(ours)
        return Rectified(image, self._left.grey(ours), self._right.grey(right), partial(self._left, left))

    def _smaller_left(self, step: int) -> Warp:
        """Warp of the left image at an n-th of its size."""
        if step not in self._smaller:
            width, height = self.geometry.size
            size = (-(-width // step), -(-height // step))
            middle = middle_px(0, step)
            scale = np.array([[step, 0.0, middle], [0.0, step, middle], [0.0, 0.0, 1.0]])
            to_ray = self.geometry.pixel_to_ray @ scale
            rotation = self.rect_SE3_left.rotation
            self._smaller[step] = Warp(self.rig.left, rotation, to_ray, size, max(size))
        return self._smaller[step]

    def _check(self, left: U8, right: U8) -> None:
        if not left.shape[:2] == right.shape[:2] == self._shape:
            raise ValueError(f"expected images of shape {self._shape}, got {left.shape} and {right.shape}")


def aligned_rectifier(
    rig: StereoRig, frames: Iterable[Frame[Shot]], params: RectifyParams
) -> tuple[Rectifier, Rectifier, RigCorrection]:
    """Rectifiers of the calibration as it is and as some frames correct it, a dozen spread over the recording, so that
    light and movement differ; and what was measured, in pixels of the images of the second."""
    # Longest side of the images in which the calibration is corrected [px]: more cost time.
    plain = Rectifier(rig, params.model_copy(update={"working_px": 1280}))
    searched = disparity_range(plain.geometry)

    def greys(frame: Frame[Shot]) -> tuple[U8, U8]:
        pair = plain(*frame.images)
        return pair.left_grey, pair.right_grey

    correction = measure_correction(map(greys, frames), plain.geometry, searched.first_px + searched.count)
    rectifier = Rectifier(correction(rig), params)
    scale = rectifier.geometry.width / plain.geometry.width
    before_px = correction.before_px * scale
    after_px = correction.after_px * scale
    return plain, rectifier, replace(correction, before_px=before_px, after_px=after_px)


def rectified_rig(rig: StereoRig) -> StereoRig:
    """The calibration of the rectified images of a pair, as OpenCV computes it for alpha 0; itself where it is one."""
    if is_ideal(rig):
        return rig
    left = rig.left
    right = rig.right
    lenses = (left.matrix, left.coefficients, right.matrix, right.coefficients)
    turn = rig.right_SE3_left.rotation
    shift = rig.right_SE3_left.translation.reshape(3, 1)
    if "fisheye" in (left.model, right.model):
        _, _, *projections, _ = cv2.fisheye.stereoRectify(*lenses, left.size, turn, shift, 0)
    else:
        _, _, *projections = cv2.stereoRectify(*lenses, left.size, turn, shift, alpha=0.0)[:4]
    cameras = [Camera(*left.size, *p[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()) for p in projections]
    pose = SE3(np.eye(3), np.array([-rig.baseline_m, 0.0, 0.0]))
    return StereoRig(cameras[0], cameras[1], pose, f"{rig.source} [rectified images]")


def is_ideal(rig: StereoRig) -> bool:
    """True if a rig is that of rectified images: no distortion, no rotation."""
    turned = float(np.abs(rig.right_SE3_left.rotation - np.eye(3)).max())
    return turned < 1e-9 and not any(np.any(one.coefficients) for one in (rig.left, rig.right))
