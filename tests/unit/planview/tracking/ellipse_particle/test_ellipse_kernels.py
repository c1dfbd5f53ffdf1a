"""Ellipse kernels against their plain numpy twins and against hand-checked areas."""

import math

import numpy as np
import pytest

from planview.tracking.ellipse_particle import _kernels as kernels
from planview.tracking.ellipse_particle._kernels import Law, Match
from tests.reference import ellipses as reference

SHAPE = (40, 50)


def random_ellipses(rng: np.random.Generator, n: int) -> np.ndarray:
    sizes = rng.uniform(2, 15, n), rng.uniform(1, 8, n), rng.uniform(-1.5, 1.5, n)
    return np.column_stack([rng.uniform(-5, 55, n), rng.uniform(-5, 45, n), *sizes])


@pytest.mark.parametrize("seed", range(5))
def test_paint_agrees_with_its_twin(seed):
    ellipses = random_ellipses(np.random.default_rng(seed), 5)
    masks = np.zeros((5, *SHAPE), dtype=np.uint8)
    kernels.paint(ellipses, masks)
    for mask, ellipse in zip(masks, ellipses, strict=True):
        np.testing.assert_array_equal(mask, reference.raster(ellipse, SHAPE))


def test_row_sums_are_those_left_of_each_edge():
    np.testing.assert_array_equal(kernels.row_sums(np.array([[1, 0, 2]], np.uint8)), [[0, 1, 1, 3]])


@pytest.mark.parametrize("seed", range(4))
def test_overlaps_agree_with_their_twin(seed):
    rng = np.random.default_rng(seed)
    left, allowed = (rng.uniform(0, 1, SHAPE) > 0.5).astype(np.uint8), (rng.uniform(0, 1, SHAPE) > 0.3).astype(np.uint8)
    states = np.zeros((6, 7))
    states[:, 0], states[:, 1], states[:, 4:] = (
        rng.uniform(-3, 53, 6),
        rng.uniform(-3, 43, 6),
        rng.normal(0, 0.3, (6, 3)),
    )
    out = np.empty((6, 2))
    kernels.overlaps(states, kernels.row_sums(left), kernels.row_sums(allowed), Law(3.0, 0.1, 4.0, 0.5), out)
    for found, (x, y, _, _, ln_a, ln_b, angle) in zip(out, states, strict=True):
        half = max(4.0, 3.0 + 0.1 * y)
        ellipse = np.array([x, y, half * math.exp(ln_a), half * 0.5 * math.exp(ln_b), angle])
        expected = reference.overlap(ellipse, left.astype(np.float32), allowed.astype(np.float32))
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_overlap_of_a_whole_ellipse_is_its_area():
    full, none = (kernels.row_sums(np.full((60, 60), v, np.uint8)) for v in (1, 0))
    out = np.empty((1, 2))
    kernels.overlaps(np.array([[30.0, 30, 0, 0, 0, 0, 0.2]]), full, none, Law(20.0, 0.0, 1.0, 0.5), out)
    # Tall ellipses are summed over every third row.
    assert out[0] == pytest.approx([math.pi * 20 * 10] * 2, rel=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_cover_agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    mask = reference.paint(np.array([[12.0, 15, 8, 3, 0], [30, 20, 9, 3.5, 0.1], [35, 22, 8, 3, 0]]), SHAPE)
    score = np.where(mask > 0, 1.0, -0.4).astype(np.float32) + rng.normal(0, 0.05, SHAPE).astype(np.float32)
    half = 7.0 + 0.05 * np.arange(SHAPE[0])
    found = kernels.cover(score.copy(), half, 0.4, 2, 0.2)
    assert [(int(e[1]), int(e[0])) for e in found] == reference.cover(score, half, 0.4, 2, 0.2)


def test_refine_agrees_with_its_twin():
    mask = reference.paint(np.array([[20.0, 20, 12, 4.5, 0.1], [27, 22, 11, 4, -0.1]]), SHAPE).astype(np.float32)
    start = np.array([[18.47, 18.1, 10, 4, 0.01], [28, 24, 12, 4.5, 0.05]])
    law, spread = Law(9.0, 0.05, 2.0, 0.4), np.array([0.12, 0.12, 0.1])
    expected = reference.refine(mask, start, law, spread, 3.0, 0.7, 0.4, 0.7, 3)
    kernels.refine(mask, start, law, Match(0.7, 0.4, 0.7, 0.12, 0.1, 3.0), 3)
    np.testing.assert_allclose(start, expected, atol=1e-6)


def test_normal_equations_are_the_slope_of_the_cost():
    mask = reference.paint(np.array([[28.0, 31, 14, 6, 0.1]]), (60, 60)).astype(np.float32)
    law, match = Law(12.0, 0.0, 1.0, 0.4), Match(0.7, 0.4, 0.7, 0.12, 0.1, 3.0)
    grad, hess, free, window = np.empty(5), np.empty((5, 5)), np.ones((60, 60)), (0, 59, 0, 59)

    def cost(step: np.ndarray, derive: bool = False) -> float:
        ellipse = np.array([30.0, 30, 13, 5, 0.05]) * np.exp([0, 0, step[2], step[3], 0])
        ellipse[[0, 1, 4]] += step[[0, 1, 4]]
        return kernels.normal_equations(mask, ellipse, window, free, law, match, grad, hess, derive)

    cost(np.zeros(5), derive=True)
    slopes = grad.copy()
    for i, step in enumerate(1e-5 * np.eye(5)):
        # The width of the soft edge is that of the ellipse, which the derivatives take as fixed.
        assert -slopes[i] == pytest.approx((cost(step) - cost(-step)) / 2e-5, rel=0.2, abs=1.5)
