"""People explained jointly: every pixel of surface and of seen background by the nearest person in front of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F64, I64
from planview.maps.colour import CODES
from planview.tracking import body
from planview.tracking.base import Decision, DecisionKind, Observation, TrackerDebug
from planview.tracking.joint._kernels import PARTS
from planview.tracking.joint.births import EVIDENCE_MAX, Births
from planview.tracking.joint.drawing import draw
from planview.tracking.joint.explanation import STEPS_M, Explanation, Owned, People, Samples
from planview.tracking.joint.identity import Exchanges, continued
from planview.tracking.joint.params import JointParams
from planview.tracking.joint.person import Person, colour_counts, colour_ratios, side_by_side
from planview.trajectories.state import State, TrackState

ACCELERATION_MPS2 = 2.0
"""Deviation of a walker's acceleration [m/s^2]."""
SLOW_DOWN_S = 0.7
"""Time in which an unseen person's speed decays [s]."""
HEIGHT_CHANGE_MPS = 0.6
"""Speed of a head that goes up and down: sitting down, bending [m/s]."""
LEAVE_S = 0.7
"""Mean time that a person beyond the border stays unknown and near [s]."""
LOG_ODDS_MAX = 8.0
"""Existence is never surer than this."""
KNOWN_ODDS = 3.0
"""Log-odds at which a newcomer is somebody known before it is sure to exist: one error in twenty."""
LOW_WALKERS = 0.01
"""Share of low people who walk, which are children; the others sit or bend, and stay where they are."""
INSIDE = 0.3
"""Share of a body in the image below which a person is at the border."""


class JointTracker:
    """Follows people by the likelihood of all pixels given who stands where (``docs/method.md``).

    Existence by the Bernoulli filter of Vo, Vo and Pham 2010.
    """

    def __init__(self, params: JointParams | None = None) -> None:
        self.params = params or JointParams()
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._people: list[Person] = []
        self._departed: list[Person] = []
        self._next_id = 1
        self._now_s = math.nan
        self._exchanges = Exchanges(self.params)
        self._births = Births()
        self._log: list[Decision] = []
        self._owned: list[tuple[tuple[int, ...], Owned]] = []

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return tuple(self._log)

    def debug(self) -> TrackerDebug:
        """Who owns each pixel, and the people on the floor."""
        return draw(self._people, self._owned)

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Follow everybody into the next frame.

        Raises:
            ValueError: an observation without the pixels that the cameras saw.
        """
        if not observation.views:
            raise ValueError("expected the pixels that the cameras saw (Observation.views), found none")
        dt = 0.0 if math.isnan(self._now_s) else max(observation.timestamp_s - self._now_s, 0.0)
        self._now_s, self._log = observation.timestamp_s, []
        frame = Explanation(observation.views, self.params, body.body_table())
        for q in self._people:
            self._predict(q, dt)
        ratios = colour_ratios(self._people)
        if self._people:
            self._explain(frame, side_by_side(self._people, ratios), dt)
        owned, points = frame.share_out(side_by_side(self._people, ratios))
        self._owned = [(v.kind.shape, o) for v, o in zip(observation.views, owned, strict=True)]
        for i, q in enumerate(self._people):
            if not q.confirmed:
                mine = [(v, o, o.owner == i) for v, o in zip(observation.views, owned, strict=True)]
                q.count_evidence([(v, o.pixels[own], o.patches[own]) for v, o, own in mine])
        if self._coloured(frame):
            self._learn(frame, owned, dt)
        self._forget_gone()
        self._meet(self._births.find(frame, self._people, owned, points, self._now_s))
        self._recognise()
        return tuple(self._state(q) for q in self._people)

    def _predict(self, q: Person, dt: float) -> None:
        p = self.params
        if q.share < 2 * p.visible_min:
            q.kalman = q.kalman.slowed(dt, SLOW_DOWN_S)
        q.kalman = q.kalman.predicted(dt, ACCELERATION_MPS2)
        q.height_var += HEIGHT_CHANGE_MPS**2 * dt * min(dt, p.errors_s)

    def _coloured(self, frame: Explanation) -> bool:
        return self.params.colour_weight > 0 and all(v.colour is not None for v in frame.views)

    # -- explaining a frame ---------------------------------------------------------------------------------------
    def _explain(self, frame: Explanation, people: People, dt: float) -> None:
        """Coordinate ascent, nearest first; then what the frame says of each place and existence."""
        predicted = people.poses.copy()
        touch = frame.touching(predicted)
        camera = frame.views[0].rays.centre_m
        order = np.argsort(np.hypot(*(predicted[:, :2] - camera[:2]).T))
        samples = [frame.around(pose, body.TORSO.torso_radius_m + 0.1) for pose in predicted]
        information = [np.array([*q.kalman.information, 1 / q.height_var]) for q in self._people]
        others = [np.flatnonzero(touch[i] & (np.arange(len(touch)) != i)) for i in range(len(touch))]
        worth, bent = np.zeros(len(predicted)), np.zeros((len(predicted), 3))
        for sweep in range(2):
            for i in order:
                if sweep and not len(others[i]):
                    continue
                samples[i].layer(people, others[i])
                worth[i], bent[i] = samples[i].ascend(
                    people.poses[i], predicted[i], information[i], people.tall[i], people, others[i],
                    people.ratios[i], STEPS_M[sweep:],
                )  # fmt: skip
        flooded = all(np.count_nonzero(v.kind) > 0.5 * v.kind.size for v in frame.views)
        for i, q in enumerate(self._people):
            q.evidence = float(worth[i])
            if len(others[i]):
                q.evidence = self._among(i, samples, people, others[i])
            self._measure(q, frame, samples[i], people.poses[i], bent[i], dt)
            if not flooded:
                self._weigh(q, dt, alone=len(others[i]) == 0)
            self._say(q, [self._people[k] for k in others[i]])

    def _among(self, i: int, samples: list[Samples], people: People, others: I64) -> float:
        """Evidence for a person on whose rays others are, where all of them are now."""
        s, pose, ratio = samples[i], people.poses[i], people.ratios[i]
        s.layer(people, others)
        evidence = s.lam(pose, ratio) + s.believed(pose, people.tall[i], people, others)
        rival = self._rival(i, people)
        return min(evidence, self._beside(i, rival, samples[rival], people)) if rival >= 0 else evidence

    def _measure(self, q: Person, frame: Explanation, s: Samples, pose: F64, bent: F64, dt: float) -> None:
        """The visible share of a person, and the place as far as the pixels tell it."""
        mine, total = s.visible(pose)
        q.inside = min(1.0, total / frame.whole_patches(pose))
        q.share, q.patches = (mine / total if total > 0 else 0.0) * min(1.0, 1.25 * q.inside), total
        q.head_in_view = frame.in_view(pose)
        if q.share < self.params.visible_min:
            return
        noise, up = s.noise(pose, bent)
        x, y, h = pose
        q.kalman = q.kalman.found_at(x, y, noise, body.SPEED_MAX_MPS)
        q.height_m, q.height_var = float(h), 1.0 / (1.0 / q.height_var + up * min(1.0, dt / self.params.errors_s))
        q.seen_s = self._now_s

    def _rival(self, i: int, people: People) -> int:
        """The person of better standing in whose place this one is; -1 for none."""
        gaps = np.hypot(*(people.poses[:, :2] - people.poses[i, :2]).T)
        gaps[i] = np.inf
        j = int(np.argmin(gaps))
        a, b = self._people[i], self._people[j]
        better = (b.confirmed, b.log_odds, -b.track_id) > (a.confirmed, a.log_odds, -a.track_id)
        return j if gaps[j] < body.APART_M and better else -1

    def _beside(self, i: int, j: int, s: Samples, people: People) -> float:
        """Evidence for a person in another's place: both, against the other alone who may stand anywhere near."""
        poses, tall, ratios = people.poses, people.tall, people.ratios
        rest = np.array([k for k in range(len(poses)) if k not in (i, j)], dtype=np.int64)
        loose = np.array([1.0, 0.0, 1.0, body.TORSO.torso_radius_m**2]) / body.TORSO.torso_radius_m**2
        s.layer(people, rest)
        first = s.lam(poses[i], ratios[i])
        starts = poses[j].copy(), np.array([*poses[i, :2], tall[j, 0]])
        alone = max(s.ascend(start, poses[j], loose, tall[j], people, rest, ratios[j])[0] for start in starts)
        s.layer(people, np.append(rest, i))
        both = first + s.lam(poses[j], ratios[j])
        both += s.believed(poses[i], tall[i], people, np.array([j]))
        both += s.believed(poses[j], tall[j], people, rest)
        return both - alone

    def _weigh(self, q: Person, dt: float, alone: bool) -> None:
        """Existence: survival, then the evidence of this look; personhood: height and moving by itself.

        What moves before, behind or beside a person may be its shadow, or be carried or pushed.
        """
        p, looks = self.params, min(1.0, dt / self.params.errors_s)
        if q.share < p.visible_min:
            away_s = LEAVE_S if q.inside < INSIDE else p.stay_s
            stays = q.existence * math.exp(-dt / away_s)
            q.log_odds = math.log(max(stays, 1e-6) / max(1 - stays, 1e-6))
        q.log_odds += looks * max(-EVIDENCE_MAX, min(EVIDENCE_MAX, q.evidence))
        q.log_odds = max(-LOG_ODDS_MAX, min(LOG_ODDS_MAX, q.log_odds))
        if q.share < p.visible_min:
            return
        q.learn_height(looks, p.low_share)
        farther = max(0.0, math.dist(q.origin_m, q.at_m) - q.walked_m)
        q.walked_m += farther
        if alone:
            step_m = math.sqrt(body.TORSO.torso_radius_m**2 + q.kalman.c_xx + q.kalman.c_yy)
            q.moved = min(q.moved + farther / step_m, LOG_ODDS_MAX)

    # -- who is who, who comes, who goes ----------------------------------------------------------------------------
    def _learn(self, frame: Explanation, owned: Sequence[Owned], dt: float) -> None:
        counts = np.zeros((len(self._people), PARTS, CODES), np.float32)
        for o in owned:
            sure = (o.share > 0.8) & (o.owner >= 0)
            counts += colour_counts(len(self._people), o.owner[sure], o.height[sure], o.colours[sure])
        for q, seen in zip(self._people, counts, strict=True):
            near = min((math.dist(q.at_m, o.at_m) for o in self._people if o is not q), default=math.inf)
            if q.share >= 0.5 and near >= body.REACH_M:
                q.learn_colours(seen)
        for a, b, odds in self._exchanges.update(self._people, owned, dt):
            a.take_identity(b)
            self._note(a, "identity", f"exchanged with {b.track_id}: colours, log-odds {odds:.1f}", odds)

    def _forget_gone(self) -> None:
        p = self.params
        keep = []
        for q in self._people:
            beyond = q.inside < 0.15 and q.share < p.visible_min and self._now_s - q.seen_s > LEAVE_S
            if q.existence >= 0.05 and not beyond:
                keep.append(q)
                continue
            self._note(q, "pruned", f"existence {q.existence:.2f}, evidence {q.evidence:.1f}", q.existence)
            if q.confirmed:
                self._departed.append(q)
        self._people = keep
        self._departed = [q for q in self._departed if self._now_s - q.seen_s <= p.remember_s]

    def _meet(self, born: list[Person]) -> None:
        """Follow newcomers, under ids of their own until it is known who they are."""
        for b in born:
            b.track_id = self._next_id
            self._next_id += 1
            self._people.append(b)
            self._note(b, "spawned", f"evidence {b.evidence:.1f}, {b.height_m:.2f} m tall", b.evidence)

    def _recognise(self) -> None:
        """Confirm newcomers, as the lost or departed whom they continue best or as strangers.

        Who somebody is is decided when the odds are, at the latest when the person is reported.
        """
        report = math.log(self.params.report / (1 - self.params.report))
        new = [q for q in self._people if not q.confirmed]
        lost = [q for q in self._people if q.confirmed and q.share < self.params.visible_min]
        known = continued(new, lost + self._departed, self.params) if new else {}
        for i, b in enumerate(new):
            person = self._personhood(b)
            sure = min(b.log_odds, b.proven, person) > report and b.share >= self.params.visible_min
            q, odds = known.get(i, (None, 0.0))
            if q is not None and (sure or odds > KNOWN_ODDS):
                self._note(q, "reacquired", f"log-odds {odds:.1f} after {b.born_s - q.seen_s:.1f} s", odds)
                self._departed = [o for o in self._departed if o is not q]
                self._people = [o for o in self._people if o is not q]
                b.take_identity(q)
                b.confirmed, b.counted = True, {}
            elif sure:
                b.confirmed, b.counted = True, {}
                reason = f"existence {b.existence:.2f}, log-odds of a person {person:.1f}"
                self._note(b, "confirmed", reason, b.existence)

    def _personhood(self, q: Person) -> float:
        """Log-odds of a person against a thing, by own movement, and by height as far as the head is in view: elsewhere
        the height is what was believed before."""
        if not q.head_in_view:
            return q.moved + math.log((1 - body.THINGS) / body.THINGS)
        low = self.params.low_share / body.HEIGHT_MEAN_M
        upright = body.stature(q.height_m, body.HEIGHT_MEAN_M, body.HEIGHT_STD_M, self.params.low_share) - low
        person = (upright + LOW_WALKERS * low) * math.exp(q.moved) + (1 - LOW_WALKERS) * low
        return math.log((1 - body.THINGS) * person / (body.THINGS / body.HEIGHT_MEAN_M))

    def _say(self, q: Person, others: Sequence[Person]) -> None:
        """Why a person is where it is, and who may hide it."""
        reason = f"evidence {q.evidence:.1f}, visible {q.share:.2f}, existence {q.existence:.3f}"
        if others:
            reason += ", beside " + ", ".join(str(o.track_id) for o in others)
        self._note(q, "matched" if q.share >= self.params.visible_min else "lost", reason, q.evidence)

    def _note(self, q: Person, kind: DecisionKind, reason: str, value: float) -> None:
        self._log.append(Decision(q.track_id, kind, reason, value))

    def _state(self, q: Person) -> TrackState:
        visible: State = "confirmed" if q.share >= self.params.visible_min else "lost"
        k = q.kalman
        return TrackState(
            q.track_id, visible if q.confirmed else "tentative", k.x_m, k.y_m, k.vx_mps, k.vy_mps, q.height_m
        )
