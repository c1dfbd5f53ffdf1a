"""Exposure: enough light, not too much, the same for both cameras."""

from __future__ import annotations

import numpy as np

from calib.images import as_grey
from calib.types import U8
from planview.doctor.check import Check, at_least, at_most
from planview.doctor.evidence import RecordingEvidence

SATURATED_LEVEL = 250
"""Grey levels from here on hold no texture (as in the matcher)."""
MAX_OVER = 0.35
"""Share of saturated pixels that leaves enough to see people by; a sunny terrace has up to a quarter (our choice)."""
MIN_BRIGHT = 40.0
"""The brightest tenth of a picture must reach this grey level: below, sensor noise is a good part of any texture."""
MAX_MISMATCH = 2.0
"""Ratio of the cameras' median brightness; block matching bears small differences only (our choice)."""


def light_checks(evidence: RecordingEvidence) -> list[Check]:
    """Over-exposure, under-exposure and brightness of left against right."""
    left = [as_grey(f.left) for f in evidence.spread]
    right = [as_grey(f.right) for f in evidence.spread]
    over = max(float(np.median([_saturated(i) for i in side])) for side in (left, right))
    bright = min(float(np.median([np.percentile(i[::2, ::2], 90) for i in side])) for side in (left, right))
    levels = [float(np.median([np.mean(i[::4, ::4]) for i in side])) + 1.0 for side in (left, right)]
    ratio = max(levels) / min(levels)
    return [
        at_most("over-exposure", over, MAX_OVER, "", "share of saturated pixels in the worse camera"),
        at_least("under-exposure", bright, MIN_BRIGHT, "grey", "brightest tenth of the picture, darker camera"),
        at_most("brightness match", ratio, MAX_MISMATCH, "", "mean brightness of one camera over the other"),
    ]


def _saturated(image: U8) -> float:
    return float(np.mean(image[::2, ::2] >= SATURATED_LEVEL))
