"""Identities: people who were in contact may have been exchanged, and newcomers may be people seen before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from calib.carried import Carried
from calib.types import F32, F64
from planview.tracking import body
from planview.tracking.explain.clothes import PART_MAX, colour_ratios, owned_colours, stranger_colours
from planview.tracking.explain.explanation import Owners
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import Person
from planview.tracking.explain.samples import PARTS
from planview.tracking.matching import best_pairs

CONTACT_M = 0.7
"""People nearer than this may be confused [m]: a body, and an arm's movement."""
KNOWN_LOG_ODDS = 3.0
"""Log-odds from which a newcomer is somebody seen before: one error in twenty. Between 0 and this more evidence is
awaited; whoever still has no more then is a stranger."""
EXCHANGED_LOG_ODDS = 6.0
"""Log-odds at which two people exchange identities: one error in 400."""
P = TypeVar("P", bound=Person)


class Match(NamedTuple, Generic[P]):
    """Two people who may be one: a newcomer and somebody seen before, or two who may have been exchanged."""

    person: P
    other: P
    log_odds: float


class Exchanges(Carried):
    """Evidence, forgotten with ``lag_s``, that two people who were in contact have each other's place."""

    CARRIED = ("_evidence",)

    def __init__(self, params: PeopleParams) -> None:
        self._params = params
        self._evidence: dict[tuple[int, int], float] = {}

    def rename(self, was: int, track_id: int) -> None:
        """Take over the id that a tentative track has from now on."""
        renamed = {}
        for pair, log_odds in self._evidence.items():
            one, other = (track_id if member == was else member for member in pair)
            renamed[min(one, other), max(one, other)] = log_odds
        self._evidence = renamed

    def update(self, people: Sequence[P], owners: Sequence[Owners], dt_s: float) -> list[Match[P]]:
        """Add the evidence of a frame; return the pairs that must exchange their identities.

        Args:
            owners: per view; none where colours do not distinguish people.
        """
        self._meet(people)
        judged = []
        for i, j in combinations(range(len(people)), 2):
            pair = people[i], people[j]
            ready = all(person.confirmed and person.identity.clothes.distinguish for person in pair)
            if ready and _ids(*pair) in self._evidence:
                judged.append((i, j))
        if not judged:
            return []
        log_ratios: F32 = np.log(colour_ratios([person.identity.clothes for person in people]))
        colours = {index: owned_colours(index, owners) for index in np.unique(judged).tolist()}
        decided: list[Match[P]] = []
        decay = math.exp(-dt_s / self._params.lag_s)
        fresh = min(1.0, dt_s / self._params.errors_s)
        for i, j in judged:
            gain = _swap_gain(log_ratios[i], log_ratios[j], *colours[i])
            gain += _swap_gain(log_ratios[j], log_ratios[i], *colours[j])
            ids = _ids(people[i], people[j])
            log_odds = self._evidence[ids] * decay + gain * fresh
            self._evidence[ids] = log_odds
            involved = any(people[i] in match or people[j] in match for match in decided)
            if log_odds > EXCHANGED_LOG_ODDS and not involved:
                decided.append(Match(people[i], people[j], log_odds))
                self._evidence[ids] = 0.0
        return decided

    def _meet(self, people: Sequence[Person]) -> None:
        """Begin to doubt pairs who are in contact, and forget pairs of whom somebody is gone."""
        alive = {person.track_id for person in people}
        self._evidence = {pair: log_odds for pair, log_odds in self._evidence.items() if alive.issuperset(pair)}
        for person, other in combinations(people, 2):
            if math.dist(person.at_m, other.at_m) < CONTACT_M:
                self._evidence.setdefault(_ids(person, other), 0.0)


def _ids(person: Person, other: Person) -> tuple[int, int]:
    """Ids of two people, in order."""
    return min(person.track_id, other.track_id), max(person.track_id, other.track_id)


def _swap_gain(own: F32, other: F32, seen: F64, patches: float) -> float:
    """Evidence that a person's pixels are another's.

    Args:
        own, other: (PARTS, CODES) logarithms of the ratios of the colours of both to anybody's.
        seen: (PARTS, CODES) shares of the colours of the pixels.
    """
    alike = float((seen * (other - own)).sum())
    return float(np.clip(alike, -PART_MAX, PART_MAX)) * min(PARTS, patches / 20.0)


def match_newcomers(
    newcomers: Sequence[P], seen_before: Sequence[P], everybody: Sequence[P], floor_m2: float, low_share: float
) -> list[Match[P]]:
    """Match newcomers to people seen before: the best joint assignment, and of the other newcomers those who would be
    likely to be somebody seen before if they turned out to be as tall.

    Args:
        everybody: seen so far, in whose clothes strangers come.
        floor_m2: over which strangers may appear.
        low_share: of people who sit, bend, or are children.
    """
    if not seen_before or not newcomers:
        return []
    odds = np.empty((len(newcomers), len(seen_before)))
    for i, newcomer in enumerate(newcomers):
        for j, person in enumerate(seen_before):
            odds[i, j] = _log_odds(person, newcomer, everybody, floor_m2, low_share)
    best = best_pairs(np.maximum(odds, 0.0))
    own_heights = np.array([_own_height(person, low_share) for person in seen_before])
    for i, newcomer in enumerate(newcomers):
        at_most = odds[i] if newcomer.glimpse.head_in_view else odds[i] + own_heights
        likeliest = int(np.argmax(at_most))
        if at_most[likeliest] > 0.0:
            best.setdefault(i, likeliest)
    return [Match(newcomers[i], seen_before[j], float(odds[i, j])) for i, j in best.items()]


def _own_height(person: Person, low_share: float) -> float:
    """Log-odds that a person's own height, once it is measured of a newcomer, adds to those of being that person: much
    for somebody very tall or short, and little for somebody as tall as most."""
    stature = person.identity.stature
    return body.log_odds_same_height(stature.mean_m, body.HEIGHT_STD_M, stature.mean_m, stature.std_m, low_share)


def _log_odds(
    person: Person, newcomer: Person, everybody: Sequence[Person], floor_m2: float, low_share: float
) -> float:
    """Log-odds of a newcomer being a person seen before rather than a stranger, by place, height and colours."""
    left = person.last_seen.kalman
    came_m = newcomer.first_seen.kalman.at_m
    gone_s = newcomer.first_seen.time_s - person.last_seen.time_s
    back_m = math.dist(left.at_m, came_m)
    if not body.is_within_reach(gone_s, back_m):
        return -math.inf
    ahead_s = body.walking_on_s(gone_s)
    x_m, y_m, vx_mps, vy_mps = left.mean.tolist()
    ahead_m = x_m + ahead_s * vx_mps, y_m + ahead_s * vy_mps
    odds = body.log_odds_same_place(gone_s, math.dist(ahead_m, came_m), back_m, floor_m2)
    others = [other.identity.clothes for other in everybody if other is not person and other is not newcomer]
    odds += person.identity.clothes.log_odds_same(newcomer.identity.clothes, stranger_colours(others))
    if not newcomer.glimpse.head_in_view:
        return odds
    stature = person.identity.stature
    std_m = max(math.sqrt(newcomer.height_var), body.HEIGHT_STD_M)  # newcomers show in part at first
    return odds + body.log_odds_same_height(newcomer.height_m, std_m, stature.mean_m, stature.std_m, low_share)
