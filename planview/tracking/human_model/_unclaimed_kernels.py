"""Compiled watch of unclaimed foreground; ``tests/reference/human_model.py`` defines it in plain numpy."""

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, I32, I64, U8, Bool
from planview.foreground.masks import BACKGROUND, NO_FEEDBACK, PERSON
from planview.tracking.human_model._measure_kernels import largest


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
    now, zero = np.float32(now_s), np.float32(0.0)
    for y in range(height):
        there, moves, stays, times = evidence[y], motion[y], stay_s[y], moved_s[y]
        # All pixels first, on vector registers; few rows have foreground that nobody claims.
        for x in range(np.uintp(width)):
            longer, shorter = min(longest, stays[x] + step), max(zero, min(rest, stays[x]) - step)
            stays[x] = longer if there[x] > 0 else shorter
            times[x] = now if (there[x] > 0) & (moves[x] > 0) else times[x]
        if largest(there) < 2:
            continue
        for x in range(np.uintp(width)):
            if there[x] > 1:
                area[labels[y, x]] += 1
                moved[labels[y, x]] += times[x] >= since


@njit(cache=True, nogil=True)
def mark_known(
    still_s: F32, limit_s: float, labels: I32, lively: Bool, claimed: U8, evidence: U8, people: bool, known: U8
) -> None:
    """Fill what is known of each pixel: ``BACKGROUND`` where unclaimed foreground has been still for long in a blob
    that is not lively, (n,); ``PERSON``, if there are people, where foreground proper is claimed; else 0."""
    height, width = known.shape
    limit, person = np.float32(limit_s), np.uint8(PERSON if people else NO_FEEDBACK)
    for y in range(height):
        row, times, taken, there = known[y], still_s[y], claimed[y], evidence[y]
        long = False
        for x in range(np.uintp(width)):
            row[x] = person if (taken[x] > 0) & (there[x] == 2) else np.uint8(NO_FEEDBACK)
            long |= times[x] >= limit
        if not long:
            continue
        blob = labels[y]
        # Without branches, since these pixels are scattered.
        for x in range(np.uintp(width)):
            is_thing = (times[x] >= limit) & (row[x] == NO_FEEDBACK) & (not lively[blob[x]])
            row[x] = np.uint8(BACKGROUND) if is_thing else row[x]
