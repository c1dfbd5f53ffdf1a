"""The judge of the times of frames, of recordings and of tables: rate, gaps, bursts, clocks that were set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64, Bool

JUMP_S = 3600.0
"""A step this long, or ten frame periods back, is a clock that was set, not a pause."""
PAUSE_S = 600.0
"""A longer step of a table's times is named [s]: no recorder pauses so long unnoticed."""
SLOW_S = 2.0
"""Steps from which nobody can be followed from frame to frame [s]: at a walking pace they are three metres. No buffer
of a camera holds frames for longer."""
WRONG_UNIT_S = 5.0
"""Milliseconds read as seconds make a frame last so long at up to 200 frames per second."""
EVEN_SHARE = 0.5
"""Share of the steps within half of their mean from which frames come one by one; of those in bursts none are."""
BUFFERED_S = 0.01
"""Steps within a burst are shorter [s]: the frames were taken before and arrive as fast as they can be read."""
UNEVEN = 0.25
"""Deviation of the steps over the frame period from which times are called uneven."""


@dataclass(frozen=True)
class Rate:
    """How evenly frames come.

    Attributes:
        fps: frames per second, of the mean of the steps that are no gaps; of bursts, of all.
        jitter_ms: standard deviation of the steps that are no gaps [ms].
        duration_s: from the first frame to the last, without jumps of the clock [s].
        gaps: steps longer than 1.5 frame periods.
        dropped: frames that would have fallen into them.
        longest_gap_s: the longest of them [s]; 0 without any.
        burst: frames that come at once, as where a buffer is read; 1 where each comes by itself.
    """

    fps: float
    jitter_ms: float
    duration_s: float
    gaps: int
    dropped: int
    longest_gap_s: float
    burst: int = 1

    @property
    def note(self) -> str:
        """That the frames come unevenly, or one in a time; empty where they do not."""
        if self.fps < 1.0 / SLOW_S:
            return f"a frame every {1.0 / self.fps:.3g} s, at which nobody can be followed"
        if self.burst == 1 and self.jitter_ms * self.fps > 1e3 * UNEVEN:
            return f"times are uneven: steps of {1e3 / self.fps:.3g} ms deviate by {self.jitter_ms:.3g} ms"
        return ""


def rate_of_times(times_s: F64) -> Rate | None:
    """Rate and gaps of (n,) times [s] in any order; None of fewer than two different ones."""
    steps = np.diff(np.sort(times_s[np.isfinite(times_s)]))
    steps = steps[(steps > 0) & (steps < JUMP_S)]
    if not steps.size:
        return None
    period, mean = float(np.median(steps)), float(steps.mean())
    even = float(np.mean(np.abs(steps - mean) < 0.5 * mean))
    if even < EVEN_SHARE and steps.max() < SLOW_S and np.median(steps[steps <= mean]) < BUFFERED_S:
        begins = np.flatnonzero(steps > mean) + 1
        if len(begins) > 2:
            mean, burst = float(steps[: begins[-1]].mean()), int(np.median(np.diff(begins)))
            return Rate(1.0 / mean, float(np.std(steps)) * 1e3, float(steps.sum()), 0, 0, 0.0, burst)
    wide = steps > 1.5 * period
    return Rate(
        fps=1.0 / float(np.mean(steps[~wide])),
        jitter_ms=float(np.std(steps[~wide])) * 1e3,
        duration_s=float(steps.sum()),
        gaps=int(wide.sum()),
        dropped=int(np.sum(np.round(steps[wide] / period) - 1)),
        longest_gap_s=float(steps[wide].max(initial=0.0)),
    )


def spread_bursts(times_s: F64, rate: Rate) -> tuple[F64, tuple[str, ...]]:
    """(n,) times [s] of frames that came in bursts, spread evenly from each burst to the next, as they are where each
    frame came by itself; and a note on times that are not even."""
    known = np.flatnonzero(np.isfinite(times_s))
    if rate.burst == 1:
        return times_s, (rate.note,) if rate.note else ()
    begins = known[np.diff(times_s[known], prepend=-math.inf) > 1.0 / rate.fps]
    last = times_s[begins[-1]] + (known[-1] - begins[-1]) / rate.fps
    spread = np.interp(known, np.append(begins, known[-1] + 1), np.append(times_s[begins], last + 1.0 / rate.fps))
    found = np.full(len(times_s), np.nan)
    found[known] = spread
    note = (
        f"frames come in bursts of about {rate.burst}: their times of arrival are spread to {rate.fps:.4g} per second"
    )
    return found, (note,)


def clock_is_set(steps_s: F64, period_s: F64 | float) -> Bool:
    """(n,) which steps from frame to frame [s] are a clock that was set, or segments that were joined: hours ahead, or
    back by more than frames come out of order."""
    far, back = np.maximum(JUMP_S, 100.0 * np.asarray(period_s)), -10.0 * np.maximum(period_s, 0.1)
    return np.asarray((steps_s > far) | (steps_s < back), dtype=np.bool_)


class RunningClock:
    """Times of frames as they come, in order: where the clock was set they run on at the nominal rate."""

    def __init__(self, fps: float) -> None:
        self._period_s, self._index, self._last_s, self._offset_s = 1.0 / fps, 0, -math.inf, 0.0

    def time(self, index: int, own_s: float) -> tuple[float, str]:
        """The time [s] of a frame by its own one, and why it cannot be used, empty where it can: such a time does not
        count for the frames after it."""
        now_s, before_s = own_s + self._offset_s, self._last_s
        usual_s = self._period_s * (index - self._index)
        if math.isfinite(now_s) and math.isfinite(before_s) and clock_is_set(np.array([now_s - before_s]), usual_s)[0]:
            self._offset_s += before_s + usual_s - now_s
            now_s = before_s + usual_s
        why = unusable_time(now_s, before_s)
        if not why:
            self._index, self._last_s = index, now_s
        return now_s, why


def unusable_time(now_s: float, before_s: float) -> str:
    """Why a frame cannot have the time ``now_s`` after one at ``before_s`` [s]; empty where it can."""
    if not math.isfinite(now_s):
        return f"its time is {now_s}"
    return "" if now_s > before_s else f"its time, {now_s:.9g} s, is not after {before_s:.9g} s of the frame before"


def run_on(times_s: F64, frames: I64 | None = None) -> tuple[F64, tuple[str, ...]]:
    """(n,) times [s] of frames in order, which run on at the usual rate where they begin again or the clock was set
    back, and a note on each such place. Frames with numbers are a table's, of which none is out of order."""
    numbers = np.arange(len(times_s)) if frames is None else frames
    if len(times_s) < 2:
        return times_s, ()
    steps, apart = np.diff(times_s), np.diff(numbers)
    ahead = steps > 0
    period = float(np.median(steps[ahead] / apart[ahead])) if ahead.any() else 0.0
    back = steps < 0
    if frames is None:
        back &= clock_is_set(steps, period)
    if not back.any():
        return times_s, ()
    found = times_s[0] + np.concatenate([[0.0], np.cumsum(np.where(back, period * apart, steps))])
    where = [
        f"times begin again at frame {int(numbers[k + 1])}: they run on at the usual rate" for k in np.flatnonzero(back)
    ]
    return found, tuple(where[:3])


def period_of(frames: I64, times_s: F64, fallback_s: float) -> float:
    """Median time per frame [s] of (n,) ascending frames with times: the mean where most frames share one,
    ``fallback_s`` where fewer than two have one or time stands."""
    if len(frames) < 2 or times_s[-1] <= times_s[0]:
        return fallback_s
    period = float(np.median(np.diff(times_s) / np.diff(frames)))
    return period if period > 0 else float((times_s[-1] - times_s[0]) / (frames[-1] - frames[0]))


def doubts(frames: I64, times_s: F64) -> Sequence[str]:
    """What is odd about the times [s] of (n,) ascending frames, a sentence each: jumps, another unit, bursts."""
    steps, apart = np.diff(times_s), np.diff(frames)
    if not len(steps):
        return ()
    if steps.max() > PAUSE_S:
        n = int(np.argmax(steps))
        return (jump_note(int(frames[n]), int(frames[n + 1]), float(steps[n])),)
    if (steps >= WRONG_UNIT_S * apart).all():
        return (f"a frame lasts {period_of(frames, times_s, 0.0):.3g} s: are the times milliseconds?",)
    next_to = np.cumsum(np.append(0.0, steps[apart == 1]))
    rate = rate_of_times(next_to)
    if rate is not None and rate.burst > 1:
        return (f"frames come in bursts of about {rate.burst}: are these times of arrival? Speeds are off",)
    return ()


def jump_note(before_frame: int, frame: int, step_s: float) -> str:
    """A jump of the clock in words."""
    days, hours = step_s / 86400.0, step_s / 3600.0
    size = f"{days:.1f} days" if days >= 2 else f"{hours:.1f} hours" if hours >= 2 else f"{step_s / 60:.0f} minutes"
    return f"the clock jumps by {size} from frame {before_frame} to {frame}: durations and rates include the jump"
