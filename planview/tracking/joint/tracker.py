"""People explained jointly: every pixel of surface and of seen background by the nearest person in front of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from calib.types import F32, F64, U8
from planview.tracking import body
from planview.tracking.base import DecisionKind, Drawing, Needs, Observation, TrackerDebug, person_boxes
from planview.tracking.explain.births import SEARCH_PRIOR, Births, odds_of_moving
from planview.tracking.explain.explanation import Explanation, Owned, People, Samples
from planview.tracking.explain.identity import KNOWN_LOG_ODDS
from planview.tracking.explain.person import Person, colour_ratios, side_by_side
from planview.tracking.explain.tracker import ExplainingTracker
from planview.tracking.joint.ranges import JointParams, likelihood_of_ranges
from planview.tracking.kalman import FloorKalman
from planview.trajectories.state import TrackState

LOW_WALKERS = 0.01
"""Share of low people who walk: these are children. The others sit or bend, and stay where they are."""
COLOURLESS_S = 3.0
"""Images without the colours that they had before are damaged for no longer [s]: then it is night mode, as for the
background (``DAMAGE_S``)."""
INSIDE = 0.3
"""Share of a body in the image below which a person is at the border."""


class JointTracker(ExplainingTracker[Person, JointParams]):
    """Follows people by the ranges of all pixels (``docs/method.md``)."""

    needs: Needs = "points"
    CARRIED = (*ExplainingTracker.CARRIED, "_births", "_coloured_s")

    def __init__(self, params: JointParams | None = None) -> None:
        super().__init__(params or JointParams())
        self._likelihood = likelihood_of_ranges(self.params)

    def reset(self) -> None:
        """Forget everybody; ids start again at 1."""
        super().reset()
        self._births, self._coloured_s = Births(self.params), -math.inf
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
        coloured = self._expects_colours(frame)
        damaged = observation.unknown or (coloured and not frame.coloured)
        if damaged:
            for person in self._people:
                person.blind_s += dt
        ratios = colour_ratios(self._people)
        if self._people:
            self._explain(frame, side_by_side(self._people, ratios), dt)
        owned = frame.assign_pixels(side_by_side(self._people, ratios))
        self._shown = [(v.kind.shape, o) for v, o in zip(views, owned, strict=True)]
        for i, person in enumerate(self._people):
            if not (person.confirmed or damaged):
                mine = [(v, o, o.owner == i) for v, o in zip(views, owned, strict=True)]
                person.count_evidence([(v, o.pixels[own], o.patches[own]) for v, o, own in mine])
        if frame.coloured:
            places = [person.at_m for person in self._people]
            gaps = [min((math.dist(a, b) for b in places if b is not a), default=math.inf) for a in places]
            self._learn(owned, [gap >= body.REACH_M for gap in gaps], dt)
        else:  # of those who touch now colours show later whether they have been exchanged
            self._exchanges.update(self._people, (), 0.0)
        self._forget_gone()
        born = self._births.find(frame, self._people, owned, self._life.now_s)
        for newcomer in self._moved(frame, born, predicted) if born else ():
            reason = f"evidence {newcomer.evidence:.1f}, {newcomer.height_m:.2f} m tall"
            self._add(newcomer, "spawned", reason, newcomer.evidence)
        if not damaged:  # else outlines may be as wrong as colours
            self._recognise(coloured)
        boxes = person_boxes(observation.camera, [(*person.at_m, person.height_m) for person in self._people])
        return tuple(
            self._state(person, box, (self._confidence(person), person.head_std_m))
            for person, box in zip(self._people, boxes, strict=True)
        )

    def _expects_colours(self, frame: Explanation) -> bool:
        """Whether colours distinguish people in this frame, or did a moment ago and will again."""
        if frame.coloured and any(view.colour is not None for view in frame.views):
            self._coloured_s = self._life.now_s
        return frame.coloured or self._life.now_s - self._coloured_s < COLOURLESS_S

    def _explain(self, frame: Explanation, people: People, dt: float) -> None:
        """Places, then the frame's evidence on each person's existence."""
        touch = frame.touching(people.poses)
        samples, found = self._ascend(frame, people, touch)
        stood_up: list[tuple[Person, F64]] = []
        for i, person in enumerate(self._people):
            person.evidence, pose = float(found.evidence[i]), people.poses[i]
            if (rival := self._rival(i, people)) >= 0:
                both, alone = self._beside(i, rival, samples.person(rival), people)
                person.evidence = min(person.evidence, both)
                if both < 0.0 and alone[2] > people.poses[rival, 2] + body.HEIGHT_STD_M:
                    stood_up.append((self._people[rival], alone))
            person.see(found.seen[i], min(1.0, float(found.seen[i, 2]) / frame.whole_patches(pose)))
            person.shared_m = frame.shared_std_m(pose)
            others = np.flatnonzero(touch[i])
            person.head_in_view = frame.shows_height(pose, person.height_m, person.upright[1])
            visible = person.share >= self.params.visible_min
            if not person.confirmed:
                mine_alone = samples.person(i)
                mine_alone.layer(people, others)
                person.shape = mine_alone.against_thing(pose, people.tall[i]) if visible else 0.0
            self._measure(person, samples.person(i), pose, found.curvature[i], found.turned[i], dt)
            self._weigh(person, dt, body.LEAVE_S if person.inside < INSIDE else self.params.stay_s)
            if visible:
                self._note_movement(person, alone=len(others) == 0)
            if visible and person.head_in_view and not person.confirmed:
                person.count_height(self.params.low_share)
            kind: DecisionKind = "matched" if visible else "lost"
            reason = f"evidence {person.evidence:.1f}, visible {person.share:.2f}, existence {person.existence:.3f}"
            if len(others):
                reason += ", next to " + ", ".join(str(self._people[k].track_id) for k in others)
            self._life.note(person, kind, reason, person.evidence)
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
            newcomer.kalman = before.found_at(newcomer.pose[:2], noise)
            newcomer.log_odds, newcomer.confirmed = person.log_odds, True
            newcomer.take_identity(person)
            self._people[i] = newcomer
            self._life.note(newcomer, "matched", f"in a newcomer's place: log-odds {odds[i, k]:.1f}", odds[i, k])
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
            if person.existence < 0.05 or gone or self._life.now_s - person.seen_s > self.params.remember_s:
                self._end(person, f"existence {person.existence:.2f}, evidence {person.evidence:.1f}", person.confirmed)

    def _recognise(self, coloured: bool) -> None:
        """Confirm newcomers, either as a lost or departed person or as a stranger.

        An identity is decided as soon as its odds suffice, and no later than when the person has shown who it is.

        Args:
            coloured: colours show, or will again.
        """
        p, new = self.params, [person for person in self._people if not person.confirmed]
        sure = [q for q in new if q.share >= p.visible_min and self._confidence(q) > p.report]
        in_doubt: list[Person] = []
        for newcomer, before, odds in self._known(sure, p.floor_m2):  # before those who may be nobody
            if odds > KNOWN_LOG_ODDS:
                self._continue(newcomer, before, odds)
            elif newcomer.shows_more_after(self._life.now_s, coloured):
                in_doubt.append(newcomer)
        for q in sure:
            if not q.confirmed and q not in in_doubt:
                self._confirm(q, f"existence {q.existence:.2f}, log-odds of a person {self._personhood(q):.1f}")
        for newcomer, before, odds in self._known([q for q in new if not q.confirmed], p.floor_m2):
            if odds > KNOWN_LOG_ODDS:
                self._continue(newcomer, before, odds)

    def _confidence(self, person: Person) -> float:
        """Probability that a person is there: of one who is not confirmed by independent evidence, and of no thing."""
        if person.confirmed:
            return person.existence
        return 1.0 / (1.0 + math.exp(-min(person.log_odds, person.proven, self._personhood(person))))

    def _personhood(self, person: Person) -> float:
        """Log-odds of a person against a thing, by shape and own movement, and by height as far as the head has been in
        view: elsewhere the height is the prior."""
        shape = math.log(2.0) - float(np.logaddexp(0.0, -person.likeness))  # half of all things are of any shape
        if person.height_patches == 0.0:
            return person.moved + shape + math.log((1 - body.THING_SHARE) / body.THING_SHARE)
        low = self.params.low_share / body.HEIGHT_MEAN_M
        density = (person.upright_density + LOW_WALKERS * low) * math.exp(person.moved) + (1 - LOW_WALKERS) * low
        return shape + math.log((1 - body.THING_SHARE) * density / (body.THING_SHARE / body.HEIGHT_MEAN_M))
