"""The stages before the foreground: a recorded frame to an image without distortion and its disparity."""

from __future__ import annotations

from typing import Any, Protocol

from calib.types import F32, U8
from stereo.depth import RectifiedGeometry
from stereo.matcher import Matcher
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


class StereoFrontEnd:
    """Rectification and matching of a pair."""

    def __init__(self, rectifier: Rectifier, matcher: Matcher) -> None:
        self._rectifier, self._matcher = rectifier, matcher
        self.geometry = rectifier.geometry

    def rectify(self, frame: StereoFrame) -> RectifiedPair:
        """See ``FrontEnd``."""
        return self._rectifier(frame.left, frame.right)

    def disparity(self, rectified: RectifiedPair) -> F32:
        """See ``FrontEnd``."""
        return self._matcher(rectified.left_grey, rectified.right_grey)


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
