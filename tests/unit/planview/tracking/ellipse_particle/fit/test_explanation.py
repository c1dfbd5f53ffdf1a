"""How many ellipses explain a region, alone and beside what is known."""

import math

import numpy as np
import pytest

from planview.tracking.ellipse_particle.fit.ellipses import EllipseFitParams, fit_ellipses, paint_union
from planview.tracking.ellipse_particle.fit.explanation import matched, near_each_other
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior

SHAPE = (80, 120)
PRIOR = SizePrior(12.0, 0.0, 0.4)
UPRIGHT = PlaneModel(math.radians(6), math.radians(20), math.radians(5), 0.0, 0.5, 1.0)


def fitted(ellipses: list[tuple[float, ...]], known: list[tuple[float, ...]], fill: float = 1.0) -> np.ndarray:
    mask = fill * paint_union(np.array(ellipses, dtype=np.float64), SHAPE).astype(np.float32)
    return fit_ellipses(mask, PRIOR, EllipseFitParams(), UPRIGHT, np.array(known).reshape(-1, 5))


def test_two_half_a_width_apart_stay_two_only_when_they_are_known():
    both = [(40.0, 35.0, 12.0, 4.8, 0.0), (45.0, 35.0, 12.0, 4.8, 0.0)]
    silhouettes = 0.7
    assert len(fitted(both, [], silhouettes)) == 1
    found = fitted(both, both, silhouettes)
    assert len(found) == 2
    np.testing.assert_allclose(np.sort(found[:, 0]), [40, 45], atol=1.5)


def test_what_is_known_and_no_longer_there_is_not_measured():
    one = (40.0, 35.0, 12.0, 4.8, 0.0)
    found = fitted([one], [one, (80.0, 35.0, 12.0, 4.8, 0.0)])
    np.testing.assert_allclose(found[:, :2], [[40, 35]], atol=0.6)


def test_a_newcomer_beside_a_known_object_is_measured():
    one, other = (40.0, 35.0, 12.0, 4.8, 0.0), (49.0, 35.0, 12.0, 4.8, 0.0)
    assert sorted(np.round(fitted([one, other], [one])[:, 0])) == [40, 49]


def test_a_known_object_across_two_people_does_not_keep_them_from_being_two():
    pair = [(40.0, 35.0, 12.0, 4.8, 0.0), (49.0, 35.0, 12.0, 4.8, 0.0)]
    assert len(fitted(pair, [(44.5, 35.0, 13.0, 7.0, 0.0)])) == 2


@pytest.mark.parametrize("larger", [1.0, 1.25])
def test_one_person_larger_than_expected_is_one(larger):
    assert len(fitted([(40.0, 35.0, 12.0 * larger, 4.8 * larger, 0.0)], [])) == 1


def test_each_known_object_accounts_for_the_nearest_ellipse_alone():
    ellipses = np.array([[13.0, 30, 10, 4, 0], [10.5, 30, 10, 4, 0], [50.0, 30, 10, 4, 0]])
    known = np.array([[10.0, 30, 10, 4, 0], [55.0, 30, 10, 4, 0]])
    # Half a width of 8 is 4: the third is 5 away from the second object.
    assert matched(ellipses, known).tolist() == [1]
    assert matched(ellipses, known[:0]).tolist() == []


def test_ellipses_share_cells_where_they_are_at_most_an_edge_apart():
    one, beside = np.array([[10.0, 30, 10, 4, 0]]), np.array([[20.0, 30, 10, 4, 0], [22.0, 30, 10, 4, 0]])
    # 4 + 4 and 3 cells of edges: nearer than 11.
    assert near_each_other(one, beside).tolist() == [[True, False]]
