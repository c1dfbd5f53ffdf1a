"""Sensors of one place that agree on where people are, or do not."""

import math

import numpy as np
import pytest

from calib.floor_camera import FloorPinhole
from calib.pose import SE3
from calib.rig import world_from_plane
from calib.types import F64
from planview.checks.check import Check
from planview.checks.sensors import SensorsWatch, people_places
from planview.maps.plan_view import FloorPoints

MATRIX = np.array([[300.0, 0.0, 239.5], [0.0, 300.0, 179.5], [0.0, 0.0, 1.0]])
FROM_SOUTH = SE3(np.diag([-1.0, -1.0, 1.0]), np.array([0.0, 6.4, 0.0]))
TILT = math.radians(58.0)
NORTH_POSE = world_from_plane(np.array([0.0, -math.sin(TILT), -math.cos(TILT)]), 2.6)
AS_THEY_ARE = SE3(np.eye(3), np.zeros(3))


def camera(pose: SE3) -> FloorPinhole:
    return FloorPinhole((480, 360), MATRIX, pose)


def person(x_m: float, y_m: float, height_m: float = 1.75, side: float = -1.0) -> F64:
    """Points of the side of an upright body that is seen from the south (-1) or the north (1), 20 cm from its axis."""
    angles = np.linspace(0.0, side * math.pi, 20)
    levels = np.arange(0.05, height_m, 0.05)
    x, z = np.meshgrid(x_m + 0.2 * np.cos(angles), levels)
    y, _ = np.meshgrid(y_m + 0.2 * np.sin(angles), levels)
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def foreground(*bodies: F64) -> FloorPoints:
    xyz = np.concatenate(bodies).astype(np.float32)
    return FloorPoints(xyz, np.full(len(xyz), 1e-3, np.float32), np.arange(len(xyz), dtype=np.int32))


def walker_m(time_s: float) -> tuple[float, float]:
    """A walk along a curve at 1.2 m/s, where both sensors look."""
    return 1.2 * math.sin(0.9 * time_s), 3.2 + 0.6 * math.cos(1.1 * time_s)


SOUTH_POSE = FROM_SOUTH @ NORTH_POSE


def watch(south: SE3 = SOUTH_POSE) -> SensorsWatch:
    return SensorsWatch({"north": camera(NORTH_POSE), "south": camera(south)})


def walk(watched: SensorsWatch, late_s: float = 0.0, moved: SE3 = AS_THEY_ARE, seconds: float = 6.0) -> None:
    """Both sensors see a walker from their side; the clock of the second is late, and its pose is moved."""
    for time_s in np.arange(0.0, seconds, 0.2):
        north = person(*walker_m(time_s))
        south = moved @ person(*walker_m(time_s - late_s), side=1.0)
        watched.update(time_s, [foreground(north), foreground(south)])


def disagreement(late_s: float = 0.0, moved: SE3 = AS_THEY_ARE) -> Check:
    watched = watch(moved @ SOUTH_POSE)
    walk(watched, late_s, moved)
    (check,) = watched.checks()
    return check


def turned(degrees: float, shift_m: tuple[float, float] = (0.0, 0.0)) -> SE3:
    """A turn about the south sensor, and a shift."""
    turn = SE3.from_rotvec([0.0, 0.0, math.radians(degrees)], [0.0, 0.0, 0.0])
    about = np.array([0.0, 6.4, 0.0])
    return SE3(turn.rotation, about - turn.rotation @ about + np.array([*shift_m, 0.0]))


def test_people_are_where_their_sensors_are():
    places = people_places(foreground(person(0.0, 3.0), person(1.2, 3.0, 1.6)), np.array([0.0, 0.0, 2.6]))
    np.testing.assert_allclose(places, [[0.0, 3.0, 1.7], [1.2, 3.0, 1.55]], atol=0.06)


def test_things_lower_than_a_person_are_nobody():
    assert len(people_places(foreground(person(0.0, 3.0, 0.8)), np.zeros(3))) == 0


def test_sensors_that_agree_are_silent():
    check = disagreement()
    assert check.ok
    assert check.value < 0.1


@pytest.mark.parametrize("late_s", [1.0, -0.4])
def test_clock_that_is_wrong_sets_people_apart(late_s):
    check = disagreement(late_s)
    assert check.warns
    assert not check.ok


@pytest.mark.parametrize("moved", [turned(0.0, (0.0, -0.5)), turned(0.0, (0.6, 0.0)), turned(8.0)])
def test_pose_that_is_wrong_sets_people_apart(moved):
    assert not disagreement(moved=moved).ok


def test_sensors_that_see_different_people_in_different_places_say_nothing():
    watched = watch()
    for time_s in np.arange(0.0, 6.0, 0.2):
        x_m = 0.3 * time_s - 1.0
        watched.update(time_s, [foreground(person(x_m, 1.0)), foreground(person(x_m, 5.4))])
    (check,) = watched.checks()
    assert check.ok
    assert math.isnan(check.value)


def test_two_people_side_by_side_of_whom_one_is_hidden_from_one_sensor_are_no_disagreement():
    watched = watch()
    for time_s in np.arange(0.0, 6.0, 0.2):
        x_m, y_m = walker_m(time_s)
        both = foreground(person(x_m, y_m), person(x_m + 0.8, y_m))
        watched.update(time_s, [both, foreground(person(x_m, y_m, side=1.0))])
    assert watched.checks()[0].ok


def test_comparison_goes_on_from_a_checkpoint():
    before, after = watch(), watch()
    walk(before, 1.0, seconds=3.0)
    after.set_state(before.state())
    assert after.checks()[0].value == before.checks()[0].value
