"""Stays in a polygon: entries, exits, and how long people were inside."""

from __future__ import annotations

import math
from dataclasses import dataclass

from calib.types import F64
from planview.analytics.events import EventKind
from planview.analytics.geometry import Outline, PlaneName, inner_radius
from planview.analytics.people import Sighting

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

    def depth(self, sighting: Sighting) -> tuple[float, float] | None:
        """Depth inside (negative outside) and the margin that decides [m]; None when not known in this plane."""
        x, y, unit = sighting.at(self.plane)
        if not math.isfinite(x + y + unit):
            return None
        return self._outline.depth(x, y) / unit, min(self._hysteresis_m, self._margin_limit / unit)


class AreaState:
    """One person at one zone. ``stay`` is the current one, None outside."""

    def __init__(self, area: Area) -> None:
        self._area = area
        self._last: tuple[Sighting, float] | None = None
        self._passed: tuple[int, float] = (0, 0.0)
        self.stay: Stay | None = None

    def update(self, sighting: Sighting) -> Passage | None:
        """An entry or exit once the person is far enough in or out, dated to when the outline was passed."""
        located = self._area.depth(sighting)
        if located is None:
            return None
        depth, margin = located
        first = self._last is None
        if self._last is not None:
            self._pass(*self._last, sighting, depth)
        self._last = sighting, depth
        if self.stay is None:
            return self._outside(sighting, depth, margin, first)
        if depth <= -margin and depth < 0:
            self.stay.end_s, self.stay.left = self._passed[1], True
            self.stay = None
            return Passage(*self._passed, "exit")
        self.stay.end_s = sighting.timestamp_s
        return None

    def _outside(self, sighting: Sighting, depth: float, margin: float, first: bool) -> Passage | None:
        if first and depth >= 0:
            self.stay = Stay(sighting.timestamp_s, sighting.timestamp_s, entered=False)
        elif depth >= margin:
            self.stay = Stay(self._passed[1], sighting.timestamp_s, entered=True)
            return Passage(*self._passed, "entry")
        return None

    def _pass(self, before: Sighting, was: float, now: Sighting, depth: float) -> None:
        if (was >= 0) == (depth >= 0):
            return
        part = was / (was - depth)
        moment = before.timestamp_s + part * (now.timestamp_s - before.timestamp_s)
        self._passed = math.ceil(before.frame + part * (now.frame - before.frame)), moment
