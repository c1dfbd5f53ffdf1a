"""Agreement of the sensors of one place: people whom two of them see are at one place at one time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any, cast

import cv2
import numpy as np

from calib.carried import Carried
from calib.floor.plane import PEOPLE_M
from calib.floor_camera import FloorCamera
from calib.pose import SE3
from calib.types import F32, F64, Bool
from planview.checks.check import Check, limit_check
from planview.evaluation.align import LEAST_M, fit_rigid
from planview.evaluation.paths import (
    MEET_M,
    TICK_S,
    Paths,
    RigAlignment,
    WalkedPath,
    apart_m,
    met_s,
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
CLOCK_S = 5.0
SHIFT_M = 2.0
"""Largest errors of clock and place that are searched [s, m]."""
BETTER = 1.5
BETTER_S = 0.5
"""A correction must let people meet for this many times as long, and this much longer [s]: two people side by side, one
of them hidden from one sensor, meet under a wrong one for a moment."""
RIVALS = 0.9
"""Two corrections are named where the worse one lets people meet for this share of the time."""
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
    """The distance at which two sensors see the same people, and what would let them agree."""
    name = f"{first.name} and {second.name}: people apart"
    paths = first.paths(second.camera)
    others = second.paths(first.camera)
    corrections = _corrections(paths, others)
    distances_m = _apart_as_given(corrections[0] if corrections else AS_GIVEN, paths, others)
    if not len(distances_m):
        return limit_check(name, math.nan, "m", "nobody walked where both sensors look", most=APART_M, warns=True)
    median_m = float(np.median(distances_m))
    note = "median distance between the places of people whom both see"
    if corrections and median_m > APART_M:
        note += f"; they would agree with {' or '.join(_cause(second, motion) for motion in corrections)}"
    return limit_check(name, median_m, "m", note, most=APART_M, warns=True)


def _cause(sensor: SensorPaths, motion: RigAlignment) -> str:
    """The change of a correction to ``rigs.toml``, in words."""
    if motion.clock_s:
        return f"start_s of {sensor.name} {abs(motion.clock_s):.1f} s {'smaller' if motion.clock_s < 0 else 'larger'}"
    camera_m = sensor.camera.centre_m[:2]
    x_m, y_m = motion.apply(camera_m)
    turned_deg = math.degrees(motion.heading_rad)
    return (
        f"{sensor.name} at x {x_m:.2f}, y {y_m:.2f} m instead of {camera_m[0]:.2f}, {camera_m[1]:.2f} m "
        f"and turned by {turned_deg:.1f} degrees"
    )


def _corrections(first: Paths, second: Paths) -> list[RigAlignment]:
    """Another clock or pose of the second sensor under which people meet for clearly longer, the better one first."""

    def together_s(motion: RigAlignment) -> float:
        return met_s(motion, first, second)

    motions = sorted([_other_clock(first, second), _other_pose(first, second)], key=together_s, reverse=True)
    longest_s = together_s(motions[0])
    given_s = together_s(AS_GIVEN)
    if longest_s <= max(BETTER * given_s, given_s + BETTER_S):
        return []
    return [motion for motion in motions if together_s(motion) >= RIVALS * longest_s]


def _apart_as_given(motion: RigAlignment, first: Paths, second: Paths) -> F64:
    """(N,) distances as given [m] of the places that meet under a motion, from where a person was seen last before and
    after a path."""
    distances = [np.empty(0)]
    for path, other in _pairs(first, second):
        ticks = np.arange(path.first, path.end, dtype=np.float64)
        now_m = np.hypot(*(other.at(np.clip(ticks, other.first, other.end - 1)) - path.xy_m).T)
        meets = apart_m(motion, path, other) < MEET_M
        distances.append(now_m[meets & np.isfinite(now_m)])
    return np.concatenate(distances)


def _pairs(first: Paths, second: Paths) -> list[tuple[WalkedPath, WalkedPath]]:
    """Paths that may be of one person."""
    return [(path, other) for path, other in product(first, second) if same_height(path, other)]


def _other_clock(first: Paths, second: Paths) -> RigAlignment:
    """The clock of the second sensor under which people meet for longest."""
    ticks = round(CLOCK_S / TICK_S)
    motions = [RigAlignment(0.0, 0.0, 0.0, tick * TICK_S) for tick in range(-ticks, ticks + 1)]
    return max(motions, key=lambda motion: met_s(motion, first, second))


def _other_pose(first: Paths, second: Paths) -> RigAlignment:
    """The pose of the second sensor, moved and turned on the floor, under which people meet for longest."""
    motions = [AS_GIVEN]
    for pair in _pairs(first, second):
        target, source = _meeting_places(AS_GIVEN, [pair], math.inf)
        shift_m = np.median(target - source, axis=0) if len(target) else np.full(2, np.inf)
        if np.hypot(*shift_m) < SHIFT_M:
            motions.append(RigAlignment(0.0, float(shift_m[0]), float(shift_m[1]), 0.0))
    best = max(motions, key=lambda motion: met_s(motion, first, second))
    for _ in range(5):
        target, source = _meeting_places(best, _pairs(first, second), MEET_M)
        if len(target) * TICK_S < MIN_PATH_S or np.ptp(source, axis=0).max() < LEAST_M:
            break
        fit = fit_rigid(source, target)
        best = RigAlignment(fit.rotation_rad, fit.x_m, fit.y_m, 0.0)
    return best


def _meeting_places(
    motion: RigAlignment, pairs: Sequence[tuple[WalkedPath, WalkedPath]], meet_m: float
) -> tuple[F64, F64]:
    """(N, 2) places of the first sensor's people and of the second's that are nearer than this under a motion [m]."""
    targets = [np.empty((0, 2))]
    sources = [np.empty((0, 2))]
    for path, other in pairs:
        meets = apart_m(motion, path, other) < meet_m
        targets.append(path.xy_m[meets])
        sources.append(other.at(np.arange(path.first, path.end)[meets].astype(np.float64)))
    return np.concatenate(targets), np.concatenate(sources)
