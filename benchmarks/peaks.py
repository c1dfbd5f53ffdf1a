"""A tracker to beat: peaks of the height map, each joined to the nearest person of the frame before."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F64
from planview.maps.plan_view import PlanViewMaps
from planview.tracking.base import Decision, Needs, Observation, TrackerDebug
from planview.trajectories.state import TrackState

BLUR_M = 0.06
"""Deviation of the Gaussian that smooths the height map [m]."""
SEPARATION_M = 0.34
"""A peak is the highest within this radius [m]."""
PEAK_M = 1.0
NEWCOMER_M = 1.15
"""Lowest peak, and lowest one of a person who is new [m]."""
BODY_M = 0.3
SURFACE_M2 = 0.04
HEAD_M = 0.28
"""Radius of a body around a peak [m], its smallest visible surface [m^2], and the height of its head [m]."""
GATE_M = 0.45
LOST_MPS = 1.2
"""Farthest a peak is from its person of the frame before [m], which grows while nothing is seen [m/s]."""
CONFIRM_FRAMES = 3
KEEP_S = 2.0
"""Peaks of a person until confirmed, and how long one without any is kept [s]."""
FAR_M = 1e3
"""Stands for a distance beyond every gate [m]."""


def find_peaks(maps: PlanViewMaps) -> F64:
    """(N, 3) places of the heads and their tops [m], at peaks of the height map with enough surface around them."""
    cell_m = maps.grid.cell_m
    xyz = maps.points.xyz
    area = maps.points.area
    smooth = cv2.GaussianBlur(maps.height, (0, 0), BLUR_M / cell_m)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(SEPARATION_M / cell_m) + 1,) * 2)
    highest = np.argwhere((smooth == cv2.dilate(smooth, around)) & (maps.height > PEAK_M))
    by_height = np.argsort(-smooth[tuple(highest.T)], kind="stable")
    heads: list[list[float]] = []
    for row, col in highest[by_height].tolist():
        at_m = maps.grid.centre_of(row, col)
        is_body = np.hypot(*(xyz[:, :2] - at_m).T) < BODY_M
        is_new = all(math.dist(at_m, head[:2]) >= SEPARATION_M for head in heads)  # flat tops have several peaks
        if is_new and area[is_body].sum() >= SURFACE_M2:
            top_m = float(np.percentile(xyz[is_body, 2], 98))
            is_head = is_body & (xyz[:, 2] > top_m - HEAD_M)
            heads.append([*np.average(xyz[is_head, :2], axis=0, weights=area[is_head]), top_m])
    return np.array(heads, dtype=np.float64).reshape(-1, 3)


@dataclass
class PeakTracker:
    """A ``Tracker``: the Hungarian method on the distance of peaks from the people of the frame before."""

    needs: ClassVar[Needs] = "maps"
    decisions: tuple[Decision, ...] = ()
    _people: list[TrackState] = field(default_factory=list)
    _seen: dict[int, tuple[int, float]] = field(default_factory=dict)
    """Number of peaks of each person, and when the last one was seen [s]."""
    _next_id: int = 1

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame from its maps."""
        maps = observation.maps
        now_s = observation.timestamp_s
        if maps is None:
            raise ValueError("expected plan-view maps, got an observation without them")
        peaks = find_peaks(maps)
        peak_of = self._match(peaks, now_s)
        people = []
        for i, person in enumerate(self._people):
            count, last_s = self._seen[person.track_id]
            if i in peak_of:
                people.append(self._at(peaks[peak_of[i]], person.track_id, count + 1, now_s))
            elif count >= CONFIRM_FRAMES and now_s - last_s < KEEP_S:
                people.append(replace(person, state="lost"))
        matched = set(peak_of.values())
        for j, peak in enumerate(peaks):
            if j not in matched and peak[2] >= NEWCOMER_M:
                people.append(self._at(peak, self._next_id, 1, now_s))
                self._next_id += 1
        self._people = people
        return tuple(people)

    def _match(self, peaks: F64, now_s: float) -> dict[int, int]:
        """The peak of each person who has one, by number."""
        before = np.array([(person.x_m, person.y_m) for person in self._people]).reshape(-1, 2)
        away_m = np.hypot(*(before[:, None] - peaks[None, :, :2]).transpose(2, 0, 1))
        last_s = np.array([self._seen[person.track_id][1] for person in self._people])
        is_near = away_m <= (GATE_M + LOST_MPS * (now_s - last_s)).reshape(-1, 1)
        people, chosen = linear_sum_assignment(np.where(is_near, away_m, FAR_M))
        pairs = zip(people.tolist(), chosen.tolist(), strict=True)
        return {person: peak for person, peak in pairs if is_near[person, peak]}

    def _at(self, peak: F64, track_id: int, count: int, now_s: float) -> TrackState:
        self._seen[track_id] = count, now_s
        state: Literal["confirmed", "tentative"] = "confirmed" if count >= CONFIRM_FRAMES else "tentative"
        x_m, y_m, top_m = peak.tolist()
        return TrackState(track_id, state, x_m, y_m, math.nan, math.nan, top_m)

    def debug(self) -> TrackerDebug:
        """Nothing to show."""
        return TrackerDebug()

    def reset(self) -> None:
        """Forget all people."""
        self._people = []
        self._seen = {}
        self._next_id = 1
