"""Stays in a polygon: entries, exits, and how long people were inside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.types import F64, I8
from planview.counting.events import EventKind
from planview.counting.geometry import Outline, PlaneName, inner_radius
from planview.counting.places import Places, side_codes

_MARGIN_SHARE = 0.25
"""Largest part of a zone's inner radius that hysteresis may take: people in the middle of a narrow zone are inside."""


@dataclass(eq=False)
class Stay:
    """One person inside, from ``start_s`` until ``end_s`` (the last observation so far).

    Attributes:
        entered: came in over the outline; false for a track that began inside.
        left: went out over the outline; false for a track that ended inside, or is still there.
        counted: the person is confirmed and old enough.
    """

    start_s: float
    end_s: float
    entered: bool
    left: bool = False
    counted: bool = False

    @property
    def dwell_s(self) -> float:
        return self.end_s - self.start_s


@dataclass(frozen=True)
class Passage:
    """An outline passed: the first frame at or after the moment, and the moment."""

    frame: int
    timestamp_s: float
    kind: EventKind


class _At(NamedTuple):
    """A sighting relative to the outline: its depth inside [m]."""

    frame: int
    timestamp_s: float
    depth_m: float


class Area:
    """A zone in its plane.

    Args:
        points: (N, 2) corners.
        hysteresis_m: depth that decides inside and outside [m].
    """

    def __init__(self, name: str, points: F64, plane: PlaneName, hysteresis_m: float, min_age_s: float) -> None:
        self.name, self.plane, self.min_age_s = name, plane, min_age_s
        self._outline = Outline(points)
        self._hysteresis_m = hysteresis_m
        self._margin_limit = _MARGIN_SHARE * inner_radius(points)

    def locate(self, places: Places) -> tuple[F64, F64]:
        """(N,) depth inside (negative outside) and the margin that decides [m]; NaN when not known in this plane."""
        x, y, unit = places.within(self.plane)
        margin = np.minimum(self._hysteresis_m, self._margin_limit / unit)
        known = np.isfinite(x + y + unit)
        return self._outline.depth(x, y) / unit, np.where(known, margin, np.nan)

    def sides(self, places: Places) -> I8:
        """(N,) 0 not known, 1 to 4 from decided outside to decided inside."""
        depth_m, margin_m = self.locate(places)
        return side_codes(depth_m, np.abs(depth_m) >= margin_m, np.isfinite(margin_m))


class AreaState:
    """One person at one zone. ``stay`` is the current one, None outside."""

    def __init__(self) -> None:
        self._last: _At | None = None
        self._passed: tuple[int, float] = (0, 0.0)
        self.stay: Stay | None = None

    def update(self, frame: int, timestamp_s: float, depth_m: float, margin_m: float) -> Passage | None:
        """An entry or exit once the person is far enough in or out, dated to when the outline was passed."""
        if not math.isfinite(margin_m):
            return None
        now, before = _At(frame, timestamp_s, depth_m), self._last
        if before is not None and (before.depth_m >= 0) != (depth_m >= 0):
            self._pass(before, now)
        self._last = now
        if self.stay is None:
            return self._outside(now, margin_m, before is None)
        if depth_m <= -margin_m and depth_m < 0:
            self.stay.end_s, self.stay.left = self._passed[1], True
            self.stay = None
            return Passage(*self._passed, "exit")
        self.stay.end_s = timestamp_s
        return None

    def _outside(self, now: _At, margin_m: float, first: bool) -> Passage | None:
        if first and now.depth_m >= 0:
            self.stay = Stay(now.timestamp_s, now.timestamp_s, entered=False)
        elif now.depth_m >= margin_m:
            self.stay = Stay(self._passed[1], now.timestamp_s, entered=True)
            return Passage(*self._passed, "entry")
        return None

    def _pass(self, before: _At, now: _At) -> None:
        """The outline is passed between two sightings."""
        part = before.depth_m / (before.depth_m - now.depth_m)
        moment = before.timestamp_s + part * (now.timestamp_s - before.timestamp_s)
        self._passed = math.ceil(before.frame + part * (now.frame - before.frame)), moment
