"""Images: enough light, not too much, the same for both cameras, and not compressed to blocks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.images import as_grey
from calib.types import U8
from planview.checks.check import Check, at_least, at_most
from stereo.recording import StereoFrame

SATURATED_LEVEL = 250
"""Grey levels from here on hold no texture (as in the matcher)."""
MAX_OVER = 0.35
"""Share of saturated pixels that leaves enough to see people by; a sunny terrace has up to a quarter (our choice)."""
MIN_BRIGHT = 40.0
"""The brightest tenth of a picture must reach this grey level: below, sensor noise is a good part of any texture."""
MAX_MISMATCH = 2.0
"""Ratio of the cameras' median brightness; block matching bears small differences only (our choice)."""


BLOCK_PX = 8
"""Side of the blocks that JPEG, MPEG and H.264 transform."""
MAX_BLOCKING = 2.0
"""Grey steps at the borders of blocks over those inside, which match at the same place in both cameras and pull
disparities there. Images as recorded have 0.7 to 1.3, JPEG of quality 10 has 5 and loses the floor (our choice)."""


def image_checks(frames: Sequence[StereoFrame]) -> list[Check]:
    """Over-exposure, under-exposure, brightness of left against right, and compression, of frames as recorded."""
    sides = [as_grey(f.left) for f in frames], [as_grey(f.right) for f in frames]
    levels = [float(np.median([np.mean(i[::4, ::4]) for i in side])) + 1.0 for side in sides]
    ratio = max(levels) / min(levels)
    blocks = max(float(np.median([blocking(i) for i in side])) for side in sides)
    return [
        *light_checks(*sides),
        at_most("brightness match", ratio, MAX_MISMATCH, "", "mean brightness of one camera over the other"),
        at_most("compression", blocks, MAX_BLOCKING, "", "grey steps at the borders of 8x8 blocks over those inside"),
    ]


def light_checks(*cameras: Sequence[U8]) -> list[Check]:
    """Over-exposure and under-exposure.

    Args:
        cameras: images of each.
    """
    sides = [[as_grey(image) for image in images] for images in cameras]
    over = max(float(np.median([_saturated(i) for i in side])) for side in sides)
    bright = min(float(np.median([np.percentile(i[::2, ::2], 90) for i in side])) for side in sides)
    return [
        at_most("over-exposure", over, MAX_OVER, "", "share of saturated pixels in the worse camera"),
        at_least("under-exposure", bright, MIN_BRIGHT, "grey", "brightest tenth of the picture, darker camera"),
    ]


def _saturated(image: U8) -> float:
    return float(np.mean(image[::2, ::2] >= SATURATED_LEVEL))


def blocking(image: U8) -> float:
    """Mean grey step along the rows of a (H, W) image across the borders of blocks, over that inside of them."""
    steps = np.abs(np.diff(image[::4].astype(np.int16), axis=1)).mean(axis=0)
    border = np.arange(len(steps)) % BLOCK_PX == BLOCK_PX - 1
    return float(steps[border].mean() / max(float(steps[~border].mean()), 1e-3)) if border.any() else np.nan
