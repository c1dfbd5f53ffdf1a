"""Parts of the ellipse tracker."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.tracking.ellipse_particle.fit import fit_ellipses, inside, own_gains, paint, slopes
from planview.tracking.ellipse_particle.particles import (
    ANGLE,
    LN_A,
    VX,
    ParticleFilter,
    X,
    Y,
    ellipses_of,
    overlap_areas,
)
from planview.tracking.ellipse_particle.size import Size, SizeLearner, size_of_camera

FIT_SHAPE = (80, 120)
FIT_SIZE = Size(12.0, 0.0, 1.0, 0.4)


def mask_of(*ellipses: tuple[float, ...]) -> np.ndarray:
    return paint(np.array(ellipses, np.float64), FIT_SHAPE).any(axis=0).astype(np.float32)


@pytest.mark.parametrize(
    ("ellipse", "size", "within"),
    [((40.0, 35, 12, 5, 0.1), FIT_SIZE, 0.6), ((60.0, 40, 20, 10, 1.3), Size(20.0, 0.0, 1.0, 0.5, upright=False), 1.0)],
    ids=["upright", "across, from above"],
)
def test_fit_finds_one_ellipse_where_it_was_painted(ellipse, size, within):
    found = fit_ellipses(mask_of(ellipse), size)
    assert len(found) == 1
    np.testing.assert_allclose(found[0], ellipse, atol=within)


@pytest.mark.parametrize(("hidden", "within"), [(slice(33, 37), 1.0), (slice(40, None), 3.0)], ids=["a pole", "legs"])
def test_fit_gives_one_ellipse_of_full_size_to_whom_something_hides_in_part(hidden, within):
    mask = mask_of((40.0, 35, 12, 4.8, 0.0))
    mask[hidden] = 0
    (found,) = fit_ellipses(mask, FIT_SIZE)
    assert found[:2] == pytest.approx([40, 35], abs=within) and found[2] == pytest.approx(12, rel=0.2)


def test_fit_explains_a_merged_region_by_two_ellipses():
    found = fit_ellipses(mask_of((40.0, 35, 12, 4.8, 0.0), (46, 38, 12, 4.8, 0.0)), FIT_SIZE)
    assert len(found) == 2
    np.testing.assert_allclose(np.sort(found[:, 0]), [40, 46], atol=1.5)


def test_fit_ignores_what_is_no_person():
    for mask in (np.zeros(FIT_SHAPE, np.float32), mask_of((40.0, 35, 3, 2, 0.0)), mask_of((40.0, 43, 5, 3, 0.0))):
        assert len(fit_ellipses(mask, FIT_SIZE)) == 0


def test_fit_follows_the_size_that_is_expected_in_a_row():
    size = Size(5.0, 0.2, 1.0, 0.4)  # half length 8 in row 15, 17 in row 60
    found = fit_ellipses(mask_of((30.0, 15, 8, 3.2, 0.0), (80, 60, 17, 6.8, 0.0)), size)
    np.testing.assert_allclose(found[np.argsort(found[:, 1]), 2], [8, 17], rtol=0.1)


def test_gain_is_the_share_of_foreground_less_background_outside_the_others():
    one, twin = (40.0, 35, 12, 4.8, 0.0), (40.0, 35, 12, 4.8, 0.0)
    mask = mask_of(one)
    assert own_gains(mask, np.array([one])) == pytest.approx([1.0])
    assert own_gains(0 * mask, np.array([one])) == pytest.approx([-0.4])
    assert own_gains(mask, np.array([one, twin])) == pytest.approx([0.0, 0.0])


SHAPE = (60, 80)
SIZE = Size(10.0, 0.0, 1.0, 0.4)
AREA = math.pi * 10 * 4
NOBODY = np.zeros(SHAPE, np.uint8)


def union(*places: tuple[float, float]) -> np.ndarray:
    return paint(np.array([[*place, 10.0, 4.0, 0.0] for place in places]), SHAPE).any(axis=0).view(np.uint8)


PER_M = float(SIZE.cells_per_m(np.array(25.0)))


def filter_at(*places: tuple[float, float], speed: float = 1.0) -> ParticleFilter:
    """Objects around ellipses of the expected size."""
    particles = ParticleFilter(2000, speed, np.random.default_rng(0))
    for place in places:
        particles.add(np.array([*place, 10.0, 4.0, 0.0]), SIZE)
    return particles


def test_new_object_may_walk_anywhere_from_where_it_was_measured():
    (state,) = filter_at((30.0, 25.0)).particles.mean(axis=0)
    assert state[[X, Y]] == pytest.approx([30, 25], abs=0.1)
    assert filter_at((30.0, 25.0)).particles[..., VX].std() == pytest.approx(PER_M, rel=0.1)


def test_prediction_spreads_with_the_acceleration():
    particles = filter_at((30.0, 25.0), speed=1e-6)
    particles.particles[..., VX] = 10.0
    particles.predict(0.5, SIZE, np.array([PER_M]))
    # Half of 2 m/s^2 over 0.5 s, squared, is 0.25 m; with a jitter of 0.03 m and 0.4 cells of the start.
    assert particles.particles[..., X].mean() == pytest.approx(35, abs=0.3)
    assert particles.particles[..., X].std() == pytest.approx(math.hypot(0.25 * PER_M, 0.03 * PER_M, 0.4), rel=0.1)


def test_size_returns_to_what_is_expected():
    particles = filter_at((30.0, 25.0))
    particles.particles[..., LN_A : ANGLE + 1] = 0.3
    particles.predict(1.0, SIZE, np.array([PER_M]))
    assert particles.particles[..., LN_A].mean() == pytest.approx(0.3 / math.e, abs=0.02)


def test_weighing_draws_an_object_to_its_measurement():
    particles = filter_at((30.0, 25.0))
    particles.predict(0.2, SIZE, np.array([PER_M]))
    state = particles.weigh(0, union((33.0, 26.0)), NOBODY, SIZE, AREA)
    assert state[[X, Y]] == pytest.approx([33, 26], abs=0.7)


def test_weighing_does_not_draw_an_object_to_what_others_cover():
    particles = filter_at((30.0, 25.0))
    particles.predict(0.2, SIZE, np.array([PER_M]))
    free = particles.weigh(0, union((36.0, 25.0), (27.0, 25.0)), union((36.0, 25.0)), SIZE, AREA)
    assert free[X] < 33


def test_objects_outside_every_measurement_are_unlikely():
    particles = filter_at((30.0, 25.0))
    particles.particles[:1000, 0, X], particles.particles[1000:, 0, X] = 30.0, 60.0
    # Both halves cover as much of what is left, nothing; those in the measured area of the other cost nothing.
    particles.weigh(0, union((30.0, 25.0)), union((30.0, 25.0)), SIZE, AREA)
    assert (particles.particles[:, 0, X] < 45).mean() > 0.99


def test_kept_objects_keep_their_particles_whose_ellipses_differ_from_the_expected_size():
    particles = filter_at((10.0, 25.0), (30.0, 25.0), (50.0, 25.0))
    particles.keep(np.array([0, 2]))
    assert particles.particles[..., X].mean(axis=0) == pytest.approx([10, 50], abs=0.2)
    state = np.array([[30.0, 20, 0, 0, math.log(1.2), 0.0, 0.1]])
    np.testing.assert_allclose(ellipses_of(state, SIZE), [[30, 20, 12, 4, 0.1]])


def learned(frames: list[list[list[float]]], shape: tuple[int, int] = (100, 160)) -> tuple[Size, float] | None:
    """The size by frames of ellipses."""
    learner = SizeLearner()
    for people in frames:
        learner.add(paint(np.array(people), shape).any(axis=0) * np.uint8(255), None)
    return learner.size(shape[1])


def half_in(found: tuple[Size, float] | None, row: float) -> float:
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
    assert half_in(found, 50) == pytest.approx(30, rel=0.2) and found[1] > 0.6


def test_person_whom_the_border_always_cuts_is_one_person():
    learner = SizeLearner()
    for k in range(30):
        mask = np.zeros((100, 160), np.uint8)
        mask[10:, 20 + 2 * k : 55 + 2 * k] = 255
        learner.add(mask, None)
    assert 2 * half_in(learner.size(160), 55) == pytest.approx(90, rel=0.1)


def walkers(angles_deg: np.ndarray, half: float) -> Size:
    """One walker after another, each at an angle of its own."""
    frames = [[[40.0 + 6 * step, 60, half, 0.5 * half, a]] for a in np.radians(angles_deg) for step in range(6)]
    return learned(frames, (120, 160))[0]


def test_large_people_who_lie_in_all_directions_are_seen_from_above():
    size = walkers(np.arange(0.0, 180.0, 22.5), 30.0)
    assert not size.upright and (size.slope, size.aspect) == (0.0, pytest.approx(0.5, rel=0.2))
    assert size.level == pytest.approx(30, rel=0.2)


@pytest.mark.parametrize(("angles_deg", "half"), [(np.zeros(8), 30.0), (np.arange(0.0, 180.0, 22.5), 7.0)])
def test_upright_or_small_people_are_upright_ellipses(angles_deg, half):
    assert walkers(angles_deg, half).upright


def test_what_does_not_move_teaches_no_size():
    learner, still = SizeLearner(), np.zeros((60, 80), np.uint8)
    for _ in range(20):
        learner.add(paint(np.array([[40.0, 30, 15, 6, 0]]), (60, 80))[0] * np.uint8(255), still)
    assert learner.size(80) is None


def test_samples_stay_bounded():
    rng, learner = np.random.default_rng(0), SizeLearner()
    for k in range(2000):
        people = np.array([[40.0 + k % 60, 50, 15, 5, 0], [120.0, rng.uniform(45, 50), 15, 5, 0]])
        learner.add(paint(people, (100, 160)).any(axis=0) * np.uint8(255), None)
    assert half_in(learner.size(160), 50) == pytest.approx(15, rel=0.1)


def test_camera_gives_the_length_of_an_adult_by_row():
    # 3 m above the floor at a tilt of 60 degrees: feet in some row are those of a head 1.7 m above them.
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(60.0))
    size = size_of_camera(camera)
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


def test_overlap_of_an_ellipse_is_its_area_inside_a_mask():
    upper, quarter = np.zeros((2, 60, 60), np.bool_)
    upper[:30] = quarter[30:, :30] = True
    ellipses = np.array([[29.5, 29.5, 20, 10, 0.2], [29.5, 29.5, 20, 10, 0.0], [-0.5, 20, 10, 10, 0.0]])
    covered = overlap_areas(ellipses, [upper, quarter])
    # Half of the last one is beyond the border of the grid.
    assert covered[0] == pytest.approx(math.pi * np.array([100, 100, 50]), rel=0.05)
    assert covered[1, 1:] == pytest.approx(math.pi * np.array([50, 0]), rel=0.05)


def test_slopes_are_the_derivatives_of_the_soft_inside():
    ellipse, window = np.array([30.0, 30, 13, 5, 0.05]), (slice(0, 60), slice(0, 60))
    found = slopes(ellipse, inside(ellipse, window), window)
    for k, step in enumerate(1e-5 * np.eye(5)):
        ends = [ellipse + side * step * np.array([1, 1, 13, 5, 1]) for side in (-1, 1)]
        change = (inside(ends[1], window) - inside(ends[0], window)) / 2e-5
        # The width of the soft edge is that of the ellipse, which the derivatives take as fixed.
        assert np.abs(found[k] - change).max() < (0.05 if k != 3 else 1.0)
