"""The particle filter, existence, groups and size learning, on numbers that can be checked by hand."""

import math

import numpy as np
import pytest

from planview.tracking.ellipse_particle.existence import ExistenceEvidence, departure, spawn_log_odds
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.groups import group, overlaps
from planview.tracking.ellipse_particle.params import ExistenceParams, ParticleFilterParams
from planview.tracking.ellipse_particle.particles import ParticleFilter, ellipses_of, normalised, union_prefix
from planview.tracking.ellipse_particle.regions import LEAN, MAJOR, MINOR, TIME_S, TRACK, RegionPairs
from planview.tracking.ellipse_particle.size_learning import SizeLearner
from planview.tracking.ellipse_particle.size_lines import line
from planview.tracking.lifecycle import Existence

PRIOR = SizePrior(12.0, 0.0, 0.4)
SHAPE = (60, 120)
UPRIGHT = PlaneModel(0.1, 0.35, math.radians(5), 0.0, 0.5, 1.0)
PARAMS = ExistenceParams()
HERE = np.array([40.0, 30, 12, 4.8, 0.0])


def filter_with(*ellipses: np.ndarray, plane: PlaneModel = UPRIGHT, **params: object) -> ParticleFilter:
    particles = ParticleFilter(ParticleFilterParams(**params), plane, np.random.default_rng(0))
    for ellipse in ellipses:
        particles.add(ellipse, PRIOR, 14.0, np.zeros(2))
    return particles


def test_prediction_moves_particles_by_their_velocity():
    particles = filter_with(HERE)
    particles.particles[:, 0, 2:4] = [20.0, -10.0]
    before = particles.means()[0, :2]
    particles.predict(0.5, np.array([14.0]))
    np.testing.assert_allclose(particles.means()[0, :2] - before, [10, -5], atol=0.5)


def test_predicted_ellipses_lean_no_more_than_measured_ones():
    particles = filter_with(HERE)
    particles.particles[:, 0, 6] = 1.0
    particles.predict(0.1, np.array([14.0]))
    assert particles.means()[0, 6] == pytest.approx(UPRIGHT.angle_limit)


@pytest.mark.parametrize("looseness", [1.0, 3.0])
def test_lengths_spread_as_loosely_as_people_of_all_distances_differ_and_widths_with_them(looseness):
    particles = filter_with(HERE, plane=UPRIGHT._replace(looseness=looseness))
    particles.predict(100.0, np.array([14.0]))
    length, width = particles.particles[:, 0, 4:6].T
    assert length.std() == pytest.approx(0.08 * looseness, rel=0.1)
    assert (width - length).std() == pytest.approx(0.08 * math.sqrt(2), rel=0.1)


def test_likelihood_is_largest_where_ellipses_cover_the_measurement():
    particles = filter_with(HERE)
    particles.particles[:] = [40.0, 30, 0, 0, 0, 0, 0]
    particles.particles[0, 0, 0] = 44.0  # shifted along the row
    particles.particles[1, 0, 0] = 80.0  # elsewhere
    log_likelihood = particles.weigh(np.array([0]), union_prefix(HERE[None], SHAPE), PRIOR, math.pi * 12 * 4.8)
    assert log_likelihood[2] > log_likelihood[0] > log_likelihood[1]
    # Elsewhere all of the measurement is missed and all of the ellipse outside: two Gaussians of 1 / 0.12 deviations.
    # Areas are right to 3 %, their squares to 6 %.
    assert log_likelihood[1] == pytest.approx(-((1 / 0.12) ** 2), rel=0.06)


def test_outside_weight_zero_is_the_equation_of_the_paper():
    # One measurement, two objects: equation (8) lets the second be anywhere once the first covers all.
    second = HERE + np.array([50.0, 0, 0, 0, 0])
    args = (np.array([0, 1]), union_prefix(HERE[None], SHAPE), PRIOR, math.pi * 12 * 4.8)
    papers = filter_with(HERE, second, plane=UPRIGHT._replace(outside_weight=0.0)).weigh(*args)
    ours = filter_with(HERE, second).weigh(*args)
    assert papers.max() > -0.5
    # One object's area outside, at a deviation of 0.12 sqrt(2) areas, is 17.4; small differences of size add to it.
    assert -30 < np.median(ours) < -17


def test_resampling_copies_particles_in_proportion_to_their_weights():
    particles = filter_with(HERE)
    weights = np.full(1000, 1e-12)
    weights[10], weights[20] = 0.75, 0.25
    index = particles.resample(np.array([0]), weights / weights.sum())
    assert set(index) == {10, 20}
    assert (index == 10).mean() == pytest.approx(0.75, abs=0.05)


def test_resampling_one_group_leaves_the_others():
    particles = filter_with(HERE, HERE)
    before = particles.particles[:, 1].copy()
    particles.resample(np.array([0]), normalised(np.linspace(-50, 0, 1000)))
    np.testing.assert_array_equal(particles.particles[:, 1], before)


def test_map_estimate_takes_a_mode_and_not_the_mean_of_two():
    particles = filter_with(HERE)
    particles.particles[:] = [40.0, 30, 0, 0, 0, 0, 0]
    particles.particles[:400, 0, 0] = 60.0
    likelihood = np.where(np.arange(1000) < 400, -0.1, 0.0)
    state = particles.estimate(np.array([0]), likelihood, np.array([2.0]), normalised(likelihood))
    assert state[0, 0] == pytest.approx(40.0)


def test_partition_brings_each_object_of_a_group_to_its_own_measurement():
    second = HERE + np.array([14.0, 0, 0, 0, 0])
    particles = filter_with(HERE + np.array([-3.0, 0, 0, 0, 0]), second + np.array([3.0, 0, 0, 0, 0]))
    particles.particles[..., :2] += np.random.default_rng(1).normal(0, 4, (1000, 2, 2))
    members, measured = np.array([0, 1]), np.array([HERE, second])
    particles.partition(members, measured, particles.means(), SHAPE, PRIOR, math.pi * 12 * 4.8)
    np.testing.assert_allclose(particles.means()[:, 0], [40, 54], atol=1.5)


def test_ellipses_of_states_follow_the_size_prior():
    states = np.array([[10.0, 50, 0, 0, math.log(1.1), 0, 0.2]])
    np.testing.assert_allclose(ellipses_of(states, SizePrior(2.0, 0.1, 0.5))[0], [10, 50, 7.7, 3.5, 0.2])


def test_groups_join_objects_that_share_a_measurement():
    objects = np.eye(3, dtype=bool)
    measured = np.array([[True, False], [True, False], [False, True]])
    found = group(objects, measured, joint=False)
    assert [(m.tolist(), z.tolist()) for m, z in found] == [([0, 1], [0]), ([2], [1])]
    assert [(m.tolist(), z.tolist()) for m, z in group(objects, measured, joint=True)] == [([0, 1, 2], [0, 1])]


def test_overlaps_grow_with_the_margin():
    far = HERE + np.array([20.0, 0, 0, 0, 0])
    assert not overlaps(HERE[None], far[None], np.zeros((1, 2)))[0, 0]
    assert overlaps(HERE[None], far[None], np.array([[15.0, 0]]))[0, 0]


def new(fill: float = 0.5, candidates: int = 1) -> ExistenceEvidence:
    return ExistenceEvidence(Existence(1, 0.0, 0.0), (0, 0), spawn_log_odds(fill, candidates, PARAMS))


def confirmed() -> ExistenceEvidence:
    evidence = new()
    evidence.who.confirmed = True
    return evidence


def follow(
    evidence: ExistenceEvidence, times: int, measured: bool = True, own: bool = True, confirmable: bool = True
) -> None:
    for _ in range(times):
        evidence.update(measured, own, 0.1, confirmable, PARAMS)


def test_repeated_measurements_speak_for_a_new_object():
    evidence = new()
    assert evidence.probability == pytest.approx(0.1 / 0.3)  # one entry for two false alarms
    follow(evidence, 1)
    assert evidence.probability < PARAMS.confirm_probability
    follow(evidence, 1)
    # 0.5 (0.85 / 0.4)^2 = 2.26 to 1; a third one confirms it, 4.8 to 1
    assert evidence.probability == pytest.approx(2.2578125 / 3.2578125)
    follow(evidence, 1)
    assert evidence.probability > PARAMS.confirm_probability


def test_what_may_be_a_piece_of_another_is_a_person_no_sooner_than_it_is_seen_apart():
    evidence = new()
    follow(evidence, 20, confirmable=False)
    assert evidence.probability == new().probability
    follow(evidence, 3)
    assert evidence.probability > PARAMS.confirm_probability


def test_new_objects_of_a_frame_full_of_measurements_are_doubted():
    assert new(candidates=14).probability == pytest.approx(0.1 / 10.1)


def test_new_object_in_a_small_group_is_as_probable_as_alone():
    assert new(candidates=4).log_odds == new(candidates=1).log_odds


def test_fill_of_a_new_object_counts_at_most_as_much_as_a_second_measurement():
    one_frame = math.log(0.85 / 0.4)
    odds = [new(fill).log_odds for fill in (0.0, 0.5, 0.575, 1.0)]
    assert np.diff(odds) == pytest.approx([one_frame, one_frame / 2, one_frame / 2])


def test_new_object_that_is_not_measured_again_has_soon_left():
    evidence = new()
    follow(evidence, 1, measured=False, own=False)
    assert departure(evidence, PARAMS) > PARAMS.confirm_probability


def test_departure_follows_the_gamma_of_the_time_without_measurement():
    evidence = confirmed()
    follow(evidence, 10, measured=False, own=False)  # 1 s, half the mean
    assert departure(evidence, PARAMS) < 0.2
    follow(evidence, 20, measured=False, own=False)  # 3 s
    assert departure(evidence, PARAMS) > 0.8


def test_object_that_shares_its_measurement_outlives_an_unmeasured_one():
    shared, unmeasured = confirmed(), confirmed()
    follow(shared, 20, own=False)
    follow(unmeasured, 20, measured=False, own=False)
    assert departure(shared, PARAMS) < departure(unmeasured, PARAMS)


def test_object_that_shares_its_measurement_for_long_is_a_prediction_only():
    evidence = confirmed()
    follow(evidence, 6, own=False)
    assert evidence.observed
    follow(evidence, 2, own=False)
    assert not evidence.observed


def test_learned_size_follows_the_row_in_spite_of_specks_and_groups():
    rng = np.random.default_rng(3)
    learner = SizeLearner(60.0)
    for frame in range(40):
        people = []
        for _ in range(2):
            y = rng.uniform(25, 75)
            people.append([rng.uniform(15, 145), y, 4 + 0.15 * y, 0.4 * (4 + 0.15 * y), 0.0])
        mask = paint_union(np.array(people), (100, 160))
        for x, y in rng.integers(2, 90, (15, 2)):
            mask[y : y + 3, x : x + 3] = 1
        for moment in (frame, frame + 0.5):
            belief = learner.update(mask.astype(np.float32), moment / 10)
    assert belief is not None
    prior = belief.prior
    for row in (30, 70):
        assert prior.half_length(row) == pytest.approx(4 + 0.15 * row, rel=0.1)
    # Painted ellipses are full, silhouettes fill theirs to three quarters.
    assert prior.aspect == pytest.approx(0.4 / 0.75, rel=0.15)


def test_size_learning_stops_after_its_time():
    learner = SizeLearner(5.0)
    small, large = (paint_union(np.array([[50.0, 50, a, 0.4 * a, 0]]), (100, 100)).astype(np.float32) for a in (10, 20))
    for frame in range(11):
        before = learner.update(small, frame)
    for frame in range(11, 50):
        assert learner.update(large, frame) == before


def pairs_of(*masks: np.ndarray) -> np.ndarray:
    pairs = RegionPairs()
    return [pairs.update(mask, n / 10, None) for n, mask in enumerate(masks)][-1]


def test_regions_say_which_of_them_the_border_cuts():
    mask = np.zeros((50, 50), dtype=np.float32)
    mask[10:30, 20:28] = 1
    mask[0:20, 40:45] = 1
    np.testing.assert_array_equal(pairs_of(mask, mask)[:, :5], [[19.5, 20, 8, 160, 0], [9.5, 20, 5, 100, 1]])


def test_axes_of_a_region_are_those_of_the_ellipse_with_its_second_moments():
    # A bar of n cells has the variance n^2 / 12, the ellipse of length L has L^2 / 16: L = n sqrt(4 / 3).
    mask = np.zeros((50, 50), dtype=np.float32)
    mask[20:26, 10:30] = 1
    major, minor, lean = pairs_of(mask, mask)[0, [MAJOR, MINOR, LEAN]]
    assert (major, minor, lean) == pytest.approx((20 * math.sqrt(4 / 3), 6 * math.sqrt(4 / 3), -1.0))


def test_region_keeps_its_track_from_frame_to_frame_and_another_one_has_its_own():
    both, pairs = np.zeros((50, 80), dtype=np.float32), RegionPairs()
    both[10:30, 20:28] = 1
    for n in range(3):
        first = both.copy()
        both = np.roll(both, 1, axis=1)
        both[10:25, 60:68] = 1 if n else 0
        found = [pairs.update(mask, n / 10, None) for mask in (first, both)][-1]
    tracks = found[:, TRACK]
    assert len(tracks) == 2
    assert len(np.unique(tracks)) == 2
    assert tracks.min() == 0
    np.testing.assert_array_equal(found[:, TIME_S], [0.2, 0.2])


def test_region_that_was_not_there_before_does_not_count():
    mask = np.zeros((50, 50), dtype=np.float32)
    mask[10:30, 20:28] = 1
    assert not len(pairs_of(np.zeros_like(mask), mask))


def test_regions_nearer_than_a_tenth_of_their_height_are_one():
    mask = np.zeros((60, 50), dtype=np.float32)
    mask[10:30, 20:28] = 1
    mask[32:50, 20:28] = 1
    np.testing.assert_array_equal(pairs_of(mask, mask)[:, :5], [[29.5, 40, 8, 304, 0]])


def test_line_through_two_points_and_its_flat_twin():
    assert line(np.array([0.0, 10]), np.array([2.0, 4]), np.ones(2), tilted=True) == pytest.approx((2.0, 0.2))
    assert line(np.array([0.0, 10]), np.array([2.0, 4]), np.ones(2), tilted=False) == pytest.approx((3.0, 0.0))


def test_poles_are_too_thin_to_teach_a_size():
    mask = np.zeros((60, 80), np.float32)
    mask[10:30, 10:12] = 1  # 20 long, 2 wide: a tenth
    mask[20:40, 40:47] = 1  # 20 long, 7 wide: a person
    np.testing.assert_array_equal(pairs_of(mask, mask)[:, :5], [[29.5, 20, 7, 140, 0]])
