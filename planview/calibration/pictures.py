"""Pictures that show whether a calibration fits: a metric floor grid, and people as the camera should see them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.ground_camera import GroundCamera
from calib.human.model import HumanModel
from calib.human.samples import HumanSample
from calib.images import as_colour
from calib.types import F64, U8
from planview.drawing.image import Project, grid_lines

GIVEN = (255, 140, 0)
COMPUTED = (200, 60, 255)
GRID = (90, 220, 90)
AXIS = (60, 200, 255)


def draw_grid(image: U8, project: Project, extent_m: tuple[float, float, float, float]) -> U8:
    """A floor grid with lines every metre and the axes from below the camera, drawn on a copy."""
    canvas = as_colour(image).copy()
    size = (canvas.shape[1], canvas.shape[0])
    for line in grid_lines(project, extent_m, size):
        _polyline(canvas, line.pixels, GRID)
    for axis, name in (((1.0, 0.0, 0.0), "x"), ((0.0, 1.0, 0.0), "y")):
        ends = project(np.array([[0.0, 0.0, 0.0], axis]))
        if np.isfinite(ends).all():
            start, end = (tuple(int(v) for v in np.clip(np.rint(p), -9999, 9999)) for p in ends)
            cv2.arrowedLine(canvas, start, end, AXIS, 2, cv2.LINE_AA)
            cv2.putText(canvas, name, end, cv2.FONT_HERSHEY_SIMPLEX, 0.6, AXIS, 2, cv2.LINE_AA)
    return canvas


def draw_samples(image: U8, camera: GroundCamera, model: HumanModel, samples: Sequence[HumanSample]) -> U8:
    """What was given (blue) and what was computed (pink) of each sample (figure 6a), drawn on a copy."""
    canvas = as_colour(image).copy()
    for sample in samples:
        left, top, width, height = sample.box_px
        corners = np.array([[left, top], [left + width, top], [left + width, top + height], [left, top + height]])
        _polyline(canvas, np.vstack([corners, corners[:1]]), GIVEN)
        for point in (sample.head_px, sample.foot_px):
            _dot(canvas, np.array(point), GIVEN)
        draw_person(canvas, camera, model, camera.back_project(sample.foot_px), COMPUTED)
    return canvas


def draw_person(
    canvas: U8, camera: GroundCamera, model: HumanModel, xy_m: ArrayLike, colour: tuple[int, int, int]
) -> None:
    """One computed person: outline, head and foot; nothing where the camera cannot see them."""
    hull = model.hull(camera, *(float(v) for v in np.asarray(xy_m)))
    if np.isfinite(hull).all():
        _polyline(canvas, np.vstack([hull, hull[:1]]), colour)
        _dot(canvas, model.head(camera, xy_m), colour)
        _dot(canvas, model.foot(camera, xy_m), colour)


def crowd(camera: GroundCamera, model: HumanModel, columns: int = 6, rows: int = 4) -> F64:
    """(N, 2) floor positions [m] with feet on an even grid of pixels, where a whole person is in the image."""
    u = (np.arange(columns) + 0.5) / columns * camera.width
    v = (np.arange(rows) + 1.0) / rows * camera.height * 0.98
    feet = camera.back_project(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    feet = feet[np.isfinite(feet).all(axis=1) & (np.hypot(feet[:, 0], feet[:, 1]) < 60.0)]
    boxes = model.boxes(camera, feet)
    far = boxes[:, :2] + boxes[:, 2:]
    inside = (boxes[:, :2] > 0).all(axis=1) & (far < np.array(camera.size)).all(axis=1)
    return np.asarray(feet[inside])


def _polyline(canvas: U8, points: F64, colour: tuple[int, int, int]) -> None:
    cv2.polylines(canvas, [np.rint(points).astype(np.int32).reshape(-1, 1, 2)], False, colour, 1, cv2.LINE_AA)


def _dot(canvas: U8, point: F64, colour: tuple[int, int, int]) -> None:
    if np.isfinite(point).all() and np.abs(point).max() < 1e5:
        cv2.circle(canvas, (round(float(point[0])), round(float(point[1]))), 3, colour, -1, cv2.LINE_AA)
