"""Compiled watch of unclaimed foreground; ``tests/reference/human_model.py`` defines it in plain numpy."""

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, I32, I64, U8


class Limits(NamedTuple):
    """Longest stay that is counted, what is left of a stay once it is interrupted, and for how long a motion counts as
    recent [s]."""

    stay_s: float
    rest_s: float
    recent_s: float


@njit(cache=True, nogil=True)
def watch_unclaimed(
    evidence: U8, motion: U8, labels: I32, dt_s: float, now_s: float, limits: Limits, stay_s: F32, moved_s: F32,
    area: I64, moved: I64,
) -> None:  # fmt: skip
    """Update for how long pixels have been evidence (interrupted, it goes as fast as it came), and when they moved.

    ``area`` and ``moved`` (n,) are filled: foreground proper of each blob, and the part of it that moved lately.
    """
    height, width = evidence.shape
    step, longest, rest = np.float32(dt_s), np.float32(limits.stay_s), np.float32(limits.rest_s)
    since = np.float32(now_s - limits.recent_s)
    for y in range(height):
        for x in range(width):
            if evidence[y, x] == 0:
                stay_s[y, x] = max(np.float32(0.0), min(rest, stay_s[y, x]) - step)
                continue
            stay_s[y, x] = min(longest, stay_s[y, x] + step)
            if motion[y, x] > 0:
                moved_s[y, x] = np.float32(now_s)
            if evidence[y, x] > 1:
                area[labels[y, x]] += 1
                if moved_s[y, x] >= since:
                    moved[labels[y, x]] += 1
