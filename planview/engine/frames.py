"""A stereo frame between the stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from calib.types import F32, U8
from planview.checks.timing import Thumbnails
from planview.maps.builder import FloorPoints
from stereo.matcher import SampledDisparity
from stereo.rectify import PartialPair

Picture = Callable[[], U8]
"""Makes a picture when it is asked for, which is seldom."""


@dataclass(frozen=True, eq=False)
class MatchedFrame:
    """A rectified frame with its disparity.

    Attributes:
        frame, timestamp_s: as in the recording.
        image: (h, w[, 3]) uint8 of the analysis size, rectified; the left one of a pair.
        disparity: (H, W) float32 [px], NaN invalid; None while the background decides what of ``pair`` is matched.
        stages_ms: time of the stages so far.
        thumbnails: of both rectified images.
        pair: what is to be matched in part.
        picture: the image at the rectified size; None where it is not kept.
    """

    frame: int
    timestamp_s: float
    image: U8
    disparity: F32 | None
    stages_ms: dict[str, float]
    thumbnails: Thumbnails | None = None
    pair: PartialPair | None = None
    picture: Picture | None = None


class Separated(NamedTuple):
    """Foreground of a frame.

    Attributes:
        image: (h, w[, 3]) uint8 of the analysis size.
        mask: (h, w) uint8.
        points: its points in the world.
        sampled: disparity.
        measured: (h, w) uint8, 0 where the disparity is that of an earlier frame; None where all of it is measured.
    """

    image: U8
    mask: U8
    points: FloorPoints
    sampled: SampledDisparity
    measured: U8 | None = None
