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
from planview.maps.pixels import PixelRays
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


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Cameras above the maps; a place is viewed by the nearest."""

    cameras: tuple[PixelRays, ...]

    def sees(self, x_m: float, y_m: float, z_m: float) -> bool:
        """Whether a world point lies in an image."""
        for camera in self.cameras:
            u, v, depth = camera.projection @ (x_m, y_m, z_m, 1.0)
            rows, columns = camera.shape
            if depth > 0 and -0.5 <= u / depth < columns - 0.5 and -0.5 <= v / depth < rows - 0.5:
                return True
        return False

    def ray(self, x_m: float, y_m: float) -> tuple[float, float, float, PixelRays]:
        """Horizontal unit vector away from the camera, horizontal distance from it [m], and the camera."""
        camera = min(self.cameras, key=lambda one: math.dist(one.centre_m[:2], (x_m, y_m)))
        dx, dy = x_m - float(camera.centre_m[0]), y_m - float(camera.centre_m[1])
        away_m = math.hypot(dx, dy)
        return (dx / away_m, dy / away_m, away_m, camera) if away_m > 1e-6 else (0.0, 1.0, away_m, camera)


def peaks(maps: PlanViewMaps, view: Viewpoint) -> list[Peak]:
    """Peaks of the height map with enough surface, at the heads of the points around them."""
    cell_m, points = maps.grid.cell_m, maps.points
    smooth = cv2.GaussianBlur(maps.height, (0, 0), BLUR_M / cell_m)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(SEPARATION_M / cell_m) + 1,) * 2)
    rows, cols = np.nonzero((smooth == cv2.dilate(smooth, around)) & (maps.height > PEAK_M))
    found = [Peak(*maps.grid.centre_of(float(r), float(c)), 0.0) for r, c in zip(rows, cols, strict=True)]
    for _ in range(2):  # peaks without surface go, and their points are shared among the others
        if not found:
            return []
        far = np.column_stack([_distances(maps, view, peak) for peak in found])
        nearest = np.where(far.min(axis=1) < 1.2, far.argmin(axis=1), -1)
        heads = [
            _head(maps, view, nearest == i) for i in range(len(found)) if points.area[nearest == i].sum() >= SURFACE_M2
        ]
        whole = len(heads) == len(found)
        found = heads
        if whole:
            break
    return found


def _distances(maps: PlanViewMaps, view: Viewpoint, peak: Peak) -> F64:
    """(N,) distance of all points from a peak, in bodies, which depth noise stretches along the viewing ray."""
    ray_x, ray_y, away_m, camera = view.ray(peak.x_m, peak.y_m)
    smear_m = camera.depth_std_per_m2 * math.hypot(away_m, float(camera.centre_m[2]) - 1.0) * away_m
    dx, dy = maps.points.xyz[:, 0] - peak.x_m, maps.points.xyz[:, 1] - peak.y_m
    return np.hypot((dx * ray_x + dy * ray_y) / math.hypot(BODY_M, smear_m), (dy * ray_x - dx * ray_y) / BODY_M)


def _head(maps: PlanViewMaps, view: Viewpoint, mine: np.ndarray) -> Peak:
    """The head of a body's points: a camera sees its near side."""
    xyz, area = maps.points.xyz[mine], maps.points.area[mine]
    top_m = float(np.percentile(xyz[:, 2], 98))
    high = xyz[:, 2] > top_m - HEAD_M
    x_m, y_m = np.average(xyz[high, :2], axis=0, weights=area[high]).tolist()
    ray_x, ray_y, away_m, camera = view.ray(x_m, y_m)
    # Heads are at about this height [m].
    behind_m = HEAD_RADIUS_M * math.cos(math.atan2(max(float(camera.centre_m[2]) - 1.6, 0.0), away_m))
    return Peak(x_m + behind_m * ray_x, y_m + behind_m * ray_y, top_m)


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
        view = Viewpoint(tuple(seen.rays for seen in observation.views))
        found = peaks(maps, view)
        cost = np.array([[_cost(p, peak, dt_s) for peak in found] for p in self._people])
        pairs = linear_sum_assignment(cost.reshape(len(self._people), len(found)))
        matched = {int(i): int(j) for i, j in zip(*pairs, strict=True) if cost[i, j] < FORBIDDEN}
        for i, p in enumerate(self._people):
            if i in matched:
                _take(p, found[matched[i]])
            else:
                p.gone_s += dt_s
                p.evidence += MISSED
        self._people = [p for p in self._people if _stays(p, view)]
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


def _stays(person: _PeakPerson, view: Viewpoint) -> bool:
    """Newcomers while the evidence is for them, others for a while, which is shorter outside the view."""
    if not person.is_confirmed:
        return person.evidence > 0
    inside = view.sees(person.kalman.x_m, person.kalman.y_m, 1.5)
    return person.gone_s < (KEEP_S if inside else LEAVE_S)
