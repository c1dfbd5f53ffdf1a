"""The stages before the foreground: a recorded frame to an image without distortion and its disparity."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from calib.errors import InputError
from calib.types import F32, U8
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange, Matcher
from stereo.recording import RgbdFrame, StereoFrame
from stereo.rectify import RectifiedPair, Rectifier
from stereo.rgbd import RectifiedRgbd, RgbdRectifier


class Rectified(Protocol):
    """A frame without lens distortion; ``left`` is the image whose pixels the maps are made of."""

    @property
    def left(self) -> U8: ...


class FrontEnd(Protocol):
    """Rectifies frames and finds their disparity; each depends on no other frame."""

    @property
    def geometry(self) -> RectifiedGeometry: ...

    def rectify(self, frame: Any) -> Rectified:
        """The frame, of the kind that its recording gives, without lens distortion."""

    def disparity(self, rectified: Any) -> F32:
        """(H, W) float32 [px] of the rectified image; NaN where unknown."""


CHECK_EVERY = 50
"""Disparities are looked at in every n-th frame (our choice, for speed)."""
MAX_NONE = 0.2
"""Share of disparities of exactly 0, or below -1, from which they stand for "none" (our choice): nothing lies beyond
infinity, and what lies there has a disparity of about 0."""


def refuse_foreign_disparity(disparity: F32, shape: tuple[int, int], searched: DisparityRange) -> None:
    """Refuse what is no disparity in pixels, as a matcher of the user's may give.

    Args:
        shape: (H, W) of the rectified image.
        searched: disparities that people on the floor can have.
    Raises:
        InputError: another shape or kind of number, sixteenths of a pixel, depth, or a number for "none".
    """
    if disparity.shape != shape or disparity.dtype != np.float32:
        raise InputError(
            f"matcher: expected float32 disparities of {shape}, found {disparity.dtype} of {disparity.shape}"
        )
    few = disparity[::8, ::8]
    valid = few[np.isfinite(few)]
    largest = searched.first_px + searched.count
    none = float(((valid == 0) | (valid <= -1)).mean()) if len(valid) else 0.0
    if none > MAX_NONE:
        raise InputError(f"matcher: expected NaN where there is no disparity, found {none:.0%} of 0 or below -1")
    if len(valid) and float(np.median(valid)) > largest:
        raise InputError(
            f"matcher: expected disparities in pixels, up to {largest} on this floor, found {np.median(valid):.0f} in "
            "the middle of the range: sixteenths of a pixel (divide OpenCV's by 16), or depth?"
        )


class StereoFrontEnd:
    """Rectification and matching of a pair.

    Args:
        searched: disparities that people on the floor can have.
    """

    def __init__(self, rectifier: Rectifier, matcher: Matcher, searched: DisparityRange) -> None:
        self._rectifier, self._matcher, self._searched = rectifier, matcher, searched
        self.geometry = rectifier.geometry
        self._matched = 0

    def rectify(self, frame: StereoFrame) -> RectifiedPair:
        """See ``FrontEnd``."""
        return self._rectifier(frame.left, frame.right)

    def disparity(self, rectified: RectifiedPair) -> F32:
        """See ``FrontEnd``."""
        disparity = self._matcher(rectified.left_grey, rectified.right_grey)
        if self._matched % CHECK_EVERY == 0:
            refuse_foreign_disparity(disparity, self.geometry.size[::-1], self._searched)
        self._matched += 1
        return disparity


class RgbdFrontEnd:
    """Rectification of an image with depth, whose disparity is the equivalent one of its depth."""

    def __init__(self, rectifier: RgbdRectifier) -> None:
        self._rectifier = rectifier
        self.geometry = rectifier.geometry

    def rectify(self, frame: RgbdFrame) -> RectifiedRgbd:
        """See ``FrontEnd``."""
        return self._rectifier(frame)

    def disparity(self, rectified: RectifiedRgbd) -> F32:
        """See ``FrontEnd``."""
        return self._rectifier.disparity(rectified)
