import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.tracking.harville import _kernels as kernels
from tests.reference import template as reference

NOBODY = np.empty((0, 2))


def sparse_map(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.where(rng.random(shape) < 0.5, rng.uniform(0.1, 2.0, shape), 0.0).astype(np.float32)


def test_difference_counts_one_sided_cells_as_h_max_thirds() -> None:
    template = np.array([[1.5, 0.0], [1.0, 0.0]], np.float32)
    seen = np.array([[1.7, 0.9], [0.0, 0.0]], np.float32)
    height, _ = kernels.differences(template, template, seen, seen, 0, 0, 0.8)
    assert height == pytest.approx((0.2 + 0.8 + 0.8) / 3, abs=1e-6)


def test_search_finds_a_template_where_it_was_moved() -> None:
    template = sparse_map(np.random.default_rng(1), (5, 5))
    height = np.zeros((20, 20), np.float32)
    height[8:13, 6:11] = template
    result = np.empty(7)
    kernels.search(template, template, height, height, 7.0, 7.0, 3, 0.8, 1.0, 1.0, 0.01, 1.0, 5.0, NOBODY, result)
    assert tuple(result[1:3]) == (8, 6)
    assert result[3] == pytest.approx(0.0, abs=1e-6)


def test_search_prefers_of_two_equal_places_the_one_away_from_a_placed_person() -> None:
    template = np.full((3, 3), 1.7, np.float32)
    height = np.zeros((9, 20), np.float32)
    height[3:6, 2:5] = height[3:6, 12:15] = template
    result = np.empty(7)
    placed = np.array([[3.0, 3.0]])
    kernels.search(template, template, height, height, 3.0, 7.0, 6, 0.8, 1.0, 1.0, 0.0, 1.0, 2.0, placed, result)
    assert tuple(result[1:3]) == (3, 12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_search_equals_its_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    template, height, occupancy = (sparse_map(rng, s) for s in ((5, 5), (24, 20), (24, 20)))
    others = rng.uniform(0, 15, (2, 2))
    args = template, template, height, occupancy, rng.uniform(-2, 22), rng.uniform(-2, 18), 3
    ours, theirs = np.empty(7), np.empty(7)
    kernels.search(*args, 0.8, 1.2, 0.9, 0.05, 1.0, 4.0, others, ours)
    reference.search(*args, 0.8, 1.2, 0.9, 0.05, 1.0, 4.0, others, theirs)
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)
