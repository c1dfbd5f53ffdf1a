"""Floors of low, level cameras, of which little shows between walls and furniture."""

import math

import cv2
import numpy as np
import pytest

from calib.camera import Camera
from calib.floor.plane import FloorParams
from calib.rig import Floor, world_from_plane
from stereo.floor import floor_in
from stereo.rgbd import NOISE, RgbdRectifier

CAMERA = Camera(320, 240, 230.0, 230.0, 159.5, 119.5)
RANGE_M = 8.0
FRAMES = 12
HEIGHT_M = 1.2
ROLL_DEG = 1.0
ROOM = [
    [-99, -99, -1, 99, 99, 0],  # the floor
    [-2.5, -9, 0, -1.5, 9, 9],
    [1.5, -9, 0, 2.5, 9, 9],
    [-9, 3.5, 0, 9, 4.5, 9],
    [-9, -9, 2.6, 9, 9, 3.6],
    [-1.4, 2.0, 0.7, -0.2, 3.0, 0.74],  # a table on a leg
    [-0.85, 2.45, 0, -0.75, 2.55, 0.7],
    [0.9, 1.8, 0, 1.5, 2.3, 1.8],  # a shelf
    [-0.1, 2.6, 0, 0.9, 3.4, 0.4],  # a sofa
]
"""Low and high corners of boxes [m]: x to the right, y ahead, z up from the floor below the camera."""
WALKER = [0.2, 1.4, 0.1, 0.7, 1.7, 1.7]


def floor_of(tilt_deg: float) -> Floor:
    """The floor below a camera that is tilted from straight down."""
    tilt = math.radians(tilt_deg)
    roll = math.radians(ROLL_DEG)
    down = np.array([-math.sin(roll), math.sin(tilt) * math.cos(roll), math.cos(tilt) * math.cos(roll)])
    return Floor(world_from_plane(-down, HEIGHT_M))


def cast(boxes: list[list[float]], floor: Floor) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) depth [m], NaN beyond the range, and the number of the box that is seen."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = CAMERA.unproject(np.column_stack([u.ravel(), v.ravel()])) @ floor.world_SE3_left.rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        edges = (np.array(boxes, float).reshape(-1, 2, 1, 3) - floor.world_SE3_left.translation) / rays
    enter = np.nanmax(edges.min(axis=1), axis=-1)
    leave = np.nanmin(edges.max(axis=1), axis=-1)
    hits = np.where((enter < leave) & (enter > 0), enter, np.inf)
    depth = np.where(hits.min(axis=0) < RANGE_M, hits.min(axis=0), np.nan)
    shape = CAMERA.height, CAMERA.width
    return depth.reshape(shape), hits.argmin(axis=0).reshape(shape)


def measured(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth with the noise of a sensor, which neighbours share, and with holes."""
    noise = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 1.5)
    noisy = depth + NOISE["structured-light"][0] * depth**2 * (noise / noise.std())
    noisy[rng.random(depth.shape) < 0.05] = np.nan
    return noisy.astype(np.float32)


@pytest.mark.parametrize("tilt_deg", [88.0, 91.0])
@pytest.mark.parametrize("walks", [False, True], ids=["nobody moves", "somebody walks"])
def test_floor_of_a_level_camera_is_found_among_larger_walls(tilt_deg, walks):
    rng = np.random.default_rng(0)
    true = floor_of(tilt_deg)
    depth, box = cast(ROOM, true)
    assert 0.03 < (box == 0).sum() / np.isfinite(depth).sum() < 0.15
    passing = np.fmin(depth, cast([WALKER], true)[0])
    frames = [measured(passing if walks and i % 2 else depth, rng) for i in range(FRAMES)]
    geometry = RgbdRectifier(CAMERA, "structured-light").geometry
    found = floor_in(frames, geometry, FloorParams())
    turned = float(found.world_SE3_left.rotation[2] @ true.world_SE3_left.rotation[2])
    assert found.height_m == pytest.approx(HEIGHT_M, abs=0.01)
    assert math.degrees(math.acos(min(1.0, turned))) < 0.5
