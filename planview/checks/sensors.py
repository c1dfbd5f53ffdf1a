"""Agreement of the sensors of one place: people whom two of them see are at one place at one time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, cast

import cv2
import numpy as np

from calib.carried import Carried
from calib.floor.plane import PEOPLE_M
from calib.floor_camera import FloorCamera
from calib.pose import SE3
from calib.types import F32, F64, Bool
from planview.checks.check import Check, limit_check
from planview.evaluation.paths import (
    TICK_S,
    Paths,
    RigAlignment,
    WalkedPath,
    apart_m,
    same_height,
    sample_path,
)
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
STRIDE_M = 0.7
LOST_S = 0.6
"""Longest way of a person between two looks, and longest time in which a path goes on unseen [m, s]."""
MIN_PATH_S = 1.0
MAX_PATH_S = 60.0
MAX_PATHS = 30
"""Shorter paths are left out, longer ones are cut [s], and so many are remembered of a sensor."""
OTHERS_M = 2.0
"""Places that are farther apart are of different people [m]."""
MOVED_PX = 1.0
STEP_PX = 2
"""Disparity by which people are nearer than the background: four deviations; and every n-th row and column that is
looked at [px]."""
AS_GIVEN = RigAlignment(0.0, 0.0, 0.0, 0.0)


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


@dataclass(eq=False)
class _Track:
    """Looks at one person, for whom the nearest is taken from look to look."""

    times_s: list[float] = field(default_factory=list)
    places: list[F64] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        return self.times_s[-1] - self.times_s[0]

    def goes_on(self, time_s: float) -> bool:
        """True if a look at this time may be the next one."""
        return time_s - self.times_s[-1] < LOST_S and self.seconds < MAX_PATH_S


class SensorPaths(Carried):
    """Paths of the people whom one sensor sees.

    Attributes:
        name: of the sensor.
        camera: it, above the common floor.
    """

    CARRIED = "_tracks", "_last_s"
    RECORDS = (_Track,)

    def __init__(self, name: str, camera: FloorCamera) -> None:
        self.name = name
        self.camera = camera
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._tracks: list[_Track] = []
        self._last_s = -math.inf

    def update(self, time_s: float, points: FloorPoints) -> None:
        """Take the foreground of the next frame, at a time on the common clock."""
        if time_s < self._last_s + EVERY_S:
            return
        self._last_s = time_s
        waiting = [track for track in self._tracks if track.goes_on(time_s)]
        walked = [track for track in self._tracks if track in waiting or track.seconds > MIN_PATH_S]
        self._tracks = walked[-MAX_PATHS:]
        for place in people_places(points, self.camera.centre_m):
            gaps_m = [float(np.hypot(*(track.places[-1] - place)[:2])) for track in waiting]
            if gaps_m and min(gaps_m) < STRIDE_M:
                track = waiting.pop(int(np.argmin(gaps_m)))
            else:
                track = _Track()
                self._tracks.append(track)
            track.times_s.append(time_s)
            track.places.append(place)

    def paths(self, other: FloorCamera) -> list[WalkedPath]:
        """Those who walk for a while; NaN where another sensor does not look."""
        paths = []
        for track in self._tracks:
            times_s = np.array(track.times_s)
            places = np.array(track.places)
            first, xy_m = sample_path(times_s, places[:, :2])
            if len(xy_m) * TICK_S < MIN_PATH_S:
                continue
            height_m = float(np.median(places[:, 2]))
            shown = np.where(_sees(other, xy_m)[:, None], xy_m, np.nan)
            paths.append(WalkedPath(first, shown, height_m, np.zeros_like(xy_m)))
        return paths


def _sees(camera: FloorCamera, xy_m: F64) -> Bool:
    """(N,) mask of the places where a person's chest is in a camera's image."""
    pixels = camera.project(np.column_stack([xy_m, np.full(len(xy_m), TRUNK_M)]))
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0) & (pixels < np.array(camera.size))
    return np.asarray(inside.all(axis=1))


class SensorsWatch(Carried):
    """Watches what several sensors of one place see."""

    def __init__(self, sensors: Sequence[SensorPaths]) -> None:
        self._sensors = sensors

    def reset(self) -> None:
        """Forget everybody."""
        for sensor in self._sensors:
            sensor.reset()

    def state(self) -> dict[str, Any]:
        """A copy of the paths of each sensor, as plain values."""
        return {sensor.name: sensor.state() for sensor in self._sensors}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue from a copy."""
        for sensor in self._sensors:
            sensor.set_state(state[sensor.name])

    def update(self, time_s: float, views: Sequence[FloorPoints]) -> None:
        """Take the foreground of all sensors in the next frame."""
        for sensor, points in zip(self._sensors, views, strict=True):
            sensor.update(time_s, points)

    def checks(self) -> list[Check]:
        """Distances at which each two sensors see the same people."""
        return [agreement_check(first, second) for first, second in combinations(self._sensors, 2)]


def watch_sensors(recording: SeveralSensors, seen: Sequence[PairFrames | DepthFrames], frames: int) -> SensorsWatch:
    """A watch of the people whom the sensors of a recording see, in as many frames of each around those in which most
    moves; ``seen`` are frames of each spread over it."""
    starts_s = np.array(recording.starts_s)
    middle_s = starts_s[0] + _liveliest_s(seen[0])
    sensors = []
    for part, start_s, spread in zip(recording.parts, starts_s, seen, strict=True):
        geometry = spread.rectifier.geometry
        pose = cast(SE3, part.sensor.world_SE3_left)
        sensor = SensorPaths(part.name, geometry.above(pose))
        background = 1.0 / geometry.depth(median_image(spread.disparities))
        step = max(1, round(part.fps * EVERY_S))
        first = round((middle_s - start_s) * part.fps) - step * (frames // 2)
        first = max(0, min(first, part.n_frames - step * frames))
        for frame in part.at(list(range(first, min(part.n_frames, first + step * frames), step))):
            depth = spread.depth_of(frame)
            nearer = geometry.disparity_metre * (1.0 / depth - background) > MOVED_PX
            sensor.update(
                start_s + frame.timestamp_s, _points(np.where(nearer, depth, np.float32(np.nan)), geometry, pose)
            )
        sensors.append(sensor)
    return SensorsWatch(sensors)


def _liveliest_s(seen: PairFrames | DepthFrames) -> float:
    """The time of the frame, of some spread over a recording, in which most is nearer than usual [s]."""
    usual = median_image(seen.disparities)
    with np.errstate(invalid="ignore"):
        shares = [float(np.mean(disparity - usual > MOVED_PX)) for disparity in seen.disparities]
    return seen.frames[int(np.argmax(shares))].timestamp_s


def _points(depth: F32, geometry: RectifiedGeometry, world_SE3_left: SE3) -> FloorPoints:
    """Every second row and column of a (H, W) depth image [m], NaN where unknown, in the world."""
    points = back_project(depth, geometry)[::STEP_PX, ::STEP_PX].reshape(-1, 3)
    pixels = np.flatnonzero(np.isfinite(points[:, 2]))
    points = points[pixels]
    area = STEP_PX**2 * points[:, 2] ** 2 / (geometry.focal_u_px * geometry.focal_v_px)
    xyz = np.asarray(world_SE3_left @ points, dtype=np.float32)
    return FloorPoints(xyz, area.astype(np.float32), pixels.astype(np.int32))


def agreement_check(first: SensorPaths, second: SensorPaths) -> Check:
    """The distance at which two sensors see the same people."""
    name = f"{first.name} and {second.name}: people apart"
    paths = first.paths(second.camera)
    others = second.paths(first.camera)
    # A person who is hidden from one sensor has nobody near by in its view: the other sensor's people have.
    median_m = float(np.fmin(_median_apart_m(paths, others), _median_apart_m(others, paths)))
    note = "median distance between the places of people whom both see"
    if math.isnan(median_m):
        note = "nobody walked where both sensors look"
    elif median_m > APART_M:
        note += "; a clock or a pose in rigs.toml is wrong: align the sensors again"
    return limit_check(name, median_m, "m", note, most=APART_M, warns=True)


def _median_apart_m(paths: Paths, others: Paths) -> float:
    """Median distance of people from whoever is nearest to them by another sensor [m]; NaN where nobody is near."""
    distances_m = [np.empty(0)]
    for path in paths:
        nearest_m = np.full(len(path.xy_m), OTHERS_M)
        for other in others:
            if same_height(path, other):
                nearest_m = np.fmin(nearest_m, apart_m(AS_GIVEN, path, other))
        distances_m.append(nearest_m[nearest_m < OTHERS_M])
    together_m = np.concatenate(distances_m)
    return float(np.median(together_m)) if len(together_m) else math.nan
