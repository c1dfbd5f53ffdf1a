import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from calib.errors import InputError, WorkError
from calib.floor.find import PeopleSeen, find_floor, floor_from_people, floor_from_points
from calib.floor.plane import FloorParams, Moved, Plane
from calib.pose import SE3
from calib.rig import Floor, world_from_plane
from calib.types import F32, F64
from calib.world import load_world, save_world

FOCAL_PX, BASELINE_M = 320.0, 0.2
WIDTH, HEIGHT = 320, 240


def pose_of(tilt_deg: float, height_m: float, roll_deg: float = 0.0) -> SE3:
    t, r = math.radians(tilt_deg), math.radians(roll_deg)
    normal = np.array([math.sin(r), -math.sin(t) * math.cos(r), -math.cos(t) * math.cos(r)])
    return world_from_plane(normal, height_m)


class Room:
    """Depth of planes seen from a pose, with the noise of stereo."""

    def __init__(self, pose: SE3, seed: int = 0) -> None:
        u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        self.rays = np.stack([(u - WIDTH / 2) / FOCAL_PX, (v - HEIGHT / 2) / FOCAL_PX, np.ones(u.shape)], -1)
        self.rays = self.rays.reshape(-1, 3)
        self.world = self.rays @ pose.rotation.T
        self.height = float(pose.translation[2])
        self.depth = np.full(len(self.rays), np.inf)
        self.rng = np.random.default_rng(seed)

    def add(self, normal: tuple[float, float, float], offset: float, box: Sequence[float] = (-99, 99, -99, 99)) -> None:
        """The part of the plane normal . p = offset within x and y bounds."""
        n = np.array(normal)
        with np.errstate(all="ignore"):
            s = (offset - self.height * n[2]) / (self.world @ n)
            s = np.where(s > 0, s, np.inf)
            p = np.where(np.isfinite(s), s, 0.0)[:, None] * self.world
        inside = (p[:, 0] > box[0]) & (p[:, 0] < box[1]) & (p[:, 1] > box[2]) & (p[:, 1] < box[3])
        self.depth = np.minimum(self.depth, np.where(inside, s, np.inf))

    def clouds(self, n: int = 4, people: bool = True) -> list[F32]:
        return [self._cloud(people) for _ in range(n)]

    def _cloud(self, people: bool) -> F32:
        still = self.depth
        if people:
            x, y = self.rng.uniform(-1.5, 1.5), self.rng.uniform(1.0, 4.0)
            self.add((0.0, 0.0, 1.0), 1.5, (x - 0.25, x + 0.25, y - 0.25, y + 0.25))
        disparity = FOCAL_PX * BASELINE_M / self.depth + self.rng.normal(0, 0.25, len(self.depth))
        self.depth = still
        disparity = np.round(disparity * 16) / 16
        disparity[(self.rng.random(len(disparity)) < 0.2) | (disparity < 1.0)] = np.nan
        wrong = self.rng.random(len(disparity)) < 0.03
        disparity[wrong & np.isfinite(disparity)] = self.rng.uniform(1, 64)
        return (self.rays * (FOCAL_PX * BASELINE_M / disparity)[:, None]).astype(np.float32)


def found(clouds: list[F32], moved: Sequence[F64] = (), near: SE3 | None = None) -> Floor:
    return find_floor(clouds, focal_px=FOCAL_PX, baseline_m=BASELINE_M, moved=moved, near=near)


FLOOR, WALL = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
PERSON = np.column_stack([np.zeros(900), np.linspace(-0.5, 1.2, 900), np.full(900, 2.2)])
"""Points that move in front of a level camera."""


def room(pose: SE3, *planes: tuple[Any, ...]) -> Room:
    """A room of planes: normal, offset and bounds of each, of a floor alone by default."""
    made = Room(pose)
    for one in planes or ((FLOOR, 0.0),):
        made.add(*one)
    return made


@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 75])
def test_floor_of_a_furnished_room_is_found_at_any_tilt(tilt_deg):
    pose, ahead = pose_of(tilt_deg, 2.6, 2.0), 2.6 * math.tan(math.radians(tilt_deg))
    table = (FLOOR, 0.75, (-0.6, 0.6, ahead - 0.4, ahead + 0.4))
    floor = found(room(pose, (FLOOR, 0.0), (WALL, 6.0), ((1.0, 0.0, 0.0), -3.0), table).clouds())
    assert floor.height_m == pytest.approx(2.6, abs=0.02)
    assert math.degrees(floor.roll_rad) == pytest.approx(2.0, abs=0.3)
    assert math.degrees(floor.tilt_rad - Floor(pose).tilt_rad) == pytest.approx(0.0, abs=0.3)


def test_known_floor_is_found_only_where_it_was():
    clouds = room(pose_of(50, 2.6)).clouds()
    assert found(clouds, near=pose_of(50.2, 2.61)).height_m == pytest.approx(2.6, abs=0.02)
    with pytest.raises(WorkError, match="no floor found"):
        found(clouds, near=pose_of(50, 1.9))


def test_wall_before_which_people_walk_is_no_floor_seen_from_above():
    clouds = room(pose_of(80, 1.8), (WALL, 5.5)).clouds(6, people=False)
    floor = found(clouds)
    assert floor.height_m == pytest.approx(5.5, abs=0.2)
    assert "a wall in front of a level camera" in floor.doubt
    with pytest.raises(WorkError, match="higher than people"):
        found(clouds, moved=[PERSON])


def patch(middle: Sequence[float], size_m: Sequence[float], points: int) -> F64:
    """Points that fill a box evenly: across, along the camera's y axis, and in depth [m]."""
    filling = np.random.default_rng(0).uniform(-0.5, 0.5, (points, 3))
    return np.array(middle) + filling * np.array(size_m)


def plane_at(tilt_deg: float, distance_m: float) -> Plane:
    return Plane(-pose_of(tilt_deg, distance_m).rotation[2] / distance_m, 1.0, np.eye(3))


WALL_AHEAD, LEVEL_FLOOR, BELOW = plane_at(0, 3.2), plane_at(90, 1.3), plane_at(0, 2.8)
LIES = "what moves does not stand on it but lies along it"
MAN_M, EDGE_M, BOARD_M = (0.5, 1.4, 0.3), (0.6, 0.04, 0.04), (1.6, 0.5, 0.5)
"""A man and a monitor's upper edge before a level camera, and a board."""


def objection(plane: Plane, *patches: F64) -> str:
    return Moved.of(patches).objection(plane, FloorParams())


def test_wall_along_which_people_stand_is_no_floor():
    people = [patch((x, 0.2, 2.2), MAN_M, 900) for x in (-1.0, 0.0, 1.0)]
    assert objection(WALL_AHEAD, *people) == LIES
    assert objection(LEVEL_FLOOR, *people) == ""


def test_wall_towards_which_people_walk_is_no_floor():
    seated = [patch((0.1 * z, 0.2, z), (0.5, 0.7, 0.5), 900) for z in (1.2, 1.9, 2.6)]
    assert objection(WALL_AHEAD, *seated) == LIES
    assert objection(LEVEL_FLOOR, *seated) == ""


def test_flicker_above_people_does_not_outvote_a_man():
    flicker = [patch((0.1 * x, -2.0, 2.2), EDGE_M, 30) for x in range(100)]
    assert objection(LEVEL_FLOOR, patch((0.3, 0.2, 2.6), MAN_M, 900), *flicker) == ""


@pytest.mark.parametrize("points", [500, 2000])
def test_a_patch_counts_by_its_points(points):
    lying = [patch((0.5 * x, 0.3, 2.2), (0.4, 0.3, 1.2), 400) for x in (-1, 0, 1)]
    man = patch((0.0, 0.3, 2.2), MAN_M, points)
    assert objection(LEVEL_FLOOR, man, *lying) == (LIES if points < 1200 else "")


def test_copies_of_patches_change_nothing():
    patches = [patch((0, 0.3, 2.2), MAN_M, 900), *(patch((x, 0.3, 2.2), (0.4, 0.3, 1.2), 400) for x in (-0.5, 0.5))]
    once, thrice = (Moved.of(patches * times).floor_to_wall(LEVEL_FLOOR, FloorParams()) for times in (1, 3))
    assert once == pytest.approx(thrice)


@pytest.mark.parametrize("tilt_deg", [40, 58, 70])
def test_carried_board_does_not_speak_against_the_floor_of_a_camera_that_looks_down(tilt_deg):
    boards = [patch((x, 0.0, 3.0), BOARD_M, 900) for x in (-0.5, 0.0, 0.5)]
    assert objection(plane_at(tilt_deg, 2.6), *boards) == ""


def test_board_carried_about_below_an_overhead_camera_does_not_speak_against_the_floor():
    across = [patch((x, -1.0, 1.7), BOARD_M, 900) for x in (-1.0, 0.0, 1.0)]
    along = [patch((1.0, y, 1.7), (0.5, 1.6, 0.5), 900) for y in (-0.5, 0.5)]
    assert objection(BELOW, *across, *along) == ""


def test_thing_carried_across_a_straight_view_leaves_a_doubt():
    boards = [patch((x, 0.1, 1.7), BOARD_M, 900) for x in (-0.5, 0.0, 0.5)]
    assert "a wall in front of a level camera" in found(room(pose_of(0, 2.8)).clouds(people=False), boards).doubt


@pytest.mark.parametrize("tilt_deg", [88.5, 90, 91.5])
def test_floor_of_a_level_camera_is_found_where_people_walk_before_the_wall(tilt_deg):
    clouds = room(pose_of(tilt_deg, 1.3), (FLOOR, 0.0), (WALL, 6.0)).clouds(6, people=False)
    floor = found(clouds, moved=[PERSON])
    assert floor.height_m == pytest.approx(1.3, abs=0.03)
    assert floor.inlier_fraction < 0.35
    assert math.degrees(floor.tilt_rad) == pytest.approx(tilt_deg, abs=0.3)
    assert not floor.doubt
    alone = found(clouds)
    assert alone.height_m == pytest.approx(1.3, abs=0.03)
    assert "another plane would be the floor 6.0" in alone.doubt


def test_refusal_holds_the_world_that_accepts_the_best_plane(tmp_path):
    with pytest.raises(WorkError, match=r"0\.70 m") as e:
        found(room(pose_of(60, 0.7)).clouds(people=False))
    (tmp_path / "world.toml").write_text("world_SE3_left" + str(e.value).split("world_SE3_left")[1])
    assert load_world(tmp_path / "world.toml").height_m == pytest.approx(0.7, abs=0.01)


def test_floor_is_known_to_two_centimetres():
    floor = found(room(pose_of(45, 3.0)).clouds())
    assert 0 < math.sqrt(floor.covariance[0, 0]) < 0.02
    assert floor.residual_m < 0.1


def test_floor_has_the_extent_that_is_seen():
    floor = found(room(pose_of(45, 3.0), (FLOOR, 0.0, (-2, 2, 1.5, 6))).clouds())
    assert floor.extent_m[1] == pytest.approx(1.5, abs=0.2)


def test_floor_takes_the_floor_below_a_table_that_is_larger():
    clouds = room(pose_of(0, 3.0), (FLOOR, 0.0), (FLOOR, 0.75, (-1.0, 1.0, -0.5, 0.7))).clouds(people=False)
    assert found(clouds).height_m == pytest.approx(3.0, abs=0.02)


def test_upside_down_camera_is_named_where_its_floor_is_refused():
    turned = [cloud * np.array([-1, -1, 1], np.float32) for cloud in room(pose_of(60, 2.5)).clouds(people=False)]
    with pytest.raises(WorkError, match="upside-down"):
        found(turned)


LINE = np.column_stack([np.ones(1200), np.linspace(-1e5, 1e5, 1200), np.ones(1200)]).astype(np.float32)


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (np.random.default_rng(1).normal((0, 0, 5), 1, (20000, 3)), "no floor found"),
        (np.full((5000, 3), np.nan), "only 0 points"),
        (LINE, None),
    ],
    ids=["a ball of clutter", "no depth", "an upright line"],
)
def test_floor_refuses_clouds_that_show_none(cloud, said):
    with pytest.raises(WorkError, match=said):
        found([cloud])


@pytest.mark.parametrize("clouds", [[], np.ones((9, 3)), [np.ones((4, 5, 3))]], ids=["none", "one cloud", "images"])
def test_clouds_of_another_shape_are_refused(clouds):
    with pytest.raises(InputError, match=r"\(N, 3\) array of points per frame"):
        found(clouds)


@settings(max_examples=15)
@given(arrays(np.float32, (1200, 3), elements=st.floats(-100, 100, width=32)))
def test_floor_of_anything_is_a_floor_or_a_refusal(cloud):
    try:
        floor = found([cloud])
    except WorkError:
        return
    assert 0.8 <= floor.height_m <= 12.0


def test_floor_from_three_points_is_their_plane():
    pose = pose_of(40, 2.5, -3.0)
    points = pose.inverse() @ np.array([[0.0, 1.0, 0.0], [1.0, 3.0, 0.0], [-1.0, 4.0, 0.0]])
    floor = floor_from_points(points)
    assert floor.height_m == pytest.approx(2.5)
    assert math.degrees(floor.roll_rad) == pytest.approx(-3.0)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0, 1, 2], [1, 1, 2]], "three or more"),
        ([[0, 1, 2], [0, 1, 3], [0, 1, 4]], "one line"),
        ([[0, 1, 2], [1, 1, 3], [0, math.nan, 4]], "NaN"),
        ([[3, 1, 2], [3, 0, 5], [3, -1, 4]], "wall"),
    ],
)
def test_floor_from_points_refuses_what_is_no_floor(points, message):
    with pytest.raises(InputError, match=message):
        floor_from_points(points)


def test_floor_from_people_refines_a_rough_guess():
    rng, truth = np.random.default_rng(0), pose_of(50, 3.0, 1.0)
    xy, heights = rng.uniform((-2, 1), (2, 6), (60, 2)), np.repeat([1.62, 1.75, 1.9], 20)
    feet, heads = (
        truth.inverse() @ np.column_stack([xy, z]) + rng.normal(0, 0.03, (60, 3)) for z in (np.zeros(60), heights)
    )
    feet[::3] = np.nan
    floor = floor_from_people(PeopleSeen(np.repeat([1, 2, 3], 20), heads, feet), Floor(pose_of(46, 2.7)))
    assert floor.height_m == pytest.approx(3.0, abs=0.04)
    assert math.degrees(floor.tilt_rad) == pytest.approx(math.degrees(Floor(truth).tilt_rad), abs=0.5)


def test_floor_from_people_refuses_one_line_of_people():
    line = np.column_stack([np.linspace(-2, 2, 30), np.full(30, 3.0), np.zeros(30)])
    seen = PeopleSeen(np.ones(30, np.int64), np.full((30, 3), np.nan), pose_of(50, 3.0).inverse() @ line)
    with pytest.raises(WorkError, match="tilt or roll"):
        floor_from_people(seen, Floor(pose_of(50, 3.0)))


def test_world_file_keeps_every_digit(tmp_path):
    floor = Floor(pose_of(33, 2.345, 1.5), 0.4, 0.02, np.diag([1e-4, 2e-5, 3e-5]), (-1.0, 0.5, 2.0, 4.0))
    save_world(floor, tmp_path / "world.toml")
    read = load_world(tmp_path / "world.toml")
    np.testing.assert_array_equal(read.world_SE3_left.matrix, floor.world_SE3_left.matrix)
    np.testing.assert_array_equal(read.covariance, np.diag([1e-4, 2e-5, 3e-5]))
    assert (read.inlier_fraction, read.extent_m) == (0.4, (-1.0, 0.5, 2.0, 4.0))


POSE = "[world_SE3_left]\nrotation = [[1,0,0],[0,1,0],[0,0,{}]]\ntranslation_m = {}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "world_SE3_left"),
        ("world_SE3_left = 3", "expected a world.toml"),
        (POSE.format(1, "[0, 0, 2750]"), "found 2750 m .*wrong units"),
        (POSE.format(1, "[0, 0, 1e-9]"), "expected a camera .*found 1e-09 m"),
        (POSE.format(1, "[0, 0, -2]"), "expected a camera .*found -2 m"),
        (POSE.format(1, "[1e9, 0, 2]"), "origin"),
        (POSE.format(2, "[0, 0, 2]"), "rotation matrix"),
    ],
)
def test_world_file_refuses_what_is_no_camera_above_a_floor(tmp_path, text, message):
    (tmp_path / "world.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_world(tmp_path / "world.toml")


@pytest.mark.parametrize("people", [False, True])
def test_narrow_floor_of_a_level_camera_is_found_below_a_larger_ceiling(people):
    room = Room(pose_of(90.0, 1.0))
    room.add(FLOOR, 0.0)
    room.add(FLOOR, 2.6)
    room.add(WALL, 6.0)
    room.add(FLOOR, 0.6, (-9.0, -0.3, 0.0, 6.0))  # tables to both sides
    room.add(FLOOR, 0.6, (0.3, 9.0, 0.0, 6.0))
    measured = np.isfinite(room.depth)
    assert 0.02 < float(np.mean((room.world[:, 2] * room.depth)[measured] < -0.99)) < 0.12
    floor = found(room.clouds(people=people))
    assert floor.height_m == pytest.approx(1.0, abs=0.05)
    assert floor.tilt_rad == pytest.approx(math.pi / 2, abs=0.03)


@pytest.mark.parametrize("tilt_deg", [96.0, 99.0])
def test_floor_of_a_camera_that_looks_up_is_found_below_a_larger_ceiling(tilt_deg):
    shown = room(pose_of(tilt_deg, 1.0), (FLOOR, 0.0), (FLOOR, 2.6), (WALL, 7.0))
    z = (shown.world[:, 2] * shown.depth)[np.isfinite(shown.depth)]
    assert 0.08 < float(np.mean(z < -0.99)) < 0.17 < 0.28 < float(np.mean(z > 1.59))
    floor = found(shown.clouds(6, people=False), moved=[PERSON])
    assert floor.height_m == pytest.approx(1.0, abs=0.03)
    assert math.degrees(floor.tilt_rad) == pytest.approx(tilt_deg, abs=0.5)
