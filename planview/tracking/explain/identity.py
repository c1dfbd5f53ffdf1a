"""Who is whom: people who were in contact may have been exchanged, and newcomers may be people seen before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from calib.carried import Carried
from calib.types import F32, F64
from planview.maps.view import CODES
from planview.tracking import body
from planview.tracking.explain.explanation import Owned
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import COLOURED_FRAMES_MIN, SMOOTHING, Person, colour_counts, colour_ratios
from planview.tracking.explain.samples import PARTS, TINY

CONTACT_M = 0.7
"""People nearer than this may be confused [m]: a body, and an arm's movement."""
KNOWN_LOG_ODDS = 3.0
"""Log-odds from which a newcomer is somebody known: one error in twenty. Between 0 and this more evidence is awaited;
whoever still has no more then is a stranger."""
EXCHANGED_LOG_ODDS = 6.0
"""Log-odds at which two people exchange identities: one error in 400."""
PART_MAX = 2.0
"""Largest evidence of the colours of one part of a body, as log-odds: light differs within a room."""
PART_SAMPLES = 10.0
"""Independent samples that the colours of a part are worth when people are recognised (our choice)."""
OTHERS_SHARE = 0.8
"""Share of the others seen so far in the colours of a stranger; the rest is any colour alike."""
DOUBT_FRAMES = 0.5
"""Weight of a stranger's colours next to those seen of a person: one frame shows most of the clothes."""
P = TypeVar("P", bound=Person)


class Exchanges(Carried):
    """Evidence, forgotten with ``lag_s``, that two people who were in contact have each other's place."""

    CARRIED = ("_evidence",)

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
                known = min(a.coloured_frames, b.coloured_frames) >= COLOURED_FRAMES_MIN and a.confirmed and b.confirmed
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


def continued(
    born: Sequence[P], known: Sequence[P], everybody: Sequence[P], floor_m2: float, low_share: float
) -> dict[int, tuple[P, float]]:
    """Newcomers, by index, who may have been seen before, with the log-odds: the best joint assignment, and of the rest
    those who would be likely to be somebody known if they turned out to be as tall.

    Args:
        everybody: seen so far, in whose clothes strangers come.
        floor_m2: over which strangers may appear.
        low_share: of people who sit, bend, or are children.
    """
    from scipy.optimize import linear_sum_assignment  # half a second

    if not known:
        return {}
    odds = np.array([[_log_odds(q, b, everybody, floor_m2, low_share) for q in known] for b in born])
    rows, cols = linear_sum_assignment(np.maximum(odds, 0.0), maximize=True)
    found = {int(i): (known[j], float(odds[i, j])) for i, j in zip(rows, cols, strict=True) if odds[i, j] > 0.0}
    for i, b in enumerate(born):
        at_most = odds[i] + [0.0 if b.head_in_view else _own_height(q, low_share) for q in known]
        best = int(np.argmax(at_most))
        if at_most[best] > 0.0:
            found.setdefault(i, (known[best], float(odds[i, best])))
    return found


def _own_height(q: Person, low_share: float) -> float:
    """Log-odds that a known person's own height, once it is measured of a newcomer, adds to those of being that
    person: much for somebody very tall or short, and little for somebody as tall as most."""
    return body.same_height(q.tall_m, body.HEIGHT_STD_M, q.tall_m, q.upright[1], low_share)


def _log_odds(q: Person, b: Person, everybody: Sequence[Person], floor_m2: float, low_share: float) -> float:
    """Log-odds of a newcomer being a known person rather than a stranger, by place, height and colours."""
    back_m = math.dist((q.seen.x_m, q.seen.y_m), b.born_m)
    if not body.within_reach(b.born_s - q.seen_s, back_m):
        return -math.inf
    gone_s, left = b.born_s - q.seen_s, q.seen
    ahead_s = body.walks_on_s(gone_s)
    away_m = math.dist((left.x_m + ahead_s * left.vx_mps, left.y_m + ahead_s * left.vy_mps), b.born_m)
    others = colours_of([person for person in everybody if person is not q and person is not b])
    odds = body.same_place(gone_s, away_m, back_m, floor_m2) + alike(q, b, others)
    if not b.head_in_view:
        return odds
    error = max(math.sqrt(b.height_var), body.HEIGHT_STD_M)  # newcomers show in part at first
    return odds + body.same_height(b.height_m, error, q.tall_m, q.upright[1], low_share)


def colours_of(others: Sequence[Person]) -> F64:
    """(PARTS, CODES) shares of the colours of a stranger."""
    seen = np.array([q.colours for q in others], np.float64).reshape(-1, PARTS, CODES) @ SMOOTHING
    frames = seen.sum(axis=2, keepdims=True)
    known = (frames > 0).sum(axis=0)
    mean = (seen / np.maximum(frames, TINY)).sum(axis=0) / np.maximum(known, 1)
    share = OTHERS_SHARE * (known > 0)
    return np.asarray(share * mean + (1.0 - share) / CODES)


def alike(one: Person, other: Person, stranger: F64) -> float:
    """Log-odds of two tracks showing the colours of one person rather than of two; 0 where there are none.

    The overlap of their colours is compared with that of either with the colours of a stranger (PARTS, CODES).
    """
    seen = [q.colours @ SMOOTHING for q in (one, other)]
    a, b = ((n + DOUBT_FRAMES * stranger) / (n.sum(axis=1, keepdims=True) + DOUBT_FRAMES) for n in seen)
    samples = PART_SAMPLES * np.prod([n.sum(axis=1) / (n.sum(axis=1) + DOUBT_FRAMES) for n in seen], axis=0)
    both, one_s, other_s = (np.log(np.sqrt(p * q).sum(axis=1)) for p, q in ((a, b), (a, stranger), (b, stranger)))
    return float(np.clip(samples * (both - 0.5 * (one_s + other_s)), -PART_MAX, PART_MAX).sum())
