"""Who is who after contact: one identity layer beneath all trackers, by what is lasting about a person.

Place tells people apart until they touch or vanish. What lasts is kept: colours by body height and body height, learned
only while a person is clear of others. After a contact the fresh measurements of all involved are compared with what is
remembered, jointly, and an exchange is mended when its odds are high enough. All ours (Harville 2002 has none).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F64
from planview.tracking.appearance_model import Appearance, AppearanceModel
from planview.tracking.lifecycle import Existence

STRANGER_COST = 4.6
"""Negative log-likelihood of a look that one person shows once in a hundred: strangers look at least as different."""
HEIGHT_COST_MAX = 4.5
"""The most that height alone may say: three deviations. A person known only from sitting is measured far taller."""


class IdentityParams(Params):
    """Identity by appearance; our choices."""

    enabled: bool = True
    """Compare appearance at all; off gives the papers' trackers."""
    looks: int = Field(3, ge=1, le=100)
    """Clear measurements needed on either side of a contact before it is judged: a fifth of a second at 15 Hz."""
    confidence: float = Field(0.95, gt=0.5, lt=1.0)
    """Probability that an exchange happened from which on it is mended: one mended wrongly in twenty."""
    doubt_s: float = Field(15.0, gt=0, le=600)
    """How long after a contact it may still be judged [s]; a conversation in a crowd lasts as long."""
    remember_s: float = Field(60.0, ge=0, le=3600)
    """How long a person who is gone is remembered, and recognised by appearance when coming back [s]."""
    colour_scatter: float = Field(0.12, gt=0, le=1)
    """Deviation of a person's colours from their mean (Hellinger distance): turning round and half hidden legs change
    a tenth to a sixth of a silhouette."""
    height_std_m: float = Field(0.04, gt=0, le=0.5)
    """Deviation of a standing person's measured height [m]: the bob of a step is 2 to 5 cm."""


def dissimilarity(fresh: AppearanceModel, known: AppearanceModel, params: IdentityParams) -> float:
    """How unlikely fresh measurements are of a known person: a negative log-likelihood, 0 the likeliest.

    Colours by the squared Hellinger distance in deviations of one person, averaged over the parts that both have. A
    person measured taller than known is unlikely to be the same; lower tells nothing, since people sit and stoop. NaN
    where nothing can be compared.
    """
    terms = []
    both = (fresh.counts > 0) & (known.counts > 0)
    if both.any():
        chosen = slice(None) if both.all() else both
        p, q = (m.colours[chosen] / m.counts[chosen, None] for m in (fresh, known))
        squared = np.minimum(np.maximum(1.0 - np.sqrt(p * q).sum(axis=1), 0.0), 1.0)
        terms.append(float(squared.mean()) / (2 * params.colour_scatter**2))
    gap = fresh.height_m - known.height_m
    if not math.isnan(gap):
        terms.append(min((max(gap, 0.0) / params.height_std_m) ** 2 / 4, HEIGHT_COST_MAX))
    return sum(terms) if terms else math.nan


@dataclass(frozen=True)
class Exchange:
    """Identities to be moved: the person at ``places[i]`` is ``identities[i]``.

    Attributes:
        places: tracks as they are now.
        identities: whose memory each place fits, in the same order; a permutation of ``places``.
        confidence: probability that this is right and the present identities are not.
    """

    places: tuple[Existence, ...]
    identities: tuple[Existence, ...]
    confidence: float


class IdentityLayer:
    """Remembers people, notes who was in contact with whom, and finds exchanges.

    Each frame: ``contact`` for all who touch another, ``learn`` for all who are clear of others, then
    ``exchanges``.
    """

    def __init__(self, params: IdentityParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget all people."""
        self._memory: dict[int, AppearanceModel] = {}
        self._fresh: dict[int, AppearanceModel] = {}
        self._contacts: dict[tuple[int, int], float] = {}

    def in_doubt(self, who: Existence) -> bool:
        """Whether a contact of this person is still to be judged."""
        return any(who.track_id in pair for pair in self._contacts)

    def remembered(self, who: Existence) -> AppearanceModel | None:
        """What is known of a person, None for nothing."""
        return self._memory.get(who.track_id)

    def contact(self, one: Existence, other: Existence, now_s: float) -> None:
        """These two cannot be told apart by place now; what was measured since an earlier contact is void."""
        if not self.params.enabled:
            return
        pair = (min(one.track_id, other.track_id), max(one.track_id, other.track_id))
        self._contacts[pair] = now_s
        for track_id in pair:
            self._fresh.pop(track_id, None)

    def learn(self, who: Existence, appearance: Appearance) -> None:
        """A clear measurement: remembered, or kept aside while the identity is in doubt."""
        if not self.params.enabled:
            return
        store = self._fresh if self.in_doubt(who) else self._memory
        store.setdefault(who.track_id, AppearanceModel.empty(appearance)).learn(appearance)

    def unlikelihood(self, who: Existence, appearance: Appearance) -> float:
        """How unlikely a measurement is of a remembered person: a negative log-likelihood, NaN where unknown."""
        memory = self._memory.get(who.track_id)
        if memory is None or not self.params.enabled:
            return math.nan
        fresh = AppearanceModel.empty(appearance)
        fresh.learn(appearance)
        return dissimilarity(fresh, memory, self.params)

    def undecided(self, who: Existence, absent: Sequence[Existence]) -> bool:
        """Whether a newcomer may be one of the people absent, and has not been measured often enough to tell."""
        memory = self._memory.get(who.track_id)
        told = memory is not None and memory.looks >= self.params.looks
        return not told and any(other.track_id in self._memory for other in absent)

    def known_as(self, who: Existence, absent: Sequence[Existence]) -> tuple[Existence, float] | None:
        """Which of the people absent a newcomer is by appearance, and the confidence; None for a new person."""
        memory = self._memory.get(who.track_id)
        known = [other for other in absent if other.track_id in self._memory]
        if memory is None or not known:
            return None
        costs = [dissimilarity(memory, self._memory[other.track_id], self.params) for other in known]
        odds = np.exp(-np.nan_to_num(np.array([STRANGER_COST, *costs]), nan=np.inf))
        best = int(np.argmax(odds))
        confidence = float(odds[best] / odds.sum())
        return (known[best - 1], confidence) if best > 0 and confidence >= self.params.confidence else None

    def retain(self, people: Sequence[Existence]) -> None:
        """Forget all others: a long recording remembers no more than those who are tracked."""
        ids = {who.track_id for who in people}
        for store in (self._memory, self._fresh):
            for track_id in [i for i in store if i not in ids]:
                del store[track_id]

    def forget(self, who: Existence) -> None:
        """A track is no person any more."""
        for store in (self._memory, self._fresh):
            store.pop(who.track_id, None)

    def exchanges(self, people: Sequence[Existence], now_s: float) -> list[Exchange]:
        """Judge every group in contact of which a member has been measured clearly since.

        Args:
            people: all who are tracked, lost people too.
        Returns:
            What to mend. A group is settled once all who are observed have been measured.
        """
        known = {who.track_id: who for who in people}
        self._expire(known, now_s)
        found = []
        for group in self._groups():
            ready = [i for i in group if self._looks(i) >= self.params.looks]
            exchange = self._judge([known[i] for i in group], [known[i] for i in ready])
            found += [exchange] if exchange else []
            if exchange or len(ready) == sum(known[i].observed for i in group) > 0:
                self._settle(group, exchange)
        return found

    def _looks(self, track_id: int) -> int:
        return self._fresh[track_id].looks if track_id in self._fresh else 0

    def _expire(self, known: dict[int, Existence], now_s: float) -> None:
        """Contacts with people who are gone, or too old to be judged, are settled as they are."""
        for pair, last_s in list(self._contacts.items()):
            if any(i not in known for i in pair) or now_s - last_s > self.params.doubt_s:
                del self._contacts[pair]
        for track_id in list(self._fresh):
            if track_id not in known or not self.in_doubt(known[track_id]):
                self._merge(track_id, self._fresh.pop(track_id))

    def _merge(self, track_id: int, fresh: AppearanceModel) -> None:
        self._memory.setdefault(track_id, AppearanceModel.empty(fresh)).merge(fresh)

    def _groups(self) -> list[list[int]]:
        """Connected people: contacts are chained."""
        groups: list[set[int]] = []
        for pair in self._contacts:
            touching = [g for g in groups if g & set(pair)]
            merged = set(pair).union(*touching)
            groups = [g for g in groups if g not in touching] + [merged]
        return [sorted(g) for g in groups]

    def _judge(self, group: list[Existence], ready: list[Existence]) -> Exchange | None:
        """The likeliest assignment of the places measured to the identities of the group, if it is not today's."""
        from scipy.optimize import linear_sum_assignment  # half a second and 60 MB, and only people who met need it

        with_memory = [who for who in group if who.track_id in self._memory]
        places = [who for who in ready if who in with_memory]
        cost = self._costs(places, with_memory)
        if len(places) == 0 or len(with_memory) < 2 or np.isnan(cost).any():
            return None
        rows, cols = linear_sum_assignment(cost)
        today = [with_memory.index(who) for who in places]
        gain = float(cost[rows, today].sum() - cost[rows, cols].sum())
        confidence = 1.0 / (1.0 + math.exp(-min(gain, 50.0)))
        if confidence < self.params.confidence:
            return None
        chosen = [with_memory[c] for c in cols]
        # Who is displaced by a place that was lost meanwhile takes the identity that became free.
        free = [who for who in places if who not in chosen]
        lost = [who for who in chosen if who not in places]
        return Exchange(tuple(places + lost), tuple(chosen + free), confidence)

    def _costs(self, places: list[Existence], identities: list[Existence]) -> F64:
        rows = [
            [dissimilarity(self._fresh[p.track_id], self._memory[i.track_id], self.params) for i in identities]
            for p in places
        ]
        return np.array(rows, dtype=np.float64).reshape(len(places), len(identities))

    def _settle(self, group: list[int], exchange: Exchange | None) -> None:
        """Fresh measurements join the memory of whom they belong to."""
        owner = {}
        if exchange:
            owner = {p.track_id: i.track_id for p, i in zip(exchange.places, exchange.identities, strict=True)}
        self._contacts = {pair: t for pair, t in self._contacts.items() if not set(pair) & set(group)}
        for track_id in group:
            fresh = self._fresh.pop(track_id, None)
            if fresh is not None:
                self._merge(owner.get(track_id, track_id), fresh)
