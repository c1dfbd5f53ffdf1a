"""Rules in pixels of a stereo rig."""

from pathlib import Path

import numpy as np
import pytest

from calib.camera import Camera
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import Floor, StereoRig, save_rig
from calib.world import save_world
from planview.counting.geometry import stereo_plane
from planview.counting.rules import parse_rules
from stereo.depth import RectifiedGeometry, StereoFloorCamera

# Two metres above the floor, straight down: image right is +x, image up is +y.
DOWN = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 2.0]))
# Looking along +y, level: the horizon is the middle row.
LEVEL = SE3(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 2.0]))
GEOMETRY = RectifiedGeometry(640, 480, 400.0, 400.0, 319.5, 239.5, 0.1)


def test_pixels_and_floor_of_a_camera_looking_down() -> None:
    camera = StereoFloorCamera(GEOMETRY, DOWN)
    pixels = np.array([[319.5, 239.5], [519.5, 239.5], [319.5, 139.5]])
    floor = camera.back_project(pixels)
    np.testing.assert_allclose(floor, [[0, 0], [1, 0], [0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(camera.project(np.column_stack([floor, np.zeros(3)])), pixels)


def test_places_above_the_horizon_and_behind_the_camera_are_unknown() -> None:
    camera = StereoFloorCamera(GEOMETRY, LEVEL)
    assert np.isnan(camera.back_project(np.array([[319.5, 100.0]]))).all()
    assert np.isnan(camera.project(np.array([[0.0, -1.0, 0.0]]))).all()


def test_plane_of_a_rig_reads_its_world(tmp_path: Path) -> None:
    lens = Camera(640, 480, 400.0, 400.0, 319.5, 239.5)
    save_rig(StereoRig(lens, lens, SE3(np.eye(3), np.array([-0.1, 0.0, 0.0]))), tmp_path / "rig.toml")
    with pytest.raises(InputError, match=r"world\.toml: expected the pose of the rig"):
        stereo_plane(tmp_path / "rig.toml")
    save_world(Floor(DOWN), tmp_path / "world.toml")
    plane = stereo_plane(tmp_path / "rig.toml")
    wire = {"name": "w", "from_px": [319.5, 239.5], "to_px": [519.5, 239.5]}
    placed = parse_rules({"tripwire": [wire]}, plane, "r").tripwires[0]
    np.testing.assert_allclose(placed.points, [[0, 0], [1, 0]], atol=0.01)
