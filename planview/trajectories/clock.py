"""The times of frames of a table, and the time that its recording covers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.table import Trajectories, frame_period_s, frame_times

USUAL_FPS = 30.0
"""Frames per second where nothing gives a rate and none decides anything."""


@dataclass(frozen=True)
class Span:
    """The time that the recording covers [s]; ``frame_s`` is the time per frame."""

    start_s: float
    end_s: float
    frame_s: float

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    @property
    def n_frames(self) -> int:
        return max(1, round(self.duration_s / self.frame_s))

    def frame_times(self) -> F64:
        return self.start_s + self.frame_s * np.arange(self.n_frames, dtype=np.float64)


class Clock:
    """Frame to time, interpolated between the rows with times and extrapolated beyond them, at ``fps`` [1/s] where
    fewer than two frames have one. Raises InputError: there are rows, and no rate is given then."""

    def __init__(self, tracks: Trajectories, fps: float | None = None) -> None:
        given_s = 1.0 / fps if fps else math.nan
        self.frame_s = frame_period_s(tracks, given_s)
        if math.isnan(self.frame_s):
            if len(tracks):
                raise InputError("the tracks have neither timestamps nor a frame rate", remedy="fps")
            self.frame_s = 1.0 / USUAL_FPS
        self._frames, self._times = frame_times(tracks)
        if not len(self._frames):
            self._frames = np.zeros(1, dtype=np.int64)
            self._times = np.zeros(1)

    def at(self, frame: I64) -> F64:
        """(N,) times [s] of (N,) frames."""
        inside = np.interp(frame, self._frames, self._times)
        before = np.minimum(frame - self._frames[0], 0)
        after = np.maximum(frame - self._frames[-1], 0)
        return np.asarray(inside + (before + after) * self.frame_s)

    def span(self, n_frames: int) -> Span:
        """From frame 0 to the end of the last of n_frames."""
        start_s, last_s = self.at(np.array([0, max(0, n_frames - 1)])).tolist()
        return Span(start_s, last_s + self.frame_s, self.frame_s)
