"""Identities: people who were in contact may have been exchanged, and newcomers may be people seen before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from calib.types import F32, F64
from planview.maps.colour import CODES
from planview.tracking import body
from planview.tracking.joint._kernels import PARTS
from planview.tracking.joint.explanation import Owned
from planview.tracking.joint.params import PeopleParams
from planview.tracking.joint.person import COLOURED_FRAMES_MIN, Person, colour_counts, colour_ratios

CONTACT_M = 0.7
"""People nearer than this may be confused [m]: a body, and an arm's movement."""
KNOWN_LOG_ODDS = 0.3
"""Log-odds from which a newcomer is recognised; without evidence it is a stranger."""
EXCHANGED_LOG_ODDS = 6.0
"""Log-odds at which two people exchange identities: one error in 400."""
PART_MAX = 2.0
"""Largest evidence of the colours of one part of a body, as log-odds: light differs within a room."""


P = TypeVar("P", bound=Person)


class Exchanges:
    """Evidence, forgotten with ``lag_s``, that two people who were in contact have each other's place."""

    def __init__(self, params: PeopleParams) -> None:
        self._params = params
        self._evidence: dict[tuple[int, int], float] = {}

    def rename(self, was: int, track_id: int) -> None:
        """A tentative track has an id from now on."""
        pairs = [[track_id if one == was else one for one in pair] for pair in self._evidence]
        self._evidence = {(min(p), max(p)): v for p, v in zip(pairs, self._evidence.values(), strict=True)}

    def update(self, people: Sequence[P], owned: Sequence[Owned], dt: float) -> list[tuple[P, P, float]]:
        """Pairs that must exchange their identities, with the log-odds.

        Args:
            owned: per view; none where colours do not distinguish people.
        """
        p, alive = self._params, {q.track_id for q in people}
        self._evidence = {pair: v for pair, v in self._evidence.items() if alive.issuperset(pair)}
        decided: list[tuple[P, P, float]] = []
        ratios: F32 | None = None
        colours: dict[int, tuple[F64, float]] = {}
        for i, a in enumerate(people):
            for j in range(i + 1, len(people)):
                b = people[j]
                pair = min(a.track_id, b.track_id), max(a.track_id, b.track_id)
                if math.dist(a.at_m, b.at_m) < CONTACT_M:
                    self._evidence.setdefault(pair, 0.0)
                known = min(a.looks, b.looks) >= COLOURED_FRAMES_MIN and a.confirmed and b.confirmed
                if pair not in self._evidence or not known:
                    continue
                gain, ratios = 0.0, np.log(colour_ratios(people)) if ratios is None else ratios
                for k, other in ((i, j), (j, i)):
                    if k not in colours:
                        colours[k] = owned_colours(k, owned)
                    seen, patches = colours[k]
                    alike = float((seen * (ratios[other] - ratios[k])).sum())
                    gain += float(np.clip(alike, -PART_MAX, PART_MAX)) * min(PARTS, patches / 20.0)
                odds = self._evidence[pair] * math.exp(-dt / p.lag_s) + gain * min(1.0, dt / p.errors_s)
                self._evidence[pair] = odds
                if odds > EXCHANGED_LOG_ODDS and not any(a in done or b in done for done in decided):
                    decided.append((a, b, odds))
                    self._evidence[pair] = 0.0
        return decided


def owned_colours(k: int, owned: Sequence[Owned]) -> tuple[F64, float]:
    """(PARTS, CODES) shares of the colours of a person's pixels, and how many patches they are."""
    total, patches = np.zeros((PARTS, CODES)), 0.0
    for o in owned:
        mine = np.flatnonzero((o.owner == k) & (o.share > 0.3))
        total += colour_counts(1, np.zeros_like(mine), o.height[mine], o.colours[mine])[0]
        patches += float(o.patches[mine].sum())
    return total / max(total.sum(), 1.0), patches


def continued(born: Sequence[P], known: Sequence[P], floor_m2: float, low_share: float) -> dict[int, tuple[P, float]]:
    """Newcomers, by index, who were seen before, with the log-odds: the best joint assignment.

    Args:
        floor_m2: over which strangers may appear.
        low_share: of people who sit, bend, or are children.
    """
    from scipy.optimize import linear_sum_assignment  # half a second

    odds = np.array([[_log_odds(q, b, known, floor_m2, low_share) for q in known] for b in born])
    odds = odds.reshape(len(born), -1)
    rows, cols = linear_sum_assignment(np.maximum(odds, KNOWN_LOG_ODDS), maximize=True)
    return {
        int(i): (known[j], float(odds[i, j])) for i, j in zip(rows, cols, strict=True) if odds[i, j] > KNOWN_LOG_ODDS
    }


def within_reach(q: Person, b: Person) -> bool:
    """Whether a known person can have walked to where a newcomer was seen first."""
    return body.within_reach(b.born_s - q.seen_s, math.dist(q.at_m, b.born_m))


def _log_odds(q: Person, b: Person, known: Sequence[Person], floor_m2: float, low_share: float) -> float:
    """Log-odds of a newcomer being a known person rather than a stranger, by place, height and colours."""
    if not within_reach(q, b):
        return -1.0
    odds = body.same_place(b.born_s - q.seen_s, math.dist(q.at_m, b.born_m), floor_m2) + _alike(q, b, known)
    if not b.head_in_view:
        return odds
    error = max(math.sqrt(b.height_var), body.HEIGHT_STD_M)  # newcomers show in part at first
    return odds + body.same_height(b.height_m, error, q.tall_m, q.upright[1], low_share)


def _alike(q: Person, b: Person, known: Sequence[Person]) -> float:
    """Log-odds of a newcomer's colours being those of a known person rather than of anybody."""
    if q.looks < COLOURED_FRAMES_MIN:
        return 0.0
    ratio = np.log(colour_ratios(known)[list(known).index(q)])
    seen = b.colours / np.maximum(b.colours.sum(axis=1, keepdims=True), 1e-6)
    return float(np.clip((seen * ratio).sum(axis=1), -PART_MAX, PART_MAX).sum())
