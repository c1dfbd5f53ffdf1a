"""People and the floor in the image of a camera and from above, and what is shown of one frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.images import as_colour
from calib.types import F64, I32, U8, AnyArray
from planview.drawing.style import TRIPWIRE, TRUTH, ZONE, Labels, Rgb, as_bgr
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import SURE_FACING, TrackState
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


ARROW_M, AXIS_M = 0.5, 0.35
"""From a person to the tip of the arrow that shows where it faces, and to the ends of a line without a head [m]: beyond
the shoulders."""


def faces_surely(person: TrackState) -> bool:
    """Whether front and back are told apart surely enough for an arrow; they are where a table has no confidence."""
    return not person.facing_confidence < SURE_FACING


def facing_line(person: TrackState) -> F64 | None:
    """(2, 2) places on the floor [m]: the person's and ARROW_M ahead of the chest, or where front and back may be
    confused AXIS_M behind and ahead; None where one is unknown."""
    ahead = math.radians(person.facing_deg)
    reach = [0.0, ARROW_M] if faces_surely(person) else [-AXIS_M, AXIS_M]
    ends = np.array([person.x_m, person.y_m]) + np.outer(reach, [math.cos(ahead), math.sin(ahead)])
    return ends if np.isfinite(ends).all() else None


def paint_facing(picture: U8, person: TrackState, ends: I32, colour: Rgb, width: int) -> None:
    """Draw the (2, 2) ends of a ``facing_line`` [px]: an arrow, or a line without a head."""
    start, tip = ends.tolist()
    cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, tipLength=0.35 if faces_surely(person) else 0.0)


SHOWN_MARGIN_M = 0.6
_VIEW, _PAPER, _LINE = (247, 238, 232), (255, 255, 255), (222, 222, 222)


@dataclass(frozen=True)
class PlanBounds:
    """The part of the floor that is shown [m]."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


def from_above(image: U8, camera: FloorCamera, x_m: AnyArray, y_m: AnyArray) -> U8:
    """What an image shows at places of the floor: (H, W, 3) uint8 for (H, W) places [m]; black outside of the image."""
    places = np.stack([x_m, y_m, np.zeros_like(x_m)], axis=-1)
    columns, rows = np.moveaxis(np.nan_to_num(camera.project(places), nan=-1.0).astype(np.float32), -1, 0)
    shown = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(shown, dtype=np.uint8)


def bounds_of(*places_m: F64) -> PlanBounds:
    """Around all finite (N, 2) places [m], with a margin; a few metres where there is none."""
    known = np.concatenate([np.empty((0, 2)), *places_m])
    known = known[np.isfinite(known).all(axis=1)]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.full(2, -2.0), np.full(2, 2.0))
    return PlanBounds(*(low - SHOWN_MARGIN_M).tolist(), *(high + SHOWN_MARGIN_M).tolist())


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
        self._size = size
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
                self._paint_facing(picture, person, as_bgr(TRUTH), 1)
        for person in (person for person in snapshot.people if not math.isnan(person.x_m)):
            x, y = self.px(np.array([(person.x_m, person.y_m)]))[0].tolist()
            colour = as_bgr(person_rgb(person.track_id, person.state))
            self._paint_facing(picture, person, colour, 2)
            cv2.circle(picture, (x, y), 6, colour, 2 if person.state == "lost" else -1, cv2.LINE_AA)
            labels.put(str(person.track_id), (x + 8, y - 4), person_rgb(person.track_id, person.state))
        return picture

    def _paint_facing(self, picture: U8, person: TrackState, colour: Rgb, width: int) -> None:
        if (line := facing_line(person)) is not None:
            paint_facing(picture, person, self.px(line), colour, width)

    def px(self, places_m: F64) -> I32:
        """(N, 2) pixels of (N, 2) places [m]; y points up."""
        known = np.nan_to_num(places_m) - self._middle
        pixels = np.array(self._size) / 2 + known * self.scale * (1, -1)
        return np.asarray(np.clip(np.round(pixels), -(2**14), 2**14), dtype=np.int32)


Project = Callable[[ArrayLike], F64]
"""(N, 3) world points [m] to (N, 2) pixels, NaN where unseen."""


class GridLine(NamedTuple):
    """A part of a line of the grid that is near the image: ``coordinate`` [m] and (k, 2) pixels."""

    coordinate: float
    pixels: F64


def grid_lines(
    project: Project, extent_m: tuple[float, float, float, float], size: tuple[int, int], step_m: float = 1.0
) -> list[GridLine]:
    """Lines of a grid over (x_min, y_min, x_max, y_max) of the floor in an image of (width, height) pixels."""
    low, high = np.floor(extent_m[:2]), np.ceil(extent_m[2:])
    lines = []
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + 1e-9, step_m).tolist():
            ends = np.stack([low, high])
            ends[:, axis] = at
            lines += [GridLine(at, part) for part in visible_parts(project, ends, size)]
    return lines


def visible_parts(project: Project, places_m: F64, size: tuple[int, int]) -> list[F64]:
    """A line through (N, 2) places on the floor [m], in pixels, in parts of at least two points near the image."""
    known = places_m[np.isfinite(places_m).all(axis=1)]
    if len(known) < 2:
        return []
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(known, axis=0).T))])
    if along[-1] <= 0:
        return []
    samples = min(2000, math.ceil(along[-1] / 0.2) + 1)
    at = np.union1d(along, np.linspace(0.0, along[-1], samples))
    xyz = np.column_stack([np.interp(at, along, known[:, 0]), np.interp(at, along, known[:, 1]), np.zeros(len(at))])
    pixels, limits = project(xyz), np.array(size)
    with np.errstate(invalid="ignore"):
        near = np.asarray(((pixels > -0.5 * limits) & (pixels < 1.5 * limits)).all(axis=1))  # not NaN either
    cuts = np.flatnonzero(np.diff(near.astype(np.int8))) + 1
    parts = zip(np.split(pixels, cuts), np.split(near, cuts), strict=True)
    return [part for part, visible in parts if len(part) > 1 and visible[0]]


GRID_STRENGTH = 0.4
"""Share of the grid's colour in the picture."""


class ImagePainter:
    """Draws snapshots into the images of one camera; boxes only for None, one that is not calibrated. ``bounds``: of
    the metre grid on the floor."""

    def __init__(
        self, camera: FloorCamera | None, rules: Sequence[Rule] = (), bounds: PlanBounds | None = None
    ) -> None:
        self._camera, self._rules = camera, rules
        self._grid: list[GridLine] = []
        if camera is not None and bounds is not None:
            extent = bounds.x_min_m, bounds.y_min_m, bounds.x_max_m, bounds.y_max_m
            # Lines each way; of larger floors not every metre.
            step = max(1, round(max(extent[2] - extent[0], extent[3] - extent[1]) / 40))
            self._grid = grid_lines(camera.project, extent, camera.size, step)

    def __call__(self, image: U8, snapshot: Snapshot) -> U8:
        """(h, w, 3) uint8 BGR: the (H, W[, 3]) uint8 image, enlarged where it is small, with everything on it."""
        # Smaller images are enlarged to this width, so that labels are legible.
        scale = max(1, math.ceil(640 / image.shape[1]))
        size = image.shape[1] * scale, image.shape[0] * scale
        picture = as_colour(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)).copy()
        labels = Labels(picture, max(1.0, picture.shape[1] / 1000))
        if self._grid:
            over = picture.copy()
            for coordinate, line in self._grid:
                width = 2 if coordinate % 5 == 0 else 1
                cv2.polylines(over, [_pixels(line, scale)], False, (255, 255, 255), width, cv2.LINE_AA)
            cv2.addWeighted(over, GRID_STRENGTH, picture, 1 - GRID_STRENGTH, 0, dst=picture)
        for rule in self._rules:
            points, colour = rule.points, TRIPWIRE
            if not rule.is_line:
                points, colour = np.vstack([points, points[:1]]), ZONE
            lines = self._visible(points) if rule.on_floor else [points]
            for line in lines:
                cv2.polylines(picture, [_pixels(line, scale)], False, as_bgr(colour), 2, cv2.LINE_AA)
            if lines:
                labels.put(rule.name, lines[0][0] * scale, colour)
        for person in snapshot.people:
            for line in self._visible(snapshot.trails.get(person.track_id, np.empty((0, 2)))):
                colour = as_bgr(person_rgb(person.track_id))
                cv2.polylines(picture, [_pixels(line, scale)], False, colour, 2, cv2.LINE_AA)
        for person in sorted(snapshot.people, key=lambda p: p.state == "confirmed"):
            _paint_box(picture, person, scale)
        for person in snapshot.people:
            self._paint_facing(picture, person, scale)
            if (place := self._place(person)) is not None:
                text = f"{person.track_id} lost" if person.state == "lost" else f"{person.track_id}"
                labels.put(text, place * scale, person_rgb(person.track_id, person.state))
        for person in snapshot.truth:
            self._paint_truth(picture, person, scale)
        return picture

    def _visible(self, points_m: F64) -> list[F64]:
        """Parts of a line on the floor that the camera shows, in pixels."""
        camera = self._camera
        return visible_parts(camera.project, points_m, camera.size) if camera is not None else []

    def _feet(self, person: TrackState) -> F64 | None:
        """The pixel of a person's feet, also outside of the image; None where it is unknown."""
        if self._camera is None or math.isnan(person.x_m):
            return None
        feet = self._camera.project(np.array([person.x_m, person.y_m, 0.0]))
        return feet if np.isfinite(feet).all() and np.abs(feet).max() < 2**14 else None

    def _place(self, person: TrackState) -> F64 | None:
        """Where a person's label stands: over the box, else at the feet [px]; None outside of the image."""
        if not math.isnan(person.box_px[0]):
            return np.array(person.box_px[:2])
        feet = self._feet(person)
        size = self._camera.size if self._camera is not None else (0, 0)
        return feet if feet is not None and (feet >= 0).all() and (feet < size).all() else None

    def _paint_facing(self, picture: U8, person: TrackState, scale: int) -> None:
        """Where a person faces, on the floor, with a white edge."""
        line = facing_line(person)
        if self._camera is None or line is None:
            return
        ends = self._camera.project(np.column_stack([line, np.zeros(2)]))
        if np.isfinite(ends).all() and np.abs(ends).max() < 2**14:
            for colour, width in (((255, 255, 255), 5), (as_bgr(person_rgb(person.track_id, person.state)), 3)):
                paint_facing(picture, person, _pixels(ends, scale), colour, width)

    def _paint_truth(self, picture: U8, person: TrackState, scale: int) -> None:
        """A white and black cross at the true person's feet."""
        if (feet := self._feet(person)) is not None:
            at = _pixels(feet[None], scale)[0].tolist()
            cv2.drawMarker(picture, at, (255, 255, 255), cv2.MARKER_TILTED_CROSS, 13, 4)
            cv2.drawMarker(picture, at, as_bgr(TRUTH), cv2.MARKER_TILTED_CROSS, 12, 2)


def _paint_box(picture: U8, person: TrackState, scale: int) -> None:
    if math.isnan(person.box_px[0]):
        return
    left, top, width, height = (round(scale * value) for value in person.box_px)
    colour: Rgb = as_bgr(person_rgb(person.track_id, person.state))
    corners = np.array([(left, top), (left + width, top), (left + width, top + height), (left, top + height)])
    if person.state == "confirmed":
        cv2.polylines(picture, [corners.astype(np.int32)], True, colour, 2, cv2.LINE_AA)
        return
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        steps = max(1, int(np.abs(b - a).max()) // 6)
        ends = np.linspace(a, b, 2 * steps + 1).round().astype(int)
        for start, stop in zip(ends[::2], ends[1::2], strict=False):
            cv2.line(picture, start.tolist(), stop.tolist(), colour, 2, cv2.LINE_AA)


def _pixels(points: F64, scale: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    return np.round(points * scale).astype(np.int32)
