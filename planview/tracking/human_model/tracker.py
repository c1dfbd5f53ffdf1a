"""Human-model tracker of one calibrated camera (Zhang et al. 2008, section 4, figure 8)."""

from __future__ import annotations

import itertools
import math

import numpy as np

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.people.model import HumanModel
from calib.types import F64, U8
from planview.tracking.appearance_model import Appearance
from planview.tracking.base import Decision, Observation, TrackerDebug
from planview.tracking.human_model.candidates import CandidateFinder, ModelCandidate
from planview.tracking.human_model.doubles import Doubles
from planview.tracking.human_model.drawing import draw
from planview.tracking.human_model.fitting import Fitter, foot_pixels
from planview.tracking.human_model.frame import ModelFrame, frame_of
from planview.tracking.human_model.missing import Missing
from planview.tracking.human_model.model_map import HumanModelMap, build_model_map
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.pruning import has_walked, is_person, prune_reason, reacquirable
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.seating import Seating
from planview.tracking.human_model.target import FIRST_WIDTH, Build, Target
from planview.tracking.human_model.unclaimed import Unclaimed
from planview.tracking.identity import IdentityLayer
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle
from planview.trajectories.state import TrackState

Box = tuple[float, float, float, float]
"""Left, top, width and height [px]."""
MIN_CONTACT = 0.05
"""Part of each of two models that is shared when two people are in contact (our choice)."""


class HumanModelTracker:
    """People as projected cylinders matched to foreground.

    Each update runs the modules of figure 8 in order: predict, match, update, new targets (and splits), merge, clean.
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
        self.params = params
        self.camera = camera
        self.model = HumanModel().scaled(params.height_m)
        self.scene = ModelScene(model_map or build_model_map(camera, self.model, params.map), params.match)
        self._life = LifeCycle()
        self._identity = IdentityLayer(params.identity)
        self._fitter = Fitter(params, camera, self.scene, self._life, self._identity)
        self._find = CandidateFinder(self.scene, params)
        self._unclaimed = Unclaimed(self.scene, params)
        self._missing = Missing(params, self.scene)
        self._doubles = Doubles(self.scene, params)
        self._seating = Seating(params, self.scene, self._life, self._fitter, self._missing)
        self.reset()

    def reset(self) -> None:
        """Forget all people; ids start again at 1."""
        self.targets: list[Target] = []
        # Boxes of this frame, since many pairs are compared.
        self._boxes: dict[int, Box] = {}
        self._life.reset()
        self._identity.reset()
        self.scene.reset()
        self._find.reset()
        self._unclaimed.reset()
        self._missing.reset()
        self._doubles.reset()
        self._seating.reset()
        self._still_s = np.zeros(self.camera.size[::-1], np.float32)
        self._evidence: U8 = np.zeros(self.camera.size[::-1], np.uint8)

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return self._life.decisions

    @property
    def foreground_columns(self) -> int | None:
        """Those of the image."""
        return None

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Raises:
            InputError: images of another size than the camera's.
            ValueError: foreground or motion are missing.
        """
        frame = frame_of(observation, self.camera.size)
        before_s = self._life.now_s
        dt = 0.0 if math.isnan(before_s) else max(0.0, frame.now_s - before_s)
        self._life.begin(frame.now_s)
        self._fitter.predict(self.targets, dt)
        self._drop_outside()
        self._fitter.fit(self.targets, frame)
        self._boxes.clear()
        self._confirm(frame)
        self._mend_identities()
        self._unclaimed.update(frame, dt)
        self._add_targets(frame)
        self._seating.review(self.targets, self._unclaimed, frame)
        self._boxes.clear()
        self._merge(frame, dt)
        self._clean()
        self.scene.watch_still(frame, dt, self._still_s)
        self._evidence = frame.evidence
        return tuple(self._state_of(target) for target in (*self.targets, *self._believed()))

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unclaimed for long.

        A person is only where foreground was measured: a model also covers the scene between arms and legs, in front of
        a person (signs, tables) and where a lost person is predicted, and scenery that must not be learned becomes
        foreground with the next change of light.
        """
        people = [target for target in self.targets if target.existence.confirmed]
        walkers = [t for t in people if t.existence.observed and is_person(t, self.params)]
        return self._unclaimed.known(self._still_s, self._evidence, bool(people), walkers)

    def debug(self) -> TrackerDebug:
        """Models with their states in the image, footprints on the floor."""
        return draw(self.targets, self.scene)

    def _drop_outside(self) -> None:
        """Targets whose prediction left the places where people are possible are gone."""
        xy = np.array([t.xy_m for t in self.targets]).reshape(-1, 2)
        entry = self.scene.model_map.entry_at(foot_pixels(self.camera, xy)[0])
        for target, e in zip(list(self.targets), entry, strict=True):
            if e < 0:
                self.targets.remove(target)
                self._life.prune(target.existence, "predicted outside the view")

    def _confirm(self, frame: ModelFrame) -> None:
        for target in list(self.targets):
            if not has_walked(target, self.params) or target.existence.confirmed or self._reappears(target, frame):
                continue
            travel_m = target.build.travel_m
            self._life.confirm(target.existence, f"walked {travel_m:.2f} m", travel_m)
            self._missing.learn(target)

    def _reappears(self, newcomer: Target, frame: ModelFrame) -> bool:
        """Whether a new target shows a missing person, who then goes on in its place."""
        lost = [t for t in self.targets if t.existence.lost]
        appearance = self._fitter.appearance(newcomer.foot_px, newcomer.model_scale, frame)
        person = self._missing.who_appears(newcomer, lost, lambda target: self._likeness(target, appearance))
        if person is None:
            return False
        self._missing.remove(person)
        self.targets = [t for t in self.targets if t is not person]
        self.targets[self.targets.index(newcomer)] = person
        person.go_on_as(newcomer)
        new_id, known_id = newcomer.existence.track_id, person.existence.track_id
        self._life.prune(newcomer.existence, f"is {known_id}, who was missing", kind="merged")
        self._life.observe(person.existence, f"appeared as {new_id} where nobody comes in")
        return True

    def _likeness(self, target: Target, appearance: Appearance | None) -> float:
        """Likeness of a target's memory to colours; NaN where they are not known."""
        if appearance is None:
            return math.nan
        return math.exp(-self._identity.unlikelihood(target.existence, appearance))

    def _believed(self) -> tuple[Target, ...]:
        """Missing people who are reported as lost: where people sit they stay, elsewhere they may be gone."""
        return self._missing.hidden if self._seating.seats else ()

    def _mend_identities(self) -> None:
        """After an occlusion, exchange identities where colours say so."""
        for first, second in itertools.combinations([t for t in self.targets if t.shared > MIN_CONTACT], 2):
            if self._touch(first, second):
                self._identity.contact(first.existence, second.existence, self._life.now_s)
        self._identity.retain([t.existence for t in (*self.targets, *self._missing)])
        for exchange in self._identity.exchanges([t.existence for t in self.targets], self._life.now_s):
            known = {id(t.existence): t for t in self.targets}
            builds = [known[id(who)].build for who in exchange.identities]
            for who, build in zip(exchange.places, builds, strict=True):
                known[id(who)].build = build
            self._life.reassign(exchange.places, exchange.identities, exchange.confidence)
            self._boxes.clear()

    def _add_targets(self, frame: ModelFrame) -> None:
        for candidate in self._find(frame, self._unclaimed):
            self._add(candidate, frame)

    def _add(self, candidate: ModelCandidate, frame: ModelFrame) -> None:
        """A new target, or a lost one reacquired."""
        foot, scale, score = candidate.foot_px, candidate.scale, candidate.score
        kalman = self._fitter.start(foot, scale)
        if kalman is None or self._is_known(candidate, kalman, frame):
            return
        self.scene.paint(self.scene.cover, foot, scale, 1)
        appearance = self._fitter.appearance(foot, scale, frame)
        xy = np.array([kalman.x_m, kalman.y_m])
        lost = reacquirable(
            self.targets, xy, lambda target: self._likeness(target, appearance), self.params, self._life.now_s
        )
        if lost is not None:
            lost.restart(kalman, foot, scale)
            self._boxes.pop(id(lost), None)
            self._life.observe(lost.existence, f"reappeared with score {score:.2f}", score)
            return
        existence = self._life.spawn(f"score {score:.2f}", score, "split" if candidate.splits else "spawned")
        target = Target(existence, kalman, Build(scale, xy), foot)
        target.whole, target.splits = candidate.whole, candidate.splits
        target.remember(self._life.now_s, 0.0, candidate.precision, self.params.states.window_s)
        self.targets.append(target)
        if appearance is not None:
            self._identity.learn(existence, appearance)

    def _is_known(self, candidate: ModelCandidate, kalman: FloorKalman, frame: ModelFrame) -> bool:
        """Whether a candidate is a target's arm or double; the target moves there where the double explains more.

        Apart from known people it may be the double of one found in this frame: head and legs, with a shirt like the
        wall between them, are two blobs, and either tells of the whole body.
        """
        foot, scale, splits = candidate.foot_px, candidate.scale, candidate.splits
        if splits and self._doubles.is_limb(np.array([*foot, scale]), self.targets, frame.evidence):
            return True
        beside = [t for t in self.targets if splits or t.existence.spawned_s == self._life.now_s]
        beside = [t for t in beside if t.seat is None and t.existence.observed]
        for target in (t for t in beside if _overlap(self._box(t), self._box_at(foot, scale, FIRST_WIDTH))):
            needless, better = self._doubles.needless(target, np.array([*foot, scale]), self.targets, frame.evidence)
            if needless and better:
                target.restart(kalman, foot, scale)
                self._boxes.pop(id(target), None)
                self._life.log(target.existence, "recentred", f"fits better with score {candidate.score:.2f}")
            if needless:
                return True
        return False

    def _merge(self, frame: ModelFrame, dt_s: float) -> None:
        for better, other in self._doubles.find(self.targets, frame.evidence, dt_s, self._touch):
            older, younger = sorted((better, other), key=lambda t: t.existence.spawned_s)
            if older is not better:
                older.go_on_as(younger)
                self._boxes.pop(id(older), None)
            self.targets.remove(younger)
            self._life.prune(younger.existence, f"walks on {older.existence.track_id}", kind="merged")

    def _clean(self) -> None:
        for target in list(self.targets):
            reason = prune_reason(target, self.params, self._life)
            if not reason:
                continue
            self.targets.remove(target)
            if self._missing.keep(target):
                self._life.log(target.existence, "state", f"missing: {reason}")
            else:
                self._life.prune(target.existence, reason)
        self._missing.watch([t for t in self.targets if t.existence.confirmed and t.existence.observed])
        for target in self._missing.forgotten(self._life.now_s):
            self._life.prune(target.existence, f"missing for {self._life.unobserved_s(target.existence):.0f} s")

    def _state_of(self, target: Target) -> TrackState:
        k, who = target.kalman, target.existence
        height = self.model.height_m * target.model_scale
        return TrackState(who.track_id, who.state, k.x_m, k.y_m, k.vx_mps, k.vy_mps, height, self._box(target))

    def _box(self, target: Target) -> Box:
        """Box of the whole model where the footprint is, as wide as the person was observed; hidden parts are in it."""
        if id(target) not in self._boxes:
            others = [t for t in self.targets if id(t) not in self._boxes and t is not target]
            asked = [target, *others]
            feet, _ = foot_pixels(self.camera, np.array([(t.kalman.x_m, t.kalman.y_m) for t in asked]))
            self._boxes |= {
                id(t): self._box_at(foot, t.model_scale, t.build.width) for t, foot in zip(asked, feet, strict=True)
            }
        return self._boxes[id(target)]

    def _box_at(self, foot_px: F64, scale: float, width: float) -> Box:
        hull = self.scene.hull(foot_px, scale)
        if hull is None:
            return (math.nan, math.nan, math.nan, math.nan)
        (left, top), (right, bottom) = hull.min(axis=0), hull.max(axis=0)
        middle, half = 0.5 * (left + right), 0.5 * (right - left) * width
        return float(middle - half), float(top), float(2 * half), float(bottom - top)

    def _touch(self, first: Target, second: Target) -> bool:
        return _overlap(self._box(first), self._box(second))


def _overlap(a: Box, b: Box) -> bool:
    """Whether two boxes overlap by at least half of the smaller width."""
    wide = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0]) > 0.5 * min(a[2], b[2])
    return wide and min(a[1] + a[3], b[1] + b[3]) > max(a[1], b[1])
