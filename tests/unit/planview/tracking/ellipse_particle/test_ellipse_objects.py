"""Which measurements objects explain, where they may be found again, and when they have left the view."""

import numpy as np
import pytest

from planview.tracking.ellipse_particle.explain import measured_shares, reachable, unexplained
from planview.tracking.ellipse_particle.fit.ellipses import SizePrior
from planview.tracking.ellipse_particle.objects import Objects
from planview.tracking.ellipse_particle.params import FilterParams, LifeParams

SHAPE = (60, 80)
PRIOR = SizePrior(10.0, 0.0, 0.4)
HERE, BESIDE = np.array([20.0, 30, 10, 4, 0]), np.array([50.0, 30, 10, 4, 0])


def objects_at(*ellipses: np.ndarray) -> Objects:
    objects = Objects(FilterParams(particles=200), LifeParams(), np.random.default_rng(0))
    for ellipse in ellipses:
        objects.bear(ellipse, 0.7, 1, PRIOR, 12.0, "")
    return objects


def test_share_of_a_double_is_measured_but_not_its_own():
    shares = measured_shares(HERE[None], np.array([HERE, HERE, BESIDE]), SHAPE)
    np.testing.assert_allclose(shares, [[1, 1], [1, 0], [0, 0]], atol=0.05)


def test_share_of_somebody_cut_by_the_border_counts_the_part_inside():
    cut = np.array([[-0.5, 30.0, 10, 4, 0]])
    assert measured_shares(cut, cut, SHAPE)[0] == pytest.approx([1, 1], abs=0.05)


def test_measurement_that_no_object_covers_is_unexplained():
    assert unexplained(np.array([HERE, BESIDE]), HERE[None], SHAPE, 0.35).tolist() == [False, True]


def test_nearest_measurement_within_reach_comes_first():
    positions, spread = np.array([[20.0, 30], [44.0, 30]]), np.full((2, 2), 0.1)
    # 10 cells are a metre: object 1 is 0.6 m from the second measurement, too far; object 0 is at the first.
    found = reachable(np.array([HERE, BESIDE]), positions, spread, np.full(2, 10.0), 1.5)
    assert found == [(0.0, 0, 0)]
    wide = reachable(np.array([HERE, BESIDE]), positions, np.full((2, 2), 1.0), np.full(2, 10.0), 1.5)
    assert [(n, m) for _, n, m in wide] == [(0, 0), (1, 1)]


@pytest.mark.parametrize(("x", "stays"), [(0.0, True), (-1.5, True), (-3.0, False), (80.5, True), (82.0, False)])
def test_objects_are_followed_until_three_quarters_have_left_the_view(x, stays):
    objects = objects_at(np.array([x, 30.0, 10, 4, 0]))
    objects.states[0, 0] = x
    objects.bury(SHAPE, PRIOR)
    assert len(objects) == stays


def test_objects_are_chosen_by_what_is_known_of_them():
    objects = objects_at(HERE, BESIDE)
    objects.lives[1].confirmed, objects.lives[1].seen = True, False
    assert objects.that(seen=True).tolist() == [True, False]
    assert objects.that(confirmed=True).tolist() == [False, True]
    assert objects.that(seen=True, confirmed=True).tolist() == [False, False]
    assert objects.that().tolist() == [True, True]
