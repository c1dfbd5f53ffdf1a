"""People on the floor, seen from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.floor_camera import FloorCamera
from calib.types import F64, I32, U8, AnyArray
from planview.drawing.people import Snapshot, facing_line, paint_facing
from planview.drawing.rules import Rule
from planview.drawing.style import TRUTH, Labels, Rgb, as_bgr, paint_line
from planview.trajectories.plot import person_rgb
from planview.trajectories.state import TrackState

SHOWN_MARGIN_M = 0.6
VIEW_BGR = (247, 238, 232)
PAPER_BGR = (255, 255, 255)
LINE_BGR = (222, 222, 222)
TEXT_BGR = (130, 130, 130)
CAMERA_BGR = (60, 60, 60)

GRID_STEPS_M = (1, 2, 5, 10, 20, 50, 100)
SMALLEST_STEP_PX = 22
"""Lines of the grid are at least this far apart [px], so that their numbers are legible."""
FARTHEST_PX = 2**14
"""Farthest place that OpenCV draws to [px]."""


@dataclass(frozen=True)
class PlanBounds:
    """The part of the floor that is shown [m]."""

    x_min_m: float
    y_min_m: float
    x_max_m: float
    y_max_m: float


def bounds_of(*places_m: F64) -> PlanBounds:
    """Around all finite (N, 2) places [m], with a margin; a few metres where there is none."""
    places = np.concatenate([np.empty((0, 2)), *places_m])
    places = places[np.isfinite(places).all(axis=1)]
    if len(places) == 0:
        places = np.array([[-2.0, -2.0], [2.0, 2.0]])
    low = places.min(axis=0) - SHOWN_MARGIN_M
    high = places.max(axis=0) + SHOWN_MARGIN_M
    return PlanBounds(*low.tolist(), *high.tolist())


def from_above(image: U8, camera: FloorCamera, x_m: AnyArray, y_m: AnyArray) -> U8:
    """Colours of an image at places of the floor: (H, W, 3) uint8 for (H, W) places [m]; black outside of the image."""
    places = np.stack([x_m, y_m, np.zeros_like(x_m)], axis=-1)
    pixels = np.nan_to_num(camera.project(places), nan=-1.0).astype(np.float32)
    columns = pixels[..., 0]
    rows = pixels[..., 1]
    floor = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(floor, dtype=np.uint8)


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
        low = np.array([bounds.x_min_m, bounds.y_min_m])
        high = np.array([bounds.x_max_m, bounds.y_max_m])
        self._size = np.array(size)
        self._middle_m = (low + high) / 2
        self.scale = float((self._size / (high - low)).min())
        self.paper = np.full((size[1], size[0], 3), PAPER_BGR, dtype=np.uint8)
        for _, outline in cameras:
            if len(outline) > 2:
                cv2.fillPoly(self.paper, [self.px(outline)], VIEW_BGR, cv2.LINE_AA)
        self._paint_grid()
        self._paint_rules(rules)
        for at_m, _ in cameras:
            cv2.drawMarker(self.paper, self._pixel(*at_m), CAMERA_BGR, cv2.MARKER_TRIANGLE_DOWN, 14, 2)

    def __call__(self, snapshot: Snapshot) -> U8:
        """(H, W, 3) uint8 BGR."""
        picture = self.paper.copy()
        labels = Labels(picture)
        for track_id, trail in snapshot.trails.items():
            if len(trail) > 1:
                paint_line(picture, self.px(trail), person_rgb(track_id))
        for person in snapshot.truth:
            if not math.isnan(person.x_m):
                pixel = self._pixel(person.x_m, person.y_m)
                cv2.drawMarker(picture, pixel, as_bgr(TRUTH), cv2.MARKER_TILTED_CROSS, 15, 2)
                self._paint_facing(picture, person, as_bgr(TRUTH), 1)
        for person in snapshot.people:
            if not math.isnan(person.x_m):
                self._paint_person(picture, labels, person)
        return picture

    def px(self, places_m: F64) -> I32:
        """(N, 2) pixels of (N, 2) places [m]; y points up."""
        from_middle_m = np.nan_to_num(places_m) - self._middle_m
        pixels = self._size / 2 + from_middle_m * self.scale * (1, -1)
        return np.asarray(np.clip(np.round(pixels), -FARTHEST_PX, FARTHEST_PX), dtype=np.int32)

    def _pixel(self, x_m: float, y_m: float) -> tuple[int, int]:
        column, row = self.px(np.array([(x_m, y_m)]))[0]
        return int(column), int(row)

    def _paint_grid(self) -> None:
        """Draw lines every metre, or at larger steps where the scale is small, with coordinates along two sides."""
        legible = (step for step in GRID_STEPS_M if step * self.scale >= SMALLEST_STEP_PX)
        step_m = next(legible, GRID_STEPS_M[-1])
        low_m = self._middle_m - self._size / 2 / self.scale
        high_m = self._middle_m + self._size / 2 / self.scale
        for axis in (0, 1):
            first_m = math.ceil(low_m[axis] / step_m) * step_m
            for coordinate_m in range(first_m, math.floor(high_m[axis]) + 1, step_m):
                self._paint_grid_line(axis, coordinate_m, bold=coordinate_m % (5 * step_m) == 0)

    def _paint_grid_line(self, axis: int, coordinate_m: int, bold: bool) -> None:
        width, height = self._size.tolist()
        place = np.array(self._middle_m)
        place[axis] = coordinate_m
        pixel = int(self.px(place[None])[0][axis])
        if axis == 0:
            start = (pixel, 0)
            end = (pixel, height)
            label = (pixel + 2, height - 4)
        else:
            start = (0, pixel)
            end = (width, pixel)
            label = (2, pixel - 2)
        cv2.line(self.paper, start, end, LINE_BGR, 2 if bold else 1)
        cv2.putText(self.paper, f"{coordinate_m}", label, cv2.FONT_HERSHEY_SIMPLEX, 0.35, TEXT_BGR, 1, cv2.LINE_AA)

    def _paint_rules(self, rules: Sequence[Rule]) -> None:
        labels = Labels(self.paper)
        for rule in rules:
            if rule.on_floor:
                pixels = self.px(rule.points)
                paint_line(self.paper, pixels, rule.colour, closed=not rule.is_line)
                labels.put(rule.name, pixels[0].tolist(), rule.colour)

    def _paint_person(self, picture: U8, labels: Labels, person: TrackState) -> None:
        column, row = self._pixel(person.x_m, person.y_m)
        colour = person_rgb(person.track_id, person.state)
        self._paint_facing(picture, person, as_bgr(colour), 2)
        thickness = 2 if person.state == "lost" else cv2.FILLED
        cv2.circle(picture, (column, row), 6, as_bgr(colour), thickness, cv2.LINE_AA)
        labels.put(str(person.track_id), (column + 8, row - 4), colour)

    def _paint_facing(self, picture: U8, person: TrackState, colour: Rgb, width: int) -> None:
        line = facing_line(person)
        if line is not None:
            paint_facing(picture, person, self.px(line), colour, width)
