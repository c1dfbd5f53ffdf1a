"""Human-model tracker of one calibrated camera (Zhang et al. 2008, section 4, figure 8)."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import F32, F64, U8, Bool
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.tracking import body
from planview.tracking.base import Decision, DecisionKind, Drawing, Observation, TrackerDebug
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model.births import CORE, FloorPlaces, births
from planview.tracking.human_model.explanation import (
    STEPS_M,
    MaskExplanation,
    MaskView,
    OutlineSamples,
    Shares,
)
from planview.tracking.human_model.model_map import HumanModelMap, build_model_map
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.walker import Walker, matches
from planview.tracking.joint.explanation import People
from planview.tracking.joint.identity import Exchanges, continued
from planview.tracking.joint.params import JointParams
from planview.tracking.joint.person import Person, colour_counts, colour_ratios
from planview.trajectories.state import State, TrackState

WALKER_M = 2.0
"""Way after which a person is no ghost of the background [m]."""
BOX_WIDTH = 1.35
"""Width of a person's box over the hull's: arms and stride."""
RETURNS = 0.2
"""Share of those who are gone inside the view that come back: the others went through a door, out of which anybody may
come."""
HIDES = -3.0
"""Log-odds, before anybody has walked there, that something hides people at a pixel."""
LIVELY = 0.01
"""Share of a region's pixels in motion from which it is no thing: a head that turns."""


class HumanModelTracker:
    """People as projected human models that explain every pixel of the foreground jointly.

    Existence by the Bernoulli filter of Vo, Vo and Pham 2010; new targets, split, merge and clean (figure 8) follow
    from it: a newcomer is born where foreground is left over, and a person without evidence ends.
    """

    def __init__(self, params: HumanModelParams, camera: GroundCamera, model_map: HumanModelMap | None = None) -> None:
        """Args:
            params: of the tracker.
            camera: calibrated from people.
            model_map: computed before for this camera; built here if None.
        Raises:
            InputError: the map is another camera's.
        """
        if model_map is not None and model_map.camera != camera:
            raise InputError(f"expected a human model map of {camera}, found one of {model_map.camera}")
        self.params, self.camera, self.model = params, camera, HumanModel()
        self.model_map = model_map or build_model_map(camera, self.model, params.map)
        self._view = MaskView(camera, params)
        self._places = FloorPlaces(self.model_map, params.birth_visible, params.patch_m)
        self._shared = JointParams(
            patch_m=params.patch_m, low_share=params.sits, floor_m2=self._places.floor_m2, errors_s=params.errors_s,
            colour_weight=params.colour_weight, remember_s=params.remember_s, lag_s=params.lag_s,
        )  # fmt: skip
        self.reset()

    def reset(self) -> None:
        """Forget all people; ids start again at 1."""
        self._people: list[Walker] = []
        self._departed: list[Walker] = []
        self._next_id = 1
        self._now_s = math.nan
        self._exchanges = Exchanges(self._shared)
        self._log: list[Decision] = []
        shape = self.camera.size[::-1]
        self._known: U8 = np.zeros(shape, np.uint8)
        self._still_s: F32 = np.zeros(shape, np.float32)
        self._hides: F32 = np.full(shape, HIDES, np.float32)

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return tuple(self._log)

    @property
    def foreground_columns(self) -> int | None:
        """Those of the image."""
        return None

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unexplained for long."""
        return self._known

    def debug(self) -> TrackerDebug:
        """Hulls with their states in the image, footprints on the floor."""
        hulls = [(q, self._hull(q.at_m, q.height_m)) for q in self._people]
        drawn = [(q, np.vstack([hull, hull[:1]]).astype(np.float32)) for q, hull in hulls if hull is not None]
        labels = tuple(
            f"{q.track_id} {q.posture} {q.motion} {q.stability} M={q.match.score:.2f}, existence {q.existence:.2f}"
            for q, _ in drawn
        )
        feet = tuple(np.array([q.at_m], np.float32) for q in self._people)
        return TrackerDebug(
            (
                Drawing("models", "image", tuple(hull for _, hull in drawn), labels),
                Drawing("footprints", "floor", feet, tuple(str(q.track_id) for q in self._people)),
            )
        )

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Raises:
            InputError: images of another size than the camera's.
            ValueError: foreground or motion are missing.
        """
        foreground, motion = observation.foreground, observation.motion
        if foreground is None or motion is None:
            raise ValueError("the human-model tracker needs foreground and motion")
        if foreground.shape != self.camera.size[::-1]:
            (width, height), (rows, cols) = self.camera.size, foreground.shape
            raise InputError(
                f"expected images of {width}x{height} px, for which the camera was calibrated, found {cols}x{rows}"
            )
        dt = 0.0 if math.isnan(self._now_s) else max(0.0, observation.timestamp_s - self._now_s)
        self._now_s, self._log = observation.timestamp_s, []
        frame = MaskExplanation(self._view, observation)
        seen = frame.kind == kernels.SEEN
        frame.kind |= seen & (self._hides > 0)  # SHADOW
        for q in self._people:
            if q.share < 2 * self.params.visible_min:
                q.kalman = q.kalman.slowed(dt, self.params.slow_down_s)
            q.kalman = q.kalman.predicted(dt, self.params.acceleration_mps2)
            q.height_var += self.params.height_change_mps**2 * dt * min(dt, self.params.errors_s)
        people = self._side_by_side()
        if self._people:
            self._explain(frame, people, dt)
        shares = frame.share_out(self._side_by_side(people.ratios))
        hulls = [self._hull(q.at_m, q.height_m) for q in self._people]
        self._judge(frame, shares, motion, hulls)
        self._learn_hiding(frame, seen, hulls, dt)
        if frame.coloured:
            self._learn(frame, shares, dt)
        self._watch(frame, shares, motion, dt)
        self._clean(dt)
        born, poses = births(self._places, frame, self._side_by_side, shares, self._now_s)
        for q, pose in zip(self._people, [] if poses is None else poses, strict=poses is not None):
            if tuple(pose) != (*q.at_m, q.height_m):
                # Go on where the model accounts for more.
                q.kalman, q.height_m = q.kalman.moved_to(float(pose[0]), float(pose[1])), float(pose[2])
                self._note(q, "recentred", f"accounts for more at {pose[0]:.2f}, {pose[1]:.2f} m", math.nan)
        self._meet(born, frame)
        self._recognise(dt)
        return tuple(self._state(q) for q in self._people)

    def _side_by_side(self, ratios: F32 | None = None) -> People:
        """Everybody; ``ratios`` where the colours are still the same."""
        poses = np.array([(*q.at_m, q.height_m) for q in self._people]).reshape(-1, 3)
        tall = np.array([q.upright for q in self._people]).reshape(-1, 2)
        sure = np.array([q.existence for q in self._people])
        return People(poses, sure, tall, colour_ratios(self._people) if ratios is None else ratios)

    # -- explaining a frame ---------------------------------------------------------------------------------------
    def _explain(self, frame: MaskExplanation, people: People, dt: float) -> None:
        """Coordinate ascent, nearest first; then what the frame says of each place and existence."""
        predicted, touch = people.poses.copy(), frame.touching(people.poses)
        samples = frame.around(predicted, body.TORSO.torso_radius_m + 0.1)
        information = np.array([(*q.kalman.information, 1 / q.height_var) for q in self._people])
        np.fill_diagonal(touch, False)
        others = [np.flatnonzero(row) for row in touch]
        for sweep in range(2):
            for i in np.argsort(people.away()):
                if sweep and not len(others[i]):
                    continue
                samples[i].layer(people, others[i], i)
                samples[i].ascend(
                    people.poses[i], predicted[i], information[i], people.tall[i], STEPS_M[sweep:]
                )  # fmt: skip
        flooded = np.count_nonzero(frame.kind == kernels.SURFACE) > 0.5 * frame.kind.size
        for i, q in enumerate(self._people):
            if len(others[i]):
                samples[i].layer(people, others[i], i)
            self._measure(q, samples[i], people.poses[i], people.tall[i])
        # Who is surer has the better standing, and who came first.
        ranks = sorted(range(len(self._people)), key=lambda k: (
            self._people[k].confirmed, self._people[k].log_odds, -self._people[k].track_id))  # fmt: skip
        rivals = frame.rivals(people, np.argsort(ranks).astype(np.float64))
        for i, q in enumerate(self._people):
            if rivals[i] >= 0 and q.share >= self.params.visible_min:
                pair = frame.beside(i, int(rivals[i]), people)
                superfluous = self._people[rivals[i]] if pair.first else q
                superfluous.evidence = min(superfluous.evidence, pair.evidence)
        for q in () if flooded else self._people:
            self._weigh(q, dt)

    def _measure(self, q: Walker, s: OutlineSamples, pose: F64, tall: F64) -> None:
        """Evidence for a person, its visible share, and the place as far as the pixels tell it."""
        q.evidence = s.evidence(pose, tall)
        mine, _, total = s.visible(pose, tall)
        q.inside = self._visibility(pose)
        q.share = (mine / total if total > 0 else 0.0) * min(1.0, 1.25 * q.inside)
        if q.share < self.params.visible_min:
            return
        noise, up = s.noise(pose, tall)
        x, y, h = pose
        q.kalman = q.kalman.found_at(x, y, noise, body.SPEED_MAX_MPS)
        q.height_m, q.height_var = float(h), 1.0 / (1.0 / q.height_var + up)
        q.seen_s = self._now_s

    def _learn_hiding(self, frame: MaskExplanation, seen: Bool, hulls: list[F64 | None], dt: float) -> None:
        """What hides people, from the bodies of those who walk: background where one is, or foreground."""
        p, walkers = self.params, np.zeros(seen.shape, np.uint8)
        for q, hull in zip(self._people, hulls, strict=True):
            if q.confirmed and q.motion == "moving" and q.share >= p.visible_min and hull is not None:
                middle = hull.mean(axis=0)
                cv2.fillConvexPoly(walkers, np.rint(middle + CORE * (hull - middle)).astype(np.int32), 1)
        inside, looks = np.flatnonzero(walkers.view(np.bool_)), min(1.0, dt / p.errors_s)
        hidden = math.log((1 - p.seen_on_background) / (1 - p.seen_on_body))
        shown = math.log(p.seen_on_background / p.seen_on_body)
        more = seen.reshape(-1)[inside] * hidden + (frame.kind.reshape(-1)[inside] == kernels.SURFACE) * shown
        hides = self._hides.reshape(-1)
        hides[inside] = np.clip(hides[inside] + looks * more, 2 * HIDES, -HIDES)

    def _visibility(self, pose: F64) -> float:
        """The human visibility ratio of the model map."""
        foot = self.camera.project(np.array([pose[0], pose[1], 0.0]))
        entry = int(self.model_map.entry_at(foot))
        return float(self.model_map.visibility[entry]) if entry >= 0 else 0.0

    def _weigh(self, q: Walker, dt: float) -> None:
        """Existence: survival, then the evidence of this look; and how far the person has walked."""
        p, looks = self.params, min(1.0, dt / self.params.errors_s)
        if q.share < p.visible_min:
            stays = q.existence * math.exp(-dt / p.stay_s)
            q.log_odds = math.log(max(stays, 1e-6) / max(1 - stays, 1e-6))
        q.log_odds += looks * min(max(q.evidence, -p.evidence_max), p.evidence_max)
        q.log_odds = min(max(q.log_odds, -p.birth_evidence), p.birth_evidence)
        if q.share < p.visible_min:
            return
        q.learn_height(looks, p.sits)
        farther = max(0.0, math.dist(q.origin_m, q.at_m) - q.kalman.position_std_m - q.walked_m)
        q.walked_m += farther
        q.moved += farther

    def _judge(self, frame: MaskExplanation, shares: Shares, motion: U8, hulls: list[F64 | None]) -> None:
        """Match (equation 1) and the automata of everybody."""
        found = matches(hulls, frame.kind == kernels.SURFACE)
        owner, n = shares.owner + 1, len(self._people) + 1
        area = np.bincount(owner, minlength=n)[1:]
        moving = np.bincount(owner[motion.reshape(-1)[frame.pixels] > 0], minlength=n)[1:]
        for i, q in enumerate(self._people):
            q.match = found[i]
            before = q.posture, q.motion, q.stability
            q.judge(self._now_s, moving[i] / max(1, area[i]), self.params)
            if (q.posture, q.motion, q.stability) != before:
                self._note(q, "state", f"{q.posture}, {q.motion}, {q.stability}", q.match.score)
            seen = q.share >= self.params.visible_min
            kind: DecisionKind = "matched" if seen == q.observed else ("reacquired" if seen else "lost")
            q.observed = seen
            if seen or kind == "lost":
                self._note(
                    q, kind,
                    f"M {q.match.score:.2f}, evidence {q.evidence:.1f}, visible {q.share:.2f}, "
                    f"existence {q.existence:.3f}", q.match.score,
                )  # fmt: skip

    # -- who is who, who comes, who goes ----------------------------------------------------------------------------
    def _learn(self, frame: MaskExplanation, shares: Shares, dt: float) -> None:
        alone = frame.touching(np.array([(*q.at_m, q.height_m) for q in self._people]).reshape(-1, 3)).sum(axis=1) == 1
        owned = shares.owned(frame)
        surely = (owned.owner >= 0) & (owned.share > 0.8)
        mine = owned.owner[surely], owned.height[surely], owned.colours[surely]
        for q, seen, apart in zip(self._people, colour_counts(len(self._people), *mine), alone, strict=True):
            if q.share >= 0.5 and apart:
                q.learn_colours(seen)
        for a, b, odds in self._exchanges.update(self._people, [owned] if frame.coloured else [], dt):
            a.take_identity(b)
            self._note(a, "identity", f"exchanged with {b.track_id}: colours, log-odds {odds:.1f}", odds)

    def _watch(self, frame: MaskExplanation, shares: Shares, motion: U8, dt: float) -> None:
        """What the foreground model is told: people, and what has been still and unexplained for long."""
        labels = np.zeros(len(self._people) + 1, np.uint8)
        for i, q in enumerate(self._people):
            if q.confirmed:
                labels[i] = WALKER if q.walked_m > WALKER_M else PERSON
        told, still_s = labels[shares.owner], np.zeros(motion.size, np.float32)
        known, left = np.zeros((2, motion.size), np.uint8)
        told[(shares.owner == -1) & shares.near & labels.any()] = PERSON
        known[frame.pixels], rest = told, frame.pixels[told == 0]
        left[rest] = 1
        n, found = cv2.connectedComponents(left.reshape(motion.shape), connectivity=8)
        regions = found.reshape(-1)[rest]
        moving = np.bincount(regions[motion.reshape(-1)[rest] > 0], minlength=n)
        lively = moving > LIVELY * np.bincount(regions, minlength=n)
        still_s[rest] = dt + np.where(lively[regions], 0.0, self._still_s.reshape(-1)[rest])
        known[rest[still_s[rest] >= self.params.still_s]] = BACKGROUND
        self._known, self._still_s = known.reshape(motion.shape), still_s.reshape(motion.shape)

    def _clean(self, dt: float) -> None:
        """People without evidence or beyond the border end, and things that somebody moved."""
        p, keep = self.params, []
        for q in self._people:
            beyond = q.inside < p.birth_visible
            thing = q.moved < (0.0 if q.confirmed else -p.still_s / p.inanimate_s)
            if q.existence >= 0.05 and not beyond and not thing:
                keep.append(q)
                continue
            why = "stationary: a thing" if thing else f"existence {q.existence:.2f}, evidence {q.evidence:.1f}"
            self._note(q, "pruned", why, q.existence)
            if q.confirmed and not thing and not beyond:
                self._departed.append(q)
        self._people = keep
        self._departed = [q for q in self._departed if self._now_s - q.seen_s <= p.remember_s]
        for q in self._departed:
            q.kalman = q.kalman.slowed(dt, p.slow_down_s).predicted(dt, p.acceleration_mps2)

    def _meet(self, born: list[Walker], frame: MaskExplanation) -> None:
        """Follow newcomers, under ids of their own until it is known who they are."""
        found = matches([self._hull(b.at_m, b.height_m) for b in born], frame.kind == kernels.SURFACE)
        for b, match in zip(born, found, strict=True):
            b.match, b.track_id = match, self._next_id
            b.inside = self._visibility(np.array([*b.at_m, b.height_m]))
            self._next_id += 1
            self._people.append(b)
            reason = f"M {match.score:.2f}, evidence {b.evidence:.1f}, {b.height_m:.2f} m tall"
            self._note(b, "split" if match.recall < 0.5 else "spawned", reason, match.score)

    def _recognise(self, dt: float) -> None:
        """Confirm newcomers, as the lost or departed whom they continue best or as strangers.

        Who somebody is is decided when the odds are, at the latest when the person is reported.
        """
        p = self.params
        for q in self._people:
            if q.motion == "stationary" and q.share >= p.visible_min:
                q.moved -= dt / p.inanimate_s
        new = [q for q in self._people if not q.confirmed]
        lost = [q for q in self._people if q.confirmed and q.share < p.visible_min]
        known = continued(new, lost + self._departed, self._shared) if new else {}
        for i, b in enumerate(new):
            sure = b.existence > p.report and b.walked_m >= p.walked_m and b.share >= p.visible_min
            before, odds = known.get(i, (None, 0.0))
            if before is not None:
                odds += math.log(RETURNS if before in self._departed else before.existence)
            if before is not None and odds > 0.0 and (sure or odds > math.log(p.report / (1 - p.report))):
                self._note(before, "reacquired", f"log-odds {odds:.1f} after {b.born_s - before.seen_s:.1f} s", odds)
                self._departed = [o for o in self._departed if o is not before]
                self._people = [o for o in self._people if o is not before]
                b.take_identity(before)
                b.confirmed = True
            elif sure:
                b.confirmed = True
                self._note(b, "confirmed", f"existence {b.existence:.2f}, walked {b.walked_m:.2f} m", b.existence)

    def _note(self, q: Person, kind: DecisionKind, reason: str, value: float) -> None:
        self._log.append(Decision(q.track_id, kind, reason, value))

    def _hull(self, at_m: tuple[float, float], height_m: float) -> F64 | None:
        """(K, 2) outline [px] of the model map, as large as a person of a height is; None where nobody is expected."""
        foot = self.camera.project(np.array([*at_m, 0.0]))
        entry = int(self.model_map.entry_at(foot))
        if entry < 0:
            return None
        tall = height_m / self.model.height_m
        # Heads are nearer to the camera than feet.
        tilt, drop = self.camera.tilt_rad, self.camera.height_m
        near = self.model.height_m * math.cos(tilt) / (at_m[1] * math.sin(tilt) + drop * math.cos(tilt))
        size = tall * (1.0 - near) / max(1.0 - tall * near, 0.1)
        return np.asarray(foot + size * (self.model_map.hull_px[entry] - self.model_map.foot_px[entry]), np.float64)

    def _state(self, q: Walker) -> TrackState:
        visible: State = "confirmed" if q.share >= self.params.visible_min else "lost"
        k, hull = q.kalman, self._hull(q.at_m, q.height_m)
        box = (math.nan,) * 4
        if hull is not None:
            (left, top), (right, bottom) = hull.min(axis=0), hull.max(axis=0)
            wide = 0.5 * (BOX_WIDTH - 1.0) * (right - left)
            box = float(left - wide), float(top), float(right - left + 2 * wide), float(bottom - top)
        return TrackState(
            q.track_id, visible if q.confirmed else "tentative", k.x_m, k.y_m, k.vx_mps, k.vy_mps, q.height_m, box
        )
