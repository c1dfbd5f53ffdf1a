"""Cameras, their poses, the frame of the room."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.camera import Camera
from calib.errors import InputError
from calib.floor_camera import FloorCamera, FloorPinhole
from calib.ground_camera import LENS_K_320, GroundCamera, load_ground_camera, save_ground_camera
from calib.pose import SE3
from calib.rig import Floor, world_from_plane
from calib.world import RigEntry, load_rigs, load_world, save_rigs, save_world

BROWN = Camera(640, 480, 500.0, 505.0, 320.0, 240.0, "brown", (-0.3, 0.1, 0.001, -0.001, 0.0))
FISHEYE = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, "fisheye", (0.02, -0.01, 0.003, 0.0))


RATIONAL = Camera(
    1280, 800, 808.3, 807.5, 634.2, 407.7, "rational", (-9.2, 65.3, -5e-5, 5e-4, -87.7, -9.29, 65.5, -87.8)
)
TILTED = Camera(
    640, 480, 500.0, 505.0, 320.0, 240.0, "rational",
    (-0.3, 0.1, 0.001, -0.001, 0.0, 0.1, 0.05, 0.01, 0.001, 0.002, -0.001, 0.0005, 0.02, -0.03),
)  # fmt: skip


@pytest.mark.parametrize("camera", [BROWN, FISHEYE, RATIONAL, TILTED])
def test_camera_unproject_inverts_project(camera: Camera) -> None:
    points = np.array([[0.0, 0.0, 2.0], [0.8, -0.5, 2.0], [-0.9, 0.6, 3.0], [1.0, 0.6, 2.0]])
    rays = camera.unproject(camera.project(points))
    np.testing.assert_allclose(rays, points / points[:, 2:], atol=1e-9)


def test_camera_has_no_ray_for_a_pixel_beyond_where_its_lens_turns_back() -> None:
    # r - 0.3 r^3 has its maximum 0.7027 at r = 1.054: nothing is imaged further out than 351 px.
    camera = Camera(1000, 480, 500.0, 500.0, 500.0, 240.0, "brown", (-0.3, 0.0, 0.0, 0.0))
    rays = camera.unproject([[500.0 + 340.0, 240.0], [500.0 + 360.0, 240.0]])
    assert np.isfinite(rays[0]).all() and np.isnan(rays[1, :2]).all()


def test_camera_projects_points_behind_it_to_nan_and_refuses_nan():
    assert np.isnan(BROWN.project([[0.0, 0.0, -1.0]])).all()
    with pytest.raises(ValueError, match="finite"):
        Camera(640, 480, float("nan"), 500.0, 320.0, 240.0)


def test_scaled_camera_keeps_pixel_centres() -> None:
    half = BROWN.scaled(320, 240)
    pixel = BROWN.project([[0.4, 0.2, 2.0]])
    np.testing.assert_allclose(half.project([[0.4, 0.2, 2.0]]), (pixel + 0.5) / 2 - 0.5, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, 3.0])
def test_pose_knows_its_inverse_and_the_angle_of_its_rotation_at_any_size(angle):
    pose = SE3(Rotation.from_rotvec(angle * np.array([2.0, -1.0, 2.0]) / 3.0).as_matrix(), np.array([1.0, 2.0, 3.0]))
    assert pose.angle_rad == pytest.approx(angle, abs=1e-9)
    np.testing.assert_allclose((pose.inverse() @ pose).matrix, np.eye(4), atol=1e-12)


def test_world_has_y_up_the_image_of_an_overhead_camera_and_ahead_of_a_level_one():
    floor = Floor(world_from_plane(np.array([0.0, 0.0, -1.0]), 2.7))
    np.testing.assert_allclose(floor.world_SE3_left @ [[1.0, 0.0, 2.7]], [[1.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(floor.world_SE3_left @ [[0.0, -1.0, 1.7]], [[0.0, 1.0, 1.0]], atol=1e-12)
    assert floor.tilt_rad == pytest.approx(0.0) and floor.height_m == pytest.approx(2.7)
    floor = Floor(world_from_plane(np.array([0.0, -1.0, 0.0]), 2.0))
    np.testing.assert_allclose(floor.world_SE3_left @ [[0.0, 2.0, 5.0]], [[0.0, 5.0, 0.0]], atol=1e-12)
    assert np.degrees(floor.tilt_rad) == pytest.approx(90.0)


def test_roll_turns_the_image_clockwise_about_its_centre() -> None:
    level = GroundCamera(641, 481, 500.0, 4.0, math.radians(60))
    rolled = GroundCamera(641, 481, 500.0, 4.0, math.radians(60), roll_rad=math.radians(30))
    point = [1.0, 6.0, 0.0]
    right, low = level.project(point) - [320.0, 240.0]
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    np.testing.assert_allclose(rolled.project(point) - [320.0, 240.0], [c * right - s * low, s * right + c * low])


@given(
    tilt=st.floats(0, 75), roll=st.floats(-20, 20), x=st.floats(-2, 2), y=st.floats(1, 8),
    lens=st.sampled_from(sorted(LENS_K_320)),
)  # fmt: skip
def test_floor_positions_come_back_from_their_pixels(tilt: float, roll: float, x: float, y: float, lens: str) -> None:
    camera = GroundCamera(640, 480, 500.0, 4.0, math.radians(tilt), lens, math.radians(roll))
    pixel = camera.project([x, y, 0.0])
    if np.isfinite(pixel).all():
        np.testing.assert_allclose(camera.back_project(pixel), [x, y], atol=1e-6)


def test_what_is_higher_than_the_camera_is_ahead_of_it_or_nowhere() -> None:
    camera = GroundCamera(640, 480, 500.0, 1.2, math.radians(85))
    pixel = camera.project([0.5, 4.0, 1.7])
    np.testing.assert_allclose(camera.back_project(pixel, 1.7), [0.5, 4.0])
    below_the_horizon = camera.project([0.5, 4.0, 1.0])
    assert np.isnan(camera.back_project(below_the_horizon, 1.7)).all()
    assert np.isnan(camera.back_project(pixel, 1.2)).all()


@pytest.mark.parametrize("lens", sorted(LENS_K_320))
def test_one_point_is_projected_to_the_bit_as_many_are(lens: str) -> None:
    rng, camera = np.random.default_rng(1), GroundCamera(640, 480, 300.0, 4.0, math.radians(65), lens, 0.1)
    pixels = np.vstack([rng.uniform(-600, 1200, (300, 2)), [[319.5, 239.5], [np.nan, 3.0]]])
    points = np.vstack([rng.uniform((-9, -9, 0), (9, 30, 2), (300, 3)), [[np.nan, 1.0, 0.0]]])
    for height_m in (1.1, 5.0):
        many = camera.back_project(pixels, height_m)
        assert np.isnan(many).any()
        np.testing.assert_array_equal([camera.back_project(p, height_m) for p in pixels], many)
    np.testing.assert_array_equal([camera.project(p) for p in points], camera.project(points))


def test_camera_survives_saving_its_file_may_lack_the_roll_and_one_on_its_side_is_refused(tmp_path: Path) -> None:
    path, camera = tmp_path / "camera.toml", GroundCamera(640, 480, 512.3, 4.1, math.radians(61), "normal", -0.0436)
    save_ground_camera(camera, path)
    assert load_ground_camera(path).roll_rad == pytest.approx(camera.roll_rad)
    text = path.read_text()
    path.write_text(re.sub("roll.*", "", text))
    assert load_ground_camera(path).roll_rad == 0.0
    path.write_text(re.sub("roll_deg = .*", "roll_deg = 90", text))
    with pytest.raises(InputError, match="roll within"):
        load_ground_camera(path)


NORTH = RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, 2.4]))
SOUTH = RigEntry('so"uth\n', SE3.from_rotvec([2.1, 0.3, 0.4], [3.0, 1.0, 2.2]), 1.25)


def test_heads_are_read_as_they_were_written(tmp_path: Path) -> None:
    save_rigs([NORTH, SOUTH], tmp_path / "rigs.toml", "two\nlines")
    for entry, again in zip((NORTH, SOUTH), load_rigs(tmp_path / "rigs.toml"), strict=True):
        assert (again.folder, again.start_s) == (entry.folder, entry.start_s)
        np.testing.assert_array_equal(again.world_SE3_left.matrix, entry.world_SE3_left.matrix)


@pytest.mark.parametrize(
    ("entries", "found"),
    [
        ([NORTH, NORTH], "once"),
        ([RigEntry("../north", NORTH.world_SE3_left)], "inside"),
        ([RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, -2.4]))], "above the floor"),
        ([], "'head'"),
    ],
)
def test_heads_that_cannot_be_are_refused(entries: list[RigEntry], found: str, tmp_path: Path) -> None:
    save_rigs(entries, tmp_path / "rigs.toml")
    with pytest.raises(InputError, match=found):
        load_rigs(tmp_path / "rigs.toml")


@pytest.mark.parametrize(
    ("text", "found"),
    [(text, "") for text in ("head = 3", "[[head]]\nfolder = 'a'", "head = [1]", "[[head", "head = []")]
    + [("a" + ".a" * 60_000 + " = 1", ".*nested more than 32 deep")],
    ids=lambda text: text[:20],
)
def test_files_that_list_no_heads_are_refused_at_once(text, found, tmp_path):
    (tmp_path / "rigs.toml").write_text(text)
    with pytest.raises(InputError, match=rf"rigs\.toml: expected{found}"):
        load_rigs(tmp_path / "rigs.toml")


@pytest.mark.parametrize("extent", [(5.0, 0.0, 3.0, 6.0), (float("nan"), 0.0, 3.0, 6.0), (0.0, 0.0, float("inf"), 1.0)])
def test_extent_that_is_no_rectangle_is_refused(extent: tuple[float, float, float, float], tmp_path: Path) -> None:
    save_world(Floor(NORTH.world_SE3_left, extent_m=extent), tmp_path / "world.toml")
    with pytest.raises(InputError, match="an extent_m of"):
        load_world(tmp_path / "world.toml")


@pytest.mark.parametrize(
    "camera",
    [
        GroundCamera(320, 240, 250.0, 3.0, 0.9, roll_rad=0.1),
        FloorPinhole(
            (320, 240),
            np.array([[250.0, 0.0, 160.0], [0.0, 240.0, 119.0], [0.0, 0.0, 1.0]]),
            SE3.from_rotvec([np.radians(180 + 40), 0.0, 0.1], [0.2, -0.3, 2.7]),
        ),
    ],
    ids=["four parameters", "a pinhole with a pose"],
)
def test_floor_cameras_agree_with_their_projection_and_find_the_floor_again(camera: FloorCamera) -> None:
    pixels = np.array([[100.0, 200.0], [160.0, 120.0], [300.0, 230.0]])
    on_floor = np.column_stack([camera.back_project(pixels), np.zeros(3)])
    np.testing.assert_allclose(camera.project(on_floor), pixels, atol=1e-9)
    u, v, depth = camera.projection @ np.column_stack([on_floor, np.ones(3)]).T
    np.testing.assert_allclose(np.column_stack([u, v]) / depth[:, None], pixels, atol=1e-9)
    rays = camera.rays(pixels)
    towards = on_floor - camera.centre_m
    np.testing.assert_allclose(np.cross(rays, towards), 0.0, atol=1e-6 * np.linalg.norm(rays))
