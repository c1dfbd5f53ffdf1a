"""A floor that was given, against the one that the images show."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calib.pose import SE3
from calib.rig import Floor, world_from_plane
from planview.checks.scene import given_floor_check
from stereo.depth import RectifiedGeometry

GEOMETRY = RectifiedGeometry(320, 240, 250.0, 250.0, 159.5, 119.5, 0.12)


def floor(height_m: float, tilt_deg: float = 50.0) -> SE3:
    tilt = np.radians(tilt_deg)
    return world_from_plane(np.array([0.0, -np.sin(tilt), -np.cos(tilt)]), height_m)


def seen(*planes: SE3) -> Any:
    """Frames of whichever plane is nearest, each a shelf to the right of the one before."""
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = np.dstack([(u - 159.5) / 250.0, (v - 119.5) / 250.0, np.ones_like(u)])
    disparity = np.zeros_like(u)
    for number, pose in enumerate(planes):
        depth = -pose.translation[2] / np.minimum(rays @ pose.rotation[2], -1e-3)
        shown = u >= 320 * number / len(planes)
        disparity[shown] = (250.0 * 0.12 / depth)[shown]
    frames = [disparity.astype(np.float32)] * 5
    return SimpleNamespace(rectifier=SimpleNamespace(geometry=GEOMETRY), disparities=frames)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (floor(2.53, 50.5), ""),
        (floor(2.5, 47.0), "the camera has rotated by 3.0 degrees since"),
        (floor(3.0), "the camera has moved down by 0.50 m since"),
        (floor(2.0), "the camera has moved up by 0.50 m since"),
    ],
)
def test_floor_that_fits_no_more_is_named_with_the_one_that_is_there(given, said):
    check = given_floor_check(seen(floor(2.5)), given, Floor(floor(2.5)), "world.toml")
    assert check.failed == bool(said)
    assert said in check.note
    assert not said or "world.toml no longer fits: the images show a floor 2.50 m below the camera" in check.note


def test_floor_of_which_a_table_shows_more_is_kept():
    table, under_it = floor(1.75), floor(2.5)
    assert given_floor_check(seen(under_it, table), under_it, Floor(table), "world.toml").ok


def test_poorly_determined_floor_refuses_none():
    unsure = Floor(floor(2.5), covariance=np.diag([0.1, 0.1, 0.1]) ** 2)
    assert given_floor_check(seen(floor(2.5)), floor(2.6, 55.0), unsure, "world.toml").ok
