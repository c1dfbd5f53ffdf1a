"""People explained jointly: every pixel of surface and of seen background by the nearest person in front of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from calib.types import F32, F64, U8, Bool
from planview.maps.view import View
from planview.tracking import body
from planview.tracking.base import DecisionKind, Drawing, Needs, Observation, TrackerDebug, person_boxes
from planview.tracking.explain.births import SEARCH_PRIOR, Births, odds_of_moving
from planview.tracking.explain.clothes import colour_ratios
from planview.tracking.explain.explanation import Explanation, Owners, People, Samples
from planview.tracking.explain.identity import KNOWN_LOG_ODDS
from planview.tracking.explain.person import BORN_LOG_ODDS, Glimpse, Person, side_by_side
from planview.tracking.explain.tracker import ExplainingTracker, without
from planview.tracking.joint.ranges import JointParams, hide_outlines, likelihood_of_ranges
from planview.tracking.kalman import FloorKalman
from planview.tracking.odds import log_odds, probability
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
        self._births = Births(self.params)
        self._coloured_s = -math.inf
        self._shown: list[tuple[tuple[int, ...], Owners]] = []

    def debug(self) -> TrackerDebug:
        """Circles of bodies with existence and visible share, and images of the owners of all pixels."""
        angles = np.linspace(0.0, 2.0 * math.pi, 25)
        circle = body.TORSO.torso_radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        strips: list[F32] = []
        labels = []
        greys = [40]
        for person in self._people:
            strips.append((circle + person.at_m).astype(np.float32))
            visible = f"visible {person.glimpse.visible_share:.2f}"
            labels.append(f"{person.track_id}: existence {person.existence:.2f}, {visible}")
            greys.append(80 + (37 * person.track_id) % 176)
        tiles: dict[str, F32 | U8] = {}
        for k, (shape, in_view) in enumerate(self._shown):
            tile: U8 = np.zeros(shape, np.uint8)
            shown = np.minimum(in_view.owner + 1, len(self._people))
            tile.reshape(-1)[in_view.pixels] = np.array(greys, np.uint8)[shown]
            tiles[f"owners/{k}"] = tile
        return TrackerDebug((Drawing("bodies", "floor", tuple(strips), tuple(labels)),), tiles)

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Follow everybody into the next frame.

        Raises:
            ValueError: an observation without the pixels that the cameras saw, or of other cameras than before.
        """
        views = [hide_outlines(view) for view in observation.views]
        if not views:
            raise ValueError("expected the pixels that the cameras saw (Observation.views), found none")
        self._births.prepare(views)
        dt_s = self._begin(observation.timestamp_s)
        predicted = {person.track_id: person.kalman for person in self._people}
        frame = Explanation(views, self._likelihood)
        coloured = self._expects_colours(frame)
        damaged = observation.unknown or (coloured and not frame.coloured)

        # Where everybody is now, and how likely it is that they are there.
        if damaged:
            for person in self._people:
                person.blind_s += dt_s
        ratios = colour_ratios([person.identity.clothes for person in self._people])
        people = side_by_side(self._people, ratios)
        shared = frame.share_rays(people.poses)
        samples = self._explain(frame, people, shared, dt_s)

        # Whose the pixels are. They show who is a person, and what each of them wears.
        owners = frame.assign_pixels(side_by_side(self._people, ratios))
        self._shown = [(view.kind.shape, in_view) for view, in_view in zip(views, owners, strict=True)]
        if not damaged:
            self._count_evidence(views, owners, samples, people, shared)
        self._learn_clothes(frame, owners, dt_s)

        # Who has left, who is new, and who of these was here before.
        self._end_gone()
        self._add_newcomers(frame, owners, predicted)
        if not damaged:  # else outlines may be as wrong as colours
            self._recognise(coloured)
        boxes = person_boxes(observation.camera, [(*person.at_m, person.height_m) for person in self._people])
        return tuple(
            self._state(person, box_px, self._confidence(person), person.head_std_m)
            for person, box_px in zip(self._people, boxes, strict=True)
        )

    def _expects_colours(self, frame: Explanation) -> bool:
        """True if colours distinguish people in this frame, or did a moment ago and will again."""
        if frame.coloured and any(view.colour is not None for view in frame.views):
            self._coloured_s = self._life.now_s
        return frame.coloured or self._life.now_s - self._coloured_s < COLOURLESS_S

    def _explain(self, frame: Explanation, people: People, shared: Bool, dt_s: float) -> Samples:
        """Move everybody to where they explain best, and weigh the frame's evidence on each person's existence; return
        the samples around each.

        Args:
            shared: (N, N) who may be on a ray of whom.
        """
        samples, fits = self._ascend(frame, people, shared)
        upright: list[tuple[Person, F64]] = []
        for i, person in enumerate(self._people):
            pose = people.poses[i]
            neighbours = np.flatnonzero(shared[i])
            evidence = float(fits.evidence[i])
            rival = _in_the_place_of(i, people)
            if rival >= 0 and self._people[rival].seniority > person.seniority:
                both, alone = self._compare_with_rival(i, rival, samples.person(rival), people)
                evidence = min(evidence, both)
                if both < 0.0 and alone[2] > people.poses[rival, 2] + body.HEIGHT_STD_M:
                    upright.append((self._people[rival], alone))
            inside_share = min(1.0, float(fits.patches[i, 2]) / frame.whole_patches(pose))
            head_in_view = frame.shows_height(pose, person.height_m, person.identity.stature.std_m)
            shared_std_m = frame.shared_std_m(pose)
            person.glimpse = Glimpse.of(evidence, fits.patches[i], inside_share, head_in_view, shared_std_m)
            self._measure(person, samples.person(i), pose, fits.curvature[i], fits.by_facing[i], dt_s)
            at_border = person.glimpse.inside_share < INSIDE
            stays_s = body.LEAVE_S if at_border else self.params.stay_s
            self._weigh(person, dt_s, stays_s)
            if self._is_visible(person):
                self._count_signs(person, alone=len(neighbours) == 0)
            self._note_match(person, [self._people[k] for k in neighbours])
        for person, pose in upright:  # one upright body explains more than a low one and another
            person.take_pose(pose)
        return samples

    def _count_signs(self, person: Person, alone: bool) -> None:
        """Count movement and height as evidence for a person and against a thing; next to somebody what moves may be a
        shadow or something carried."""
        walk = person.identity.walk
        farther_m = walk.extend(person.at_m)
        if alone:
            place_var = float(np.trace(person.kalman.covariance[:2, :2]))
            step_m = math.sqrt(body.TORSO.torso_radius_m**2 + place_var)
            walk.evidence = min(walk.evidence + farther_m / step_m, body.LOG_ODDS_MAX)
        if person.glimpse.head_in_view and not person.confirmed:
            person.proof.count_height(person.height_m, person.glimpse, self.params.low_share)

    def _note_match(self, person: Person, neighbours: Sequence[Person]) -> None:
        """Write down how well the frame shows a person."""
        kind: DecisionKind = "matched" if self._is_visible(person) else "lost"
        glimpse = person.glimpse
        shown = f"evidence {glimpse.evidence:.1f}, visible {glimpse.visible_share:.2f}"
        reason = f"{shown}, existence {person.existence:.3f}"
        if neighbours:
            reason += ", next to " + ", ".join(str(neighbour.track_id) for neighbour in neighbours)
        self._life.note(person, kind, reason, glimpse.evidence)

    def _explains_in_another_posture(self, frame: Explanation, newcomer: Person) -> bool:
        """True if the person in whose place a newcomer would stand explains the pixels as well alone, in another
        posture; that person takes the posture."""
        everybody = side_by_side([*self._people, newcomer])
        n = len(self._people)
        rival = _in_the_place_of(n, everybody)
        if rival < 0:
            return False
        samples = frame.samples_around(everybody.poses[rival], body.TORSO.torso_radius_m + 0.1)
        both, alone = self._compare_with_rival(n, rival, samples, everybody)
        if both >= self.params.birth_evidence:
            return False
        self._people[rival].take_pose(alone)
        return True

    def _compare_with_rival(self, i: int, rival: int, samples: Samples, people: People) -> tuple[float, F64]:
        """Evidence for a person and the rival in whose place it stands, compared with the rival alone anywhere nearby;
        (5,) the pose that the rival alone would have.

        Args:
            samples: those of the rival.
        """
        existence = people.existence.copy()
        existence[[i, rival]] = 1.0  # both are there, or one is
        people = people._replace(existence=existence)
        pose, stature, ratios = people.person(rival)
        rest = np.delete(np.arange(len(people.poses)), [i, rival])
        near = np.append(rest, (i, rival))  # one alone has arms as well
        samples.lay_others(people, rest, near)
        second = samples.log_ratio(*people.person(i))
        fits = []
        in_the_place_of_the_other = np.array([*people.poses[i, :2], stature[0], *pose[3:]])
        for alone in (pose.copy(), in_the_place_of_the_other):
            evidence, _ = samples.ascend(alone, pose, SEARCH_PRIOR, stature, ratios)
            fits.append((evidence, alone))
        one, alone = max(fits, key=lambda fit: fit[0])
        prior = samples.log_prior(pose, stature)
        prior += samples.log_prior(people.poses[i], people.statures[i], np.array([rival]))
        samples.lay_others(people, np.append(rest, i), near)
        both = second + samples.log_ratio(pose, stature, ratios) + prior
        return both - one, alone

    def _count_evidence(
        self, views: Sequence[View], owners: Sequence[Owners], samples: Samples, people: People, shared: Bool
    ) -> None:
        """Add the pixels of each newcomer to the evidence that it is a person and no thing."""
        confirmed = np.array([person.confirmed for person in self._people], np.bool_)
        for i in np.flatnonzero(~confirmed).tolist():
            person = self._people[i]
            pixels = []
            for view, in_view in zip(views, owners, strict=True):
                mine = in_view.owner == i
                pixels.append((view, in_view.pixels[mine], in_view.patches[mine]))
            new_share = person.proof.count(pixels, person.glimpse)
            if new_share and self._is_visible(person):  # a thing that stands shows nothing new
                own = samples.person(i)
                own.lay_others(people, np.flatnonzero(shared[i] & confirmed))  # newcomers may be parts of one thing
                shape = own.against_things(people.poses[i], people.statures[i])
                if not person.glimpse.head_in_view:  # a body without its head may look as flat as any thing
                    shape = np.maximum(shape, 0.0)
                person.proof.shape = person.proof.shape + new_share * shape

    def _learn_clothes(self, frame: Explanation, owners: Sequence[Owners], dt_s: float) -> None:
        """Learn the colours of people who stand apart; without colours, people who touch may be exchanged, which
        colours show later."""
        if not frame.coloured:
            self._exchanges.update(self._people, (), 0.0)
            return
        apart = []
        for person in self._people:
            gaps_m = [math.dist(person.at_m, other.at_m) for other in without(self._people, person)]
            apart.append(min(gaps_m, default=math.inf) >= body.REACH_M)
        self._learn_colours(owners, apart, dt_s)

    def _end_gone(self) -> None:
        """Stop following people who have left or were not seen for long."""
        for person in self._people:
            left = person.glimpse.inside_share < 0.15 and person.unseen_s > body.LEAVE_S
            unmeasured_s = self._life.now_s - person.last_seen.time_s
            if left or person.existence < 0.05 or unmeasured_s > self.params.remember_s:
                reason = f"existence {person.existence:.2f}, evidence {person.glimpse.evidence:.1f}"
                self._end(person, reason, person.confirmed)

    def _add_newcomers(
        self, frame: Explanation, owners: Sequence[Owners], predicted: Mapping[int, FloorKalman]
    ) -> None:
        """Follow one more person where pixels ask for one, unless somebody who was predicted elsewhere is there."""
        born = self._births.find(frame, self._people, owners, self._life.now_s)
        if not born:
            return
        for newcomer in self._move_to_newcomers(frame, born, predicted):
            if self._explains_in_another_posture(frame, newcomer):
                continue
            evidence = newcomer.glimpse.evidence
            self._add(newcomer, "spawned", f"evidence {evidence:.1f}, {newcomer.height_m:.2f} m tall", evidence)

    def _move_to_newcomers(
        self, frame: Explanation, born: list[Person], predicted: Mapping[int, FloorKalman]
    ) -> list[Person]:
        """Move people who were predicted elsewhere to the newcomers that they are; return the other newcomers."""
        people = list(self._people)
        strangers = list(born)
        before = [predicted[person.track_id] for person in people]
        odds = odds_of_moving(frame, people, before, born, self.params)
        while odds.size and odds.max() > KNOWN_LOG_ODDS:
            i, k = np.unravel_index(int(np.argmax(odds)), odds.shape)
            person = people[i]
            newcomer = born[k]
            noise = newcomer.kalman.covariance[:2, :2]
            newcomer.kalman = before[i].correct_to(newcomer.pose[:2], noise)
            newcomer.log_odds = person.log_odds
            newcomer.proof = person.proof
            newcomer.confirmed = True
            newcomer.swap_identity(person)
            self._people[i] = newcomer
            reason = f"in a newcomer's place: log-odds {odds[i, k]:.1f}"
            self._life.note(newcomer, "matched", reason, odds[i, k])
            strangers.remove(newcomer)
            odds[i] = -math.inf
            odds[:, k] = -math.inf
        return strangers

    def _recognise(self, coloured: bool) -> None:
        """Confirm newcomers, either as a lost or departed person or as a stranger.

        An identity is decided as soon as its odds suffice, and no later than when the person has shown who it is.

        Args:
            coloured: colours show, or will again.
        """
        newcomers = [person for person in self._people if not person.confirmed]
        sure = [person for person in newcomers if self._is_visible(person) and self._is_sure(person)]
        in_doubt: list[Person] = []
        for match in self._match(sure, self.params.floor_m2):  # before those who may be nobody
            if match.log_odds > KNOWN_LOG_ODDS:
                self._continue(match)
            elif match.person.will_show_more(self._life.now_s, coloured):
                in_doubt.append(match.person)
        for person in sure:
            if not person.confirmed and person not in in_doubt:
                personhood = self._personhood(person)
                self._confirm(person, f"existence {person.existence:.2f}, log-odds of a person {personhood:.1f}")
        unconfirmed = [person for person in newcomers if not person.confirmed]
        for match in self._match(unconfirmed, self.params.floor_m2):
            if match.log_odds > KNOWN_LOG_ODDS:
                self._continue(match)

    def _is_sure(self, newcomer: Person) -> bool:
        """True if each kind of evidence by itself shows a person, even if but one newcomer in fifty were one."""
        least = min(newcomer.log_odds, newcomer.proof.log_odds, self._personhood(newcomer))
        return probability(least) > self.params.report

    def _confidence(self, person: Person) -> float:
        """Probability that somebody is there, of a newcomer by independent evidence as well, and is no thing. The
        evidence of its birth makes a newcomer as likely as not."""
        existence = person.log_odds
        if not person.confirmed:
            existence = min(existence, person.proof.log_odds) - BORN_LOG_ODDS
        return probability(existence) * probability(self._personhood(person))

    def _personhood(self, person: Person) -> float:
        """Log-odds of a person against a thing, by shape and own movement, and by height as far as the head has been in
        view: elsewhere the height is the prior."""
        proof = person.proof
        moved = person.identity.walk.evidence
        thing = float(np.logaddexp.reduce(-proof.shape)) - math.log(len(proof.shape))
        shape = math.log(2.0) - float(np.logaddexp(0.0, thing))  # half of all things are of any shape
        by_shape = shape - log_odds(body.THING_SHARE)
        if proof.height_patches == 0.0:
            return moved + by_shape
        low = self.params.low_share / body.HEIGHT_MEAN_M
        walking = proof.upright_density + LOW_WALKERS * low
        density = walking * math.exp(moved) + (1 - LOW_WALKERS) * low
        return by_shape + math.log(density * body.HEIGHT_MEAN_M)


def _in_the_place_of(i: int, people: People) -> int:
    """Index of the person in whose place this one stands; -1 for none."""
    gaps = np.hypot(*(people.poses[:, :2] - people.poses[i, :2]).T)
    gaps[i] = math.inf
    nearest = int(np.argmin(gaps))
    return nearest if gaps[nearest] < body.APART_M else -1
