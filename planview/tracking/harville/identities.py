"""The identity layer on plan-view maps: who is in contact, who is clear, and what is mended."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F64
from planview.maps.builder import PlanViewMaps
from planview.tracking.appearance import appearances, is_distinctive
from planview.tracking.detection import PersonCandidate, inseparable_pairs
from planview.tracking.harville.params import TemplateTrackerParams
from planview.tracking.harville.state import TemplatePerson
from planview.tracking.identity import Exchange, IdentityLayer
from planview.tracking.lifecycle import LifeCycle

CONTACT_M = 0.5
"""Two people nearer than this (stretched along the ray by depth noise) may be exchanged [m]: shoulder to shoulder."""


LEARN_S = 0.2
"""Time between two measurements of a person whose identity is not in doubt [s]: a person hardly turns in less. All who
are clear are measured together, so that most frames need no colours."""
HEAD_ROOM_M = 0.05
"""A height is measured only where this much above the head is in the image too [m]: else the image may cut it off."""


class Identities:
    """Feeds the identity layer with what the template tracker measures.

    Two people are in contact while their templates overlap (2 W_avg); a person is clear of others when no other is
    within that distance, its head is measured and the match is good.
    """

    def __init__(self, params: TemplateTrackerParams, life: LifeCycle) -> None:
        self._params, self._life = params, life
        self._layer = IdentityLayer(params.identity)
        self.reset()

    def reset(self) -> None:
        """Forget all people."""
        self._layer.reset()
        self._gone: list[TemplatePerson] = []

    def update(self, maps: PlanViewMaps, people: Sequence[TemplatePerson]) -> None:
        """Note contacts, learn appearances, mend exchanges; once per frame, after all are located."""
        if not self._params.identity.enabled:
            return
        nearest = self._contacts(maps, people)
        clear = [q for q, apart in zip(people, nearest, strict=True) if q.observed and self._clear(maps, q, apart)]
        self._learn(maps, self._due(clear), [q for q in people if q.observed])
        remember_s = self._params.identity.remember_s
        self._gone = [q for q in self._gone if self._life.unobserved_s(q.existence) <= remember_s]
        self._layer.retain([q.existence for q in (*people, *self._gone)])
        confirmed = [q for q in people if q.existence.confirmed]
        for exchange in self._layer.exchanges([q.existence for q in confirmed], self._life.now_s):
            self._mend(exchange, confirmed)

    def remember(self, person: TemplatePerson) -> None:
        """A person is gone, and may come back: strangers may do so too, and must look different."""
        memory = self._layer.remembered(person.existence)
        if memory is not None and is_distinctive(memory):
            self._gone.append(person)

    def known_as(self, newcomer: TemplatePerson, people: Sequence[TemplatePerson]) -> TemplatePerson | None:
        """Who a newcomer is by appearance, of the people gone or not clearly observed; the identity moves to it.

        Returns the track that the person was believed to be, if any, which has none of its own any more.
        """
        absent = self._absent(newcomer, people)
        found = self._layer.known_as(newcomer.existence, [person.existence for person in absent])
        if found is None:
            return None
        who, confidence = found
        person = next(q for q in absent if q.existence is who)
        self._layer.forget(newcomer.existence)
        newcomer.tallest_m = max(newcomer.tallest_m, person.tallest_m)
        self._life.reassign([newcomer.existence, who], [who, newcomer.existence], confidence)
        self._gone = [q for q in self._gone if q is not person]
        return person if person in people else None

    def undecided(self, newcomer: TemplatePerson, people: Sequence[TemplatePerson]) -> bool:
        """Whether a newcomer may be a person who is absent, and its appearance is not known yet."""
        absent = self._absent(newcomer, people)
        return self._layer.undecided(newcomer.existence, [person.existence for person in absent])

    def _absent(self, newcomer: TemplatePerson, people: Sequence[TemplatePerson]) -> list[TemplatePerson]:
        """People not clearly observed now who could have walked to where the newcomer is."""
        p, absent = self._params, []
        for person in (*people, *self._gone):
            away_s = self._life.now_s - person.clear_s
            reach_m = p.reach_m + p.speed_max_mps * away_s
            if person.existence.confirmed and away_s > p.confirm_s and math.dist(newcomer.at_m, person.at_m) < reach_m:
                absent.append(person)
        return absent

    def _contacts(self, maps: PlanViewMaps, people: Sequence[TemplatePerson]) -> F64:
        """Note who is in contact; distance (K,) of each from the nearest other person [m]."""
        places = np.array([q.at_m if q.observed else q.predicted_m for q in people]).reshape(-1, 2)
        for i, j in inseparable_pairs(maps.view, places, CONTACT_M):
            self._layer.contact(people[i].existence, people[j].existence, self._life.now_s)
        dx, dy = (places[None] - places[:, None]).transpose(2, 0, 1)
        apart: F64 = np.hypot(dx, dy)
        np.fill_diagonal(apart, np.inf)
        nearest: F64 = apart.min(axis=1, initial=np.inf)
        return nearest

    def _clear(self, maps: PlanViewMaps, person: TemplatePerson, nearest_m: float) -> bool:
        """Whether a measurement now is the person's alone."""
        apart = nearest_m > (1.0 if self._layer.in_doubt(person.existence) else 2.0) * CONTACT_M
        well = person.head and person.score <= self._params.match.score_max / 2
        return apart and well and maps.view.sees(*person.at_m, person.height_m + HEAD_ROOM_M)

    def _due(self, clear: Sequence[TemplatePerson]) -> list[TemplatePerson]:
        """Who is measured: those in doubt, and all others as soon as one of these has not been for ``LEARN_S``."""
        doubtful = [q for q in clear if self._layer.in_doubt(q.existence) or not q.existence.confirmed]
        rested = any(self._life.now_s - q.clear_s >= LEARN_S for q in clear if q not in doubtful)
        return list(clear) if rested else doubtful

    def _learn(self, maps: PlanViewMaps, due: Sequence[TemplatePerson], observed: Sequence[TemplatePerson]) -> None:
        """Measure the appearance of those due; points nearer to others are the others'."""
        if not due:
            return
        measured = [*due, *(q for q in observed if q not in due)]
        looks = appearances(
            maps.points, [q.at_m for q in measured], [q.tallest_m for q in measured],
            [q.height_m for q in measured], self._params.reach_m,
        )  # fmt: skip
        for person, look in zip(due, looks, strict=False):
            person.clear_s = self._life.now_s
            self._layer.learn(person.existence, look)

    def _mend(self, exchange: Exchange, people: Sequence[TemplatePerson]) -> None:
        """Identities move; what belongs to a person and not to a place moves along."""
        by_id = {q.existence.track_id: q for q in people}
        tallest = [by_id[who.track_id].tallest_m for who in exchange.identities]
        places = [by_id[who.track_id] for who in exchange.places]
        self._life.reassign(exchange.places, exchange.identities, exchange.confidence)
        for person, height_m in zip(places, tallest, strict=True):
            person.tallest_m = max(height_m, person.height_m)

    def unlikelihood(
        self, maps: PlanViewMaps, person: TemplatePerson, candidate: PersonCandidate, others: Sequence[TemplatePerson]
    ) -> float:
        """How unlikely a candidate's appearance is of a lost person: a negative log-likelihood, 0 where unknown.

        Only a candidate clear of others is compared: in contact, points of other bodies are among its own.
        """
        where = (candidate.x_m, candidate.y_m)
        if not maps.view.sees(*where, candidate.height_m + HEAD_ROOM_M):
            return 0.0
        crowded = any(math.dist(where, q.at_m) < 2 * self._params.width_m for q in others)
        if crowded or self._layer.remembered(person.existence) is None:
            return 0.0
        (look,) = appearances(maps.points, [where], [person.tallest_m], [candidate.height_m], self._params.reach_m)
        return float(np.nan_to_num(self._layer.unlikelihood(person.existence, look)))
