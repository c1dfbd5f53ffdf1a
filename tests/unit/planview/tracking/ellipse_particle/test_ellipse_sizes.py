"""Which sizes of people are learned from painted foreground, and told by a camera."""

import math

import numpy as np
import pytest

from calib.ground_camera import GroundCamera
from planview.tracking.ellipse_particle.camera_size import size_of_camera
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.image_grid import columns_for
from planview.tracking.ellipse_particle.size_learning import ASPECT, SizeLearner, likely_aspect
from planview.tracking.ellipse_particle.size_lines import STEEPEST, line, lines, log_density, over_centres
from planview.tracking.ellipse_particle.size_samples import lasted_s, weights


def test_size_is_that_of_one_person_where_people_hide_one_another():
    rng, learner = np.random.default_rng(0), SizeLearner(60.0)
    for frame in range(60):
        y = rng.uniform([30, 30, 15], [70, 70, 60])
        behind = y[2] + rng.uniform(8, 14)
        places = [(20.0, y[0]), (55.0, y[1]), (90.0, y[2]), (90.0, behind)]
        people = np.array([[*place, a, 0.35 * a, 0.0] for place, a in zip(places, rng.normal(10, 0.8, 4), strict=True)])
        for moment in (frame, frame + 0.5):
            belief = learner.update(paint_union(people, (100, 120)).astype(np.float32), moment / 10)
    assert belief is not None
    assert belief.prior.half_length(45) == pytest.approx(10, rel=0.1)


def test_large_person_who_falls_to_pieces_is_one_person():
    rng, learner = np.random.default_rng(0), SizeLearner(60.0)
    for frame in range(30):
        # One body of 60 cells with a gap at the waist, and ten specks that fall off it, each for two frames.
        if frame % 2 == 0:
            specks = np.column_stack([rng.uniform(5, 110, 10), rng.uniform(10, 90, 10)])
        body = [[30.0 + frame, y, 14.5, 10, 0] for y in (35, 65)]
        people = np.array([*body, *([*s, 4, 2, 0] for s in specks)])
        belief = learner.update(paint_union(people, (100, 120)).astype(np.float32), frame / 10)
    assert belief is not None
    assert belief.prior.half_length(50) == pytest.approx(30, rel=0.2)
    assert belief.confidence > 0.6


def test_size_that_explains_most_is_kept_when_people_fall_to_pieces():
    rng, learner, sizes = np.random.default_rng(0), SizeLearner(60.0), []
    for frame in range(120):
        # A person of 60 cells, 40 frames long; then a second one from whom the frame's noise leaves only pieces too.
        people = [[30.0 + frame / 2, 50, 30, 12, 0]]
        if frame >= 40:
            people += [[130.0 + rng.uniform(-3, 3), y, 7, 4, 0] for y in (25, 45, 65, 85)]
        belief = learner.update(paint_union(np.array(people), (100, 160)).astype(np.float32), frame / 10)
        sizes += [belief.prior.half_length(50)] if belief else []
    assert sizes == pytest.approx([30] * len(sizes), rel=0.15)


def test_person_whom_the_border_always_cuts_is_one_person():
    learner = SizeLearner(60.0)
    for frame in range(30):
        mask = np.zeros((100, 160), np.float32)
        mask[10:, 20 + 2 * frame : 55 + 2 * frame] = 1
        belief = learner.update(mask, frame / 10)
    assert belief is not None
    assert 2 * belief.prior.half_length(55) == pytest.approx(90, rel=0.1)


def belief_of_walkers(angles_deg: np.ndarray, half_length: float, growth: float = 0.0) -> SizePrior:
    """One walker after another across a grid of 120 x 160 cells, each at an angle of its own, larger in lower rows."""
    learner, frame = SizeLearner(60.0), 0
    for k, angle in enumerate(np.radians(angles_deg)):
        row = 65.0 if k % 4 < 2 else 55.0
        half = half_length + growth * (row - 60.0)
        for step in range(6):
            ellipse = np.array([[60.0 + 6 * step, row, half, 0.5 * half, angle]])
            learner.update(paint_union(ellipse, (120, 160)).astype(np.float32), frame / 10)
            frame += 1
    assert learner.belief is not None
    return learner.belief.prior


def test_large_people_who_lie_in_all_directions_are_seen_from_above():
    prior = belief_of_walkers(np.arange(0.0, 180.0, 22.5), 38.0)
    assert prior.any_direction
    assert prior.half_length(60) == pytest.approx(38, rel=0.2)
    assert prior.aspect == pytest.approx(0.5, rel=0.2)


def test_from_above_people_are_of_one_size_in_all_rows():
    prior = belief_of_walkers(np.arange(0.0, 180.0, 22.5), 38.0, growth=0.8)
    assert prior.any_direction
    assert prior.half_length_slope == 0.0


@pytest.mark.parametrize(("angles_deg", "half_length"), [(np.zeros(8), 38.0), (np.arange(0.0, 180.0, 22.5), 12.0)])
def test_upright_or_small_people_are_upright_ellipses(angles_deg, half_length):
    assert not belief_of_walkers(angles_deg, half_length).any_direction


def test_circles_have_the_area_of_their_ellipses():
    prior = SizePrior(20.0, 0.1, 0.25)
    assert prior.rounded().half_length(50) ** 2 == pytest.approx(0.25 * prior.half_length(50) ** 2)


def test_what_does_not_move_teaches_no_size():
    learner, mask = SizeLearner(60.0), paint_union(np.array([[40.0, 30, 15, 6, 0]]), (60, 80)).astype(np.float32)
    for frame in range(20):
        assert learner.update(mask, frame / 10, np.zeros(mask.shape, np.bool_)) is None


def test_camera_gives_the_length_of_an_adult_by_row():
    # 3 m above the floor at a tilt of 60 degrees: feet in some row are those of a head 1.7 m above them.
    camera = GroundCamera(640, 480, 500.0, 3.0, math.radians(60.0))
    prior = size_of_camera(camera, 4.0, 0.36)
    assert prior is not None
    foot, head = camera.project(np.array([[0.0, 5.0, 0.0], [0.0, 5.0, 1.7]]))[:, 1]
    centre = ((foot + head) / 2 - 1.5) / 4.0
    assert 2 * prior.half_length(centre) * 4.0 == pytest.approx(foot - head, rel=0.1)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(3.0, 10.0), (1.1, 85.0)])
def test_steep_or_low_camera_leaves_the_size_to_be_learned(height_m, tilt_deg):
    assert size_of_camera(GroundCamera(640, 480, 500.0, height_m, math.radians(tilt_deg)), 4.0, 0.36) is None


def test_density_of_lengths_is_largest_for_one_person_and_group_beats_speck():
    expected, width = np.full(4, 20.0), np.full(4, 7.0)
    one, group, piece, odd = log_density(
        np.array([20.0, 32, 8, 80]), width, expected, np.zeros(4, np.bool_), np.zeros(4)
    )
    assert one > piece > odd
    assert one > group > odd


def test_what_lasts_is_the_less_a_piece_the_longer_it_lasts():
    lengths, uncut = np.full(3, 8.0), np.zeros(3, np.bool_)
    brief, second, long = log_density(lengths, np.full(3, 3.0), np.full(3, 20.0), uncut, np.array([0.2, 1.0, 5.0]))
    assert brief == second > long


def test_tracks_last_from_their_first_to_their_last_whole_region():
    # Columns: CUT is 4, TRACK 8, TIME_S 9.
    samples = np.zeros((5, 10))
    samples[:, 8] = [7, 7, 7, 9, 9]
    samples[:, 9] = [0.0, 2.0, 5.0, 1.0, 3.0]
    samples[:, 4] = [0, 0, 1, 1, 1]
    np.testing.assert_array_equal(lasted_s(samples), [2, 2, 2, 0, 0])


def test_one_who_walks_alone_is_a_person_beside_two_who_walk_as_one():
    # A pair in depth, twice as long as one person, crosses the view; then one person alone.
    learner = SizeLearner(60.0)
    for frame in range(80):
        half, row = (22.0, 45.0) if frame < 40 else (11.0, 60.0)
        mask = paint_union(np.array([[20.0 + frame % 40 * 3, row, half, 0.35 * half, 0]]), (100, 160))
        learner.collect(mask.astype(np.float32), frame / 10)
    belief = learner.learn(100)
    assert belief is not None
    assert belief.prior.half_length(60) == pytest.approx(11, rel=0.15)


def test_people_at_all_distances_are_as_broad_as_they_are_long_and_those_without_legs_are_not():
    # Heads in one row: four people at four distances, or one of whom less and less of the legs shows.
    length, uncut = np.array([20.0, 30, 40, 50]), np.zeros(4, np.bool_)
    farther, legless = (
        log_density(length, width, length, uncut, np.zeros(4)) for width in (0.3 * length, np.full(4, 12.0))
    )
    assert farther.sum() > legless.sum()


def test_line_over_the_feet_is_one_over_the_centres():
    # Length 10 in row 0 of the feet, half a row longer per row: a person with feet in row 40 is 30 long, centred in 25.
    level, slope = over_centres(10.0, 0.5)
    assert level + slope * 25 == pytest.approx(30)
    prior = SizePrior(level / 2, slope / 2, 0.36)
    assert 2 * prior.half_lengths_standing(np.array([40.0])) == pytest.approx([30])


def test_lines_rise_through_whole_people_only():
    foot, length, cut = np.array([20.0, 40, 60]), np.array([10.0, 20, 60]), np.array([False, False, True])
    levels, slopes = lines(foot, length, cut, 100)
    assert sorted(zip(slopes, levels, strict=True)) == [(0, 10), (0, 20), (0, 60), (0.5, 0)]


def test_line_is_no_steeper_than_that_of_a_low_camera():
    foot = np.array([10.0, 20, 30])
    assert line(foot, 3 * foot, np.ones(3), True) == pytest.approx((60 - 20 * STEEPEST, STEEPEST))


def test_people_who_walk_up_to_a_low_camera_are_one_size_each_at_every_distance():
    learner = SizeLearner(60.0)
    for frame in range(30):
        # A camera at eye height: heads stay in row 30, and feet go down as the person comes near.
        half = 12.0 + frame
        mask = paint_union(np.array([[60.0, 30 + half, half, 0.3 * half, 0]]), (140, 120)).astype(np.float32)
        learner.update(mask, frame / 10)
    assert learner.belief is not None
    for half in (15.0, 25.0, 38.0):
        assert learner.belief.prior.half_length(30 + half) == pytest.approx(half, rel=0.15)


def test_samples_that_are_alike_share_their_weight():
    samples = np.array([[30.0, 20, 7, 100, 0]] * 4 + [[60, 30, 9, 100, 0]])
    each, other = weights(samples)[[0, 4]]
    assert other == pytest.approx(2 * each)


@pytest.mark.parametrize(("cells", "expected"), [(100.0, 0.6), (0.01, ASPECT)])
def test_breadth_is_the_measured_one_of_large_people_and_the_usual_one_of_small_ones(cells, expected):
    assert likely_aspect(0.6, cells) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("cells", "columns"), [(40, 160), (11, 320), (2, 320), (20, 176), (80, 80), (4000, 24)])
def test_grid_is_as_fine_as_people_are_small_within_bounds(cells, columns):
    assert columns_for(cells, 160) == columns


@pytest.mark.parametrize(("learn_s", "settled"), [(60.0, False), (0.9, True)])
def test_size_is_settled_once_nothing_more_is_learned(learn_s, settled):
    learner = SizeLearner(learn_s)
    for frame in range(20):
        mask = paint_union(np.array([[20.0 + frame, 40, 15, 6, 0]]), (80, 120)).astype(np.float32)
        learner.update(mask, frame / 10)
    assert learner.settled is settled
