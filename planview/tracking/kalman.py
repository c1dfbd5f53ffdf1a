"""Constant-velocity Kalman filter on the floor."""

from __future__ import annotations

import math
from typing import NamedTuple


class PositionNoise(NamedTuple):
    """Covariance of a measured floor position [m^2]: along x, between x and y, along y."""

    xx: float
    xy: float
    yy: float

    @staticmethod
    def isotropic(std_m: float) -> PositionNoise:
        """The same deviation [m] in every direction."""
        return PositionNoise(std_m**2, 0.0, std_m**2)

    def scaled(self, factor: float) -> PositionNoise:
        """With all deviations multiplied by a factor."""
        return PositionNoise(factor**2 * self.xx, factor**2 * self.xy, factor**2 * self.yy)


class FloorKalman(NamedTuple):
    """Position and velocity of one person.

    Plain floats, not arrays: the filter runs per person and frame, where array overhead would dominate. With isotropic
    noise the cross terms stay exactly zero, and both axes have one covariance.

    Attributes:
        x_m, y_m: position [m].
        vx_mps, vy_mps: velocity [m/s].
        c_xx, c_xy, c_yy: covariance of the position.
        c_xu, c_xv, c_yu, c_yv: covariance of position (x, y) and velocity (u, v).
        c_uu, c_uv, c_vv: covariance of the velocity.
    """

    x_m: float
    y_m: float
    vx_mps: float
    vy_mps: float
    c_xx: float
    c_xy: float
    c_yy: float
    c_xu: float
    c_xv: float
    c_yu: float
    c_yv: float
    c_uu: float
    c_uv: float
    c_vv: float

    @staticmethod
    def at(x_m: float, y_m: float, position_std_m: float, speed_std_mps: float) -> FloorKalman:
        """Standing at a place; how fast it will move is unknown."""
        return FloorKalman.measured(x_m, y_m, PositionNoise.isotropic(position_std_m), speed_std_mps)

    @staticmethod
    def measured(x_m: float, y_m: float, noise: PositionNoise, speed_std_mps: float) -> FloorKalman:
        """As ``at``, with a measured position's covariance."""
        speed = speed_std_mps**2
        return FloorKalman(
            x_m, y_m, 0.0, 0.0, noise.xx, noise.xy, noise.yy, 0.0, 0.0, 0.0, 0.0, speed, 0.0, speed,
        )  # fmt: skip

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position along the worse known axis [m]."""
        return math.sqrt(max(self.c_xx, self.c_yy))

    def predicted(self, dt_s: float, acceleration_std_mps2: float) -> FloorKalman:
        """After dt with a random acceleration that is constant over dt."""
        q, s = acceleration_std_mps2**2, self
        return FloorKalman(
            s.x_m + dt_s * s.vx_mps,
            s.y_m + dt_s * s.vy_mps,
            s.vx_mps,
            s.vy_mps,
            s.c_xx + 2 * dt_s * s.c_xu + dt_s**2 * s.c_uu + q * dt_s**4 / 4,
            s.c_xy + dt_s * (s.c_xv + s.c_yu) + dt_s**2 * s.c_uv,
            s.c_yy + 2 * dt_s * s.c_yv + dt_s**2 * s.c_vv + q * dt_s**4 / 4,
            s.c_xu + dt_s * s.c_uu + q * dt_s**3 / 2,
            s.c_xv + dt_s * s.c_uv,
            s.c_yu + dt_s * s.c_uv,
            s.c_yv + dt_s * s.c_vv + q * dt_s**3 / 2,
            s.c_uu + q * dt_s**2,
            s.c_uv,
            s.c_vv + q * dt_s**2,
        )

    def updated(self, x_m: float, y_m: float, position_std_m: float) -> FloorKalman:
        """With a measured position."""
        return self.corrected(x_m, y_m, PositionNoise.isotropic(position_std_m))

    @property
    def information(self) -> tuple[float, float, float]:
        """Inverse covariance of the position: along x, between x and y, along y [1/m^2]."""
        det = self.c_xx * self.c_yy - self.c_xy**2
        return self.c_yy / det, -self.c_xy / det, self.c_xx / det

    def found_at(self, x_m: float, y_m: float, noise: PositionNoise, fastest_mps: float) -> FloorKalman:
        """After a search for the likeliest position that has seen this prediction, no faster than people are.

        The search's place is that of the posterior: the measurement is what makes it so.
        """
        xx, xy, yy = self.information
        ox, oy = x_m - self.x_m, y_m - self.y_m
        gx, gy = xx * ox + xy * oy, xy * ox + yy * oy
        found = self.corrected(x_m + noise.xx * gx + noise.xy * gy, y_m + noise.xy * gx + noise.yy * gy, noise)
        slower = min(1.0, fastest_mps / max(math.hypot(found.vx_mps, found.vy_mps), 1e-6))
        return found._replace(vx_mps=slower * found.vx_mps, vy_mps=slower * found.vy_mps)

    def corrected(self, x_m: float, y_m: float, noise: PositionNoise) -> FloorKalman:
        """With a measured position and its covariance: x, then what of y is independent of x."""
        if noise.xy == 0.0 and self.c_xy == self.c_xv == self.c_yu == self.c_uv == 0.0:
            return self._corrected_apart(x_m - self.x_m, y_m - self.y_m, noise)
        lean = noise.xy / noise.xx
        first = self._with(x_m - self.x_m, 1.0, 0.0, noise.xx)
        dx, dy = x_m - first.x_m, y_m - first.y_m
        return first._with(dy - lean * dx, -lean, 1.0, noise.yy - lean * noise.xy)

    def _corrected_apart(self, off_x_m: float, off_y_m: float, noise: PositionNoise) -> FloorKalman:
        """The same where x and y have nothing in common: what is multiplied by zero is left out."""
        s = self
        across, along = s.c_xx + noise.xx, s.c_yy + noise.yy
        gx, gu, gy, gv = s.c_xx / across, s.c_xu / across, s.c_yy / along, s.c_yv / along
        return FloorKalman(
            s.x_m + gx * off_x_m,
            s.y_m + gy * off_y_m,
            s.vx_mps + gu * off_x_m,
            s.vy_mps + gv * off_y_m,
            s.c_xx - gx * s.c_xx,
            0.0,
            s.c_yy - gy * s.c_yy,
            s.c_xu - gx * s.c_xu,
            0.0,
            0.0,
            s.c_yv - gy * s.c_yv,
            s.c_uu - gu * s.c_xu,
            0.0,
            s.c_vv - gv * s.c_yv,
        )

    def _with(self, off: float, hx: float, hy: float, variance: float) -> FloorKalman:
        """Scalar update with hx x + hy y, which was measured ``off`` from the prediction with a variance [m^2]."""
        s = self
        bx, by = hx * s.c_xx + hy * s.c_xy, hx * s.c_xy + hy * s.c_yy
        bu, bv = hx * s.c_xu + hy * s.c_yu, hx * s.c_xv + hy * s.c_yv
        innovation = hx * bx + hy * by + variance
        gx, gy, gu, gv = bx / innovation, by / innovation, bu / innovation, bv / innovation
        return FloorKalman(
            s.x_m + gx * off,
            s.y_m + gy * off,
            s.vx_mps + gu * off,
            s.vy_mps + gv * off,
            s.c_xx - gx * bx,
            s.c_xy - gx * by,
            s.c_yy - gy * by,
            s.c_xu - gx * bu,
            s.c_xv - gx * bv,
            s.c_yu - gy * bu,
            s.c_yv - gy * bv,
            s.c_uu - gu * bu,
            s.c_uv - gu * bv,
            s.c_vv - gv * bv,
        )

    def moved_to(self, x_m: float, y_m: float) -> FloorKalman:
        """At another place, velocity and covariance unchanged (re-centering, Harville 2002, section 4)."""
        return self._replace(x_m=x_m, y_m=y_m)

    def slowed(self, dt_s: float, time_constant_s: float) -> FloorKalman:
        """Velocity decayed: hardly any person keeps walking straight for long."""
        keep = math.exp(-dt_s / time_constant_s)
        return self._replace(vx_mps=keep * self.vx_mps, vy_mps=keep * self.vy_mps)
