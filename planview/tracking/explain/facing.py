"""Which way a body faces, as a probability of every direction: its silhouette shows an axis, and the way that somebody
walks shows which end of it is ahead."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F64
from planview.tracking.body import FACINGS, TURNING_RAD2_PS

DIRECTIONS_RAD = np.arange(FACINGS) * (2.0 * math.pi / FACINGS)
"""Middles of the sectors of a belief, counterclockwise from x [rad]."""
TURNED_RAD2_PS = 4.0
"""Variance of the turn within a second of somebody who stands [rad^2/s]: who stops turns by up to half a turn, and a
belief that excludes it stays wrong. Walkers turn as slowly as bodies do (``body.TURNING_RAD2_PS``)."""
OTHER_SHAPE = 0.1
"""Share of observations whose silhouette says nothing of the axis: arms, bags, neighbours (our choice)."""
OTHER_WAY = 0.02
"""Share of a walk that goes sideways or backwards (our choice)."""
STEP_FRESH = 0.5
"""How independent the ways of going are next to silhouettes: a step back or aside takes half a second, twice as long as
errors of a silhouette stay the same (``PeopleParams.errors_s``)."""


class FacingBelief(NamedTuple):
    """What is known of where a chest points.

    Front and back look the same, and so do a turn through a narrow silhouette and one back from it: the probability
    leaks to the other end of the axis with each turn that may have been one or the other, and with time unobserved.

    Attributes:
        share: (FACINGS,) float64, probability of each sector around DIRECTIONS_RAD.
    """

    share: F64

    @staticmethod
    def unknown() -> FacingBelief:
        """Any direction is as likely as any other."""
        return FacingBelief(np.full(FACINGS, 1.0 / FACINGS))

    def predicted(self, dt_s: float, still: float) -> FacingBelief:
        """After dt in which the body turned at random: the heat kernel on the circle.

        Args:
            still: how surely the person stands, 0 to 1.
        """
        harmonics = np.arange(FACINGS // 2 + 1)
        turned = (1.0 - still) * TURNING_RAD2_PS + still * TURNED_RAD2_PS
        decay = np.exp(-0.5 * turned * dt_s * harmonics**2)
        share = np.maximum(np.fft.irfft(np.fft.rfft(self.share) * decay, FACINGS), 0.0)
        return FacingBelief(share / share.sum())

    def seen(self, log_ratios: F64, fresh: float, walk: float, heading: float) -> FacingBelief:
        """With a silhouette, and the way that a walker goes.

        Args:
            log_ratios: (FACINGS / 2,) log-likelihood ratios of the first half of the directions; the others look alike.
            fresh: how much of the observation is independent of the ones before, 0 to 1.
            walk, heading: concentration of the facing about the direction of walking, and that direction [rad].
        """
        likely = np.exp(log_ratios - log_ratios.max())
        shape = np.tile((1.0 - OTHER_SHAPE) * likely + OTHER_SHAPE * likely.mean(), 2)
        ahead = np.exp(-2.0 * walk * np.sin(0.5 * (DIRECTIONS_RAD - heading)) ** 2)
        share = self.share * (shape * (ahead + OTHER_WAY) ** STEP_FRESH) ** fresh
        return FacingBelief(share / share.sum())

    @property
    def axis_var(self) -> float:
        """Variance of the axis, whichever end of it is ahead [rad^2]."""
        return -0.5 * math.log(max(abs(self._axis), 1e-3))

    def near(self, facing: float) -> tuple[float, float]:
        """The mean of the directions within a right angle of one [rad], and their probability."""
        ahead = np.cos(DIRECTIONS_RAD - facing)
        share = self.share * np.where(np.abs(ahead) < 1e-6, 0.5, ahead > 0.0)
        return float(np.angle(share @ np.exp(1j * DIRECTIONS_RAD))), float(share.sum())

    @property
    def best(self) -> tuple[float, float]:
        """The likelier end of the axis: its direction [rad] and its probability, 0.5 to 1."""
        axis = 0.5 * float(np.angle(self._axis))
        return max(self.near(axis), self.near(axis + math.pi), key=lambda end: end[1])

    @property
    def _axis(self) -> complex:
        """Mean of the doubled direction as a complex number: 1 in size where the axis is certain."""
        return complex(self.share @ np.exp(2j * DIRECTIONS_RAD))
