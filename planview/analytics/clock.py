"""The time of every frame of a table of tracks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64
from planview.trajectories.table import Trajectories
from planview.trajectories.timing import frame_period_s


@dataclass(frozen=True)
class Span:
    """The time that the recording covers [s]; ``frame_s`` is the time per frame."""

    start_s: float
    end_s: float
    frame_s: float

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    def interval_starts(self, interval_s: float) -> F64:
        """Beginnings of the intervals that cover the span."""
        count = max(1, math.ceil((self.duration_s - 1e-9) / interval_s))
        return self.start_s + interval_s * np.arange(count, dtype=np.float64)

    def frame_times(self) -> F64:
        """Times of all frames."""
        count = max(1, round(self.duration_s / self.frame_s))
        return self.start_s + self.frame_s * np.arange(count, dtype=np.float64)


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

    def at(self, frame: I64) -> F64:
        """(N,) times [s] of (N,) frames."""
        inside = np.interp(frame, self._frames, self._times)
        beyond = np.minimum(frame - self._frames[0], 0) + np.maximum(frame - self._frames[-1], 0)
        return np.asarray(inside + beyond * self.frame_s)

    def span(self, n_frames: int) -> Span:
        """From frame 0 to the end of the last of n_frames."""
        start, last = self.at(np.array([0, max(0, n_frames - 1)]))
        return Span(float(start), float(last) + self.frame_s, self.frame_s)
