"""Paths on the floor as two sensors see them, and how they lie over each other in place and time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F64
from planview.evaluation.align import floor_rotation

TICK_S = 0.1
"""Time between the samples of a path [s]: a walker moves a hand's breadth in it."""
MEET_M = 0.40
"""Two positions nearer than this are of one person [m]: a torso's width."""
HEIGHT_M = 0.15
"""People whose heights differ by more are different [m]."""


@dataclass(frozen=True, eq=False)
class WalkedPath:
    """One person without a gap: from tick ``first`` on (N, 2) floor positions, one per tick [m], median height [m], NaN
    when unknown, and (N, 2) how far the positions move when all disparities grow by a pixel [m]."""

    first: int
    xy_m: F64
    height_m: float
    per_px_m: F64

    @property
    def end(self) -> int:
        """The tick after the last sample."""
        return self.first + len(self.xy_m)

    def at(self, ticks: F64, disparity_px: float = 0.0) -> F64:
        """(N, 2) positions at fractional ticks, with all disparities larger by ``disparity_px``; NaN outside."""
        own_ticks = np.arange(self.first, self.end)
        values = self.xy_m + disparity_px * self.per_px_m
        return np.column_stack([np.interp(ticks, own_ticks, column, left=np.nan, right=np.nan) for column in values.T])


def sample_path(times_s: F64, xy_m: F64) -> tuple[int, F64]:
    """The first tick within some times, and (N, 2) positions at every tick from there to the last [m]."""
    first = math.ceil(times_s[0] / TICK_S)
    last = math.floor(times_s[-1] / TICK_S)
    ticks_s = np.arange(first, last + 1) * TICK_S
    return first, np.column_stack([np.interp(ticks_s, times_s, column) for column in xy_m.T])


@dataclass(frozen=True, eq=False)
class RigAlignment:
    """``first_SE2_second`` and the clock, with the deviation of each value.

    Attributes:
        heading_rad, x_m, y_m: p_first = R(heading_rad) p_second + (x_m, y_m).
        clock_s: time on the first rig's clock at which the second one's begins.
        residual_m: root mean square distance of people who meet, per axis.
        shared_s: how long people are seen by both rigs, added up.
        std: of (heading_rad, x_m, y_m, clock_s); of x and y where people meet, see ``pivot_m``.
        pivot_m: middle of the second rig's positions that meet, in its world; x and y are most certain there.
    """

    heading_rad: float
    x_m: float
    y_m: float
    clock_s: float
    residual_m: float = math.nan
    shared_s: float = 0.0
    std: tuple[float, float, float, float] = (math.nan,) * 4
    pivot_m: tuple[float, float] = (0.0, 0.0)

    def apply(self, xy_m: F64) -> F64:
        """(..., 2) positions of the second rig's world in the first's."""
        return np.asarray(xy_m @ floor_rotation(self.heading_rad).T + np.array([self.x_m, self.y_m]))

    @property
    def heading_std_rad(self) -> float:
        return self.std[0]

    @property
    def position_std_m(self) -> float:
        """Deviation of the place on the floor where people meet, of the larger of both axes."""
        return max(self.std[1:3])

    @property
    def clock_std_s(self) -> float:
        return self.std[3]


Paths = Sequence[WalkedPath]


def same_height(path: WalkedPath, other: WalkedPath) -> bool:
    """True if two paths may be of one person; also where a height is not known."""
    return not abs(path.height_m - other.height_m) > HEIGHT_M


def met_s(motion: RigAlignment, first: Paths, second: Paths) -> float:
    """Seconds of the first rig's paths that meet the second's under a motion; nearer ones count more."""
    total = 0.0
    for path in first:
        best = np.zeros(len(path.xy_m))
        for other in second:
            if same_height(path, other):
                best = np.fmax(best, 1.0 - (apart_m(motion, path, other) / MEET_M) ** 2)
        total += float(best.sum()) * TICK_S
    return total


def apart_m(motion: RigAlignment, path: WalkedPath, other: WalkedPath) -> F64:
    """(N,) distance of the samples of a path of the first rig from one of the second under a motion [m]; NaN where the
    other path has no sample."""
    shift = motion.clock_s / TICK_S
    if other.first + shift >= path.end or other.end + shift <= path.first:
        return np.full(len(path.xy_m), np.nan)
    ticks = np.arange(path.first, path.end, dtype=np.float64)
    return np.asarray(np.hypot(*(motion.apply(other.at(ticks - shift)) - path.xy_m).T))
