"""Floors that are little of the picture: random rooms full of furniture, seen by low and level depth cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from calib.camera import Camera
from calib.errors import WorkError
from calib.floor.plane import FloorParams
from calib.rig import Floor, world_from_plane
from calib.types import F32, F64
from stereo.floor import BLIND_SENSOR, floor_in
from stereo.rgbd import NOISE, RgbdRectifier

CAMERA = Camera(320, 240, 230.0, 230.0, 159.5, 119.5)
RANGE_M = 8.0
SHARES = (0.03, 0.15)
"""Share of the floor in the measured pixels."""
FRAMES = 12
HEIGHT_OFF_M, ANGLE_OFF_DEG = 0.01, 0.5
WRONG_M, WRONG_DEG = 0.05, 2.0
"""Beyond these it is another plane."""


@dataclass(frozen=True, eq=False)
class LowRoom:
    """Depth images [m] of a room, NaN where unknown, the true floor, and its share of the measured pixels."""

    depths: list[F32]
    floor: Floor
    share: float


def low_room(seed: int) -> LowRoom:
    """A camera at 0.8 to 1.5 m, tilted by 78 to 93 degrees from straight down, in a room with tables, shelves and
    boxes; somebody walks in half of them. The first room of the seed with a floor of the right share."""
    rng = np.random.default_rng(seed)
    while True:
        height_m, tilt = rng.uniform(0.8, 1.5), math.radians(rng.uniform(78, 93))
        roll = math.radians(rng.normal(0, 1.5))
        normal = -np.array([-math.sin(roll), math.sin(tilt) * math.cos(roll), math.cos(tilt) * math.cos(roll)])
        floor = Floor(world_from_plane(normal, height_m))
        width, length = rng.uniform(2.5, 6), rng.uniform(3, 7)
        aside = rng.uniform(-0.3, 0.3) * width
        left, right, far, high = aside - width / 2, aside + width / 2, length, rng.uniform(2.4, 3)
        walls = [[left - 1, -9, 0, left, 9, 9], [right, -9, 0, right + 1, 9, 9], [-9, far, 0, 9, far + 1, 9]]
        ground, ceiling = [-99, -99, -1, 99, 99, 0], [-9, -9, high, 9, 9, high + 1]
        still, which = _cast(np.array([ground, *walls, ceiling, *_furniture(rng, left, right, far)]), floor)
        share = float((which == 0).sum() / np.isfinite(still).sum())
        if SHARES[0] <= share <= SHARES[1]:
            break
    depths, walks = [], rng.random() < 0.5
    for _ in range(FRAMES):
        depth = still
        if walks:
            x, y = rng.uniform(left + 0.4, right - 0.4), rng.uniform(1.2, max(1.3, far - 0.5))
            depth = np.fmin(still, _cast(np.array([[x - 0.25, y - 0.15, 0.1, x + 0.25, y + 0.15, 1.7]]), floor)[0])
        noisy = depth + NOISE["structured-light"][0] * depth**2 * _smooth(rng, depth.shape)
        noisy[rng.random(depth.shape) < 0.05] = np.nan
        depths.append(noisy.astype(np.float32))
    return LowRoom(depths, floor, share)


def _furniture(rng: np.random.Generator, left: float, right: float, far: float) -> list[list[float]]:
    boxes = []
    for _ in range(rng.integers(2, 8)):
        kind, x, y = rng.integers(3), rng.uniform(left, right), rng.uniform(1.0, far)
        if kind == 0:  # a table on a leg
            across, deep, top = rng.uniform(0.8, 2.4), rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.78)
            boxes.append([x - across / 2, y, top - 0.04, x + across / 2, y + deep, top])
            boxes.append([x - 0.05, y + deep / 2, 0, x + 0.05, y + deep / 2 + 0.1, top])
        elif kind == 1:  # a shelf
            boxes.append([x, y, 0, x + rng.uniform(0.3, 1.5), y + rng.uniform(0.3, 0.6), rng.uniform(0.8, 2.2)])
        else:  # a sofa, a bed, a box
            across, deep = rng.uniform(0.4, 2.0, 2)
            boxes.append([x, y, 0, x + across, y + deep, rng.uniform(0.2, 0.6)])
    return boxes


def _cast(boxes: F64, floor: Floor) -> tuple[F64, F64]:
    """(H, W) depth [m], NaN beyond the range, and the number of the box, of (N, 6) low and high corners."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = CAMERA.unproject(np.column_stack([u.ravel(), v.ravel()])) @ floor.world_SE3_left.rotation.T
    at = floor.world_SE3_left.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        edges = (boxes.reshape(-1, 2, 1, 3) - at) / rays
    enter, leave = np.nanmax(edges.min(axis=1), axis=-1), np.nanmin(edges.max(axis=1), axis=-1)
    hits = np.where((enter < leave) & (enter > 0), enter, np.inf)
    which, depth = hits.argmin(axis=0), hits.min(axis=0)
    shape = CAMERA.height, CAMERA.width
    return np.where(depth < RANGE_M, depth, np.nan).reshape(shape), which.reshape(shape)


def _smooth(rng: np.random.Generator, shape: tuple[int, int]) -> F64:
    """(H, W) noise that neighbours share, as a matching window does, with a deviation of 1."""
    noise = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 1.5)
    return np.asarray(noise / noise.std())


def floor_of(room: LowRoom) -> Floor:
    """The floor as a run finds it. Raises WorkError: it does not."""
    rectifier = RgbdRectifier(CAMERA, "structured-light")
    return floor_in(room.depths, rectifier.geometry, FloorParams(), BLIND_SENSOR)


def errors_of(found: Floor, true: Floor) -> tuple[float, float]:
    """Errors of the height [m] and of the plane's direction [degrees]."""
    a, b = found.world_SE3_left.rotation[2], true.world_SE3_left.rotation[2]
    return abs(found.height_m - true.height_m), math.degrees(math.acos(min(1.0, float(a @ b))))


def low_floors(rooms: int) -> tuple[float, int, int]:
    """Of so many rooms, the share whose floor is found within HEIGHT_OFF_M and ANGLE_OFF_DEG, and the numbers of wrong
    floors with a doubt and without."""
    good, doubted, silent = 0, 0, 0
    for seed in range(rooms):
        room = low_room(seed)
        try:
            found = floor_of(room)
        except WorkError:
            continue
        height_m, angle_deg = errors_of(found, room.floor)
        if height_m < HEIGHT_OFF_M and angle_deg < ANGLE_OFF_DEG:
            good += 1
        elif height_m > WRONG_M or angle_deg > WRONG_DEG:
            doubted, silent = doubted + bool(found.doubt), silent + (not found.doubt)
    return good / rooms, doubted, silent
