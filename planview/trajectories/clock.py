"""The times of frames of a table, and the time that its recording covers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.table import Trajectories, frame_period_s, frame_times, rows_by_id

USUAL_FPS = 30.0
"""Frames per second where nothing gives a rate and none decides anything."""
BRIDGED_S = 0.9
"""Longest time between two positions of a walking person between which the others lie on a line [s]: a slow step."""


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


def at_times(timed: Trajectories, frames: I64, times_s: F64) -> Trajectories:
    """Everybody's row nearest to each of (F,) frames in time, moved to where the person is then: on a line between rows
    that are at most BRIDGED_S apart. Frames between others have none."""
    places = timed.x_m + 1j * timed.y_m
    margin_s = np.median(np.diff(times_s)) / 2
    parts = []
    for _, rows in rows_by_id(timed.track_id):
        own_s = timed.timestamp_s[rows]
        steps_s = np.diff(own_s)
        near = np.searchsorted(own_s[:-1] + steps_s / 2, times_s)
        reach_s = max(margin_s, steps_s[steps_s <= BRIDGED_S].max(initial=0.0) / 2)
        is_inside = np.abs(times_s - np.clip(times_s, own_s[0], own_s[-1])) <= margin_s
        covered = np.flatnonzero(is_inside & (np.abs(own_s[near] - times_s) <= reach_s))
        parts.append((covered, rows[near[covered]], np.interp(times_s[covered], own_s, places[rows])))
    at, nearest, place = map(np.concatenate, zip(*parts, strict=True))
    table = replace(timed.where(nearest), frame=frames[at], timestamp_s=times_s[at], x_m=place.real, y_m=place.imag)
    return table.where(np.argsort(at, kind="stable"))
