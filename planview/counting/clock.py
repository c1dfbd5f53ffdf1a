"""The time of every frame of a table of tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64
from planview.trajectories.table import Trajectories
from planview.trajectories.timing import frame_period_s

INTERVALS_MAX = 10_080
"""Intervals listed in full: a week of minutes (our choice)."""
JUMP_S = 600.0
"""A step of the clock from one frame to the next that is longer is a jump [s]: no recorder pauses so long unnoticed
(our choice)."""


def jump_told(before_frame: int, frame: int, step_s: float) -> str:
    """A jump of the clock in words."""
    days, hours = step_s / 86400.0, step_s / 3600.0
    size = f"{days:.1f} days" if days >= 2 else f"{hours:.1f} hours" if hours >= 2 else f"{step_s / 60:.0f} minutes"
    return f"the clock jumps by {size} from frame {before_frame} to {frame}: durations and rates include the jump"


@dataclass(frozen=True)
class Span:
    """The time that the recording covers [s]; ``frame_s`` is the time per frame."""

    start_s: float
    end_s: float
    frame_s: float

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    def interval_starts(self, interval_s: float, busy_s: Sequence[float]) -> F64:
        """Beginnings of the intervals that cover the span.

        Where the clock has jumped there are more than INTERVALS_MAX: then only the first, the last, and those that hold
        one of the times ``busy_s``.
        """
        count = max(1, math.ceil((self.duration_s - 1e-9) / interval_s))
        indices = np.arange(min(count, INTERVALS_MAX), dtype=np.float64)
        if count > INTERVALS_MAX:
            held = (np.asarray(busy_s, dtype=np.float64) - self.start_s) // interval_s
            indices = np.unique(np.concatenate([[0.0, count - 1.0], np.clip(held, 0, count - 1)]))
        return self.start_s + interval_s * indices

    @property
    def n_frames(self) -> int:
        """Number of frames at the nominal rate."""
        return max(1, round(self.duration_s / self.frame_s))

    def frame_times(self) -> F64:
        """Times of all frames."""
        return self.start_s + self.frame_s * np.arange(self.n_frames, dtype=np.float64)

    def first_frames(self, times_s: F64) -> F64:
        """(N,) number of the first frame at or after each time, ``n_frames`` beyond the end."""
        return np.clip(np.ceil((times_s - self.start_s) / self.frame_s - 1e-9), 0, self.n_frames)


class Clock:
    """Frame to time: as the rows say, straight in between and beyond.

    Args:
        tracks: rows with timestamps, or without any.
        fps: frame rate where fewer than two frames have a timestamp [1/s].
    """

    def __init__(self, tracks: Trajectories, fps: float) -> None:
        known = np.isfinite(tracks.timestamp_s)
        frames, first = np.unique(tracks.frame[known], return_index=True)
        times = tracks.timestamp_s[known][first]
        self.frame_s = frame_period_s(tracks, 1.0 / fps)
        self._frames = frames if len(frames) else np.zeros(1, dtype=np.int64)
        self._times = times if len(frames) else np.zeros(1)

    def jump(self) -> str:
        """The longest jump between two frames with rows, in words; empty for none."""
        steps = np.diff(self._times)
        if not len(steps) or steps.max() <= JUMP_S:
            return ""
        n = int(np.argmax(steps))
        return jump_told(int(self._frames[n]), int(self._frames[n + 1]), float(steps[n]))

    def at(self, frame: I64) -> F64:
        """(N,) times [s] of (N,) frames."""
        inside = np.interp(frame, self._frames, self._times)
        beyond = np.minimum(frame - self._frames[0], 0) + np.maximum(frame - self._frames[-1], 0)
        return np.asarray(inside + beyond * self.frame_s)

    def span(self, n_frames: int) -> Span:
        """From frame 0 to the end of the last of n_frames."""
        start, last = self.at(np.array([0, max(0, n_frames - 1)]))
        return Span(float(start), float(last) + self.frame_s, self.frame_s)
