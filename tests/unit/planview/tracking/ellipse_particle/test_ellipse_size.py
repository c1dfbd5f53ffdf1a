"""Which sizes of people are learned from painted foreground, and told by a camera."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.tracking.ellipse_particle.fit import painted
from planview.tracking.ellipse_particle.size import Size, SizeLearner, log_density, size_of_camera

SPREAD = 0.17


def learned(frames: list[list[list[float]]], shape: tuple[int, int] = (100, 160)) -> tuple[Size, float] | None:
    """The size by frames of ellipses."""
    learner = SizeLearner(SPREAD)
    for people in frames:
        learner.add(painted(np.array(people), shape).any(axis=0) * np.uint8(255), None)
    return learner.size()


def half_in(found: tuple[Size, float] | None, row: float) -> float:
    assert found is not None
    return float(found[0].half_lengths(np.array(row)))


def test_size_is_that_of_one_person_where_people_hide_one_another():
    rng, frames = np.random.default_rng(0), []
    for _ in range(60):
        y = rng.uniform([30, 30, 15], [70, 70, 60])
        places = [(20.0, y[0]), (55.0, y[1]), (90.0, y[2]), (90.0, y[2] + rng.uniform(8, 14))]
        people = [[*place, a, 0.35 * a, 0.0] for place, a in zip(places, rng.normal(10, 0.8, 4), strict=True)]
        frames += [people, people]
    assert half_in(learned(frames), 45) == pytest.approx(10, rel=0.1)


def test_lengths_grow_with_the_rows():
    frames = [[[20.0 + 2 * k, 20.0 + k, 6 + 0.2 * k, 2 + 0.07 * k, 0]] for k in range(60)]
    found = learned(frames, (120, 160))
    for k in (5, 30, 55):
        assert half_in(found, 20.0 + k) == pytest.approx(6 + 0.2 * k, rel=0.1)


def test_large_person_from_whom_pieces_fall_is_one_person():
    rng, frames = np.random.default_rng(0), []
    for k in range(30):
        if k % 2 == 0:
            specks = np.column_stack([rng.uniform(5, 150, 10), rng.uniform(10, 90, 10)])
        frames.append([[30.0 + k, 50, 30, 10, 0], *([*s, 4, 2, 0] for s in specks)])
    found = learned(frames)
    assert half_in(found, 50) == pytest.approx(30, rel=0.2)
    assert found is not None
    assert found[1] > 0.6


def test_person_whom_the_border_always_cuts_is_one_person():
    learner = SizeLearner(SPREAD)
    for k in range(30):
        mask = np.zeros((100, 160), np.uint8)
        mask[10:, 20 + 2 * k : 55 + 2 * k] = 255
        learner.add(mask, None)
    assert 2 * half_in(learner.size(), 55) == pytest.approx(90, rel=0.1)


def walkers(angles_deg: np.ndarray, half: float) -> Size:
    """One walker after another, each at an angle of its own."""
    frames = [[[40.0 + 6 * step, 60, half, 0.5 * half, a]] for a in np.radians(angles_deg) for step in range(6)]
    found = learned(frames, (120, 160))
    assert found is not None
    return found[0]


def test_large_people_who_lie_in_all_directions_are_seen_from_above_and_of_one_size():
    size = walkers(np.arange(0.0, 180.0, 22.5), 30.0)
    assert not size.upright
    assert (size.slope, size.aspect) == (0.0, pytest.approx(0.5, rel=0.2))
    assert size.level == pytest.approx(30, rel=0.2)


@pytest.mark.parametrize(("angles_deg", "half"), [(np.zeros(8), 30.0), (np.arange(0.0, 180.0, 22.5), 7.0)])
def test_upright_or_small_people_are_upright_ellipses(angles_deg, half):
    assert walkers(angles_deg, half).upright


def test_what_does_not_move_teaches_no_size():
    learner, still = SizeLearner(SPREAD), np.zeros((60, 80), np.uint8)
    for _ in range(20):
        learner.add(painted(np.array([[40.0, 30, 15, 6, 0]]), (60, 80))[0] * np.uint8(255), still)
    assert learner.size() is None


def test_samples_stay_bounded():
    rng, learner = np.random.default_rng(0), SizeLearner(SPREAD)
    for k in range(2000):
        people = np.array([[40.0 + k % 60, 50, 15, 5, 0], [120.0, rng.uniform(45, 50), 15, 5, 0]])
        learner.add(painted(people, (100, 160)).any(axis=0) * np.uint8(255), None)
    assert half_in(learner.size(), 50) == pytest.approx(15, rel=0.1)


def test_density_of_lengths_is_largest_for_one_person():
    ratios, whole = np.array([1.0, 1.6, 0.4, 4.0]), np.zeros(4, np.bool_)
    one, *others = log_density(ratios, whole, SPREAD)
    assert one > max(others)
    # Who is cut by the border may be of any length up to one.
    cut = log_density(ratios, ~whole, SPREAD)
    assert cut[2] - cut[0] > others[1] - one


def test_camera_gives_the_length_of_an_adult_by_row():
    # 3 m above the floor at a tilt of 60 degrees: feet in some row are those of a head 1.7 m above them.
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(60.0))
    size = size_of_camera(camera)
    assert size is not None
    foot, head = camera.project(np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 1.7]]))[:, 1]
    assert 2 * size.half_lengths((foot + head) / 2) == pytest.approx(foot - head, rel=0.1)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(3.0, 10.0), (1.1, 85.0)])
def test_steep_or_low_camera_leaves_the_size_to_be_learned(height_m, tilt_deg):
    assert size_of_camera(GroundCamera(640, 480, 500.0, height_m, math.radians(tilt_deg))) is None


def test_size_on_a_grid_is_that_in_pixels_over_the_scale():
    size = Size(20.0, 0.1, 4.0, 0.4)
    cells = size.on(4.0)
    # Row 25 of cells of 4 px is centred in row 101.5 px.
    assert 4 * float(cells.half_lengths(np.array(25.0))) == pytest.approx(float(size.half_lengths(np.array(101.5))))
    assert size.on(0.5).on(2.0).level == pytest.approx(20.0)
