"""Ellipse kernels against their plain numpy twins and against hand-checked areas."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planview.tracking.ellipse_particle._kernels import (
    Transition,
    copy_particles,
    draw_systematically,
    mean_near,
    propagate,
    union_overlap,
)
from planview.tracking.ellipse_particle._region_kernels import region_sums
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit._cover import cover
from planview.tracking.ellipse_particle.fit._em import em_step
from planview.tracking.ellipse_particle.fit._evidence import explained
from planview.tracking.ellipse_particle.fit._lm import (
    Match,
    Prior,
    free_of,
    normal_equations,
    refine,
    soft_edges,
)
from planview.tracking.ellipse_particle.fit.prior import SizeLaw
from tests.reference import ellipses as reference
from tests.reference import particles as particle_reference

SHAPE = (40, 50)


def random_ellipses(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack(
        [
            rng.uniform(-5, 55, n),
            rng.uniform(-5, 45, n),
            rng.uniform(2, 15, n),
            rng.uniform(1, 8, n),
            rng.uniform(-1.5, 1.5, n),
        ]
    )


def random_mask(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, 1, SHAPE).astype(np.float32)


def test_ellipse_sum_of_a_full_grid_is_the_area_of_the_ellipse():
    prefix = kernels.row_prefix(np.ones((200, 200), dtype=np.float32))
    total, area = kernels.ellipse_sum(prefix, 100.0, 100.0, 60.0, 20.0, 0.3)
    assert total == pytest.approx(math.pi * 60 * 20, rel=2e-3)
    assert area == pytest.approx(total)


def test_ellipse_sum_counts_only_the_part_inside_the_grid():
    prefix = kernels.row_prefix(np.ones((200, 200), dtype=np.float32))
    # The centre lies on the left edge of the first column: half of the ellipse is outside.
    _, area = kernels.ellipse_sum(prefix, -0.5, 100.0, 50.0, 20.0, 0.0)
    assert area == pytest.approx(math.pi * 50 * 20 / 2, rel=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_paint_and_claims_agree_with_their_twins(seed):
    rng = np.random.default_rng(seed)
    ellipses, values = random_ellipses(rng, 5), random_mask(rng)
    mask = np.zeros(SHAPE, dtype=np.uint8)
    kernels.paint(mask, ellipses, 1)
    np.testing.assert_array_equal(mask, reference.paint(ellipses, SHAPE))
    prefix = kernels.row_prefix(values)
    out = np.zeros((5, 4))
    kernels.exclusive(prefix, ellipses, out)
    np.testing.assert_allclose(out, reference.exclusive(values, ellipses), atol=1e-4)
    kernels.claim(prefix, ellipses, np.array([3, 0, 1, 4, 2]), out)
    np.testing.assert_allclose(out, reference.claim(values, ellipses, [3, 0, 1, 4, 2]), atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_union_overlap_agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    measured, allowed = (random_mask(rng) > 0.5).astype(np.float32), (random_mask(rng) > 0.3).astype(np.float32)
    particles = np.zeros((6, 4, 7))
    particles[..., 0], particles[..., 1] = rng.uniform(-3, 53, (6, 4)), rng.uniform(-3, 43, (6, 4))
    particles[..., 4:] = rng.normal(0, 0.3, (6, 4, 3))
    law = SizeLaw(3.0, 0.1, 4.0, 0.5)
    members = np.array([0, 2, 3])
    out = np.empty((6, 2))
    union_overlap(particles, members, kernels.row_prefix(measured), kernels.row_prefix(allowed), law, out)
    for p in range(6):
        x, y, _, _, ln_a, ln_b, angle = particles[p, members].T
        half = np.maximum(4.0, 3.0 + 0.1 * y)
        ellipses = np.column_stack([x, y, half * np.exp(ln_a), half * 0.5 * np.exp(ln_b), angle])
        np.testing.assert_allclose(out[p], reference.union_overlap(ellipses, measured, allowed), atol=1e-6)


def test_union_overlap_counts_shared_area_once():
    full = kernels.row_prefix(np.ones((60, 60), dtype=np.float32))
    none = kernels.row_prefix(np.zeros((60, 60), dtype=np.float32))
    twice = np.zeros((1, 2, 7))
    twice[..., :2] = 30.0
    out = np.empty((1, 2))
    union_overlap(twice, np.array([0, 1]), full, none, SizeLaw(20.0, 0.0, 1.0, 0.5), out)
    # Tall ellipses are summed over every third row.
    assert out[0] == pytest.approx([math.pi * 20 * 10] * 2, rel=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_cover_agrees_with_its_twin(seed):
    rng = np.random.default_rng(seed)
    mask = reference.paint(np.array([[12.0, 15, 8, 3, 0], [30, 20, 9, 3.5, 0.1], [35, 22, 8, 3, 0]]), SHAPE)
    score = np.where(mask > 0, 1.0, -0.4).astype(np.float32) + rng.normal(0, 0.05, SHAPE).astype(np.float32)
    lengths = 7.0 + 0.05 * np.arange(SHAPE[0])
    found = cover(score.copy(), lengths, 0.4, 2, 0.2, 10)
    expected = reference.cover(score, lengths, 0.4, 2, 0.2, 10)
    assert [(int(e[1]), int(e[0])) for e in found] == expected


def test_em_step_agrees_with_its_twin():
    rng = np.random.default_rng(1)
    mask = reference.paint(np.array([[15.0, 18, 12, 5, 0.1], [26, 20, 11, 4, -0.1]]), SHAPE)
    rows, cols = np.nonzero(mask)
    points = np.column_stack([cols, rows, rng.uniform(0.3, 1, len(rows))]).astype(np.float64)
    start = np.array([[14.0, 17, 10, 4, 0.0], [28, 21, 10, 4, 0.0]])
    law = SizeLaw(9.0, 0.05, 2.0, 0.4)
    expected = reference.em_step(points, start, law, 0.5, 1e-4)
    em_step(points, start, law, 0.5, 1e-4, True)
    np.testing.assert_allclose(start, expected, atol=1e-9)


def test_normal_equations_are_the_slope_of_the_squared_residual():
    shape = (60, 60)
    mask = reference.paint(np.array([[28.0, 31, 14, 6, 0.1]]), shape).astype(np.float32)
    ellipses = np.array([[30.0, 30, 13, 5, 0.05], [36, 33, 12, 5, 0.0]])
    soft, background = 0.7, 0.4
    grad, hess = np.empty(5), np.empty((5, 5))
    free, window = np.empty(shape), np.array([0, 59, 0, 59])
    free_of(ellipses, soft_edges(ellipses, soft), 0, soft, window, free)
    np.testing.assert_allclose(1 - free, reference.soft_union(ellipses[1:], shape, soft, ellipses[1:, 3]), atol=8e-3)
    match = Match(0.7, background, soft)
    squared = normal_equations(mask, ellipses[0], window, free, match, grad, hess, True)
    assert normal_equations(mask, ellipses[0], window, free, match, grad, hess, False) == squared
    weight = mask + background * (1 - mask)

    def cost(step: np.ndarray) -> float:
        e = ellipses.copy()
        e[0, [0, 1, 4]] += step[[0, 1, 4]]
        e[0, 2:4] *= np.exp(step[2:4])
        return float((0.5 * weight * (mask - reference.soft_union(e, shape, soft, ellipses[:, 3])) ** 2).sum())

    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-5
        slope = (cost(step) - cost(-step)) / 2e-5
        assert -grad[i] == pytest.approx(slope, rel=0.02, abs=0.05)
    assert np.linalg.eigvalsh(hess).min() > -1e-9


@pytest.mark.parametrize(("looseness", "common"), [(1.0, 0.0), (3.0, 8 / 17)])
def test_refine_agrees_with_its_twin(looseness, common):
    mask = reference.paint(np.array([[20.0, 20, 12, 4.5, 0.1], [27, 22, 11, 4, -0.1]]), SHAPE).astype(np.float32)
    start = np.array([[18.5, 18, 10, 4, 0.0], [28, 24, 12, 4.5, 0.05]])
    law, spread, limits = SizeLaw(9.0, 0.05, 2.0, 0.4), np.array([0.12, 0.12, 0.1, 0.7]), np.array([0.34, 0.35])
    for members in [0, 1], [1]:
        moved = start.copy()
        expected = reference.refine(mask, start, law, spread, limits, 0.4, 0.7, 3, members, looseness)
        refine(mask, moved, np.array(members), law, Prior(0.12, 0.1, 0.34, 0.35, common), Match(0.7, 0.4, 0.7), 3)
        np.testing.assert_allclose(moved, expected, atol=1e-6)
    np.testing.assert_array_equal(moved[0], start[0])


@pytest.mark.parametrize("count", [1, 5])
def test_explained_agrees_with_its_twin(count):
    rng = np.random.default_rng(11)
    mask, ellipses = random_mask(rng), random_ellipses(rng, count)
    expected = reference.explained(mask, ellipses, 0.4, 0.7)
    assert explained(mask, ellipses, Match(0.7, 0.4, 0.7)) == pytest.approx(expected, abs=1e-6)


def test_an_ellipse_explains_half_of_the_foreground_in_it_and_loses_background():
    match, ellipse = Match(0.7, 0.4, 0.05), np.array([[100.0, 100, 60, 20, 0.0]])
    full, area = np.ones((200, 200), dtype=np.float32), math.pi * 60 * 20
    assert explained(full, ellipse, match) == pytest.approx(0.5 * area, rel=0.02)
    assert explained(0 * full, ellipse, match) == pytest.approx(-0.5 * 0.4 * area, rel=0.02)
    assert explained(full, ellipse[:0], match) == 0.0


def test_shown_rows_agree_with_their_twin():
    rng = np.random.default_rng(3)
    mask, ellipses, order = random_mask(rng), random_ellipses(rng, 5), np.array([3, 0, 1, 4, 2])
    limb, out = np.array([0.5, 1.0, 1.5, 2.0, 2.5]), np.zeros((5, 2))
    kernels.shown_rows(mask, ellipses, order, limb, 0.5, out)
    np.testing.assert_array_equal(out, reference.shown_rows(mask, ellipses, order.tolist(), limb, 0.5))


def test_propagate_agrees_with_its_twin():
    rng = np.random.default_rng(4)
    particles, noise = rng.normal(size=(6, 3, 7)), rng.normal(size=(6, 3, 7)).astype(np.float32)
    pull, push, fresh = rng.uniform(size=3), rng.uniform(size=3), rng.uniform(size=3)
    expected, surprise = particle_reference.propagate(particles, noise, 0.2, pull, push, 0.7, fresh)
    out = np.empty((6, 3))
    propagate(particles, noise, Transition(0.2, pull, push, 0.7, fresh), out)
    np.testing.assert_allclose(particles, expected)
    np.testing.assert_allclose(out, surprise, rtol=1e-6)


def test_copied_particles_agree_with_their_twin():
    rng = np.random.default_rng(5)
    particles, surprise, index = rng.normal(size=(6, 4, 7)), rng.normal(size=(6, 4)), rng.integers(0, 6, 6)
    members = np.array([1, 3])
    states, costs = particle_reference.copy_particles(particles, surprise, members, index)
    copy_particles(particles, surprise, members, index)
    np.testing.assert_array_equal(particles, states)
    np.testing.assert_array_equal(surprise, costs)


def test_region_sums_agree_with_their_twin():
    rng = np.random.default_rng(7)
    labels, moving = rng.integers(0, 3, (12, 15)).astype(np.int32), rng.uniform(size=(12, 15)) > 0.5
    sums, moved = np.zeros((3, 6)), np.zeros(3)
    region_sums(labels, moving, sums, moved)
    expected, expected_moved = reference.region_sums(labels, moving, 3)
    np.testing.assert_array_equal(sums[1:], expected[1:])
    np.testing.assert_array_equal(moved[1:], expected_moved[1:])


def test_systematic_draws_and_means_agree_with_their_twins():
    rng = np.random.default_rng(6)
    particles, weights, members = rng.normal(size=(40, 4, 7)), rng.uniform(size=40) ** 4, np.array([0, 2])
    weights /= weights.sum()
    index, states, radius = np.empty(40, np.int64), np.empty((2, 7)), np.array([0.5, 2.0])
    draw_systematically(weights, 0.3, index)
    np.testing.assert_array_equal(index, particle_reference.draw_systematically(weights, 0.3))
    mean_near(particles, members, 7, weights, radius, states)
    np.testing.assert_allclose(states, particle_reference.mean_near(particles, members, 7, weights, radius))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(-100, 100),
    st.floats(-100, 100),
    st.floats(0.5, 60),
    st.floats(0.5, 60),
    st.floats(-4, 4),
)
def test_ellipse_sum_stays_within_the_grid_for_any_ellipse(rows, cols, x, y, a, b, angle):
    prefix = kernels.row_prefix(np.ones((rows, cols), dtype=np.float32))
    total, area = kernels.ellipse_sum(prefix, x, y, a, b, angle)
    assert 0 <= area <= rows * cols + 1e-6
    assert total == pytest.approx(area, abs=1e-6)
