"""What speaks for the existence of objects and for their having left (section V)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from planview.tracking.ellipse_particle.params import ExistenceParams
from planview.tracking.lifecycle import Existence

OCCLUDED = 2.0
"""An object that shares its measurement is waited for so many times as long as one without any. Our choice."""
HIDDEN_S = 0.7
"""An object without measured area of its own for longer than this is reported as predicted only [s]. Our choice."""
GROUP = 4
"""So many people may enter at once: hardly any group of walkers is larger (Moussaid et al. 2010)."""
HALF_FULL, FILL_SPREAD = 0.5, 0.15
"""Foreground in a measured ellipse that speaks neither for nor against a body, and what it takes to speak fully: a
silhouette has 0.67, less what a step changes. Our choice."""
GAMMA_SHAPE = 4.0
"""Shape of the Gamma distribution of the time after which an object has left: 4 makes it a sum of four waits, with half
the mean as its deviation. Our choice."""


@dataclass
class ExistenceEvidence:
    """What speaks for and against the existence of one object.

    Attributes:
        who: its id and state.
        spawned_at: (x, y) of its first measurement [cells].
        log_odds: of being an object rather than a false alarm, while not confirmed.
        moved: it has left its first place, which no ghost of the background does.
        measured: measurements cover its ellipse in this frame.
        shares: they do, but older objects cover almost all of that too (occlusion).
        unmeasured_s: time since it last had measured area.
        shared_s: time for which it has shared; it runs back twice as fast, since two ellipses on one object take turns
            at having some area of their own.
    """

    who: Existence
    spawned_at: tuple[float, float]
    log_odds: float
    moved: bool = False
    measured: bool = True
    shares: bool = False
    unmeasured_s: float = 0.0
    shared_s: float = 0.0

    @property
    def probability(self) -> float:
        """That this is an object and not a false alarm."""
        return 1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, self.log_odds))))

    @property
    def observed(self) -> bool:
        """Measured, and not hidden behind an older object for so long that its place is only a prediction."""
        return self.measured and self.shared_s <= HIDDEN_S

    @property
    def waited_s(self) -> float:
        """Time without measured area, or without any of its own."""
        return max(self.unmeasured_s, self.shared_s)

    def update(self, measured: bool, own: bool, dt_s: float, confirmable: bool, params: ExistenceParams) -> None:
        """Take one frame into account.

        The number k of the n frames in which a new object is measured is binomial too, B(n, detection) for an object
        and B(n, repetition) for a false alarm; their ratio updates the odds. Frames in which it may be a piece of
        another do not speak for it: it would be confirmed in the frame in which that one leaves the view.

        Args:
            measured: measurements cover its ellipse.
            own: enough of that is covered by no older object.
            dt_s: time since the last frame [s].
            confirmable: nothing but time speaks against confirming it.
        """
        self.measured, self.shares = measured, measured and not own
        self.unmeasured_s = 0.0 if measured else self.unmeasured_s + dt_s
        self.shared_s = max(0.0, self.shared_s - 2 * dt_s) if own else self.shared_s + dt_s
        hit = measured and own
        if not self.who.confirmed and (confirmable or not hit):
            real = params.detection if hit else 1.0 - params.detection
            false = params.repetition if hit else 1.0 - params.repetition
            self.log_odds += math.log(real / false)

    def found(self) -> None:
        """It is measured again, at a place of its own."""
        self.measured, self.shares, self.unmeasured_s, self.shared_s = True, False, 0.0, 0.0


def spawn_log_odds(fill: float, candidates: int, params: ExistenceParams) -> float:
    """Logarithm of the odds that an uncovered measurement is an object.

    Its fill counts for or against it as much as a frame does in which it is measured again or not: a body fills two
    thirds of its ellipse and hardly less than half, scattered noise and outlines of ghosts do not.

    Of n uncovered measurements the number of objects is binomial, B(n, q) with q = entries / (entries + false
    alarms): each is an object with the prior probability q. A frame with many of them (a light changed, the camera
    shook) has more false alarms than the expected number, so that number is raised to all but ``GROUP`` of them.

    Args:
        fill: foreground share of the ellipse.
        candidates: number of uncovered measurements.
    """
    false_alarms = max(params.false_alarms, float(candidates - GROUP))
    solid = math.log(params.detection / params.repetition)
    return math.log(params.entries / false_alarms) + float(np.clip((fill - HALF_FULL) / FILL_SPREAD, -1.0, 1.0)) * solid


def departure(evidence: ExistenceEvidence, params: ExistenceParams) -> float:
    """Probability that an object has left: Gamma distributions of the times without measurement, and sharing.

    A tentative object has left when it is probably a false alarm.
    """
    if not evidence.who.confirmed:
        return 1.0 - evidence.probability if evidence.waited_s > 0.0 else 0.0
    unmeasured = gammainc(GAMMA_SHAPE, GAMMA_SHAPE * evidence.unmeasured_s / params.patience_s)
    shared = gammainc(GAMMA_SHAPE, GAMMA_SHAPE * evidence.shared_s / (OCCLUDED * params.patience_s))
    return float(max(unmeasured, shared))
