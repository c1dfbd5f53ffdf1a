"""Agreement of the sensors of one place: people whom two of them see are at one place at one time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import combinations, permutations
from typing import cast

import cv2
import numpy as np

from calib.carried import Carried
from calib.floor.plane import PEOPLE_M
from calib.floor_camera import FloorCamera
from calib.pose import SE3
from calib.types import F32, F64, Bool
from planview.checks.check import Check, limit_check
from planview.checks.motion import liveliest
from planview.maps.grid import Grid
from planview.maps.plan_view import FloorPoints, accumulate
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.floor import DepthFrames, PairFrames
from stereo.readers.open import SeveralSensors

APART_M = 0.25
"""Largest distance between two sensors' places of one person [m]: half of what keeps two people apart."""
EVERY_S = 0.18
"""Least time between looks [s]: a walker moves a hand's length in it."""
CELL_M = 0.1
"""Cells in which people are kept apart [m]."""
TRUNK_M = 0.9
"""Furniture and legs are lower [m]."""
TOP_M = 0.35
"""Head and shoulders, whose middle is a person's place [m]."""
SURFACE_TO_AXIS_M = 0.1
"""A sensor sees the near side of a person, who is this much further away in the middle [m]."""
MIN_SURFACE_M2 = 0.06
"""Less visible surface above ``TRUNK_M`` is no person [m^2]."""
MIN_PERSON_M = 1.2
"""Lower tops are of things, of children and of people who sit [m]."""
OTHERS_M = 2.0
HEIGHT_M = 0.15
"""Places that are farther apart, or heights that differ by more, are of different people [m]."""
LOOKS_MIN = 4
LOOKS_MAX = 4096
"""Fewest places of people that are judged, a walk of two thirds of a second, and most that are remembered."""
MOVED_PX = 1.0
STEP_PX = 2
"""Disparity by which people are nearer than the background: four deviations; and every n-th row and column that is
looked at [px]."""


def people_places(points: FloorPoints, camera_m: F64) -> F64:
    """(N, 3) x, y and height [m] of people among foreground points that a camera at (3,) ``camera_m`` sees."""
    high = (points.xyz[:, 2] > TRUNK_M) & (points.xyz[:, 2] < PEOPLE_M)
    xyz = points.xyz[high]
    if not len(xyz):
        return np.empty((0, 3))
    low = xyz.min(axis=0)
    far = xyz.max(axis=0)
    grid = Grid.covering(float(low[0]), float(low[1]), float(far[0]) + CELL_M, float(far[1]) + CELL_M, CELL_M)
    _, surface = accumulate(xyz, points.area[high], TRUNK_M, (grid.x_min_m, grid.y_min_m, CELL_M), grid.shape)
    # A cell with a few points at an edge of depth would join people.
    count, labels = cv2.connectedComponents((surface > 0.05 * surface.max()).astype(np.uint8))
    columns = np.floor((xyz[:, 0] - grid.x_min_m) / CELL_M).astype(np.int64)
    rows = np.floor((xyz[:, 1] - grid.y_min_m) / CELL_M).astype(np.int64)
    label_of_point = labels[rows, columns]
    people = []
    for label in range(1, count):
        person = xyz[label_of_point == label]
        height_m = float(np.percentile(person[:, 2], 98.0))
        if surface[labels == label].sum() < MIN_SURFACE_M2 or height_m < MIN_PERSON_M:
            continue
        near_m = person[person[:, 2] > height_m - TOP_M, :2].mean(axis=0)
        away = near_m - camera_m[:2]
        axis_m = near_m + away * (SURFACE_TO_AXIS_M / max(float(np.hypot(*away)), SURFACE_TO_AXIS_M))
        people.append([*axis_m, height_m])
    return np.array(people).reshape(-1, 3)


def _sees(camera: FloorCamera, people: F64) -> Bool:
    """(N,) mask of the people whose chest is in a camera's image, by their (N, 3) places."""
    pixels = camera.project(np.column_stack([people[:, :2], np.full(len(people), TRUNK_M)]))
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0) & (pixels < np.array(camera.size))
    return np.asarray(inside.all(axis=1))


class SensorsWatch(Carried):
    """Compares the places of people whom several sensors of one place see at one time; ``cameras`` are theirs, by name,
    above the common floor."""

    CARRIED = "_last_s", "_apart_m"

    def __init__(self, cameras: Mapping[str, FloorCamera]) -> None:
        self._cameras = cameras
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._last_s = -math.inf
        # Of people of one sensor to the nearest ones of another.
        self._apart_m = {pair: deque[float](maxlen=LOOKS_MAX) for pair in permutations(self._cameras, 2)}

    def update(self, time_s: float, views: Sequence[FloorPoints]) -> None:
        """Take the foreground of all sensors in the next frame."""
        if time_s < self._last_s + EVERY_S:
            return
        self._last_s = time_s
        people = {}
        for (name, camera), points in zip(self._cameras.items(), views, strict=True):
            people[name] = people_places(points, camera.centre_m)
        self.compare(people)

    def compare(self, people: Mapping[str, F64]) -> None:
        """Take the (N, 3) places of people of each sensor by its name, at one time."""
        for (first, second), distances_m in self._apart_m.items():
            ours = people[first][_sees(self._cameras[second], people[first])]
            theirs = people[second][_sees(self._cameras[first], people[second])]
            away = ours[:, None] - theirs
            is_same_height = np.abs(away[..., 2]) < HEIGHT_M
            apart_m = np.where(is_same_height, np.hypot(away[..., 0], away[..., 1]), OTHERS_M)
            nearest_m = apart_m.min(axis=1, initial=OTHERS_M)
            distances_m.extend(nearest_m[nearest_m < OTHERS_M].tolist())

    def checks(self) -> list[Check]:
        """Distances at which each two sensors see the same people."""
        return [self._agreement(first, second) for first, second in combinations(self._cameras, 2)]

    def _agreement(self, first: str, second: str) -> Check:
        # A person who is hidden from one sensor has nobody near by in its view: the other sensor's people have.
        sides = self._apart_m[first, second], self._apart_m[second, first]
        medians_m = [float(np.median(side)) for side in sides if len(side) >= LOOKS_MIN]
        median_m = min(medians_m, default=math.nan)
        note = "median distance between the places of people whom both see"
        if math.isnan(median_m):
            note = "no person was seen by both sensors at one place"
        elif median_m > APART_M:
            note += "; a clock or a pose in rigs.toml is wrong: align the sensors again"
        return limit_check(f"{first} and {second}: people apart", median_m, "m", note, most=APART_M, warns=True)


def watch_sensors(recording: SeveralSensors, seen: Sequence[PairFrames | DepthFrames], moments: int) -> SensorsWatch:
    """A watch of the people whom the sensors of a recording see, in some moments around that in which most moves;
    ``seen`` are frames of each spread over it."""
    middle_s = recording.starts_s[0] + liveliest(seen[0].frames).timestamp_s
    moments_s = middle_s + EVERY_S * (np.arange(moments) - moments // 2)
    cameras = {}
    people: list[dict[str, F64]] = [{} for _ in moments_s]
    for part, start_s, spread in zip(recording.parts, recording.starts_s, seen, strict=True):
        geometry = spread.rectifier.geometry
        pose = cast(SE3, part.sensor.world_SE3_left)
        cameras[part.name] = camera = geometry.above(pose)
        background = 1.0 / geometry.depth(median_image(spread.disparities))
        due = np.round((moments_s - start_s) * part.fps)
        due = np.unique(due[(due >= 0) & (due < part.n_frames)])
        for frame in part.at(due.astype(int).tolist()):
            depth = spread.depth_of(frame)
            nearer = geometry.disparity_metre * (1.0 / depth - background) > MOVED_PX
            points = _points(np.where(nearer, depth, np.float32(np.nan)), geometry, pose)
            away_s = np.abs(start_s + frame.timestamp_s - moments_s)
            if away_s.min() < EVERY_S / 2:
                people[int(np.argmin(away_s))][part.name] = people_places(points, camera.centre_m)
    watch = SensorsWatch(cameras)
    for together in people:
        watch.compare({name: together.get(name, np.empty((0, 3))) for name in cameras})
    return watch


def _points(depth: F32, geometry: RectifiedGeometry, world_SE3_left: SE3) -> FloorPoints:
    """Every second row and column of a (H, W) depth image [m], NaN where unknown, in the world."""
    points = back_project(depth, geometry)[::STEP_PX, ::STEP_PX].reshape(-1, 3)
    pixels = np.flatnonzero(np.isfinite(points[:, 2]))
    points = points[pixels]
    area = STEP_PX**2 * points[:, 2] ** 2 / (geometry.focal_u_px * geometry.focal_v_px)
    xyz = np.asarray(world_SE3_left @ points, dtype=np.float32)
    return FloorPoints(xyz, area.astype(np.float32), pixels.astype(np.int32))
