"""Facing of a body: its silhouette shows an axis, and the direction of walking shows which end of it is ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calib.types import F64
from planview.tracking import body
from planview.tracking.body import FACINGS
from planview.tracking.kalman import FloorKalman

DIRECTIONS_RAD = np.arange(FACINGS) * (2.0 * math.pi / FACINGS)
"""Middles of the sectors of a distribution, counterclockwise from x [rad]."""
STANDING_TURN_RAD2_PS = 4.0
"""Variance of the turn within a second of somebody who stands [rad^2/s]: who stops turns by up to half a turn, and a
distribution that excludes it stays wrong. Walkers turn as slowly as bodies do (``body.TURNING_RAD2_PS``)."""
OTHER_SHAPE = 0.1
"""Share of observations whose silhouette shows nothing of the axis: arms, bags, neighbours (our choice)."""
OTHER_WAY = 0.02
"""Share of a walk that goes sideways or backwards (our choice)."""
STEP_FRESH = 0.5
"""How independent directions of walking are compared with silhouettes: a step back or aside takes half a second, twice
as long as errors of a silhouette stay the same (``PeopleParams.errors_s``)."""
ANY_FACING_VAR = math.pi**2 / 3.0
"""Variance of a direction that can be any [rad^2]."""
FACING_STD_MAX_RAD = 1.0
"""Facing is reported when the deviation of its axis is smaller [rad]."""
LEANING_M2_PS = 0.02
"""Variance of the change of a lean within a second [m^2/s]."""


class Gait(NamedTuple):
    """Movement of a person, as far as it shows where the chest points.

    Attributes:
        still: 0 for a fast walk straight ahead; towards 1 for standing or strolling, which goes to any side.
        heading_rad: direction of walking.
        concentration: of the facing about that direction [1/rad^2].
    """

    still: float
    heading_rad: float
    concentration: float

    @staticmethod
    def of(kalman: FloorKalman) -> Gait:
        """Gait of somebody with this velocity."""
        speed_var = float(kalman.covariance[2, 2] + kalman.covariance[3, 3])
        spread = body.STROLL_MPS**2 + speed_var
        vx_mps, vy_mps = kalman.velocity_mps
        still = spread / (spread + max(vx_mps**2 + vy_mps**2, 1e-6))
        concentration = 1.0 / (body.SIDEWARD_RAD**2 + still / (1.0 - still))
        return Gait(still, math.atan2(vy_mps, vx_mps), concentration)


class FacingDistribution(NamedTuple):
    """Probability of each direction in which a chest may point.

    Front and back look the same, and so do a turn through a narrow silhouette and one back from it: probability leaks
    to the other end of the axis with each turn that may have been one or the other, and with time unobserved.

    Attributes:
        share: (FACINGS,) float64, probability of each sector around DIRECTIONS_RAD.
    """

    share: F64

    @staticmethod
    def uniform() -> FacingDistribution:
        """Any direction is as likely as any other."""
        return FacingDistribution(np.full(FACINGS, 1.0 / FACINGS))

    def predict(self, dt_s: float, still: float) -> FacingDistribution:
        """Spread by random turns for dt_s, with the heat kernel on the circle.

        Args:
            still: see ``Gait``.
        """
        harmonics = np.arange(FACINGS // 2 + 1)
        turning = (1.0 - still) * body.TURNING_RAD2_PS + still * STANDING_TURN_RAD2_PS
        decay = np.exp(-0.5 * turning * dt_s * harmonics**2)
        spectrum = np.fft.rfft(self.share) * decay
        share = np.maximum(np.fft.irfft(spectrum, FACINGS), 0.0)
        return FacingDistribution(share / share.sum())

    def observe(self, log_ratios: F64, fresh: float, gait: Gait) -> FacingDistribution:
        """Multiply by the likelihood of a silhouette and of the direction of walking.

        Args:
            log_ratios: (FACINGS / 2,) log-likelihood ratios of the first half of the directions; the others look alike.
            fresh: how much of the observation is independent of the ones before, 0 to 1.
        """
        likely = np.exp(log_ratios - log_ratios.max())
        shape = np.tile((1.0 - OTHER_SHAPE) * likely + OTHER_SHAPE * likely.mean(), 2)
        aside = np.sin(0.5 * (DIRECTIONS_RAD - gait.heading_rad))
        ahead = np.exp(-2.0 * gait.concentration * aside**2)
        share = self.share * (shape * (ahead + OTHER_WAY) ** STEP_FRESH) ** fresh
        return FacingDistribution(share / share.sum())

    @property
    def axis_var(self) -> float:
        """Variance of the axis, whichever end of it is ahead [rad^2]."""
        return -0.5 * math.log(max(abs(self._axis), 1e-3))

    def near(self, facing_rad: float) -> tuple[float, float]:
        """Mean of the directions within a right angle of one [rad], and their probability."""
        ahead = np.cos(DIRECTIONS_RAD - facing_rad)
        share = self.share * np.where(np.abs(ahead) < 1e-6, 0.5, ahead > 0.0)
        return float(np.angle(share @ np.exp(1j * DIRECTIONS_RAD))), float(share.sum())

    @property
    def best(self) -> tuple[float, float]:
        """Likelier end of the axis: its direction [rad] and its probability, 0.5 to 1."""
        axis = 0.5 * float(np.angle(self._axis))
        front = self.near(axis)
        back = self.near(axis + math.pi)
        return max(front, back, key=lambda end: end[1])

    @property
    def _axis(self) -> complex:
        """Mean of the doubled direction as a complex number: 1 in size where the axis is certain."""
        return complex(self.share @ np.exp(2j * DIRECTIONS_RAD))


@dataclass(eq=False)
class Stance:
    """Direction of a person's chest, and how far the head is before the feet.

    Attributes:
        facing_rad, facing_var: of the pose that explains best, counterclockwise from x, and the variance within which
            the next pose is searched.
        facings: probability of each direction.
        lean_m, lean_var: head before the feet [m], and its variance.
    """

    facing_rad: float = 0.0
    lean_m: float = 0.0
    facing_var: float = ANY_FACING_VAR
    facings: FacingDistribution = field(default_factory=FacingDistribution.uniform)
    lean_var: float = body.LEAN_STD_M**2

    @property
    def backward(self) -> float:
        """Probability that the pose is back to front."""
        return 1.0 - self.facings.near(self.facing_rad)[1]

    @property
    def reported_facing(self) -> tuple[float, float]:
        """Direction of the chest, -180 to 180 [deg], and the probability that this is not back to front; NaN while the
        axis is not known."""
        if self.facings.axis_var >= FACING_STD_MAX_RAD**2:
            return math.nan, math.nan
        facing_rad, probability = self.facings.best
        return math.degrees(facing_rad), probability

    def predict(self, dt_s: float, still: float) -> None:
        """Widen facing and lean by what may change in dt_s; ``still``: see ``Gait``."""
        self.facings = self.facings.predict(dt_s, still)
        self.facing_var = min(self.facing_var + body.TURNING_RAD2_PS * dt_s, ANY_FACING_VAR)
        self.lean_var = min(self.lean_var + LEANING_M2_PS * dt_s, body.LEAN_STD_M**2)

    def measure(self, pose: F64, log_ratios: F64, curvature: F64, fresh: float, gait: Gait) -> None:
        """Take over facing and lean of the pose that explains best.

        Args:
            pose: (5,) see ``Person.pose``.
            log_ratios: (FACINGS / 2,) of the body there by its facing.
            curvature: (2,) of the log-likelihood ratio in the facing and in the lean.
            fresh: independent share of this frame.
        """
        if not log_ratios.any():  # seen so that a body looks the same from everywhere
            return
        before_rad = self.facing_rad
        self.facings = self.facings.observe(log_ratios, fresh, gait)
        self.facing_rad = math.remainder(float(pose[3]), 2.0 * math.pi)
        facing_information = max(float(curvature[0]), 0.0) + gait.concentration
        self.facing_var = 1.0 / (1.0 / self.facing_var + fresh * facing_information)
        lean_information = fresh * max(float(curvature[1]), 0.0)
        gain = 1.0 - 1.0 / (1.0 + lean_information * self.lean_var)
        lean_m = self.lean_m * math.cos(self.facing_rad - before_rad)
        self.lean_m = max(lean_m + gain * (float(pose[4]) - lean_m), 0.0)
        self.lean_var *= 1.0 - gain
