"""Births and deaths of objects (section V)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from planview.tracking.ellipse_particle.params import LifeParams
from planview.trajectories.state import State

HIDDEN_S = 0.7
"""An object without measured area of its own for longer than this is reported as predicted only [s]."""
GROUP = 4
"""So many people may enter at once: hardly any group of walkers is larger (Moussaid et al. 2010)."""
HALF_FULL, FILL_SPREAD = 0.5, 0.15
"""Foreground in a measured ellipse that speaks neither for nor against a body, and what it takes to speak fully: a
silhouette has 0.67, less what a step changes. Our choice."""


@dataclass
class Life:
    """What is known of one object's existence.

    Attributes:
        track_id: positive, unique in a run.
        birthplace: (x, y) of its first measurement [cells].
        moved: it has left its birthplace, which no ghost of the background does.
        confirmed: believed once, and so for ever.
        log_odds: of being an object rather than a false alarm, while not confirmed.
        age_s: time since its first measurement [s].
        seen: its ellipse is covered by measurements in this frame.
        unseen_s: time since it last had measured area.
        shared_s: time without measured area of its own, only such that an older object covers too (occlusion); it
            runs back twice as fast, since two ellipses on one object take turns at having some of their own.
        hidden: it is sharing.
        offset_m: from the centre of what is seen of a body to its axis on the floor [m] (floor plane).
        height_m: of its head, smoothed; NaN while unknown (floor plane).
    """

    track_id: int
    birthplace: tuple[float, float]
    confirmed: bool
    log_odds: float
    age_s: float = 0.0
    seen: bool = True
    moved: bool = False
    unseen_s: float = 0.0
    shared_s: float = 0.0
    hidden: bool = False
    offset_m: tuple[float, float] = (0.0, 0.0)
    height_m: float = math.nan

    @property
    def state(self) -> State:
        if not self.confirmed:
            return "tentative"
        return "confirmed" if self.seen and not (self.hidden and self.shared_s > HIDDEN_S) else "lost"

    @property
    def probability(self) -> float:
        """That this is an object and not a false alarm."""
        return 1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, self.log_odds))))


def birth(track_id: int, birthplace: tuple[float, float], fill: float, unexplained: int, params: LifeParams) -> Life:
    """A new object from an unexplained measurement.

    Its fill counts for or against it as much as a frame does in which it is seen again or not: a body fills two
    thirds of its ellipse and hardly less than half, scattered noise and outlines of ghosts do not.

    Of n unexplained measurements the number of objects is binomial, B(n, q) with q = entries / (entries + false
    alarms): each is an object with the prior probability q. A frame with many of them (a light changed, the camera
    shook) has more false alarms than the expected number, so that number is raised to all but ``GROUP`` of them.
    """
    false_alarms = max(params.false_alarms, float(unexplained - GROUP))
    solid = math.log(params.detection / params.repetition)
    odds = math.log(params.entries / false_alarms) + float(np.clip((fill - HALF_FULL) / FILL_SPREAD, -1.0, 1.0)) * solid
    return Life(track_id, birthplace, False, odds)


def observe(life: Life, seen: bool, own: bool, dt_s: float, params: LifeParams, believable: bool = True) -> None:
    """Update the existence of an object with one frame.

    The number k of the n frames since birth in which it is seen is binomial too, B(n, detection) for an object and
    B(n, repetition) for a false alarm; their ratio updates the odds.

    Args:
        seen: measurements cover its ellipse.
        own: part of them is covered by no older object.
        dt_s: time since the last frame [s].
        believable: nothing but time speaks against it.
    """
    life.seen = seen
    life.unseen_s = 0.0 if seen else life.unseen_s + dt_s
    life.shared_s = max(0.0, life.shared_s - 2 * dt_s) if own else life.shared_s + dt_s
    life.hidden = seen and not own
    if not life.confirmed:
        hit = seen and own
        real = params.detection if hit else 1.0 - params.detection
        false = params.repetition if hit else 1.0 - params.repetition
        life.log_odds += math.log(real / false)
        life.confirmed = hit and believable and life.probability >= params.believe


def gone(life: Life, params: LifeParams) -> float:
    """Probability that an object has left: Gamma distributions of the time unseen, and of the time shared.

    A new object that is not believed yet has left when it is probably a false alarm.
    """
    if not life.confirmed:
        return 1.0 - life.probability if life.unseen_s > 0.0 or life.shared_s > 0.0 else 0.0
    k = params.gamma_shape
    unseen = gammainc(k, k * life.unseen_s / params.patience_s)
    shared = gammainc(k, k * life.shared_s / params.occluded_patience_s)
    return float(max(unseen, shared))
