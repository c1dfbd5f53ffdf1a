"""Crossings of a line, with a side that must be left and another that must be reached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.types import F64, I8
from planview.counting.events import Direction
from planview.counting.geometry import PlaneName
from planview.counting.places import Places, side_codes

MAX_SPEED_MPS = 8.0
JUMP_M = 1.0
"""A step over a line that is faster [m/s] and longer [m] is a correction by the tracker and not a movement (our choice:
a sprint, and ten times the noise of a good tracker)."""
PUT_BACK_S = 2.0
"""A jump back within this time of a crossing undoes it [s]; a jump at another time stands for a crossing once the
person has stayed beyond the line for as long as a new track must last. Our choice."""


@dataclass(frozen=True)
class Crossing:
    """When (interpolated) and which way."""

    frame: int
    timestamp_s: float
    direction: Direction


class _At(NamedTuple):
    """A sighting relative to the line: side_m left of it [m], ``along`` 0 at its first and 1 at its second point."""

    frame: int
    timestamp_s: float
    side_m: float
    along: float


class Wire:
    """A tripwire in its plane.

    Args:
        points: (2, 2) first and second point.
        plane: "floor", or "image" whose y axis points down, so that left and right change places.
        hysteresis_m: distance that decides a side [m].
    """

    def __init__(self, name: str, points: F64, plane: PlaneName, hysteresis_m: float, min_age_s: float) -> None:
        self.name, self.plane, self.hysteresis_m, self.min_age_s = name, plane, hysteresis_m, min_age_s
        self._start: list[float] = points[0].tolist()
        self._length = float(np.hypot(*(points[1] - points[0])))
        self._ahead: list[float] = ((points[1] - points[0]) / self._length).tolist()
        self._left_sign = 1.0 if plane == "floor" else -1.0

    def locate(self, places: Places) -> tuple[F64, F64]:
        """(N,) distance left of the line [m], and place along it from 0 to 1; NaN when not known in this plane."""
        x, y, unit = places.within(self.plane)
        dx, dy = x - self._start[0], y - self._start[1]
        ahead = self._ahead[0] * dx + self._ahead[1] * dy
        left = self._left_sign * (self._ahead[0] * dy - self._ahead[1] * dx)
        return left / unit, np.where(np.isfinite(x + y + unit), ahead / self._length, np.nan)

    def sides(self, places: Places) -> I8:
        """(N,) 0 not known, 1 to 4 from decided right to decided left."""
        side_m, along = self.locate(places)
        return side_codes(side_m, np.abs(side_m) >= self.hysteresis_m, np.isfinite(along))


class WireState:
    """One person at one wire: the side last decided, and the way taken since."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        self._side = 0  # 1 left, -1 right, 0 not decided: not yet observed far enough from the line
        self._last: _At | None = None
        self._net = 0  # passages through the wire since the side was decided, 1 to the left, -1 to the right
        self._passed: tuple[int, float] = (0, 0.0)
        self._jumped = False  # whether the last passage was too fast for a person
        self._put_back = 0  # side from which a jump took the person; reaching it again is no crossing
        self._crossed_s = -math.inf
        self._waiting: Crossing | None = None  # in a jump: counts once the person has stayed

    def update(self, frame: int, timestamp_s: float, side_m: float, along: float) -> Crossing | None:
        """The crossing that is certain now, the person far enough on the other side; dated to when the line was passed.

        Going round the end of the line passes its extension, which does not count; turning back within the hysteresis
        is no crossing. A person put back over the line in a jump crosses it again without counting again, and who is
        back from a jump before ``min_age_s`` has not crossed at all.
        """
        if not math.isfinite(along):
            return None
        now = _At(frame, timestamp_s, side_m, along)
        if self._last is not None and (self._last.side_m >= 0) != (side_m >= 0):
            self._pass(self._last, now)
        self._last = now
        crossing = self._decide(side_m)
        if crossing is not None and self._waiting is not None:
            crossing = self._waiting = None  # back already: the jump was an error of measurement
        elif crossing is not None and self._jumped:
            crossing, self._waiting = None, crossing
        if self._waiting is not None and timestamp_s - self._waiting.timestamp_s >= self._wire.min_age_s:
            crossing, self._waiting = self._waiting, None
        if crossing is not None:
            self._crossed_s = crossing.timestamp_s
        return crossing

    def _decide(self, side_m: float) -> Crossing | None:
        """The passage that took the person to this side, once far enough on it."""
        if abs(side_m) < self._wire.hysteresis_m:
            return None
        side = 1 if side_m >= 0 else -1
        before, net = self._side, self._net
        self._side, self._net = side, 0
        if before in (0, side) or net * side <= 0:
            return None
        back = self._jumped and self._passed[1] - self._crossed_s <= PUT_BACK_S
        again, self._put_back = self._put_back == side, before if back else 0
        return None if again or back else Crossing(*self._passed, "right_to_left" if side > 0 else "left_to_right")

    def _pass(self, a: _At, b: _At) -> None:
        """The line, or its extension, is passed between two sightings."""
        part = a.side_m / (a.side_m - b.side_m)
        if 0.0 <= a.along + part * (b.along - a.along) <= 1.0:
            self._net += 1 if b.side_m >= 0 else -1
            moment = a.timestamp_s + part * (b.timestamp_s - a.timestamp_s)
            step_m = abs(b.side_m - a.side_m)
            self._jumped = step_m > JUMP_M and step_m > MAX_SPEED_MPS * (b.timestamp_s - a.timestamp_s)
            self._passed = math.ceil(a.frame + part * (b.frame - a.frame)), moment
