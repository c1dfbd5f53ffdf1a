"""People explained jointly: every pixel of surface and of seen background by the nearest person in front of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, Generic, TypeVar

import numpy as np

from calib.carried import Carried, Records
from calib.types import F32, F64, U8, Bool
from planview.maps.view import CODES
from planview.tracking import body
from planview.tracking.base import (
    NO_BOX,
    Box,
    Decision,
    DecisionKind,
    Drawing,
    Needs,
    Observation,
    TrackerDebug,
    TrackLog,
    person_boxes,
)
from planview.tracking.joint.births import EVIDENCE_MAX, SEARCH_PRIOR, Births, odds_of_moving
from planview.tracking.joint.explanation import STEPS_M, Explanation, Owned, People, Samples, likelihood_of_ranges
from planview.tracking.joint.params import JointParams, PeopleParams
from planview.tracking.joint.person import (
    KNOWN_LOG_ODDS,
    Exchanges,
    Person,
    colour_counts,
    colour_ratios,
    continued,
    side_by_side,
)
from planview.tracking.joint.samples import KNOWN, PARTS
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import State, TrackState

HEIGHT_CHANGE_MPS = 0.6
"""Speed of a head that goes up and down: sitting down, bending [m/s]."""
LOW_WALKERS = 0.01
"""Share of low people who walk: these are children. The others sit or bend, and stay where they are."""
STEP_STD_M = 0.2
"""Deviation of a walker's foot from the place of the head [m]: while the head is out of view, no more may show."""
INSIDE = 0.3
"""Share of a body in the image below which a person is at the border."""


P = TypeVar("P", bound=Person)
Q = TypeVar("Q", bound=PeopleParams)


class ExplainingTracker(Carried, Generic[P, Q]):
    """Follows people by the likelihood of all pixels, given where people stand; the same for all sensors.

    Existence by the Bernoulli filter of Vo, Vo and Pham 2010.
    """

    CARRIED: ClassVar[tuple[str, ...]] = ("_people", "_departed", "_exchanges", "_log")
    RECORDS: ClassVar[Records] = (Person, FloorKalman)

    def __init__(self, params: Q) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        self._people: list[P] = []
        self._departed: list[P] = []
        self._exchanges = Exchanges(self.params)
        self._log = TrackLog()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._log.decisions

    def _begin(self, now_s: float) -> float:
        """Predict everybody; the time since the last frame [s]."""
        dt = self._log.begin(now_s)
        for person in self._people:
            if person.share < 2 * self.params.visible_min:
                person.kalman = person.kalman.slowed(dt * person.known, body.SLOW_DOWN_S)
            person.kalman = person.kalman.predicted(dt, body.ACCELERATION_MPS2)
            person.height_var += HEIGHT_CHANGE_MPS**2 * dt * min(dt, self.params.errors_s)
            person.predict_facing(dt)
        return dt

    # -- explaining a frame ---------------------------------------------------------------------------------------
    def _ascend(self, frame: Explanation, people: People, touch: Bool) -> tuple[Samples, F64, F64, F64]:
        """Coordinate ascent, nearest first.

        Args:
            touch: (N, N) who may be on a ray of whom.

        Returns:
            The samples; of everybody the evidence, the curvature, and what is visible (``Samples.explain``).
        """
        predicted, order = people.poses.copy(), frame.nearest_first(people.poses)
        samples = frame.around(predicted, body.TORSO.torso_radius_m + 0.1)
        fine = np.array([person.kalman.position_std_m < STEPS_M[1] for person in self._people], np.int64)
        known = np.array([person.prior for person in self._people], KNOWN)
        return samples, *samples.explain(people, (predicted, known, STEPS_M, fine), order, touch)

    def _measure(self, person: P, s: Samples, pose: F64, curvature: F64, dt: float) -> None:
        """The place and the height, as far as the pixels show them."""
        if person.share < self.params.visible_min:
            return
        noise, up = s.noise(pose, curvature)
        if not person.head_in_view:
            noise = noise + STEP_STD_M**2 * np.eye(2)
        person.kalman = person.kalman.found_at(pose[:2], noise, body.SPEED_MAX_MPS)
        fresh = min(1.0, dt / self.params.errors_s)
        person.measure_facing(pose, curvature[3:5], fresh)
        if person.head_in_view:
            person.height_m, person.height_var = float(pose[2]), 1.0 / (1.0 / person.height_var + up * fresh)
        else:  # whatever is in view, nobody's height shows without the head
            person.height_m, person.height_var = person.tall_m, person.upright[1] ** 2
        person.seen, person.seen_s, person.unseen_s = person.kalman, self._log.now_s, 0.0

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
            self._note(one, "identity", f"exchanged with {other.track_id}: colours, log-odds {odds:.1f}", odds)

    def _end(self, person: P, reason: str, may_return: bool) -> None:
        """Stop following a person, who may be recognised later."""
        self._note(person, "pruned", reason, person.existence)
        self._people = [o for o in self._people if o is not person]
        if may_return:
            self._departed.append(person)

    def _add(self, newcomer: P, kind: DecisionKind, reason: str, value: float) -> None:
        """Follow a newcomer under a negative number, until it is recognised or confirmed."""
        newcomer.track_id = self._log.tentative_id()
        self._people.append(newcomer)
        self._note(newcomer, kind, reason, value)

    def _known(self, new: Sequence[P], floor_m2: float) -> list[tuple[P, P, float]]:
        """Newcomers and the lost or departed people they continue, with the log-odds."""
        p = self.params
        self._departed = [person for person in self._departed if self._log.now_s - person.seen_s <= p.remember_s]
        lost = [person for person in self._people if person.confirmed and person.share < p.visible_min]
        everybody = self._people + self._departed
        known = continued(new, lost + self._departed, everybody, floor_m2, p.low_share) if new else {}
        return [(new[i], *found) for i, found in known.items()]

    def _continue(self, newcomer: P, known: P, odds: float) -> None:
        """Give a newcomer the identity of a person known before."""
        reason = f"log-odds {odds:.1f} after {newcomer.born_s - known.seen_s:.1f} s"
        self._log.note(known.track_id, "reacquired", reason, odds, was=newcomer.track_id)
        self._departed = [o for o in self._departed if o is not known]
        self._people = [o for o in self._people if o is not known]
        newcomer.take_identity(known)
        newcomer.confirmed, newcomer.counted = True, {}

    def _confirm(self, newcomer: P, reason: str) -> None:
        was, newcomer.track_id = newcomer.track_id, self._log.person_id()
        newcomer.confirmed, newcomer.counted = True, {}
        self._exchanges.rename(was, newcomer.track_id)
        self._log.note(newcomer.track_id, "confirmed", reason, newcomer.existence, was=was)

    def _note(self, person: P, kind: DecisionKind, reason: str, value: float) -> None:
        self._log.note(person.track_id, kind, reason, value)

    def _state(self, person: P, box_px: Box = NO_BOX) -> TrackState:
        seen: State = "confirmed" if person.share >= self.params.visible_min else "lost"
        k, state = person.kalman, seen if person.confirmed else "tentative"
        x_m, y_m = person.head_m
        return TrackState(
            person.track_id, state, x_m, y_m, k.vx_mps, k.vy_mps, person.height_m, box_px, person.facing_deg
        )


class JointTracker(ExplainingTracker[Person, JointParams]):
    """Follows people by the ranges of all pixels (``docs/method.md``)."""

    needs: Needs = "points"
    CARRIED = (*ExplainingTracker.CARRIED, "_births")

    def __init__(self, params: JointParams | None = None) -> None:
        super().__init__(params or JointParams())
        self._likelihood = likelihood_of_ranges(self.params)

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        super().reset()
        self._births = Births(self.params)
        self._shown: list[tuple[tuple[int, ...], Owned]] = []

    def debug(self) -> TrackerDebug:
        """Circles of bodies with existence and visible share, and images of the owners of all pixels."""
        angles = np.linspace(0.0, 2.0 * math.pi, 25)
        circle = body.TORSO.torso_radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        strips = tuple(np.asarray(circle + q.at_m, dtype=np.float32) for q in self._people)
        labels = tuple(f"{q.track_id}: existence {q.existence:.2f}, visible {q.share:.2f}" for q in self._people)
        grey = np.array([40, *(80 + (37 * q.track_id) % 176 for q in self._people)], np.uint8)
        tiles: dict[str, F32 | U8] = {}
        for k, (shape, of) in enumerate(self._shown):
            tile: U8 = np.zeros(shape, np.uint8)
            tile.reshape(-1)[of.pixels] = grey[np.minimum(of.owner + 1, len(self._people))]
            tiles[f"owners/{k}"] = tile
        return TrackerDebug((Drawing("bodies", "floor", strips, labels),), tiles)

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Follow everybody into the next frame.

        Raises:
            ValueError: an observation without the pixels that the cameras saw, or of other cameras than before.
        """
        if not observation.views:
            raise ValueError("expected the pixels that the cameras saw (Observation.views), found none")
        views = observation.views
        self._births.prepare(views)
        dt = self._begin(observation.timestamp_s)
        predicted = {person.track_id: person.kalman for person in self._people}
        frame = Explanation(views, self._likelihood)
        ratios = colour_ratios(self._people)
        if self._people:
            self._explain(frame, side_by_side(self._people, ratios), dt)
        owned = frame.assign_pixels(side_by_side(self._people, ratios))
        self._shown = [(v.kind.shape, o) for v, o in zip(views, owned, strict=True)]
        for i, person in enumerate(self._people):
            if not person.confirmed:
                mine = [(v, o, o.owner == i) for v, o in zip(views, owned, strict=True)]
                person.count_evidence([(v, o.pixels[own], o.patches[own]) for v, o, own in mine])
        if frame.coloured:
            places = [person.at_m for person in self._people]
            gaps = [min((math.dist(a, b) for b in places if b is not a), default=math.inf) for a in places]
            self._learn(owned, [gap >= body.REACH_M for gap in gaps], dt)
        self._forget_gone()
        born = self._births.find(frame, self._people, owned, self._log.now_s)
        for newcomer in self._moved(frame, born, predicted) if born else ():
            reason = f"evidence {newcomer.evidence:.1f}, {newcomer.height_m:.2f} m tall"
            self._add(newcomer, "spawned", reason, newcomer.evidence)
        self._recognise(frame.coloured)
        boxes = person_boxes(observation.camera, [(*person.at_m, person.height_m) for person in self._people])
        return tuple(self._state(person, box) for person, box in zip(self._people, boxes, strict=True))

    def _explain(self, frame: Explanation, people: People, dt: float) -> None:
        """Places, then the frame's evidence on each person's existence."""
        touch = frame.touching(people.poses)
        samples, evidence, curvature, seen = self._ascend(frame, people, touch)
        stood_up: list[tuple[Person, F64]] = []
        for i, person in enumerate(self._people):
            person.evidence, pose = float(evidence[i]), people.poses[i]
            if (rival := self._rival(i, people)) >= 0:
                both, alone = self._beside(i, rival, samples.person(rival), people)
                person.evidence = min(person.evidence, both)
                if both < 0.0 and alone[2] > people.poses[rival, 2] + body.HEIGHT_STD_M:
                    stood_up.append((self._people[rival], alone))
            person.see(seen[i], min(1.0, float(seen[i, 2]) / frame.whole_patches(pose)))
            others = np.flatnonzero(touch[i])
            person.head_in_view = frame.shows_height(pose, person.height_m, person.upright[1])
            visible = person.share >= self.params.visible_min
            if not person.confirmed:
                mine_alone = samples.person(i)
                mine_alone.layer(people, others)
                person.shape = mine_alone.against_thing(pose, people.tall[i]) if visible else 0.0
            self._measure(person, samples.person(i), pose, curvature[i], dt)
            self._weigh(person, dt, body.LEAVE_S if person.inside < INSIDE else self.params.stay_s)
            if visible:
                self._note_movement(person, alone=len(others) == 0)
            kind: DecisionKind = "matched" if visible else "lost"
            reason = f"evidence {person.evidence:.1f}, visible {person.share:.2f}, existence {person.existence:.3f}"
            if len(others):
                reason += ", next to " + ", ".join(str(self._people[k].track_id) for k in others)
            self._note(person, kind, reason, person.evidence)
        for person, (x, y, h, *_) in stood_up:  # one upright body explains more than a low one and another
            person.kalman, person.height_m = person.kalman.moved_to(float(x), float(y)), float(h)

    def _rival(self, i: int, people: People) -> int:
        """The more established person in whose place this one stands; -1 for none."""
        gaps = np.hypot(*(people.poses[:, :2] - people.poses[i, :2]).T)
        gaps[i] = np.inf
        j = int(np.argmin(gaps))
        a, newcomer = self._people[i], self._people[j]
        return j if gaps[j] < body.APART_M and newcomer.standing > a.standing else -1

    def _beside(self, i: int, j: int, s: Samples, people: People) -> tuple[float, F64]:
        """Evidence for a person in another's place: both people, compared with the other one alone anywhere nearby, and
        (5,) the pose that this one would have."""
        poses, sure, tall, ratios = people.poses, people.sure.copy(), people.tall, people.ratios
        sure[[i, j]] = 1.0  # both are there, or one is
        people = People(poses, sure, tall, ratios)
        rest = np.array([k for k in range(len(poses)) if k not in (i, j)], dtype=np.int64)
        near = np.append(rest, (i, j))  # one alone has arms as well
        s.layer(people, rest, near)
        first = s.log_ratio(poses[i], tall[i], ratios[i])
        starts = poses[j].copy(), np.array([*poses[i, :2], tall[j, 0], *poses[j, 3:]])
        found = [s.ascend(start, poses[j], SEARCH_PRIOR, tall[j], ratios[j])[0] for start in starts]
        prior = s.log_prior(poses[j], tall[j]) + s.log_prior(poses[i], tall[i], np.array([j]))
        s.layer(people, np.append(rest, i), near)
        both = first + s.log_ratio(poses[j], tall[j], ratios[j]) + prior
        return both - max(found), starts[int(np.argmax(found))]

    def _moved(self, frame: Explanation, born: list[Person], predicted: Mapping[int, FloorKalman]) -> list[Person]:
        """The newcomers of a frame, without those to whom somebody moves who was predicted elsewhere."""
        people, strangers = list(self._people), list(born)
        odds = odds_of_moving(frame, people, [predicted[q.track_id] for q in people], born, self.params)
        while odds.size and odds.max() > KNOWN_LOG_ODDS:
            i, k = np.unravel_index(int(np.argmax(odds)), odds.shape)
            person, newcomer, before = people[i], born[k], predicted[people[i].track_id]
            noise = newcomer.kalman.covariance[:2, :2]
            newcomer.kalman = before.found_at(newcomer.pose[:2], noise, body.SPEED_MAX_MPS)
            newcomer.log_odds, newcomer.confirmed = person.log_odds, True
            newcomer.take_identity(person)
            self._people[i] = newcomer
            self._note(newcomer, "matched", f"in a newcomer's place: log-odds {odds[i, k]:.1f}", odds[i, k])
            strangers.remove(newcomer)
            odds[i], odds[:, k] = -math.inf, -math.inf
        return strangers

    def _note_movement(self, person: Person, alone: bool) -> None:
        """Count movement as evidence for a person; next to somebody it may be a shadow or something carried."""
        farther = max(0.0, math.dist(person.origin_m, person.at_m) - person.walked_m)
        person.walked_m += farther
        if alone:
            step_m = math.sqrt(body.TORSO.torso_radius_m**2 + float(np.trace(person.kalman.covariance[:2, :2])))
            person.moved = min(person.moved + farther / step_m, body.LOG_ODDS_MAX)

    def _forget_gone(self) -> None:
        for person in self._people:
            gone = person.inside < 0.15 and person.unseen_s > body.LEAVE_S
            if person.existence < 0.05 or gone or self._log.now_s - person.seen_s > self.params.remember_s:
                self._end(person, f"existence {person.existence:.2f}, evidence {person.evidence:.1f}", person.confirmed)

    def _recognise(self, coloured: bool) -> None:
        """Confirm newcomers, either as a lost or departed person or as a stranger.

        An identity is decided as soon as its odds suffice, and no later than when the person has shown who it is.
        """
        p, new = self.params, [person for person in self._people if not person.confirmed]
        report, visible = math.log(p.report / (1 - p.report)), [q for q in new if q.share >= p.visible_min]
        sure = [q for q in visible if min(q.log_odds, q.proven, self._personhood(q)) > report]
        in_doubt: list[Person] = []
        for newcomer, before, odds in self._known(sure, p.floor_m2):  # before those who may be nobody
            if odds > KNOWN_LOG_ODDS:
                self._continue(newcomer, before, odds)
            elif newcomer.shows_more_after(self._log.now_s if coloured else math.inf):
                in_doubt.append(newcomer)
        for q in sure:
            if not q.confirmed and q not in in_doubt:
                self._confirm(q, f"existence {q.existence:.2f}, log-odds of a person {self._personhood(q):.1f}")
        for newcomer, before, odds in self._known([q for q in new if not q.confirmed], p.floor_m2):
            if odds > KNOWN_LOG_ODDS:
                self._continue(newcomer, before, odds)

    def _personhood(self, person: Person) -> float:
        """Log-odds of a person against a thing, by shape and own movement, and by height as far as the head is in view:
        elsewhere the height is the prior."""
        shape = math.log(2.0) - float(np.logaddexp(0.0, -person.likeness))  # half of all things are of any shape
        if not person.head_in_view:
            return person.moved + shape + math.log((1 - body.THING_SHARE) / body.THING_SHARE)
        low = self.params.low_share / body.HEIGHT_MEAN_M
        upright = body.stature(person.height_m, body.HEIGHT_MEAN_M, body.HEIGHT_STD_M, self.params.low_share) - low
        density = (upright + LOW_WALKERS * low) * math.exp(person.moved) + (1 - LOW_WALKERS) * low
        return shape + math.log((1 - body.THING_SHARE) * density / (body.THING_SHARE / body.HEIGHT_MEAN_M))
