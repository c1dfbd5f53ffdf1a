"""Fitting of ellipses to masks that were painted from known ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from planview.tracking.ellipse_particle.fit import fit_ellipses, own_gains, painted
from planview.tracking.ellipse_particle.params import EllipseFitParams
from planview.tracking.ellipse_particle.size import Size

SHAPE = (80, 120)
SIZE = Size(12.0, 0.0, 1.0, 0.4)
PARAMS = EllipseFitParams()


def mask_of(*ellipses: tuple[float, ...]) -> np.ndarray:
    return painted(np.array(ellipses, dtype=np.float64), SHAPE).any(axis=0).astype(np.float32)


def test_fit_finds_one_ellipse_where_it_was_painted():
    found = fit_ellipses(mask_of((40.0, 35, 12, 5, 0.1)), SIZE, PARAMS)
    assert len(found) == 1
    np.testing.assert_allclose(found[0], [40, 35, 12, 5, 0.1], atol=0.6)


def test_fit_keeps_one_ellipse_for_a_split_region():
    mask = mask_of((40.0, 35, 12, 4.8, 0.0))
    mask[33:37] = 0  # a pole crosses the person
    found = fit_ellipses(mask, SIZE, PARAMS)
    assert len(found) == 1
    np.testing.assert_allclose(found[0, :2], [40, 35], atol=1.0)


def test_fit_explains_a_merged_region_by_two_ellipses():
    found = fit_ellipses(mask_of((40.0, 35, 12, 4.8, 0.0), (46, 38, 12, 4.8, 0.0)), SIZE, PARAMS)
    assert len(found) == 2
    np.testing.assert_allclose(np.sort(found[:, 0]), [40, 46], atol=1.5)


def test_fit_keeps_the_full_size_of_an_object_whose_legs_are_hidden():
    mask = mask_of((40.0, 35, 12, 4.8, 0.0))
    mask[40:] = 0
    found = fit_ellipses(mask, SIZE, PARAMS)
    assert len(found) == 1
    assert found[0, 2] == pytest.approx(12, rel=0.2)


def test_fit_ignores_specks_suitcases_and_empty_masks():
    for mask in (np.zeros(SHAPE, np.float32), mask_of((40.0, 35, 3, 2, 0.0)), mask_of((40.0, 43, 5, 3, 0.0))):
        assert len(fit_ellipses(mask, SIZE, PARAMS)) == 0


def test_fit_follows_the_size_that_is_expected_in_a_row():
    size = Size(5.0, 0.2, 1.0, 0.4)  # half length 8 in row 15, 17 in row 60
    found = fit_ellipses(mask_of((30.0, 15, 8, 3.2, 0.0), (80, 60, 17, 6.8, 0.0)), size, PARAMS)
    np.testing.assert_allclose(found[np.argsort(found[:, 1]), 2], [8, 17], rtol=0.1)


def test_fit_from_above_finds_a_person_who_lies_across():
    found = fit_ellipses(mask_of((60.0, 40, 20, 10, 1.3)), Size(20.0, 0.0, 1.0, 0.5, upright=False), PARAMS)
    assert len(found) == 1
    np.testing.assert_allclose(found[0], [60, 40, 20, 10, 1.3], atol=1.0)


def test_gain_is_the_share_of_foreground_less_background_outside_the_others():
    one, twin = (40.0, 35, 12, 4.8, 0.0), (40.0, 35, 12, 4.8, 0.0)
    mask = mask_of(one)
    assert own_gains(mask, np.array([one]), 0.4) == pytest.approx([1.0])
    assert own_gains(0 * mask, np.array([one]), 0.4) == pytest.approx([-0.4])
    assert own_gains(mask, np.array([one, twin]), 0.4) == pytest.approx([0.0, 0.0])


@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 24), st.integers(1, 24)), elements=st.sampled_from([0, 0.5, 1])),
    st.floats(0.5, 10),
    st.floats(-0.5, 0.5),
    st.floats(0.15, 1.0),
    st.booleans(),
)
def test_fit_of_any_mask_is_finite(mask, level, slope, aspect, upright):
    found = fit_ellipses(mask, Size(level, slope, 1.0, aspect, upright), PARAMS)
    assert found.shape[1] == 5
    assert np.isfinite(found).all()
    assert (found[:, 2:4] > 0).all()
