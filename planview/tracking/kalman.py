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
    def at(x_m: float, y_m: float, position_std_m: float, speed_std_mps: float = SPEED_STD_MPS) -> FloorKalman:
        """Standing at a place; how fast it will move is unknown."""
        return FloorKalman.measured(np.array([x_m, y_m]), position_std_m**2 * np.eye(2), speed_std_mps)

    @staticmethod
    def measured(xy_m: F64, noise: F64, speed_std_mps: float = SPEED_STD_MPS) -> FloorKalman:
        """As ``at``, with a measured position (2,) [m] and its covariance (2, 2) [m^2]."""
        covariance = np.diag([0.0, 0.0, speed_std_mps**2, speed_std_mps**2])
        covariance[:2, :2] = noise
        return FloorKalman(np.array([*xy_m, 0.0, 0.0]), covariance)

    @property
    def x_m(self) -> float:
        """Position along x [m]."""
        return float(self.mean[0])

    @property
    def y_m(self) -> float:
        """Position along y [m]."""
        return float(self.mean[1])

    @property
    def vx_mps(self) -> float:
        """Velocity along x [m/s]."""
        return float(self.mean[2])

    @property
    def vy_mps(self) -> float:
        """Velocity along y [m/s]."""
        return float(self.mean[3])

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

    def predicted(self, dt_s: float, acceleration_std_mps2: float) -> FloorKalman:
        """After dt with a random acceleration that is constant over dt."""
        step = np.array([[1.0, 0.0, dt_s, 0.0], [0.0, 1.0, 0.0, dt_s], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        place, both, speed = (acceleration_std_mps2**2 * q for q in (0.25 * dt_s**4, 0.5 * dt_s**3, dt_s**2))
        push = np.array(
            [[place, 0.0, both, 0.0], [0.0, place, 0.0, both], [both, 0.0, speed, 0.0], [0.0, both, 0.0, speed]]
        )
        covariance = step @ self.covariance @ step.T + push
        return FloorKalman(step @ self.mean, covariance)

    def updated(self, x_m: float, y_m: float, position_std_m: float) -> FloorKalman:
        """With a measured position."""
        return self.corrected(np.array([x_m, y_m]), position_std_m**2 * np.eye(2))

    def corrected(self, xy_m: F64, noise: F64) -> FloorKalman:
        """With a measured position (2,) [m] and its covariance (2, 2) [m^2]."""
        innovation = self.covariance[:2, :2] + noise
        gain = self.covariance[:, :2] @ _inverse(innovation)
        covariance = self.covariance - gain @ innovation @ gain.T
        return FloorKalman(self.mean + gain @ (xy_m - self.mean[:2]), 0.5 * (covariance + covariance.T))

    def found_at(self, xy_m: F64, noise: F64, fastest_mps: float = math.inf) -> FloorKalman:
        """After a search for the likeliest position that has seen this prediction, no faster than ``fastest_mps``.

        The search's place is that of the posterior: the measurement is what makes it so.
        """
        measured = xy_m + noise @ (_inverse(self.covariance[:2, :2]) @ (xy_m - self.mean[:2]))
        mean, covariance = self.corrected(measured, noise)
        mean[2:] *= min(1.0, fastest_mps / max(float(np.hypot(mean[2], mean[3])), 1e-6))
        return FloorKalman(mean, covariance)

    def moved_to(self, x_m: float, y_m: float) -> FloorKalman:
        """At another place, velocity and covariance unchanged (re-centering, Harville 2002, section 4)."""
        return FloorKalman(np.array([x_m, y_m, *self.mean[2:]]), self.covariance)

    def slowed(self, dt_s: float, time_constant_s: float) -> FloorKalman:
        """Velocity decayed: hardly any person keeps walking straight for long."""
        return FloorKalman(self.mean * np.array([1.0, 1.0, *[math.exp(-dt_s / time_constant_s)] * 2]), self.covariance)


def _inverse(matrix: F64) -> F64:
    """Of a (2, 2) matrix, without the tenth of a millisecond that numpy takes."""
    (a, b), (c, d) = matrix.tolist()
    return np.asarray(np.array([[d, -b], [-c, a]]) / (a * d - b * c), dtype=np.float64)
