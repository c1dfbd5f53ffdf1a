"""The end of a track: rows of one id are one walk only as far as somebody can have walked it."""

from __future__ import annotations

import numpy as np

from calib.types import F64, I64, Bool
from planview.trajectories.table import Trajectories, rows_by_id

HIDDEN_S = 4.0
"""Without a row for longer a track has ended [s]: people who are lost for longer are gone (Harville 2002, section 4).
Predicted rows of somebody hidden are rows."""
JUMP_M = 1.0
JUMP_MPS = 8.0
"""Length [m] and speed [m/s] above which a step is a jump: ten times the noise of a good tracker, and a sprint."""
ERROR_M = 3.0
"""A shorter jump may correct the place of the same person [m]. Our choice: three times JUMP_M, more than our trackers
ever err."""
STEP_S = 0.25
"""Time before and after, between which a velocity is measured [s]. Half a stride, so that the sway of a walker
cancels."""
BOX_M = 1.7
"""Height that a box is taken to show where only boxes are known: it gives metres to pixels [m]."""


def is_jump(step_s: F64 | float, moved_m: F64 | float) -> Bool:
    """True where nobody can have walked so far in this time; of numbers, or of arrays."""
    return np.asarray((moved_m > JUMP_M) & (moved_m > JUMP_MPS * step_s))


def has_ended(gap_s: F64 | float, step_s: F64 | float = 0.0, moved_m: F64 | float = 0.0) -> Bool:
    """True where a track has ended before the next row of its id; of numbers, or of arrays.

    Args:
        gap_s: time since its last row.
        step_s: time since it was last seen.
        moved_m: distance from where it was last seen; 0 where the next row is not seen.
    """
    return (gap_s > HIDDEN_S) | ((moved_m > ERROR_M) & is_jump(step_s, moved_m))


class PlacesByMoment:
    """The place of each row of a table: on the floor [m], or the foot of its box [px] with pixels per metre.

    Attributes:
        is_known: (N,) whether the row was seen somewhere, and not predicted.
    """

    def __init__(self, table: Trajectories) -> None:
        left, top, width, height = table.box_px.T
        self._on_floor = np.isfinite(table.x_m + table.y_m)
        self._x = np.where(self._on_floor, table.x_m, left + width / 2)
        self._y = np.where(self._on_floor, table.y_m, top + height)
        box_per_m = np.where(height > 0, height / BOX_M, np.nan)
        self._per_m = np.where(self._on_floor, 1.0, box_per_m)
        self.is_known = np.isfinite(self._x + self._y + self._per_m) & (table.state != "lost")

    def apart_m(self, first: I64, second: I64) -> F64:
        """Distances between rows [m]; 0 between the floor and the image. A box that is cut off has too few pixels per
        metre, so the larger number counts."""
        away = np.hypot(self._x[second] - self._x[first], self._y[second] - self._y[first])
        per_m = np.maximum(self._per_m[first], self._per_m[second])
        return np.where(self._on_floor[first] == self._on_floor[second], away / per_m, 0.0)


class Steps:
    """The steps of all ids of a table, from each row to the id's next one.

    Attributes:
        first, second: (S,) indices of the rows.
        gap_s: time between them.
        step_s: time since the last row that was seen; 0 where the second is not seen.
        moved_m: distance from that row to the second; 0 where one of them is not seen.
    """

    def __init__(self, table: Trajectories, times_s: F64) -> None:
        """``times_s``: (N,) of the rows."""
        places = PlacesByMoment(table)
        order = np.lexsort((table.frame, table.track_id))
        ids = table.track_id[order]
        second = np.flatnonzero(np.diff(ids) == 0) + 1
        self.first = order[second - 1]
        self.second = order[second]
        self.gap_s = times_s[self.second] - times_s[self.first]
        # The last row with a place, of this id or one before.
        with_place = np.where(places.is_known[order], np.arange(len(order)), 0)
        last_seen = order[np.maximum.accumulate(with_place)[second - 1]]
        is_same = table.track_id[last_seen] == table.track_id[self.second]
        is_seen = is_same & places.is_known[last_seen] & places.is_known[self.second]
        self.step_s = np.where(is_seen, times_s[self.second] - times_s[last_seen], 0.0)
        self.moved_m = np.where(is_seen, places.apart_m(last_seen, self.second), 0.0)

    @property
    def ended(self) -> Bool:
        """(S,) whether the track has ended between the two rows."""
        return has_ended(self.gap_s, self.step_s, self.moved_m)


def track_numbers(table: Trajectories, times_s: F64) -> I64:
    """(N,) number of the track of each row, at (N,) times [s]: the rows of one id until its track ends. Numbers rise by
    id, then by time."""
    steps = Steps(table, times_s)
    begins = np.ones(len(table), dtype=np.int64)
    begins[steps.second[~steps.ended]] = 0
    order = np.lexsort((table.frame, table.track_id))
    numbers = np.empty_like(begins)
    numbers[order] = np.cumsum(begins[order]) - 1
    return numbers


def velocities(table: Trajectories, times_s: F64, places: F64 | None = None) -> F64:
    """(N, 2) velocities of the rows of a table, at (N,) times [s], from (N, 2) places STEP_S before and after, by
    default those on the floor; NaN for a single row. Rows of one time, as of clocks that count whole seconds, have one
    place and one velocity."""
    if places is None:
        places = np.column_stack([table.x_m, table.y_m])
    velocity = np.full(places.shape, np.nan)
    for _, rows in rows_by_id(track_numbers(table, times_s)):
        moments_s, moment = np.unique(times_s[rows], return_inverse=True)
        before_s = np.maximum(moments_s - STEP_S, moments_s[0])
        after_s = np.minimum(moments_s + STEP_S, moments_s[-1])
        span_s = np.where(after_s > before_s, after_s - before_s, np.nan)
        counts = np.bincount(moment)
        for axis in (0, 1):
            place = np.bincount(moment, places[rows, axis]) / counts
            moved = np.interp(after_s, moments_s, place) - np.interp(before_s, moments_s, place)
            velocity[rows, axis] = (moved / span_s)[moment]
    return velocity
