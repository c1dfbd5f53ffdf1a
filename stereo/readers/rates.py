"""Rate, jitter and gaps of a camera from the times of its frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64
from stereo.readers.time_pairs import JUMP_S

GAP = 1.5
"""A step of more than this many frame periods is a gap (our choice)."""


@dataclass(frozen=True)
class Rate:
    """How evenly frames come.

    Attributes:
        fps: frames per second, of the median step.
        jitter_ms: standard deviation of the steps that are no gaps [ms].
        duration_s: from the first frame to the last, without jumps of the clock [s].
        gaps: steps longer than ``GAP`` frame periods.
        dropped: frames that would have fallen into them.
        longest_gap_s: the longest of them [s]; 0 without any.
    """

    fps: float
    jitter_ms: float
    duration_s: float
    gaps: int
    dropped: int
    longest_gap_s: float


def rate_of_times(times_s: F64) -> Rate | None:
    """Rate and gaps.

    Args:
        times_s: (n,) float64 [s], in any order.
    Returns:
        None of fewer than two different times.
    """
    steps = np.diff(np.sort(times_s[np.isfinite(times_s)]))
    steps = steps[(steps > 0) & (steps < JUMP_S)]
    if not steps.size:
        return None
    period = float(np.median(steps))
    wide = steps > GAP * period
    dropped = int(np.sum(np.round(steps[wide] / period) - 1))
    longest = float(steps[wide].max()) if wide.any() else 0.0
    jitter = float(np.std(steps[~wide])) * 1e3
    return Rate(1.0 / period, jitter, float(steps.sum()), int(wide.sum()), dropped, longest)
