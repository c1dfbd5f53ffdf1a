import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.tracking import _axis_kernels
from planview.tracking.harville import _kernels as _template_kernels
from tests.reference import axis as axis_reference
from tests.reference import template as reference


def sparse_map(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.where(rng.random(shape) < 0.5, rng.uniform(0.1, 2.0, shape), 0.0).astype(np.float32)


def test_difference_counts_one_sided_cells_as_h_max_thirds() -> None:
    template = np.array([[1.5, 0.0], [1.0, 0.0]], np.float32)
    seen = np.array([[1.7, 0.9], [0.0, 0.0]], np.float32)
    height, _ = _template_kernels.differences(template, template, seen, seen, 0, 0, 0.8)
    assert height == pytest.approx((0.2 + 0.8 + 0.8) / 3, abs=1e-6)


def test_search_finds_a_template_where_it_was_moved() -> None:
    template = sparse_map(np.random.default_rng(1), (5, 5))
    height = np.zeros((20, 20), np.float32)
    height[8:13, 6:11] = template
    result = np.empty(7)
    _template_kernels.search(
        template, template, height, height, 7.0, 7.0, 3, 0.8, 1.0, 1.0, 0.01, 1.0, 5.0, np.empty((0, 2)), result
    )
    assert tuple(result[1:3]) == (8, 6)
    assert result[3] == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_search_equals_its_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    template, height, occupancy = (sparse_map(rng, s) for s in ((5, 5), (24, 20), (24, 20)))
    others = rng.uniform(0, 15, (2, 2))
    args = template, template, height, occupancy, rng.uniform(-2, 22), rng.uniform(-2, 18), 3
    ours, theirs = np.empty(7), np.empty(7)
    _template_kernels.search(*args, 0.8, 1.2, 0.9, 0.05, 1.0, 4.0, others, ours)
    reference.search(*args, 0.8, 1.2, 0.9, 0.05, 1.0, 4.0, others, theirs)
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_clear_adapt_and_peak_equal_their_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    maps = [sparse_map(rng, (24, 20)) for _ in range(2)]
    people = rng.uniform(4, 16, (5, 2))
    expected = np.array([False, True, True, False, True])
    templates = [sparse_map(rng, (5, 5)) for _ in range(2)]
    angle = rng.uniform(0, 6)
    results = []
    for module in (_template_kernels, reference):
        t = [a.copy() for a in templates]
        share = module.adapt(*t, *maps, 6, 7, people, 0, 0.4, 0.3)
        peak = module.occupancy_peak(maps[1], 6, 7, 5, people, 0)
        m = [a.copy() for a in maps]
        module.clear(*m, *people[0], np.sin(angle), np.cos(angle), 3.2, 4.4, people, expected)
        results.append((share, peak, *t, *m))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_axis_kernels_equal_their_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-1, -1, -0.2), (1, 1, 2.5), (60, 3)).astype(np.float32)
    area = rng.uniform(0, 1, 60).astype(np.float32)
    people = rng.uniform(-1, 1, (3, 2))
    results = []
    for module in (_axis_kernels, axis_reference):
        label, histogram, sums = np.empty(60, np.int32), np.empty((3, 50)), np.empty((3, 3))
        module.height_histograms(xyz, area, people, 0.6, 0.05, label, histogram)
        low, high = np.array([0.5, 0.0, 1.0]), np.array([2.0, 1.5, np.inf])
        module.slab_centroids(xyz, area, label, low, high, people, 0.4, sums)
        top, bodies, heads = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        module.tops(histogram, np.array([0.01, 0.3, 9.0]), 0.05, 0.04, top)
        module.body_and_head(xyz, area, label, people, 0.6, low, 0.2, bodies, heads)
        results.append((label, histogram, sums, top, bodies, heads))
    for ours, theirs in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_mean_counts_only_known_values() -> None:
    values, known = np.array([[1.0, 2.0], [3.0, 9.0]], np.float32), np.array([[0.5, 0.0], [1.0, 0.0]], np.float32)
    assert _template_kernels.mean_where(values, known) == 2.0
    assert _template_kernels.mean_where(values, np.zeros_like(values)) == 0.0
