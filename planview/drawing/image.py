"""People and the floor in the image of a camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.floor_camera import FloorCamera
from calib.images import as_colour
from calib.types import F64, I32, U8
from planview.drawing.people import Snapshot, facing_line, paint_facing
from planview.drawing.plan import FARTHEST_PX, PlanBounds
from planview.drawing.rules import Rule
from planview.drawing.style import TRUTH, Labels, as_bgr, paint_line
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState

Project = Callable[[ArrayLike], F64]
"""(N, 3) world points [m] to (N, 2) pixels, NaN where unseen."""

GRID_STRENGTH = 0.4
"""Share of the grid's colour in the picture."""
GRID_LINES = 40
"""About as many lines each way; on a larger floor not every metre has one."""
SAMPLE_M = 0.2
MAX_SAMPLES = 2000
"""Number of places at most at which a line on the floor is projected, every SAMPLE_M."""
LEGIBLE_WIDTH_PX = 640
"""Narrower images are enlarged, so that labels are legible."""
WHITE = (255, 255, 255)


class GridLine(NamedTuple):
    """A part of a line of the grid that is near the image: ``coordinate`` [m] and (k, 2) pixels."""

    coordinate: float
    pixels: F64


def grid_lines(
    project: Project, extent_m: tuple[float, float, float, float], size: tuple[int, int], step_m: float = 1.0
) -> list[GridLine]:
    """Lines of a grid over (x_min, y_min, x_max, y_max) of the floor in an image of (width, height) pixels."""
    low = np.floor(extent_m[:2])
    high = np.ceil(extent_m[2:])
    lines = []
    for axis in (0, 1):
        for coordinate in np.arange(low[axis], high[axis] + 1e-9, step_m).tolist():
            ends = np.stack([low, high])
            ends[:, axis] = coordinate
            for pixels in visible_parts(project, ends, size):
                lines.append(GridLine(coordinate, pixels))
    return lines


def visible_parts(project: Project, places_m: F64, size: tuple[int, int]) -> list[F64]:
    """A line through (N, 2) places on the floor [m], in pixels, in parts of at least two points near the image."""
    places_m = places_m[np.isfinite(places_m).all(axis=1)]
    if len(places_m) < 2:
        return []
    steps_m = np.hypot(*np.diff(places_m, axis=0).T)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    length_m = along_m[-1]
    if length_m <= 0:
        return []
    samples = min(MAX_SAMPLES, math.ceil(length_m / SAMPLE_M) + 1)
    sampled_m = np.union1d(along_m, np.linspace(0.0, length_m, samples))
    x_m = np.interp(sampled_m, along_m, places_m[:, 0])
    y_m = np.interp(sampled_m, along_m, places_m[:, 1])
    pixels = project(np.column_stack([x_m, y_m, np.zeros(len(x_m))]))
    limits = np.array(size)
    with np.errstate(invalid="ignore"):
        is_near = ((pixels > -0.5 * limits) & (pixels < 1.5 * limits)).all(axis=1)  # not NaN either
    cuts = np.flatnonzero(np.diff(is_near.astype(np.int8))) + 1
    parts = []
    for part, near in zip(np.split(pixels, cuts), np.split(is_near, cuts), strict=True):
        if len(part) > 1 and near[0]:
            parts.append(part)
    return parts


class ImagePainter:
    """Draws snapshots into the images of one camera; boxes only for None, one that is not calibrated. ``bounds``: of
    the metre grid on the floor."""

    def __init__(
        self, camera: FloorCamera | None, rules: Sequence[Rule] = (), bounds: PlanBounds | None = None
    ) -> None:
        self._camera = camera
        self._rules = rules
        self._grid: list[GridLine] = []
        if camera is not None and bounds is not None:
            extent_m = (bounds.x_min_m, bounds.y_min_m, bounds.x_max_m, bounds.y_max_m)
            longest_m = max(extent_m[2] - extent_m[0], extent_m[3] - extent_m[1])
            step_m = max(1, round(longest_m / GRID_LINES))
            self._grid = grid_lines(camera.project, extent_m, camera.size, step_m)

    def __call__(self, image: U8, snapshot: Snapshot) -> U8:
        """(h, w, 3) uint8 BGR: the (H, W[, 3]) uint8 image, enlarged where it is small, with everything on it."""
        scale = max(1, math.ceil(LEGIBLE_WIDTH_PX / image.shape[1]))
        size = (image.shape[1] * scale, image.shape[0] * scale)
        enlarged = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
        picture = as_colour(enlarged).copy()
        labels = Labels(picture, max(1.0, size[0] / 1000))
        self._paint_grid(picture, scale)
        for rule in self._rules:
            self._paint_rule(picture, labels, rule, scale)
        for track_id, trail in snapshot.trails.items():
            for part in self._visible_parts(trail):
                paint_line(picture, _whole_pixels(part, scale), person_rgb(track_id))
        for person in sorted(snapshot.people, key=lambda person: person.state == "confirmed"):
            _paint_box(picture, person, scale)
        for person in snapshot.people:
            self._paint_facing(picture, person, scale)
            self._label(labels, person, scale)
        for person in snapshot.truth:
            self._paint_truth(picture, person, scale)
        return picture

    def _paint_grid(self, picture: U8, scale: int) -> None:
        if not self._grid:
            return
        over = picture.copy()
        for line in self._grid:
            width = 2 if line.coordinate % 5 == 0 else 1
            paint_line(over, _whole_pixels(line.pixels, scale), WHITE, width)
        cv2.addWeighted(over, GRID_STRENGTH, picture, 1 - GRID_STRENGTH, 0, dst=picture)

    def _paint_rule(self, picture: U8, labels: Labels, rule: Rule, scale: int) -> None:
        points = rule.points
        if not rule.is_line:
            points = np.vstack([points, points[:1]])
        lines = self._visible_parts(points) if rule.on_floor else [points]
        for line in lines:
            paint_line(picture, _whole_pixels(line, scale), rule.colour)
        if lines:
            labels.put(rule.name, lines[0][0] * scale, rule.colour)

    def _visible_parts(self, points_m: F64) -> list[F64]:
        """Parts of a line on the floor that the camera shows, in pixels."""
        if self._camera is None:
            return []
        return visible_parts(self._camera.project, points_m, self._camera.size)

    def _feet(self, person: TrackState) -> F64 | None:
        """The pixel of a person's feet, also outside of the image; None where it is unknown."""
        if self._camera is None or math.isnan(person.x_m):
            return None
        feet = self._camera.project(np.array([person.x_m, person.y_m, 0.0]))
        return feet if _can_be_drawn(feet) else None

    def _label(self, labels: Labels, person: TrackState, scale: int) -> None:
        """Put a person's id over the box, else at the feet; nothing where both are outside of the image."""
        place = self._feet(person)
        if not math.isnan(person.box_px[0]):
            place = np.array(person.box_px[:2])
        elif place is None or self._camera is None or (place < 0).any() or (place >= self._camera.size).any():
            return
        text = f"{person.track_id}"
        if person.state == "lost":
            text += " lost"
        labels.put(text, place * scale, person_rgb(person.track_id, person.state))

    def _paint_facing(self, picture: U8, person: TrackState, scale: int) -> None:
        """Draw where a person faces, on the floor, with a white edge."""
        line = facing_line(person)
        if self._camera is None or line is None:
            return
        ends = self._camera.project(np.column_stack([line, np.zeros(2)]))
        if _can_be_drawn(ends):
            pixels = _whole_pixels(ends, scale)
            paint_facing(picture, person, pixels, WHITE, 5)
            paint_facing(picture, person, pixels, as_bgr(person_rgb(person.track_id, person.state)), 3)

    def _paint_truth(self, picture: U8, person: TrackState, scale: int) -> None:
        """Mark the true person's feet with a white and black cross."""
        feet = self._feet(person)
        if feet is not None:
            pixel = _whole_pixels(feet, scale).tolist()
            cv2.drawMarker(picture, pixel, WHITE, cv2.MARKER_TILTED_CROSS, 13, 4)
            cv2.drawMarker(picture, pixel, as_bgr(TRUTH), cv2.MARKER_TILTED_CROSS, 12, 2)


def _can_be_drawn(pixels: F64) -> bool:
    return bool(np.isfinite(pixels).all() and np.abs(pixels).max() < FARTHEST_PX)


def _whole_pixels(points: F64, scale: int) -> I32:
    return np.round(points * scale).astype(np.int32)


def _paint_box(picture: U8, person: TrackState, scale: int) -> None:
    """Draw a person's box: thick if it is confirmed, else thin."""
    if math.isnan(person.box_px[0]):
        return
    left, top, width, height = (round(scale * value) for value in person.box_px)
    right = left + width
    bottom = top + height
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    width_px = 2 if person.state == "confirmed" else 1
    colour = person_rgb(person.track_id, person.state)
    paint_line(picture, corners.astype(np.int32), colour, width_px, closed=True)
