"""What measurements and objects cover, where objects may be reacquired, and when they have left the view."""

import numpy as np
import pytest

from planview.tracking.ellipse_particle.coverage import measured_shares, reachable, uncovered
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.params import ExistenceParams, ParticleFilterParams

SHAPE = (60, 80)
PRIOR = SizePrior(10.0, 0.0, 0.4)
UPRIGHT = PlaneModel(0.1, 0.35, 0.09, 0.0, 0.5, 1.0)
HERE, BESIDE = np.array([20.0, 30, 10, 4, 0]), np.array([50.0, 30, 10, 4, 0])


def objects_at(*ellipses: np.ndarray) -> Objects:
    objects = Objects(ParticleFilterParams(particles=200), ExistenceParams(), UPRIGHT, np.random.default_rng(0))
    for ellipse in ellipses:
        objects.spawn(ellipse, 0.7, 1, PRIOR, 12.0, "")
    return objects


def test_share_of_a_double_is_measured_but_not_its_own():
    shares = measured_shares(HERE[None], np.array([HERE, HERE, BESIDE]), SHAPE)
    np.testing.assert_allclose(shares, [[1, 1], [1, 0], [0, 0]], atol=0.05)


def test_share_of_an_object_cut_by_the_border_counts_the_part_inside():
    cut = np.array([[-0.5, 30.0, 10, 4, 0]])
    assert measured_shares(cut, cut, SHAPE)[0] == pytest.approx([1, 1], abs=0.05)


def test_measurement_that_no_object_covers_is_uncovered():
    assert uncovered(np.array([HERE, BESIDE]), HERE[None], SHAPE, 0.35).tolist() == [False, True]


def test_all_measurements_are_uncovered_where_no_object_is():
    assert uncovered(np.array([HERE, BESIDE]), np.zeros((0, 5)), SHAPE, 0.35).tolist() == [True, True]


def side_by_side(gap: float) -> np.ndarray:
    """(3, 5) two measurements 8 cells wide whose centres are so far apart, and an object between them."""
    return np.array([[24.0 + dx, 30, 10, 4, 0] for dx in (-gap / 2, gap / 2, 0)])


def test_one_of_two_measurements_that_an_object_lies_across_is_uncovered():
    *both, between = side_by_side(8.0)
    assert sum(uncovered(np.array(both), between[None], SHAPE, 0.35)) == 1


def test_two_measurements_of_one_object_are_not_uncovered():
    *both, between = side_by_side(2.0)
    assert not uncovered(np.array(both), between[None], SHAPE, 0.35).any()


def test_two_measurements_with_two_objects_are_not_uncovered():
    *both, _ = side_by_side(8.0)
    assert not uncovered(np.array(both), np.array(both), SHAPE, 0.35).any()


def test_nearest_measurement_within_reach_comes_first():
    positions, spread = np.array([[20.0, 30], [44.0, 30]]), np.full((2, 2), 0.1)
    # 10 cells are a metre: object 1 is 0.6 m from the second measurement, too far; object 0 is at the first.
    found = reachable(np.array([HERE, BESIDE]), positions, spread, np.full(2, 10.0), 1.5)
    assert found == [(0.0, 0, 0)]
    wide = reachable(np.array([HERE, BESIDE]), positions, np.full((2, 2), 1.0), np.full(2, 10.0), 1.5)
    assert [(n, m) for _, n, m in wide] == [(0, 0), (1, 1)]


@pytest.mark.parametrize(("x", "stays"), [(0.0, True), (-1.5, True), (-3.0, False), (80.5, True), (82.0, False)])
def test_objects_are_tracked_until_three_quarters_have_left_the_view(x, stays):
    objects = objects_at(np.array([x, 30.0, 10, 4, 0]))
    objects.states[0, 0] = x
    objects.prune(SHAPE, PRIOR)
    assert len(objects) == stays


def test_objects_are_chosen_by_what_is_known_of_them():
    objects = objects_at(HERE, BESIDE)
    objects.evidence[1].who.confirmed, objects.evidence[1].measured = True, False
    assert objects.measured.tolist() == [True, False]
    assert objects.confirmed.tolist() == [False, True]


def test_object_that_is_measured_again_and_again_is_confirmed_lost_and_reacquired():
    objects, kinds = objects_at(HERE), []
    for covered in (1.0, 1.0, 0.0, 0.0, 1.0):
        objects.cycle.begin(0.0)
        objects.observe(0, covered > 0.5, covered > 0.5, 0.1, True, covered)
        kinds += [d.kind for d in objects.cycle.decisions]
    assert kinds == ["confirmed", "lost", "reacquired"]


def test_object_against_which_more_than_time_speaks_stays_tentative():
    objects = objects_at(HERE)
    for _ in range(5):
        objects.observe(0, True, True, 0.1, False, 1.0)
    assert objects.evidence[0].who.state == "tentative"
