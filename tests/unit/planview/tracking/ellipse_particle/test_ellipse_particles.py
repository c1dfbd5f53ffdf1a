"""The particle filter on single steps that can be checked by hand."""

import math

import numpy as np
import pytest

from planview.tracking.ellipse_particle._kernels import ANGLE, LN_A, VX, X, Y
from planview.tracking.ellipse_particle.fit import painted
from planview.tracking.ellipse_particle.params import ParticleFilterParams
from planview.tracking.ellipse_particle.particles import ParticleFilter, ellipses_of
from planview.tracking.ellipse_particle.size import Size

SHAPE = (60, 80)
SIZE = Size(10.0, 0.0, 1.0, 0.4)
AREA = math.pi * 10 * 4
NOBODY = np.zeros(SHAPE, np.uint8)


def union(*places: tuple[float, float]) -> np.ndarray:
    return painted(np.array([[*place, 10.0, 4.0, 0.0] for place in places]), SHAPE).any(axis=0).view(np.uint8)


def filter_at(*places: tuple[float, float], speed: float = 1.0) -> ParticleFilter:
    """Objects around ellipses of the expected size, at 12 cells per metre."""
    params = ParticleFilterParams(particles=2000, speed_mps=speed)
    particles = ParticleFilter(params, np.random.default_rng(0))
    for place in places:
        particles.add(np.array([*place, 10.0, 4.0, 0.0]), SIZE, 12.0)
    return particles


def test_new_object_is_where_it_was_measured_and_may_walk_anywhere():
    (state,) = filter_at((30.0, 25.0)).particles.mean(axis=0)
    assert state[[X, Y]] == pytest.approx([30, 25], abs=0.1)
    assert filter_at((30.0, 25.0)).particles[..., VX].std() == pytest.approx(12.0, rel=0.1)


def test_prediction_moves_with_the_velocity_and_spreads_with_the_acceleration():
    particles = filter_at((30.0, 25.0), speed=1e-6)
    particles.particles[..., VX] = 10.0
    particles.predict(0.5, SIZE, np.array([12.0]))
    # Half of 2 m/s^2 over 0.5 s, squared, is 0.25 m: 3 cells; with a jitter of 0.36 cells and 0.4 of the start.
    assert particles.particles[..., X].mean() == pytest.approx(35, abs=0.3)
    assert particles.particles[..., X].std() == pytest.approx(math.hypot(3.0, 0.36, 0.4), rel=0.1)


def test_size_and_angle_return_to_what_is_expected():
    particles = filter_at((30.0, 25.0))
    particles.particles[..., LN_A : ANGLE + 1] = 0.3
    particles.predict(1.0, SIZE, np.array([12.0]))
    assert particles.particles[..., LN_A].mean() == pytest.approx(0.3 / math.e, abs=0.02)


def test_weighing_draws_an_object_to_its_measurement():
    particles = filter_at((30.0, 25.0))
    particles.predict(0.2, SIZE, np.array([12.0]))
    state = particles.weigh(0, union((33.0, 26.0)), NOBODY, SIZE, AREA)
    assert state[[X, Y]] == pytest.approx([33, 26], abs=0.7)
    assert particles.particles[:, 0, X].mean() == pytest.approx(33, abs=0.7)


def test_what_others_cover_draws_nobody():
    particles = filter_at((30.0, 25.0))
    particles.predict(0.2, SIZE, np.array([12.0]))
    before = particles.particles[:, 0, X].mean()
    particles.weigh(0, union((33.0, 25.0)), union((33.0, 25.0)), SIZE, AREA)
    # Its place outside the measured area costs something, and the measurement is another's.
    assert particles.particles[:, 0, X].mean() > before
    free = particles.weigh(0, union((36.0, 25.0), (27.0, 25.0)), union((36.0, 25.0)), SIZE, AREA)
    assert free[X] < 33


def test_objects_outside_every_measurement_are_unlikely():
    particles = filter_at((30.0, 25.0))
    particles.particles[:1000, 0, X], particles.particles[1000:, 0, X] = 30.0, 60.0
    # Both halves cover as much of what is left, nothing; those in the measured area of the other cost nothing.
    particles.weigh(0, union((30.0, 25.0)), union((30.0, 25.0)), SIZE, AREA)
    assert (particles.particles[:, 0, X] < 45).mean() > 0.99


def test_kept_objects_keep_their_particles():
    particles = filter_at((10.0, 25.0), (30.0, 25.0), (50.0, 25.0))
    particles.keep(np.array([0, 2]))
    assert particles.particles[..., X].mean(axis=0) == pytest.approx([10, 50], abs=0.2)


def test_ellipses_of_states_have_the_expected_size_and_what_they_differ_by():
    state = np.array([[30.0, 20, 0, 0, math.log(1.2), 0.0, 0.1]])
    np.testing.assert_allclose(ellipses_of(state, SIZE), [[30, 20, 12, 4, 0.1]])
