"""Fitting of ellipses to masks that were painted from known ones."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planview.tracking.ellipse_particle.fit.ellipses import (
    MAX_ELLIPSES,
    EllipseFitParams,
    extent,
    fit_ellipses,
    paint_union,
)
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior

SHAPE = (80, 120)
PRIOR = SizePrior(12.0, 0.0, 0.4)
PARAMS = EllipseFitParams()
UPRIGHT = PlaneModel(math.radians(6), math.radians(20), math.radians(5), 0.0, 0.5, 1.0)


def mask_of(*ellipses: tuple[float, ...]) -> np.ndarray:
    return paint_union(np.array(ellipses, dtype=np.float64), SHAPE).astype(np.float32)


def test_fit_finds_one_ellipse_where_it_was_painted():
    found = fit_ellipses(mask_of((40.0, 35, 12, 5, 0.1)), PRIOR, PARAMS, UPRIGHT)
    assert len(found) == 1
    np.testing.assert_allclose(found[0], [40, 35, 12, 5, 0.1], atol=0.6)


def test_fit_keeps_one_ellipse_for_a_split_region():
    mask = mask_of((40.0, 35, 12, 4.8, 0.0))
    mask[33:37] = 0  # a pole crosses the person
    found = fit_ellipses(mask, PRIOR, PARAMS, UPRIGHT)
    assert len(found) == 1
    np.testing.assert_allclose(found[0, :2], [40, 35], atol=1.0)


def test_fit_explains_a_merged_region_by_two_ellipses():
    found = fit_ellipses(mask_of((40.0, 35, 12, 4.8, 0.0), (46, 38, 12, 4.8, 0.0)), PRIOR, PARAMS, UPRIGHT)
    assert len(found) == 2
    np.testing.assert_allclose(np.sort(found[:, 0]), [40, 46], atol=1.5)


def test_fit_keeps_the_full_size_of_an_object_whose_legs_are_hidden():
    mask = mask_of((40.0, 35, 12, 4.8, 0.0))
    mask[40:] = 0
    found = fit_ellipses(mask, PRIOR, PARAMS, UPRIGHT)
    assert len(found) == 1
    assert found[0, 2] == pytest.approx(12, rel=0.2)


def test_fit_ignores_specks_and_empty_masks():
    assert len(fit_ellipses(np.zeros(SHAPE, dtype=np.float32), PRIOR, PARAMS, UPRIGHT)) == 0
    assert len(fit_ellipses(mask_of((40.0, 35, 3, 2, 0.0)), PRIOR, PARAMS, UPRIGHT)) == 0


def test_fit_follows_the_size_that_is_expected_in_a_row():
    prior = SizePrior(5.0, 0.2, 0.4)  # half length 8 in row 15, 17 in row 60
    found = fit_ellipses(mask_of((30.0, 15, 8, 3.2, 0.0), (80, 60, 17, 6.8, 0.0)), prior, PARAMS, UPRIGHT)
    np.testing.assert_allclose(found[np.argsort(found[:, 1]), 2], [8, 17], rtol=0.1)


def test_size_prior_is_never_smaller_than_its_minimum():
    prior = SizePrior(-3.0, 0.2, 0.4, half_length_min=4.0)
    assert prior.half_length(0) == 4.0
    np.testing.assert_allclose(prior.half_lengths(np.array([0.0, 100.0])), [4.0, 17.0])


@pytest.mark.parametrize("values", [(np.nan, 0.0, 0.4), (5.0, 0.0, 0.0), (5.0, np.inf, 0.4)])
def test_size_prior_refuses_what_is_no_size(values):
    with pytest.raises(ValueError, match="expected finite sizes"):
        SizePrior(*values)


def test_fit_refuses_masks_of_another_type():
    with pytest.raises(ValueError, match="float32"):
        fit_ellipses(np.zeros((5, 5)), PRIOR, PARAMS, UPRIGHT)


def test_extent_of_a_lying_ellipse_is_swapped():
    assert extent(np.array([0, 0, 12.0, 5.0, np.pi / 2])) == pytest.approx((12.0, 5.0))


@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from([0, 0.5, 1])),
    st.floats(0.5, 10),
    st.floats(-0.5, 0.5),
    st.floats(0.15, 1.0),
    st.sampled_from([20.0, 90.0]),
)
def test_fit_of_any_mask_is_finite_and_bounded(mask, half, slope, aspect, angle_limit):
    plane = UPRIGHT._replace(angle_limit=math.radians(angle_limit))
    found = fit_ellipses(mask, SizePrior(half, slope, aspect), PARAMS, plane)
    assert found.shape[1] == 5
    assert len(found) <= MAX_ELLIPSES
    assert np.isfinite(found).all()
    assert (found[:, 2:4] > 0).all()
