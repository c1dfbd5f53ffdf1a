"""Following people by how well they explain every pixel; the same for all sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, Generic, TypeVar

import numpy as np

from calib.carried import Carried, Records
from calib.types import F64, Bool
from planview.maps.view import CODES
from planview.tracking import body
from planview.tracking.base import NO_BOX, Box, Decision, DecisionKind, LifeCycle, state_of
from planview.tracking.explain.births import EVIDENCE_MAX
from planview.tracking.explain.explanation import STEPS_M, Explanation, Found, Owned, People, Samples
from planview.tracking.explain.facing import FacingBelief
from planview.tracking.explain.identity import Exchanges, continued
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import Person, colour_counts
from planview.tracking.explain.samples import KNOWN, PARTS
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

HEIGHT_CHANGE_MPS = 0.6
"""Speed of a head that goes up and down: sitting down, bending [m/s]."""
STEP_STD_M = 0.2
"""Deviation of a walker's foot from the place of the head [m]: while the head is out of view, no more may show."""


P = TypeVar("P", bound=Person)
Q = TypeVar("Q", bound=PeopleParams)


class ExplainingTracker(Carried, Generic[P, Q]):
    """Follows people by the likelihood of all pixels, given where people stand; the same for all sensors.

    Existence by the Bernoulli filter of Vo, Vo and Pham 2010.
    """

    CARRIED: ClassVar[tuple[str, ...]] = ("_people", "_departed", "_exchanges", "_life")
    RECORDS: ClassVar[Records] = (Person, FloorKalman, FacingBelief)

    def __init__(self, params: Q) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        self._people: list[P] = []
        self._departed: list[P] = []
        self._exchanges = Exchanges(self.params)
        self._life = LifeCycle()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    def _begin(self, now_s: float) -> float:
        """Predict everybody; the time since the last frame [s]."""
        dt = self._life.begin(now_s)
        for person in self._people:
            if person.share < 2 * self.params.visible_min:
                person.kalman = person.kalman.slowed(dt * person.known, body.SLOW_DOWN_S)
            person.kalman = person.kalman.predicted(dt, body.ACCELERATION_MPS2)
            person.height_var += HEIGHT_CHANGE_MPS**2 * dt * min(dt, self.params.errors_s)
            person.predict_facing(dt)
        return dt

    # -- explaining a frame ---------------------------------------------------------------------------------------
    def _ascend(self, frame: Explanation, people: People, touch: Bool) -> tuple[Samples, Found]:
        """Coordinate ascent, nearest first.

        Args:
            touch: (N, N) who may be on a ray of whom.

        Returns:
            The samples, and what is found of everybody.
        """
        predicted, order = people.poses.copy(), frame.nearest_first(people.poses)
        samples = frame.around(predicted, body.TORSO.torso_radius_m + 0.1)
        fine = np.array([person.kalman.position_std_m < STEPS_M[1] for person in self._people], np.int64)
        known = np.array([person.prior for person in self._people], KNOWN)
        return samples, samples.explain(people, (predicted, known, STEPS_M, fine), order, touch)

    def _measure(self, person: P, s: Samples, pose: F64, curvature: F64, turned: F64, dt: float) -> None:
        """The place, the height and the facing, as far as the pixels show them."""
        if person.share < self.params.visible_min:
            return
        noise, up = s.noise(pose, curvature)
        if not person.head_in_view:
            noise = noise + STEP_STD_M**2 * np.eye(2)
        # The speed of a newcomer is hardly known, and hardly anybody runs.
        fastest_mps = math.inf if person.confirmed else body.SPEED_MAX_MPS
        person.kalman = person.kalman.found_at(pose[:2], noise, fastest_mps)
        fresh = min(1.0, dt / self.params.errors_s)
        person.measure_facing(pose, turned, curvature[3:5], fresh)
        if person.head_in_view:
            person.height_m, person.height_var = float(pose[2]), 1.0 / (1.0 / person.height_var + up * fresh)
        else:  # whatever is in view, nobody's height shows without the head
            person.height_m, person.height_var = person.tall_m, person.upright[1] ** 2
        person.seen, person.seen_s, person.unseen_s = person.kalman, self._life.now_s, 0.0

    def _weigh(self, person: P, dt: float, away_s: float) -> None:
        """Update the existence: an unseen person stays for ``away_s`` on average, as far as there is anything to see;
        then add the frame's evidence."""
        p, fresh = self.params, min(1.0, dt / self.params.errors_s)
        if person.share < p.visible_min:
            person.unseen_s += dt * person.known
            stays = person.existence * math.exp(-dt * person.known / away_s)
            person.log_odds = math.log(max(stays, 1e-6) / max(1 - stays, 1e-6))
        if person.known > 0.0:  # else the evidence is the prior of the pose alone
            person.log_odds += fresh * max(-EVIDENCE_MAX, min(EVIDENCE_MAX, person.evidence))
        person.log_odds = max(-body.LOG_ODDS_MAX, min(body.LOG_ODDS_MAX, person.log_odds))
        if person.share >= p.visible_min and person.head_in_view:
            person.learn_height(fresh, p.low_share)

    # -- identities, births, deaths ---------------------------------------------------------------------------------
    def _learn(self, owned: Sequence[Owned], apart: Sequence[bool], dt: float) -> None:
        """Learn the colours of people who touch nobody, and undo exchanged identities."""
        counts = np.zeros((len(self._people), PARTS, CODES), np.float32)
        for o in owned:
            sure = (o.share > 0.8) & (o.owner >= 0)
            counts += colour_counts(len(self._people), o.owner[sure], o.height[sure], o.colours[sure])
        for person, seen, alone in zip(self._people, counts, apart, strict=True):
            if person.share >= 0.5 and alone:
                person.learn_colours(seen)
        for one, other, odds in self._exchanges.update(self._people, owned, dt):
            one.take_identity(other)
            self._life.note(one, "identity", f"exchanged with {other.track_id}: colours, log-odds {odds:.1f}", odds)

    def _end(self, person: P, reason: str, may_return: bool) -> None:
        """Stop following a person, who may be recognised later."""
        self._life.prune(person, reason, person.existence)
        self._people = [o for o in self._people if o is not person]
        if may_return:
            self._departed.append(person)

    def _add(self, newcomer: P, kind: DecisionKind, reason: str, value: float) -> None:
        """Follow a newcomer under a negative number, until it is recognised or confirmed."""
        self._people.append(newcomer)
        self._life.appear(newcomer, reason, value, kind)

    def _known(self, new: Sequence[P], floor_m2: float) -> list[tuple[P, P, float]]:
        """Newcomers and the lost or departed people they continue, with the log-odds."""
        p = self.params
        self._departed = [person for person in self._departed if self._life.now_s - person.seen_s <= p.remember_s]
        lost = [person for person in self._people if person.confirmed and person.share < p.visible_min]
        everybody = self._people + self._departed
        known = continued(new, lost + self._departed, everybody, floor_m2, p.low_share) if new else {}
        return [(new[i], *found) for i, found in known.items()]

    def _continue(self, newcomer: P, known: P, odds: float) -> None:
        """Give a newcomer the identity of a person known before."""
        was = newcomer.track_id
        newcomer.take_identity(known)
        newcomer.counted = {}
        self._life.recognise(newcomer, was, f"log-odds {odds:.1f} after {newcomer.born_s - known.seen_s:.1f} s", odds)
        self._departed = [o for o in self._departed if o is not known]
        self._people = [o for o in self._people if o is not known]

    def _confirm(self, newcomer: P, reason: str) -> None:
        """Report a newcomer as a stranger."""
        was = newcomer.track_id
        self._life.confirm(newcomer, reason, newcomer.existence)
        newcomer.counted = {}
        self._exchanges.rename(was, newcomer.track_id)

    def _state(self, person: P, box_px: Box = NO_BOX, claims: tuple[float, float] = (math.nan, math.nan)) -> TrackState:
        """``claims``: the probability that somebody is there, and the deviation of the place [m]."""
        state = state_of(person.confirmed, person.share >= self.params.visible_min)
        k, (x_m, y_m) = person.kalman, person.head_m
        return TrackState(
            person.track_id, state, x_m, y_m, k.vx_mps, k.vy_mps, person.height_m, box_px, *person.faces, *claims
        )  # fmt: skip
