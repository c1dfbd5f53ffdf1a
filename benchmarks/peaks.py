"""A tracker to beat: peaks of the height map, each joined to the nearest person of the frame before."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F64
from planview.maps.builder import PlanViewMaps
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

BLUR_M, SEPARATION_M = 0.06, 0.34
"""Deviation of the Gaussian that smooths the height map; a peak is the highest within this radius [m]."""
PEAK_M, NEWCOMER_M = 1.0, 1.15
"""Lowest peak, and lowest one of a person who is new [m]."""
BODY_M, SURFACE_M2 = 0.3, 0.04
"""Radius of a body, within 1.2 of which points belong to a peak; smallest visible surface of a person."""
HEAD_M, HEAD_RADIUS_M = 0.28, 0.08
"""Height of a head, whose points give the position [m], and how far its centre lies behind their middle."""
POSITION_STD_M, ACCELERATION_STD_MPS2, SPEED_STD_MPS = 0.08, 1.5, 1.0
"""Deviations of the Kalman filter: position of a head, random acceleration, velocity of a newcomer."""
GATE_M, SPEED_MAX_MPS, LOST_SPEED_MPS = 0.45, 3.1, 1.2
"""Farthest a peak is from its person's prediction: a step, what the fastest walks in a frame, and what one who is lost
walks meanwhile, for a second."""
FOUND, MISSED = 1.9, -0.6
"""Evidence (log-odds) of a frame with and without a peak, of a person not yet confirmed; a newcomer has 1."""
SLOW_DOWN_S, KEEP_S, LEAVE_S = 0.6, 4.0, 0.6
"""Time in which a lost person's speed falls to 1/e; how long the lost are kept inside and outside the view [s]."""


class Peak(NamedTuple):
    """Position of a head, and its top [m]."""

    x_m: float
    y_m: float
    top_m: float


def peaks(maps: PlanViewMaps) -> list[Peak]:
    """Peaks of the height map with enough surface, at the heads of the points around them."""
    cell_m, points = maps.grid.cell_m, maps.points
    smooth = cv2.GaussianBlur(maps.height, (0, 0), BLUR_M / cell_m)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(SEPARATION_M / cell_m) + 1,) * 2)
    rows, cols = np.nonzero((smooth == cv2.dilate(smooth, around)) & (maps.height > PEAK_M))
    found = [Peak(*maps.grid.centre_of(float(r), float(c)), 0.0) for r, c in zip(rows, cols, strict=True)]
    for _ in range(2):  # peaks without surface go, and their points are shared among the others
        if not found:
            return []
        far = np.column_stack([_distances(maps, peak) for peak in found])
        nearest = np.where(far.min(axis=1) < 1.2, far.argmin(axis=1), -1)
        heads = [_head(maps, nearest == i) for i in range(len(found)) if points.area[nearest == i].sum() >= SURFACE_M2]
        whole = len(heads) == len(found)
        found = heads
        if whole:
            break
    return found


def _distances(maps: PlanViewMaps, peak: Peak) -> F64:
    """(N,) distance of all points from a peak, in bodies, which depth noise stretches along the viewing ray."""
    across_m, along_m, ray = maps.view.footprint(peak.x_m, peak.y_m, BODY_M, 1.0)
    dx, dy = maps.points.xyz[:, 0] - peak.x_m, maps.points.xyz[:, 1] - peak.y_m
    return np.hypot((dx * ray[0] + dy * ray[1]) / along_m, (dy * ray[0] - dx * ray[1]) / across_m)


def _head(maps: PlanViewMaps, mine: np.ndarray) -> Peak:
    """The head of a body's points: a camera sees its near side."""
    xyz, area = maps.points.xyz[mine], maps.points.area[mine]
    top_m = float(np.percentile(xyz[:, 2], 98))
    high = xyz[:, 2] > top_m - HEAD_M
    place = np.average(xyz[high, :2], axis=0, weights=area[high]).reshape(1, 2)
    (away,), (depression,) = maps.view.viewing(place)
    x_m, y_m = place[0] + HEAD_RADIUS_M * math.cos(float(depression)) * away
    return Peak(float(x_m), float(y_m), top_m)


@dataclass
class _PeakPerson:
    track_id: int
    kalman: FloorKalman
    height_m: float
    evidence: float = 1.0
    n_peaks: int = 1
    gone_s: float = 0.0

    @property
    def is_confirmed(self) -> bool:
        # A newcomer is confirmed after so many peaks.
        return self.n_peaks >= 3

    def state(self) -> TrackState:
        seen: Literal["confirmed", "lost"] = "lost" if self.gone_s else "confirmed"
        k = self.kalman
        state = seen if self.is_confirmed else "tentative"
        return TrackState(self.track_id, state, k.x_m, k.y_m, k.vx_mps, k.vy_mps, self.height_m)


@dataclass
class PeakTracker:
    """A ``Tracker``: the Hungarian method on distance and height, one Kalman filter a person."""

    decisions: tuple[Decision, ...] = ()
    _people: list[_PeakPerson] = field(default_factory=list)
    _last_s: float = math.nan
    _next_id: int = 1

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame from its maps."""
        maps = observation.maps
        if maps is None:
            raise ValueError("expected plan-view maps, got an observation without them")
        dt_s = 0.0 if math.isnan(self._last_s) else observation.timestamp_s - self._last_s
        self._last_s = observation.timestamp_s
        for p in self._people:
            lost = p.kalman.slowed(dt_s, SLOW_DOWN_S) if p.gone_s else p.kalman
            p.kalman = lost.predicted(dt_s, ACCELERATION_STD_MPS2)
        found = peaks(maps)
        cost = np.array([[_cost(p, peak, dt_s) for peak in found] for p in self._people])
        pairs = linear_sum_assignment(cost.reshape(len(self._people), len(found)))
        matched = {int(i): int(j) for i, j in zip(*pairs, strict=True) if cost[i, j] < FORBIDDEN}
        for i, p in enumerate(self._people):
            if i in matched:
                _take(p, found[matched[i]])
            else:
                p.gone_s += dt_s
                p.evidence += MISSED
        self._people = [p for p in self._people if _stays(p, maps)]
        for peak in (found[j] for j in range(len(found)) if j not in matched.values()):
            taken = any(
                math.hypot(p.kalman.x_m - peak.x_m, p.kalman.y_m - peak.y_m) < BODY_M
                for p in self._people
                if not p.gone_s
            )
            if peak.top_m >= NEWCOMER_M and not taken:
                kalman = FloorKalman.at(peak.x_m, peak.y_m, POSITION_STD_M, SPEED_STD_MPS)
                self._people.append(_PeakPerson(self._next_id, kalman, peak.top_m))
                self._next_id += 1
        return tuple(p.state() for p in self._people)

    def debug(self) -> TrackerDebug:
        """Nothing to show."""
        return TrackerDebug()

    def reset(self) -> None:
        """Forget all people."""
        self._people, self._last_s, self._next_id = [], math.nan, 1


FORBIDDEN = 1e3
"""Cost of a pair that cannot be."""


def _cost(person: _PeakPerson, peak: Peak, dt_s: float) -> float:
    """Of a peak as a person's: far away, of another height (worse: taller), or of one who is not confirmed."""
    away_m = math.hypot(person.kalman.x_m - peak.x_m, person.kalman.y_m - peak.y_m)
    if away_m > max(GATE_M, SPEED_MAX_MPS * dt_s) + LOST_SPEED_MPS * min(1.0, person.gone_s):
        return FORBIDDEN
    taller_m = peak.top_m - person.height_m
    return 2 * away_m + abs(taller_m) + 2 * max(0.0, taller_m - 0.1) + (0.0 if person.is_confirmed else 0.5)


def _take(person: _PeakPerson, peak: Peak) -> None:
    """A person is where the peak is, at once after a while without one."""
    kalman = person.kalman.moved_to(peak.x_m, peak.y_m) if person.gone_s > LEAVE_S else person.kalman
    person.kalman = kalman.updated(peak.x_m, peak.y_m, POSITION_STD_M)
    person.height_m += 0.2 * (peak.top_m - person.height_m)
    person.n_peaks, person.gone_s, person.evidence = person.n_peaks + 1, 0.0, person.evidence + FOUND


def _stays(person: _PeakPerson, maps: PlanViewMaps) -> bool:
    """Newcomers while the evidence is for them, others for a while, which is shorter outside the view."""
    if not person.is_confirmed:
        return person.evidence > 0
    inside = maps.view.sees(person.kalman.x_m, person.kalman.y_m, 1.5)
    return person.gone_s < (KEEP_S if inside else LEAVE_S)
