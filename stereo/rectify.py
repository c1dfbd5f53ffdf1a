"""Rectification: both images as if taken by one ideal pinhole, moved along its own x axis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.images import as_grey
from calib.params import Params
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8
from stereo.gate import Window
from stereo.matcher import disparity_range
from stereo.recording import StereoFrame
from stereo.vertical import VerticalFit, VerticalModel, measure_vertical
from stereo.view import common_geometry
from stereo.warp import Warp


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


@dataclass(frozen=True, eq=False)
class PartialPair:
    """A pair that is rectified only where it is asked for.

    Attributes:
        recorded: (h', w'[, 3]) uint8, the left image.
        reduced: (h, w[, 3]) uint8, the rectified left image at the analysis size.
        sources: uint8 grey, both recorded images at the size that their warps need.
        warps: rectify them.
    """

    recorded: U8
    reduced: U8
    sources: tuple[U8, U8]
    warps: tuple[Warp, Warp]

    def left(self) -> U8:
        """(H, W[, 3]) uint8, the rectified left image."""
        return self.warps[0](self.recorded)

    def left_grey(self, window: Window) -> U8:
        """(h, w) uint8 of a window."""
        return self.warps[0].part(self.sources[0], window)

    def right_grey(self, window: Window) -> U8:
        """(h, w) uint8 of a window."""
        return self.warps[1].part(self.sources[1], window)

    def samples(self, step: int) -> tuple[U8, U8]:
        """Every ``step``-th row and column of both images, (h, w) uint8 grey."""
        left, right = (warp.samples(source, step) for warp, source in zip(self.warps, self.sources, strict=True))
        return left, right


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
        left_rotation, right_rotation = rig.rectifying_rotations()
        self.rect_SE3_left = SE3(left_rotation, np.zeros(3))
        self.geometry = common_geometry(rig, left_rotation, self.params.working_px, self.params.field_quantile)
        to_ray: F64 = np.asarray(np.linalg.inv(self.geometry.matrix), dtype=np.float64)
        size, working_px = self.geometry.size, self.params.working_px
        self._left = Warp(rig.left, left_rotation, to_ray, size, working_px)
        self._right = Warp(rig.right, right_rotation, to_ray @ self.vertical.matrix, size, working_px)
        self._smaller: dict[int, Warp] = {}
        self.mask, self.right_mask = self._left.mask, self._right.mask

    def __call__(self, left: U8, right: U8) -> RectifiedPair:
        """Rectify one pair.

        Args:
            left, right: (h, w) or (h, w, 3) uint8 at the rig's size, BGR.
        Raises:
            ValueError: images of another size.
        """
        self._check(left, right)
        rectified = self._left(left)
        return RectifiedPair(rectified, as_grey(rectified), self._right(as_grey(right)))

    def partly(self, left: U8, right: U8, step: int) -> PartialPair:
        """Rectify a pair later in part, but the left image at every ``step``-th row and column now: means of what lies
        between (arguments and errors as of a call)."""
        self._check(left, right)
        ours = self._left.source(left)
        reduced = self._reduced(step)
        sources = as_grey(ours), self._right.source(as_grey(right))
        return PartialPair(left, reduced.of(reduced.source(ours)), sources, (self._left, self._right))

    def _reduced(self, step: int) -> Warp:
        """Of the left image at an n-th of its size."""
        if step == 1:
            return self._left
        if step not in self._smaller:
            width, height = self.geometry.size
            size, middle = (-(-width // step), -(-height // step)), 0.5 * (step - 1)
            scale = np.array([[step, 0.0, middle], [0.0, step, middle], [0.0, 0.0, 1.0]])
            to_ray = np.asarray(np.linalg.inv(self.geometry.matrix) @ scale, dtype=np.float64)
            rotation = self.rect_SE3_left.rotation
            self._smaller[step] = Warp(self.rig.left, rotation, to_ray, size, max(size))
        return self._smaller[step]

    def _check(self, left: U8, right: U8) -> None:
        size = self.rig.left.size[::-1]
        if left.shape[:2] != size or right.shape[:2] != size:
            raise ValueError(f"expected images of shape {size}, got {left.shape} and {right.shape}")


def aligned_rectifier(
    rig: StereoRig, frames: Iterable[StereoFrame], params: RectifyParams | None = None
) -> tuple[Rectifier, VerticalFit]:
    """A rectifier whose right image is shifted by the row offset measured in some frames.

    Args:
        rig: calibration at the recorded size.
        frames: a dozen spread over the recording, so that light and movement differ.
    Returns:
        The rectifier, and what was measured before and after the correction.
    """
    plain = Rectifier(rig, params)
    searched = disparity_range(plain.geometry)
    pairs = (plain(frame.left, frame.right) for frame in frames)
    fit = measure_vertical(((p.left_grey, p.right_grey) for p in pairs), searched.first_px + searched.count)
    return (plain if fit.model == VerticalModel() else Rectifier(rig, params, fit.model)), fit
