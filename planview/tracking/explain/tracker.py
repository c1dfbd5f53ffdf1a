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
from planview.tracking.explain.clothes import colour_counts
from planview.tracking.explain.explanation import STEPS_M, Explanation, Fits, Owners, People, Samples
from planview.tracking.explain.facing import Gait
from planview.tracking.explain.identity import Exchanges, Match, match_newcomers
from planview.tracking.explain.params import PeopleParams
from planview.tracking.explain.person import EVIDENCE_MAX, RECORDS, Person, Sighting
from planview.tracking.explain.samples import PARTS, POSE_PRIOR, Searches
from planview.tracking.odds import survive
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
    RECORDS: ClassVar[Records] = RECORDS

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
        """Predict everybody into a frame; return the time since the last one [s]."""
        dt_s = self._life.begin(now_s)
        for person in self._people:
            if person.glimpse.visible_share < 2 * self.params.visible_min:
                person.kalman = person.kalman.slow_down(dt_s * person.glimpse.shown_share, body.SLOW_DOWN_S)
            person.kalman = person.kalman.predict(dt_s, body.ACCELERATION_MPS2)
            person.height_var += HEIGHT_CHANGE_MPS**2 * dt_s * min(dt_s, self.params.errors_s)
            person.stance.predict(dt_s, Gait.of(person.kalman).still)
        return dt_s

    def _fresh(self, dt_s: float) -> float:
        """Share of a frame that is independent of the last one."""
        return min(1.0, dt_s / self.params.errors_s)

    def _is_visible(self, person: Person) -> bool:
        """True if enough of a person shows for the place to be measured."""
        return person.glimpse.visible_share >= self.params.visible_min

    # -- explaining a frame ---------------------------------------------------------------------------------------
    def _ascend(self, frame: Explanation, people: People, shared: Bool) -> tuple[Samples, Fits]:
        """Move everybody to where they explain best, the nearest first, by coordinate ascent.

        Args:
            shared: (N, N) who may be on a ray of whom.
        """
        predicted = people.poses.copy()
        samples = frame.samples_around(predicted, body.TORSO.torso_radius_m + 0.1)
        priors = np.array([person.pose_prior for person in self._people], POSE_PRIOR)
        well_known = [person.kalman.position_std_m < STEPS_M[1] for person in self._people]
        searches = Searches(predicted, priors, STEPS_M, np.array(well_known, np.int64))
        order = frame.order_by_distance(people.poses)
        return samples, samples.explain(people, searches, order, shared)

    def _measure(self, person: P, samples: Samples, pose: F64, curvature: F64, turned: F64, dt_s: float) -> None:
        """Take over place, height and facing of a pose, as far as the pixels show them."""
        if not self._is_visible(person):
            return
        noise, height_information = samples.precision(pose, curvature)
        if not person.glimpse.head_in_view:
            noise = noise + STEP_STD_M**2 * np.eye(2)
        # The speed of a newcomer is hardly known, and hardly anybody runs.
        fastest_mps = math.inf if person.confirmed else body.SPEED_MAX_MPS
        person.kalman = person.kalman.correct_to(pose[:2], noise, fastest_mps)
        fresh = self._fresh(dt_s)
        person.stance.measure(pose, turned, curvature[3:5], fresh, Gait.of(person.kalman))
        if person.glimpse.head_in_view:
            person.measure_height(float(pose[2]), height_information * fresh)
        else:
            person.assume_upright()
        person.last_seen = Sighting(self._life.now_s, person.kalman)
        person.unseen_s = 0.0

    def _weigh(self, person: P, dt_s: float, away_s: float) -> None:
        """Update the existence: an unseen person stays for ``away_s`` on average, as far as there is anything to see;
        then add the frame's evidence."""
        glimpse = person.glimpse
        fresh = self._fresh(dt_s)
        visible = self._is_visible(person)
        if not visible:
            person.unseen_s += dt_s * glimpse.shown_share
            person.log_odds = survive(person.log_odds, dt_s * glimpse.shown_share, away_s)
        if glimpse.shown_share > 0.0:  # else the evidence is the prior of the pose alone
            person.log_odds += fresh * max(-EVIDENCE_MAX, min(EVIDENCE_MAX, glimpse.evidence))
        person.log_odds = max(-body.LOG_ODDS_MAX, min(body.LOG_ODDS_MAX, person.log_odds))
        if visible and glimpse.head_in_view:
            person.identity.stature.learn(person.height_m, fresh, self.params.low_share)

    # -- identities, births, deaths ---------------------------------------------------------------------------------
    def _learn_colours(self, owners: Sequence[Owners], apart: Sequence[bool], dt_s: float) -> None:
        """Learn the colours of people who touch nobody, and undo exchanged identities."""
        counts = np.zeros((len(self._people), PARTS, CODES), np.float32)
        for in_view in owners:
            sure = (in_view.share > 0.8) & (in_view.owner >= 0)
            owner = in_view.owner[sure]
            counts += colour_counts(len(self._people), owner, in_view.height[sure], in_view.colours[sure])
        for person, seen, alone in zip(self._people, counts, apart, strict=True):
            if person.glimpse.visible_share >= 0.5 and alone:
                person.identity.clothes.learn(seen)
        for one, other, log_odds in self._exchanges.update(self._people, owners, dt_s):
            one.swap_identity(other)
            reason = f"exchanged with {other.track_id}: colours, log-odds {log_odds:.1f}"
            self._life.note(one, "identity", reason, log_odds)

    def _end(self, person: P, reason: str, may_return: bool) -> None:
        """Stop following a person, who may be recognised later."""
        self._life.prune(person, reason, person.existence)
        self._people = without(self._people, person)
        if may_return:
            self._departed.append(person)

    def _add(self, newcomer: P, kind: DecisionKind, reason: str, value: float) -> None:
        """Follow a newcomer under a negative number, until it is recognised or confirmed."""
        self._people.append(newcomer)
        self._life.appear(newcomer, reason, value, kind)

    def _match(self, newcomers: Sequence[P], floor_m2: float) -> list[Match[P]]:
        """Match newcomers to the lost or departed people whom they may continue."""
        p = self.params
        now_s = self._life.now_s
        self._departed = [person for person in self._departed if now_s - person.last_seen.time_s <= p.remember_s]
        lost = [person for person in self._people if person.confirmed and not self._is_visible(person)]
        everybody = self._people + self._departed
        return match_newcomers(newcomers, lost + self._departed, everybody, floor_m2, p.low_share)

    def _continue(self, match: Match[P]) -> None:
        """Give a newcomer the identity of the person seen before."""
        newcomer, before, log_odds = match
        was = newcomer.track_id
        newcomer.swap_identity(before)
        newcomer.proof = before.proof
        gone_s = newcomer.first_seen.time_s - before.last_seen.time_s
        self._life.recognise(newcomer, was, f"log-odds {log_odds:.1f} after {gone_s:.1f} s", log_odds)
        self._departed = without(self._departed, before)
        self._people = without(self._people, before)

    def _confirm(self, newcomer: P, reason: str) -> None:
        """Report a newcomer as a stranger."""
        was = newcomer.track_id
        self._life.confirm(newcomer, reason, newcomer.existence)
        newcomer.proof.spent = {}
        self._exchanges.rename(was, newcomer.track_id)

    def _state(
        self, person: P, box_px: Box = NO_BOX, confidence: float = math.nan, std_m: float = math.nan
    ) -> TrackState:
        """Report a person, with the probability that somebody is there and the deviation of the place [m]."""
        state = state_of(person.confirmed, self._is_visible(person))
        motion = *person.head_m, *person.kalman.velocity_mps
        facing = person.stance.reported_facing
        return TrackState(person.track_id, state, *motion, person.height_m, box_px, *facing, confidence, std_m)


def without(people: Sequence[P], gone: P) -> list[P]:
    """People other than this one."""
    return [person for person in people if person is not gone]
