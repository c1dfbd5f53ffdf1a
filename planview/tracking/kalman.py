"""Constant-velocity Kalman filter on the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class FloorKalman:
    """Position and velocity of one person; both axes share one covariance, since both see the same noise.

    Plain floats, not arrays: the filter runs per person and frame, where array overhead would dominate.

    Attributes:
        x_m, y_m: position [m].
        vx_mps, vy_mps: velocity [m/s].
        p_xx, p_xv, p_vv: covariance of (position, velocity) along either axis.
    """

    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    p_xx: float
    p_xv: float
    p_vv: float

    @staticmethod
    def at(x_m: float, y_m: float, position_std_m: float, speed_std_mps: float) -> FloorKalman:
        """Standing at a place; how fast it will move is unknown."""
        return FloorKalman(x_m, y_m, 0.0, 0.0, position_std_m**2, 0.0, speed_std_mps**2)

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position along either axis [m]."""
        return math.sqrt(self.p_xx)

    def predicted(self, dt_s: float, acceleration_std_mps2: float) -> FloorKalman:
        """After dt with a random acceleration that is constant over dt."""
        q = acceleration_std_mps2**2
        return FloorKalman(
            self.x_m + dt_s * self.vx_mps,
            self.y_m + dt_s * self.vy_mps,
            self.vx_mps,
            self.vy_mps,
            self.p_xx + 2 * dt_s * self.p_xv + dt_s**2 * self.p_vv + q * dt_s**4 / 4,
            self.p_xv + dt_s * self.p_vv + q * dt_s**3 / 2,
            self.p_vv + q * dt_s**2,
        )

    def updated(self, x_m: float, y_m: float, position_std_m: float) -> FloorKalman:
        """With a measured position."""
        innovation_variance = self.p_xx + position_std_m**2
        gain_x, gain_v = self.p_xx / innovation_variance, self.p_xv / innovation_variance
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return FloorKalman(
            self.x_m + gain_x * dx,
            self.y_m + gain_x * dy,
            self.vx_mps + gain_v * dx,
            self.vy_mps + gain_v * dy,
            self.p_xx - gain_x * self.p_xx,
            self.p_xv - gain_x * self.p_xv,
            self.p_vv - gain_v * self.p_xv,
        )

    def moved_to(self, x_m: float, y_m: float) -> FloorKalman:
        """At another place, velocity and covariance unchanged (re-centering, Harville 2002, section 4)."""
        return replace(self, x_m=x_m, y_m=y_m)

    def slowed(self, dt_s: float, time_constant_s: float) -> FloorKalman:
        """Velocity decayed: nobody is known to keep walking straight for long."""
        keep = math.exp(-dt_s / time_constant_s)
        return replace(self, vx_mps=keep * self.vx_mps, vy_mps=keep * self.vy_mps)
