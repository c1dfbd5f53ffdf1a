"""The floor's Kalman filter against the matrix equations, and isotropic noise as its special case."""

import numpy as np
import pytest

from planview.tracking.kalman import FloorKalman, PositionNoise


def test_correlated_noise_gives_the_matrix_equations() -> None:
    kalman = FloorKalman.measured(0.0, 0.0, PositionNoise(0.04, 0.01, 0.09), 1.5)
    state, covariance = np.zeros(4), np.diag([0.04, 0.09, 2.25, 2.25])
    covariance[0, 1] = covariance[1, 0] = 0.01
    dt, noise = 0.1, np.array([[0.05, -0.02], [-0.02, 0.03]])
    forward, push = np.eye(4), np.vstack([np.eye(2) * dt**2 / 2, np.eye(2) * dt])
    forward[0, 2] = forward[1, 3] = dt
    for k in range(1, 20):
        measured = np.array([0.1 * k, -0.05 * k])
        state, covariance = forward @ state, forward @ covariance @ forward.T + 4.0 * push @ push.T
        gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + noise)
        state, covariance = state + gain @ (measured - state[:2]), covariance - gain @ covariance[:2]
        kalman = kalman.predicted(dt, 2.0).corrected(*measured, PositionNoise(0.05, -0.02, 0.03))
    np.testing.assert_allclose(kalman[:4], state, atol=1e-12)
    upper = [(0, 0), (0, 1), (1, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3)]
    np.testing.assert_allclose(kalman[4:], [covariance[index] for index in upper], atol=1e-12)


def test_isotropic_noise_keeps_the_axes_apart() -> None:
    kalman = FloorKalman.at(1.0, 2.0, 0.1, 1.0).predicted(0.1, 2.0).updated(1.1, 1.9, 0.05)
    assert (kalman.c_xy, kalman.c_xv, kalman.c_yu, kalman.c_uv) == (0.0, 0.0, 0.0, 0.0)
    assert (kalman.c_xx, kalman.c_xu, kalman.c_uu) == (kalman.c_yy, kalman.c_yv, kalman.c_vv)


def test_certain_direction_follows_the_measurement_and_the_other_does_not() -> None:
    kalman = FloorKalman.measured(0.0, 0.0, PositionNoise(1.0, 0.0, 1.0), 0.0)
    found = kalman.corrected(1.0, 1.0, PositionNoise(1e-9, 0.0, 1e9))
    assert (found.x_m, found.y_m) == pytest.approx((1.0, 0.0), abs=1e-6)


def test_noise_is_scaled_by_its_deviations() -> None:
    assert PositionNoise(1.0, 0.5, 4.0).scaled(2.0) == (4.0, 2.0, 16.0)


def test_kalman_learns_a_constant_velocity() -> None:
    state = FloorKalman.at(0.0, 0.0, 0.05, 1.0)
    for i in range(1, 40):
        state = state.predicted(0.1, 0.5).updated(0.1 * i, -0.05 * i, 0.05)
    assert (state.vx_mps, state.vy_mps) == pytest.approx((1.0, -0.5), abs=0.02)
    assert state.position_std_m < 0.05


def test_kalman_grows_uncertain_without_measurements() -> None:
    state = FloorKalman.at(0.0, 0.0, 0.05, 0.0)
    assert state.predicted(0.5, 2.0).position_std_m == pytest.approx(np.hypot(0.05, 2.0 * 0.5**2 / 2))


def test_the_place_that_a_search_found_is_that_of_the_posterior() -> None:
    noise = PositionNoise(0.05, -0.02, 0.03)
    kalman = FloorKalman.measured(1.0, 2.0, PositionNoise(0.04, 0.01, 0.02), 1.0).predicted(0.1, 2.0)
    measured = kalman.corrected(1.2, 1.9, noise)
    found = kalman.found_at(measured.x_m, measured.y_m, noise, 2.5)
    assert found == pytest.approx(measured)
    fast = kalman.found_at(9.0, 2.0, noise, 0.5)
    assert np.hypot(fast.vx_mps, fast.vy_mps) == pytest.approx(0.5)
