"""The floor from above, and what is shown of one frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import F64, I32, U8
from planview.drawing.style import TRIPWIRE, TRUTH, ZONE, Labels, Rgb, as_bgr
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, row_states


@dataclass(frozen=True, eq=False)
class Rule:
    """A tripwire or zone: (N, 2) points on the floor [m], or in the image [px]."""

    name: str
    is_line: bool
    on_floor: bool
    points: F64


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Confirmed and lost people at a frame, its time (NaN where unknown), (N, 2) places of the last seconds by id [m],
    the newest last, and the true people."""

    frame: int
    time_s: float
    people: list[TrackState]
    trails: dict[int, F64] = field(default_factory=dict)
    truth: list[TrackState] = field(default_factory=list)


def snapshot_at(tracks: Trajectories, frame: int, trail_frames: int = 0, truth: Trajectories | None = None) -> Snapshot:
    """A frame of tables that are sorted by frame, with trails of ``trail_frames``."""
    first, start, stop = np.searchsorted(tracks.frame, [frame - trail_frames, frame, frame + 1]).tolist()
    people = [person for person in row_states(tracks, slice(start, stop)) if person.state != "tentative"]
    ids = tracks.track_id[first:stop]
    xy = np.column_stack([tracks.x_m[first:stop], tracks.y_m[first:stop]])
    trails = {person.track_id: xy[ids == person.track_id] for person in people}
    time_s = float(tracks.timestamp_s[start]) if stop > start else float("nan")
    true = row_states(truth, slice(*np.searchsorted(truth.frame, [frame, frame + 1]).tolist())) if truth else []
    return Snapshot(frame, time_s, people, trails, true)


def rules_of(counts: dict[str, object]) -> list[Rule]:
    """The rules in the ``rules`` object of counts.json. Raises InputError: points that no rule can have."""
    rules = []
    for name, rule in counts.items():
        points = rule.get("points") if isinstance(rule, dict) else None
        if isinstance(rule, dict) and points:
            on_floor = rule.get("plane") == "floor"
            try:
                places = np.array(points, dtype=np.float64).reshape(len(points), 2)
            except (OverflowError, TypeError, ValueError):
                places = np.full((1, 2), np.nan)
            if not (np.abs(places) <= 1e5).all():  # as far as rules.toml may have them
                raise InputError(f"counts.json: expected points of rule {name!r:.40} up to 1e5, found {points!s:.80}")
            rules.append(Rule(name, rule.get("kind") == "tripwire", on_floor, places))
    return rules


ARROW_M = 0.5
"""Length of the arrow that shows where a person faces [m]: beyond the shoulders."""


def facing_arrow(person: TrackState) -> F64 | None:
    """(2, 2) places on the floor [m], the person's and ARROW_M ahead of the chest; None where one is unknown."""
    ahead = math.radians(person.facing_deg)
    ends = np.array([person.x_m, person.y_m]) + np.outer([0.0, ARROW_M], [math.cos(ahead), math.sin(ahead)])
    return ends if np.isfinite(ends).all() else None


MARGIN_M = 0.6
_VIEW, _PAPER, _LINE = (247, 238, 232), (255, 255, 255), (222, 222, 222)


@dataclass(frozen=True)
class PlanBounds:
    """The part of the floor that is shown [m]."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


def bounds_of(*places_m: F64) -> PlanBounds:
    """Around all finite (N, 2) places [m], with a margin; a few metres where there is none."""
    known = np.concatenate([np.empty((0, 2)), *places_m])
    known = known[np.isfinite(known).all(axis=1)]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.full(2, -2.0), np.full(2, 2.0))
    return PlanBounds(*(low - MARGIN_M).tolist(), *(high + MARGIN_M).tolist())


class PlanPainter:
    """Draws snapshots on the floor, fitted into pictures of (width, height) pixels at ``scale`` [px/m]. ``cameras``:
    place (x, y) and outline of the view (N, 2) on the floor [m]; ``paper``: (H, W, 3) uint8 BGR, the floor without
    people."""

    def __init__(
        self,
        bounds: PlanBounds,
        size: tuple[int, int],
        cameras: Sequence[tuple[tuple[float, float], F64]] = (),
        rules: Sequence[Rule] = (),
    ) -> None:
        self._bounds, self._size = bounds, size
        wide, high = bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m
        self.scale = min(size[0] / wide, size[1] / high)
        self._middle = np.array([(bounds.x_min_m + bounds.x_max_m) / 2, (bounds.y_min_m + bounds.y_max_m) / 2])
        picture = np.full((self._size[1], self._size[0], 3), _PAPER, dtype=np.uint8)
        for _, outline in cameras:
            if len(outline) > 2:
                cv2.fillPoly(picture, [self.px(outline)], _VIEW, cv2.LINE_AA)
        # Lines every metre, or every 5 or 10 where metres are too fine; their coordinates along two sides.
        width, height = self._size
        step = next((s for s in (1, 2, 5, 10, 20, 50) if s * self.scale >= 22), 100)
        corners = self._middle + np.array([(-width, -height), (width, height)]) / 2 / self.scale
        for axis, along in ((0, height), (1, width)):
            for metre in range(math.ceil(corners[0, axis] / step) * step, math.floor(corners[1, axis]) + 1, step):
                place = np.array(self._middle)
                place[axis] = metre
                at = int(self.px(place[None])[0][axis])
                ends = ((at, 0), (at, along)) if axis == 0 else ((0, at), (along, at))
                cv2.line(picture, *ends, _LINE, 2 if metre % (5 * step) == 0 else 1)
                text = (at + 2, height - 4) if axis == 0 else (2, at - 2)
                cv2.putText(picture, f"{metre}", text, cv2.FONT_HERSHEY_SIMPLEX, 0.35, (130, 130, 130), 1, cv2.LINE_AA)
        labels = Labels(picture)
        for rule in rules:
            if rule.on_floor:
                colour = TRIPWIRE if rule.is_line else ZONE
                cv2.polylines(picture, [self.px(rule.points)], not rule.is_line, as_bgr(colour), 2, cv2.LINE_AA)
                labels.put(rule.name, self.px(rule.points[:1])[0].tolist(), colour)
        for at_m, _ in cameras:
            mark = self.px(np.array([at_m]))[0].tolist()
            cv2.drawMarker(picture, mark, (60, 60, 60), cv2.MARKER_TRIANGLE_DOWN, 14, 2)
        self.paper = picture

    def __call__(self, snapshot: Snapshot) -> U8:
        """(H, W, 3) uint8 BGR."""
        picture = self.paper.copy()
        labels = Labels(picture)
        for person in snapshot.people:
            trail = snapshot.trails.get(person.track_id)
            if trail is not None and len(trail) > 1:
                colour = as_bgr(person_rgb(person.track_id))
                cv2.polylines(picture, [self.px(trail)], False, colour, 2, cv2.LINE_AA)
        for person in snapshot.truth:
            if not math.isnan(person.x_m):
                at = self.px(np.array([(person.x_m, person.y_m)]))[0].tolist()
                cv2.drawMarker(picture, at, as_bgr(TRUTH), cv2.MARKER_TILTED_CROSS, 15, 2)
                self._paint_arrow(picture, person, as_bgr(TRUTH), 1)
        for person in (person for person in snapshot.people if not math.isnan(person.x_m)):
            x, y = self.px(np.array([(person.x_m, person.y_m)]))[0].tolist()
            colour = as_bgr(person_rgb(person.track_id, person.state))
            self._paint_arrow(picture, person, colour, 2)
            cv2.circle(picture, (x, y), 6, colour, 2 if person.state == "lost" else -1, cv2.LINE_AA)
            labels.put(str(person.track_id), (x + 8, y - 4), person_rgb(person.track_id, person.state))
        return picture

    def _paint_arrow(self, picture: U8, person: TrackState, colour: Rgb, width: int) -> None:
        if (arrow := facing_arrow(person)) is not None:
            start, tip = self.px(arrow).tolist()
            cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, tipLength=0.35)

    def px(self, places_m: F64) -> I32:
        """(N, 2) pixels of (N, 2) places [m]; y points up."""
        known = np.nan_to_num(places_m) - self._middle
        pixels = np.array(self._size) / 2 + known * self.scale * (1, -1)
        return np.asarray(np.clip(np.round(pixels), -(2**14), 2**14), dtype=np.int32)
