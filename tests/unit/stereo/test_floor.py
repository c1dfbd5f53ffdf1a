"""The floor in depth images of rooms in which somebody moves."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from calib.floor.plane import FloorParams
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.types import F32
from stereo.depth import RectifiedGeometry
from stereo.floor import floor_in

VIEW = RectifiedGeometry(240, 180, 150.0, 150.0, 119.5, 89.5, 0.1)
Box = tuple[float, float, float, float, float, float]
"""Low and high corner in the world [m]."""


def camera(tilt_deg: float, height_m: float) -> SE3:
    tilt = math.radians(tilt_deg)
    return world_from_plane(np.array([0.0, -math.sin(tilt), -math.cos(tilt)]), height_m)


def depth_of(boxes: Sequence[Box], pose: SE3, noise: np.random.Generator) -> F32:
    """Depth [m] of boxes, with the noise of disparities."""
    u, v = np.meshgrid(np.arange(VIEW.width), np.arange(VIEW.height))
    rays = np.dstack([(u - VIEW.cu_px) / VIEW.focal_u_px, (v - VIEW.cv_px) / VIEW.focal_v_px, np.ones(u.shape)])
    rays = rays @ pose.rotation.T + 1e-12
    corners = np.array(boxes).reshape(-1, 2, 1, 1, 3) - pose.translation
    edges = corners / rays
    enter, leave = edges.min(axis=1).max(axis=-1), edges.max(axis=1).min(axis=-1)
    depth = np.where((enter < leave) & (enter > 0), enter, np.inf).min(axis=0)
    disparity = VIEW.disparity_metre / depth + noise.normal(0.0, 0.02, depth.shape)
    return np.asarray(VIEW.disparity_metre / np.maximum(disparity, 0.5), dtype=np.float32)


def man(x: float, y: float) -> Box:
    return x - 0.25, y - 0.15, 0.0, x + 0.25, y + 0.15, 1.74


def board(x: float, y: float) -> Box:
    """A board of 2.6 m that a man carries before him."""
    return x - 1.3, y - 0.5, 1.0, x + 1.3, y - 0.15, 1.3


def edge(x: float, y: float) -> Box:
    """The upper edge of a monitor."""
    return x - 0.3, y, 0.9, x + 0.3, y + 0.1, 1.1


ROOM: list[Box] = [(-9.0, -9.0, -1.0, 9.0, 9.0, 0.0), (-9.0, 6.0, 0.0, 9.0, 9.0, 3.0), (2.5, -9.0, 0.0, 9.0, 9.0, 3.0)]
WALK = [(0.5 * step - 1.5, 3.0 + 0.2 * (step % 3)) for step in range(8)]


def test_floor_is_found_where_the_only_person_carries_a_board():
    pose, noise = camera(58, 2.6), np.random.default_rng(0)
    depths = [depth_of([*ROOM, man(*at), board(*at)], pose, noise) for at in WALK]
    floor = floor_in(depths, VIEW, FloorParams())
    assert (floor.height_m, math.degrees(floor.tilt_rad)) == pytest.approx((2.6, 58), abs=0.3)


def test_floor_of_a_level_camera_is_found_where_monitors_flicker():
    pose, noise = camera(90, 1.07), np.random.default_rng(0)
    depths = []
    for step, at in enumerate(WALK):
        flickers = [edge(x, 1.6) for x in (-1.0, -0.35, 0.35, 1.0) if step % 2]
        depths.append(depth_of([*ROOM, man(at[0], at[1] + 1.0), *flickers], pose, noise))
    floor = floor_in(depths, VIEW, FloorParams())
    assert (floor.height_m, math.degrees(floor.tilt_rad)) == pytest.approx((1.07, 90), abs=0.3)
