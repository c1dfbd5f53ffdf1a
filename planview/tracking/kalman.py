"""Constant-velocity Kalman filter on the floor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F64

SPEED_STD_MPS = 1.0
"""Deviation of the velocity of a person who appears [m/s]."""


class FloorKalman(NamedTuple):
    """Position and velocity of one person.

    Attributes:
        mean: (4,) float64 x, y [m], vx, vy [m/s].
        covariance: (4, 4) float64.
    """

    mean: F64
    covariance: F64

    @staticmethod
    def at(x_m: float, y_m: float, position_std_m: float) -> FloorKalman:
        """Standing at a place; how fast it will move is unknown."""
        return FloorKalman.from_measurement(np.array([x_m, y_m]), position_std_m**2 * np.eye(2))

    @staticmethod
    def from_measurement(xy_m: F64, noise: F64, speed_std_mps: float = SPEED_STD_MPS) -> FloorKalman:
        """Standing at a measured position (2,) [m] with its covariance (2, 2) [m^2]; see ``at``."""
        covariance = np.diag([0.0, 0.0, speed_std_mps**2, speed_std_mps**2])
        covariance[:2, :2] = noise
        return FloorKalman(np.array([*xy_m, 0.0, 0.0]), covariance)

    @property
    def at_m(self) -> tuple[float, float]:
        """Position along x and y [m]."""
        x_m, y_m, _, _ = self.mean.tolist()
        return x_m, y_m

    @property
    def velocity_mps(self) -> tuple[float, float]:
        """Velocity along x and y [m/s]."""
        _, _, vx_mps, vy_mps = self.mean.tolist()
        return vx_mps, vy_mps

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position along the worse known axis [m]."""
        return math.sqrt(max(self.covariance[0, 0], self.covariance[1, 1]))

    @property
    def information(self) -> tuple[float, float, float]:
        """Inverse covariance of the position: along x, between x and y, along y [1/m^2]."""
        (xx, xy), (_, yy) = self.covariance[:2, :2].tolist()
        det = xx * yy - xy * xy
        return yy / det, -xy / det, xx / det

    def log_prior(self, xy_m: F64) -> float:
        """Logarithm of the density of the position (2,) [m], over that of the likeliest one."""
        off = xy_m - self.mean[:2]
        return -0.5 * float(off @ _inverse(self.covariance[:2, :2]) @ off)

    def predict(self, dt_s: float, acceleration_std_mps2: float) -> FloorKalman:
        """Move on for dt_s with a random acceleration that is constant over it."""
        step = np.eye(4)
        step[[0, 1], [2, 3]] = dt_s
        variance = acceleration_std_mps2**2
        push = np.zeros((4, 4))
        push[[0, 1], [0, 1]] = variance * (0.25 * dt_s**4)
        push[[0, 1, 2, 3], [2, 3, 0, 1]] = variance * (0.5 * dt_s**3)
        push[[2, 3], [2, 3]] = variance * dt_s**2
        covariance = step @ self.covariance @ step.T + push
        return FloorKalman(step @ self.mean, covariance)

    def update(self, x_m: float, y_m: float, position_std_m: float) -> FloorKalman:
        """Take in a measured position."""
        return self.correct(np.array([x_m, y_m]), position_std_m**2 * np.eye(2))

    def correct(self, xy_m: F64, noise: F64) -> FloorKalman:
        """Take in a measured position (2,) [m] with its covariance (2, 2) [m^2]."""
        innovation = self.covariance[:2, :2] + noise
        gain = self.covariance[:, :2] @ _inverse(innovation)
        covariance = self.covariance - gain @ innovation @ gain.T
        return FloorKalman(self.mean + gain @ (xy_m - self.mean[:2]), 0.5 * (covariance + covariance.T))

    def correct_to(self, xy_m: F64, noise: F64, fastest_mps: float = math.inf) -> FloorKalman:
        """Take in the measurement that makes ``xy_m`` the likeliest position, no faster than ``fastest_mps``.

        A search for the likeliest position that has seen this prediction ends on the place of the posterior.
        """
        measured = xy_m + noise @ (_inverse(self.covariance[:2, :2]) @ (xy_m - self.mean[:2]))
        mean, covariance = self.correct(measured, noise)
        speed_mps = float(np.hypot(mean[2], mean[3]))
        mean[2:] *= min(1.0, fastest_mps / max(speed_mps, 1e-6))
        return FloorKalman(mean, covariance)

    def move_to(self, x_m: float, y_m: float) -> FloorKalman:
        """Jump to another place, velocity and covariance unchanged (re-centering, Harville 2002, section 4)."""
        return FloorKalman(np.array([x_m, y_m, *self.mean[2:]]), self.covariance)

    def slow_down(self, dt_s: float, time_constant_s: float) -> FloorKalman:
        """Lose speed: hardly any person keeps walking straight for long."""
        mean = self.mean.copy()
        mean[2:] *= math.exp(-dt_s / time_constant_s)
        return FloorKalman(mean, self.covariance)


def _inverse(matrix: F64) -> F64:
    """Inverse of a (2, 2) matrix, without the tenth of a millisecond that numpy takes."""
    (a, b), (c, d) = matrix.tolist()
    return np.asarray(np.array([[d, -b], [-c, a]]) / (a * d - b * c))
