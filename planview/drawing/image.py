"""The camera's image with people's boxes and ids, their trails, the rules and a metre grid on the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.images import as_colour
from calib.types import F64, U8
from planview.drawing.colours import TRIPWIRE, TRUTH, ZONE, Rgb, as_bgr, person_rgb
from planview.drawing.labels import Labels
from planview.drawing.moment import Moment, Rule
from planview.drawing.plan import PlanBounds
from planview.trajectories.state import TrackState

WIDTH_MIN_PX = 640
"""Smaller images are enlarged to this width, so that labels are legible."""
GRID_LINES_MAX = 40
"""Lines each way; of larger floors not every metre is drawn."""
GRID_STRENGTH = 0.4
"""Share of the grid's colour in the picture."""
_SAMPLE_M = 0.2


class ImageCamera(Protocol):
    """A camera above the floor."""

    @property
    def size(self) -> tuple[int, int]: ...

    def project(self, points_world: ArrayLike) -> F64: ...

    def back_project(self, pixels: ArrayLike) -> F64: ...


class ImagePainter:
    """Draws moments into the images of one camera.

    Args:
        camera: above the floor; None for one that is not calibrated: boxes only.
        rules: tripwires and zones.
        bounds: of the metre grid on the floor; None for no grid.
    """

    def __init__(
        self, camera: ImageCamera | None, rules: Sequence[Rule] = (), bounds: PlanBounds | None = None
    ) -> None:
        self._camera, self._rules = camera, rules
        self._grid = _grid_lines(camera, bounds) if camera is not None and bounds is not None else []

    def __call__(self, image: U8, moment: Moment) -> U8:
        """(h, w, 3) uint8 BGR: the image, enlarged where it is small, with everything drawn on it.

        Args:
            image: (H, W[, 3]) uint8 BGR.
        """
        scale = max(1, math.ceil(WIDTH_MIN_PX / image.shape[1]))
        size = image.shape[1] * scale, image.shape[0] * scale
        picture = as_colour(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)).copy()
        labels = Labels(picture, max(1.0, picture.shape[1] / 1000))
        self._paint_floor(picture, scale)
        self._paint_rules(picture, labels, scale)
        for person in moment.people:
            self._paint_trail(picture, moment.trails.get(person.track_id), person, scale)
        for person in sorted(moment.people, key=lambda p: p.state == "confirmed"):
            _paint_box(picture, person, scale)
        for person in moment.people:
            self._label(labels, person, scale)
        for person in moment.truth:
            self._paint_truth(picture, person, scale)
        return picture

    def _paint_floor(self, picture: U8, scale: int) -> None:
        if not self._grid:
            return
        over = picture.copy()
        for coordinate, line in self._grid:
            strong = coordinate % 5 == 0
            cv2.polylines(over, [_pixels(line, scale)], False, (255, 255, 255), 2 if strong else 1, cv2.LINE_AA)
        cv2.addWeighted(over, GRID_STRENGTH, picture, 1 - GRID_STRENGTH, 0, dst=picture)

    def _paint_rules(self, picture: U8, labels: Labels, scale: int) -> None:
        for rule in self._rules:
            points = rule.points if rule.is_line else np.vstack([rule.points, rule.points[:1]])
            for line in self._visible(points) if rule.on_floor else [points]:
                colour = as_bgr(TRIPWIRE if rule.is_line else ZONE)
                cv2.polylines(picture, [_pixels(line, scale)], False, colour, 2, cv2.LINE_AA)
            first = next(iter(self._visible(points) if rule.on_floor else [points]), None)
            if first is not None:
                labels.put(rule.name, first[0] * scale, TRIPWIRE if rule.is_line else ZONE)

    def _visible(self, points_m: F64) -> list[F64]:
        """Parts of a line on the floor that the camera shows, in pixels."""
        return _projected(self._camera, points_m) if self._camera is not None else []

    def _paint_trail(self, picture: U8, trail_m: F64 | None, person: TrackState, scale: int) -> None:
        if trail_m is None or person.state == "tentative":
            return
        for line in self._visible(trail_m):
            cv2.polylines(picture, [_pixels(line, scale)], False, as_bgr(person_rgb(person.track_id)), 2, cv2.LINE_AA)

    def _label(self, labels: Labels, person: TrackState, scale: int) -> None:
        if person.state == "tentative":
            return
        place = self._place(person)
        if place is not None:
            lost = " lost" if person.state == "lost" else ""
            labels.put(f"{person.track_id}{lost}", place * scale, person_rgb(person.track_id, person.state))

    def _place(self, person: TrackState) -> F64 | None:
        """Where a person's label stands: over the box, else at the feet [px]; None outside of the image."""
        if not math.isnan(person.box_px[0]):
            return np.array(person.box_px[:2])
        if self._camera is None or math.isnan(person.x_m):
            return None
        feet = self._camera.project(np.array([person.x_m, person.y_m, 0.0]))
        inside = np.isfinite(feet).all() and (feet >= 0).all() and (feet < self._camera.size).all()
        return feet if inside else None

    def _paint_truth(self, picture: U8, person: TrackState, scale: int) -> None:
        """A white and black cross at the true person's feet."""
        if self._camera is None or math.isnan(person.x_m):
            return
        feet = self._camera.project(np.array([person.x_m, person.y_m, 0.0]))
        if np.isfinite(feet).all() and np.abs(feet).max() < 2**14:
            at = _pixels(feet[None], scale)[0].tolist()
            cv2.drawMarker(picture, at, (255, 255, 255), cv2.MARKER_TILTED_CROSS, 13, 4)
            cv2.drawMarker(picture, at, as_bgr(TRUTH), cv2.MARKER_TILTED_CROSS, 12, 2)


def _paint_box(picture: U8, person: TrackState, scale: int) -> None:
    if math.isnan(person.box_px[0]):
        return
    left, top, width, height = (round(scale * value) for value in person.box_px)
    colour: Rgb = as_bgr(person_rgb(person.track_id, person.state))
    corners = np.array([(left, top), (left + width, top), (left + width, top + height), (left, top + height)])
    if person.state != "lost":
        thickness = 2 if person.state == "confirmed" else 1
        cv2.polylines(picture, [corners.astype(np.int32)], True, colour, thickness, cv2.LINE_AA)
        return
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        steps = max(1, int(np.abs(b - a).max()) // 6)
        ends = np.linspace(a, b, 2 * steps + 1).round().astype(int)
        for start, stop in zip(ends[::2], ends[1::2], strict=False):
            cv2.line(picture, start.tolist(), stop.tolist(), colour, 2, cv2.LINE_AA)


def _pixels(points: F64, scale: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    return np.round(points * scale).astype(np.int32)


def _grid_lines(camera: ImageCamera, bounds: PlanBounds) -> list[tuple[int, F64]]:
    """Metre lines as far as the image shows them: (coordinate [m], (N, 2) pixels)."""
    x_min, y_min = math.floor(bounds.x_min_m), math.floor(bounds.y_min_m)
    x_max, y_max = math.ceil(bounds.x_max_m), math.ceil(bounds.y_max_m)
    step = max(1, round(max(x_max - x_min, y_max - y_min) / GRID_LINES_MAX))
    lines = []
    for x in range(x_min, x_max + 1, step):
        lines += [(x, part) for part in _projected(camera, np.array([(x, y_min), (x, y_max)], dtype=np.float64))]
    for y in range(y_min, y_max + 1, step):
        lines += [(y, part) for part in _projected(camera, np.array([(x_min, y), (x_max, y)], dtype=np.float64))]
    return lines


def _projected(camera: ImageCamera, points_m: F64) -> list[F64]:
    """A line on the floor in pixels, in parts of at least two points near the image."""
    known = points_m[np.isfinite(points_m).all(axis=1)]
    if len(known) < 2:
        return []
    steps = np.hypot(*np.diff(known, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if along[-1] <= 0:
        return []
    at = np.union1d(along, np.linspace(0.0, along[-1], math.ceil(along[-1] / _SAMPLE_M) + 1))
    xyz = np.column_stack([np.interp(at, along, known[:, 0]), np.interp(at, along, known[:, 1]), np.zeros(len(at))])
    pixels = camera.project(xyz)
    size = np.array(camera.size)
    with np.errstate(invalid="ignore"):
        near = np.asarray(((pixels > -0.5 * size) & (pixels < 1.5 * size)).all(axis=1))  # not NaN either
    cuts = np.flatnonzero(np.diff(near.astype(np.int8))) + 1
    parts = zip(np.split(pixels, cuts), np.split(near, cuts), strict=True)
    return [part for part, visible in parts if len(part) > 1 and visible[0]]
