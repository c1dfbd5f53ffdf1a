"""Cameras, their poses, the frame of the room, and single cameras in files of other programs."""

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
from calib.floor_camera import FloorPinhole
from calib.formats import base
from calib.formats.one_camera import holds_one_camera, load_one_camera, load_tsai
from calib.ground_camera import LENS_K_320, CameraDeviations, GroundCamera, load_ground_camera, save_ground_camera
from calib.pose import SE3
from calib.rig import Floor, world_from_plane
from calib.world import RigEntry, load_rigs, load_world, save_rigs, save_world

BROWN = Camera(640, 480, 500.0, 505.0, 320.0, 240.0, "brown", (-0.3, 0.1, 0.001, -0.001, 0.0))
FISHEYE = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, "fisheye", (0.02, -0.01, 0.003, 0.0))
EIGHT = (-9.2, 65.3, -5e-5, 5e-4, -87.7, -9.29, 65.5, -87.8)
TILT = (*BROWN.distortion, 0.1, 0.05, 0.01, 0.001, 0.002, -0.001, 0.0005, 0.02, -0.03)
RATIONAL = Camera(1280, 800, 808.3, 807.5, 634.2, 407.7, "rational", EIGHT)
TILTED = Camera(640, 480, 500.0, 505.0, 320.0, 240.0, "rational", TILT)


@pytest.mark.parametrize("camera", [BROWN, FISHEYE, RATIONAL, TILTED])
def test_camera_unproject_inverts_project(camera):
    points = np.array([[0.0, 0.0, 2.0], [0.8, -0.5, 2.0], [-0.9, 0.6, 3.0], [1.0, 0.6, 2.0]])
    rays = camera.unproject(camera.project(points))
    np.testing.assert_allclose(rays, points / points[:, 2:], atol=1e-9)


def test_camera_has_no_ray_for_a_pixel_beyond_where_its_lens_turns_back():
    # r - 0.3 r^3 has its maximum 0.7027 at r = 1.054: nothing is imaged further out than 351 px.
    camera = Camera(1000, 480, 500.0, 500.0, 500.0, 240.0, "brown", (-0.3, 0.0, 0.0, 0.0))
    rays = camera.unproject([[500.0 + 340.0, 240.0], [500.0 + 360.0, 240.0]])
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1, :2]).all()


def test_camera_projects_points_behind_it_to_nan():
    assert np.isnan(BROWN.project([[0.0, 0.0, -1.0]])).all()


def test_camera_refuses_a_focal_length_of_nan():
    with pytest.raises(ValueError, match="finite"):
        Camera(640, 480, float("nan"), 500.0, 320.0, 240.0)


def test_scaled_camera_keeps_pixel_centres():
    half = BROWN.scaled(320, 240)
    pixel = BROWN.project([[0.4, 0.2, 2.0]])
    np.testing.assert_allclose(half.project([[0.4, 0.2, 2.0]]), (pixel + 0.5) / 2 - 0.5, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.3, 3.0])
def test_angle_of_a_pose_is_that_of_its_rotation_at_any_size(angle):
    rotation = Rotation.from_rotvec(angle * np.array([2.0, -1.0, 2.0]) / 3.0)
    assert SE3(rotation.as_matrix(), np.zeros(3)).angle_rad == pytest.approx(angle, abs=1e-9)


def test_pose_after_its_inverse_is_the_identity():
    pose = SE3.from_rotvec([0.2, -0.1, 0.2], [1.0, 2.0, 3.0])
    np.testing.assert_allclose((pose.inverse() @ pose).matrix, np.eye(4), atol=1e-12)


@pytest.mark.parametrize(
    ("normal", "height_m", "tilt_deg", "points"),
    [
        ([0.0, 0.0, -1.0], 2.7, 0.0, {(1.0, 0.0, 2.7): [1.0, 0.0, 0.0], (0.0, -1.0, 1.7): [0.0, 1.0, 1.0]}),
        ([0.0, -1.0, 0.0], 2.0, 90.0, {(0.0, 2.0, 5.0): [0.0, 5.0, 0.0]}),
    ],
)
def test_world_follows_the_view_of_the_camera(normal, height_m, tilt_deg, points):
    floor = Floor(world_from_plane(np.array(normal), height_m))
    np.testing.assert_allclose(floor.world_SE3_left @ list(points), list(points.values()), atol=1e-12)
    assert np.degrees(floor.tilt_rad) == pytest.approx(tilt_deg)
    assert floor.height_m == pytest.approx(height_m)


def test_roll_turns_the_image_clockwise_about_its_centre():
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
def test_floor_positions_come_back_from_their_pixels(tilt, roll, x, y, lens):
    camera = GroundCamera(640, 480, 500.0, 4.0, math.radians(tilt), lens, math.radians(roll))
    pixel = camera.project([x, y, 0.0])
    if np.isfinite(pixel).all():
        np.testing.assert_allclose(camera.back_project(pixel), [x, y], atol=1e-6)


def test_what_is_higher_than_the_camera_is_ahead_of_it_or_nowhere():
    camera = GroundCamera(640, 480, 500.0, 1.2, math.radians(85))
    pixel, below_the_horizon = camera.project([[0.5, 4.0, 1.7], [0.5, 4.0, 1.0]])
    np.testing.assert_allclose(camera.back_project(pixel, 1.7), [0.5, 4.0])
    assert np.isnan(camera.back_project(below_the_horizon, 1.7)).all()
    assert np.isnan(camera.back_project(pixel, 1.2)).all()


@pytest.fixture
def camera_file(tmp_path) -> Path:
    """A camera that has rolled by -0.0436 rad."""
    save_ground_camera(GroundCamera(640, 480, 512.3, 4.1, 1.06, "normal", -0.0436), tmp_path / "camera.toml")
    return tmp_path / "camera.toml"


def test_ground_camera_survives_saving(camera_file):
    assert load_ground_camera(camera_file).roll_rad == pytest.approx(-0.0436)


def test_ground_camera_whose_file_lacks_the_roll_has_none(camera_file):
    camera_file.write_text(re.sub("roll.*", "", camera_file.read_text()))
    assert load_ground_camera(camera_file).roll_rad == 0.0


def test_ground_camera_on_its_side_is_refused(camera_file):
    camera_file.write_text(re.sub("roll_deg = .*", "roll_deg = 90", camera_file.read_text()))
    with pytest.raises(InputError, match="roll"):
        load_ground_camera(camera_file)


def test_deviations_of_a_camera_grow_with_the_distance_of_a_place(tmp_path):
    std = CameraDeviations(0.1, 1.5, 0.12, 1.0, 0.02, 0.1)
    camera = GroundCamera(640, 480, 500.0, 4.0, 1.0, std=std)
    save_ground_camera(camera, tmp_path / "camera.toml")
    again = load_ground_camera(tmp_path / "camera.toml")
    assert again.std == std
    assert std.sentence.endswith("to 2% of their distance relative to each other, to 10% from the camera")
    assert again.std_m(6.0, 8.0) == pytest.approx(1.0 / math.sqrt(2))


NORTH = RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, 2.4]))
SOUTH = RigEntry('so"uth\n', SE3.from_rotvec([2.1, 0.3, 0.4], [3.0, 1.0, 2.2]), 1.25)


def test_sensors_are_read_as_they_were_written(tmp_path):
    save_rigs([NORTH, SOUTH], tmp_path / "rigs.toml", "two\nlines")
    for entry, again in zip((NORTH, SOUTH), load_rigs(tmp_path / "rigs.toml"), strict=True):
        assert (again.folder, again.start_s) == (entry.folder, entry.start_s)
        np.testing.assert_array_equal(again.world_SE3_left.matrix, entry.world_SE3_left.matrix)


def test_older_files_list_sensors_as_heads(tmp_path):
    path = tmp_path / "rigs.toml"
    save_rigs([NORTH, SOUTH], path)
    path.write_text(path.read_text().replace("[sensor.", "[head.").replace("[[sensor]]", "[[head]]"))
    assert [entry.folder for entry in load_rigs(path)] == [NORTH.folder, SOUTH.folder]


@pytest.mark.parametrize(
    ("entries", "found"),
    [
        ([NORTH, NORTH], "once"),
        ([RigEntry("../north", NORTH.world_SE3_left)], "inside"),
        ([RigEntry("north", SE3.from_rotvec([2.0, 0.1, 0.2], [0.0, 0.0, -2.4]))], "above the floor"),
        ([], "'sensor'"),
    ],
)
def test_sensors_that_cannot_be_are_refused(entries, found, tmp_path):
    save_rigs(entries, tmp_path / "rigs.toml")
    with pytest.raises(InputError, match=found):
        load_rigs(tmp_path / "rigs.toml")


@pytest.mark.parametrize("text", ["sensor = 3", "[[sensor]]\nfolder = 'a'", "sensor = [1]", "[[sensor", "sensor = []"])
def test_files_that_list_no_sensors_are_refused_at_once(text, tmp_path):
    (tmp_path / "rigs.toml").write_text(text)
    with pytest.raises(InputError, match=r"rigs\.toml: expected"):
        load_rigs(tmp_path / "rigs.toml")


@pytest.mark.parametrize("extent", [(5.0, 0.0, 3.0, 6.0), (float("nan"), 0.0, 3.0, 6.0), (0.0, 0.0, float("inf"), 1.0)])
def test_extent_that_is_no_rectangle_is_refused(extent, tmp_path):
    save_world(Floor(NORTH.world_SE3_left, extent_m=extent), tmp_path / "world.toml")
    with pytest.raises(InputError, match="an extent_m of"):
        load_world(tmp_path / "world.toml")


PINHOLE = np.array([[250.0, 0.0, 160.0], [0.0, 240.0, 119.0], [0.0, 0.0, 1.0]])
POSE = SE3.from_rotvec([np.radians(180 + 40), 0.0, 0.1], [0.2, -0.3, 2.7])


@pytest.mark.parametrize(
    "camera", [GroundCamera(320, 240, 250.0, 3.0, 0.9, roll_rad=0.1), FloorPinhole((320, 240), PINHOLE, POSE)]
)
def test_rays_of_a_floor_camera_meet_the_floor_where_it_projects(camera):
    pixels = np.array([[100.0, 200.0], [160.0, 120.0], [300.0, 230.0]])
    on_floor = np.column_stack([camera.back_project(pixels), np.zeros(3)])
    np.testing.assert_allclose(camera.project(on_floor), pixels, atol=1e-9)
    u, v, depth = camera.projection @ np.column_stack([on_floor, np.ones(3)]).T
    np.testing.assert_allclose(np.column_stack([u, v]) / depth[:, None], pixels, atol=1e-9)
    rays = camera.rays(pixels)
    towards = on_floor - camera.centre_m
    np.testing.assert_allclose(np.cross(rays, towards), 0.0, atol=1e-6 * np.linalg.norm(rays))


def tsai(folder: Path, focal="8", kappa="0", rx=f"{math.pi}", ty="0", tz="5000", pitch="") -> Path:
    """A camera of 768 x 576 px and dpx = 0.0096 * 800 / 768 = 0.01 mm, 5 m above the origin, looking straight down."""
    (folder / "view.xml").write_text(
        f'<Camera><Geometry width="768" height="576" ncx="800" nfx="768" dx="0.0096" dy="0.01" {pitch} dpy="0.01"/>'
        f'<Intrinsic focal="{focal}" kappa1="{kappa}" cx="384" cy="288" sx="1.0"/>'
        f'<Extrinsic tx="0" ty="{ty}" tz="{tz}" rx="{rx}" ry="0" rz="0"/></Camera>'
    )
    return folder / "view.xml"


@pytest.mark.parametrize(("point", "pixel"), [((1.0, 0.0), (384 + 160, 288)), ((0.0, 1.0), (384, 288 - 160))])
def test_tsai_camera_projects_as_by_hand(tmp_path, point, pixel):
    camera = load_tsai(tsai(tmp_path))  # 800 px of focal length
    np.testing.assert_allclose(camera.centre_m, [0.0, 0.0, 5.0], atol=1e-12)
    np.testing.assert_allclose(camera.project([[*point, 0.0]]), [pixel], atol=1e-9)


def test_tsai_camera_has_nothing_above_the_horizon(tmp_path):
    assert np.isnan(load_tsai(tsai(tmp_path, rx=f"{-math.pi / 2}")).back_project([[384.0, 0.0]])).all()


@pytest.mark.parametrize("kappa", ["0.01", "-0.005"])
def test_tsai_back_projection_inverts_projection(kappa, tmp_path):
    camera = load_tsai(tsai(tmp_path, kappa=kappa, rx="2.2"))
    floor = np.array([[0.0, 0.5, 0.3], [0.4, -0.2, 0.3]])
    np.testing.assert_allclose(camera.back_project(camera.project(floor), 0.3), floor[:, :2], atol=1e-10)


@pytest.mark.parametrize("value", [{"focal": "nan"}, {"focal": "-1"}, {"focal": "x"}, {"pitch": 'dpx="0"'}], ids=str)
def test_tsai_file_with_a_bad_number_is_refused(value, tmp_path):
    with pytest.raises(InputError, match="Tsai"):
        load_tsai(tsai(tmp_path, **value))


def test_tsai_camera_is_the_same_camera_above_the_floor_at_the_size_of_the_images(tmp_path):
    turn = math.radians(180 - 70)  # looks along +y, 7 m above the floor
    path = tsai(tmp_path, "11", rx=f"{turn}", ty=f"{7000 * math.sin(turn)}", tz=f"{-7000 * math.cos(turn)}")
    assert holds_one_camera(path)
    found = load_one_camera(path, (384, 288))
    assert (found.size, found.lens) == ((384, 288), "pinhole")
    assert found.height_m == pytest.approx(7.0)
    assert found.focal_px == pytest.approx(550.0, rel=1e-3)
    assert math.degrees(found.tilt_rad) == pytest.approx(70.0, abs=0.05)
    with pytest.raises(InputError, match="768x576"):
        load_one_camera(path, (640, 360))


K3 = "data: [700., 0, 320, 0, 701, 240, 0, 0, 1]"


@pytest.mark.parametrize(
    ("name", "text", "lens"),
    [
        ("opencv.yml", f"%YAML:1.0\n---\ncamera_matrix: {{{K3}}}\n", "focal length 700"),
        ("cameras.txt", "# List\n1 PINHOLE 640 480 512.5 512.5 320 240\n", "COLMAP, PINHOLE, focal length 512"),
        ("kalibr.yaml", "cam0: {intrinsics: [458, 457, 367, 248], resolution: [752, 480]}\n", "focal length 458"),
        ("room.pet", '<PETRACK><OLD_MODEL FX="842.5" FY="842.7"/></PETRACK>', "PeTrack .*focal length 842"),
    ],
)
def test_lens_without_a_place_is_refused_with_its_focal_length(name, text, lens, tmp_path):
    (tmp_path / name).write_text(text)
    assert holds_one_camera(tmp_path / name)
    with pytest.raises(InputError, match=rf"found only a lens \(.*{lens}"):
        load_one_camera(tmp_path / name)


def test_transposed_camera_matrix_is_named():
    with pytest.raises(ValueError, match="transposed"):
        base.camera((640, 480), np.array([500.0, 0, 0, 0, 500, 0, 320, 240, 1]), np.zeros(5), name="M1")
