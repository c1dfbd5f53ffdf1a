"""Rauch-Tung-Striebel smoothing of a path with the trackers' constant-velocity model."""

from __future__ import annotations

import numpy as np

from calib.types import F64, Bool
from planview.offline.params import RefineParams
from planview.tracking.kalman import FloorKalman


def smoothed(times_s: F64, xy_m: F64, measured: Bool, params: RefineParams) -> tuple[F64, F64]:
    """Positions and velocities from the measurements before and after (Rauch, Tung, Striebel 1965).

    Args:
        times_s: (N,) rising times [s].
        xy_m: (N, 2) positions [m]; used where measured.
        measured: (N,); the first must be.
    Returns:
        (N, 2) positions [m] and (N, 2) velocities [m/s].
    """
    filtered, predicted = _forward(times_s, xy_m, measured, params)
    states = np.array([[s.x_m, s.y_m, s.vx_mps, s.vy_mps] for s in filtered]).reshape(-1, 2, 2)
    for k in range(len(filtered) - 2, -1, -1):
        ahead = predicted[k + 1]
        gain = _gain(filtered[k], ahead, float(times_s[k + 1] - times_s[k]))
        states[k] += gain @ (states[k + 1] - [[ahead.x_m, ahead.y_m], [ahead.vx_mps, ahead.vy_mps]])
    return states[:, 0], states[:, 1]


def _forward(
    times_s: F64, xy_m: F64, measured: Bool, params: RefineParams
) -> tuple[list[FloorKalman], list[FloorKalman]]:
    """The filter after, and before, the measurement of every row."""
    state = FloorKalman.at(float(xy_m[0, 0]), float(xy_m[0, 1]), params.position_std_m, params.speed_std_mps)
    filtered, predicted = [state], [state]
    for k in range(1, len(times_s)):
        state = state.predicted(float(times_s[k] - times_s[k - 1]), params.acceleration_std_mps2)
        predicted.append(state)
        if measured[k]:
            state = state.updated(float(xy_m[k, 0]), float(xy_m[k, 1]), params.position_std_m)
        filtered.append(state)
    return filtered, predicted


def _gain(now: FloorKalman, ahead: FloorKalman, dt_s: float) -> F64:
    """(2, 2) P_k F^T P_{k+1|k}^-1 of position and velocity: the noise is isotropic, so that x stands for both axes."""
    now_cov = np.array([[now.c_xx, now.c_xu], [now.c_xu, now.c_uu]])
    ahead_cov = np.array([[ahead.c_xx, ahead.c_xu], [ahead.c_xu, ahead.c_uu]])
    transition = np.array([[1.0, dt_s], [0.0, 1.0]])
    return np.asarray(np.linalg.solve(ahead_cov, transition @ now_cov).T)
