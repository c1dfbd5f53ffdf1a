"""Human-model tracker of one calibrated camera (Zhang et al. 2008, section 4, figure 8)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.human.model import HumanModel
from calib.types import U8
from planview.foreground.masks import BACKGROUND, PERSON
from planview.tracking.base import Decision, DecisionKind, Observation, TrackerDebug
from planview.tracking.human_model.births import Candidate, find_candidates
from planview.tracking.human_model.drawing import draw
from planview.tracking.human_model.fitting import Fitter
from planview.tracking.human_model.frame import Frame, frame_of
from planview.tracking.human_model.identity import Mingling
from planview.tracking.human_model.lifecycle import believable, redundant, same_as_lost, why_remove
from planview.tracking.human_model.model_map import HumanModelMap, build_model_map
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Target
from planview.trajectories.state import State, TrackState


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
        self._mingling = Mingling(params.life)
        self._fitter = Fitter(params, camera, self.scene, self._mingling, self._decide)
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self.targets: list[Target] = []
        self._ids: Iterator[int] = itertools.count(1)
        self._decisions: list[Decision] = []
        self._now_s = np.nan
        # Boxes of this frame, since many pairs are compared.
        self._boxes: dict[int, tuple[float, float, float, float]] = {}
        self._mingling.reset()
        self.scene.clear()
        self._still_s = np.zeros(self.camera.size[::-1], np.float32)

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Decisions of the last update."""
        return tuple(self._decisions)

    @property
    def needs_foreground(self) -> bool:
        """Observations must hold foreground and motion."""
        return True

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame.

        Raises:
            InputError: images of another size than the camera's.
            ValueError: foreground or motion are missing.
        """
        frame = frame_of(observation, self.camera.size)
        dt = 0.0 if np.isnan(self._now_s) else max(0.0, frame.now_s - self._now_s)
        self._now_s = frame.now_s
        self._decisions = []
        self._fitter.predict(self.targets, dt)
        self._drop_outside()
        self._fitter.fit(self.targets, frame)
        self._boxes.clear()
        self._believe()
        self._tell_apart()
        self._new_targets(frame)
        self._merge()
        self._clean()
        self._watch_still(frame, dt)
        return tuple(self._state_of(target) for target in self.targets)

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unexplained for long."""
        mask = np.zeros(self.camera.size[::-1], np.uint8)
        mask[self._still_s >= self.params.life.still_s] = BACKGROUND
        if any(target.confirmed for target in self.targets):
            mask[self.scene.claimed > 0] = PERSON
        return mask

    def debug(self) -> TrackerDebug:
        """Models with their states in the image, footprints on the floor."""
        return draw(self.targets, self.scene)

    def _decide(self, target: Target, kind: DecisionKind, reason: str, value: float = np.nan) -> None:
        self._decisions.append(Decision(target.track_id, kind, reason, value))

    def _drop_outside(self) -> None:
        """Targets whose prediction left the places where people are possible are gone."""
        xy = np.array([t.kalman.state[:2] for t in self.targets]).reshape(-1, 2)
        entry = self.scene.model_map.entry_at(self.camera.project(np.column_stack([xy, np.zeros(len(xy))])))
        for target, e in zip(list(self.targets), entry, strict=True):
            if e < 0:
                self.targets.remove(target)
                self._decide(target, "pruned", "predicted outside the view")

    def _believe(self) -> None:
        for target in self.targets:
            if not target.confirmed and believable(target, self.params):
                target.confirmed = True
                self._decide(target, "confirmed", f"walked {target.travel_m:.2f} m", target.travel_m)

    def _tell_apart(self) -> None:
        """After an occlusion, swap two people whose colours say so."""
        for first, second in itertools.combinations(self.targets, 2):
            if min(first.shared, second.shared) > 0.05 and self._touch(first, second):
                self._mingling.close(first, second, self._now_s)
        for first, second, gain in self._mingling.swapped(self.targets, self._now_s):
            first.swap_with(second)
            self._boxes.clear()
            self._decide(first, "state", f"colours say: swapped with {second.track_id} (gain {gain:.2f})", gain)

    def _new_targets(self, frame: Frame) -> None:
        rest = np.where(self.scene.claimed > 0, 0, frame.evidence).astype(np.uint8)
        for candidate in find_candidates(self.scene, self.params, rest, frame):
            self._add(candidate, frame)

    def _add(self, candidate: Candidate, frame: Frame) -> None:
        """A new target, or a lost one seen again."""
        scene, now = self.scene, self._now_s
        kalman = self._fitter.start(candidate.foot_px, candidate.scale)
        if kalman is None:
            return
        scene.paint(scene.cover, candidate.foot_px, candidate.scale, 1)
        colours = None
        if frame.image is not None:
            colours = scene.colours(frame.image, frame.evidence, candidate.foot_px, candidate.scale)
        xy = kalman.state[:2].copy()
        lost = same_as_lost(self.targets, xy, colours, self.params, now)
        if lost is not None:
            lost.take_up(kalman, candidate.foot_px, candidate.scale, now)
            self._decide(lost, "reacquired", f"seen again with score {candidate.score:.2f}", candidate.score)
            return
        target = Target(next(self._ids), kalman, now, now, xy, candidate.foot_px, candidate.scale, colours=colours)
        target.remember(now, 0.0, candidate.precision, self.params.states.window_s)
        self.targets.append(target)
        kind: DecisionKind = "split" if candidate.splits else "spawned"
        self._decide(target, kind, f"score {candidate.score:.2f}", candidate.score)

    def _merge(self) -> None:
        for target, other in redundant(self.targets, self.params.life, self._now_s, self._touch):
            self.targets.remove(target)
            self._decide(target, "merged", f"walks on {other.track_id}")

    def _clean(self) -> None:
        for target in list(self.targets):
            reason = why_remove(target, self.params, self._now_s)
            if reason:
                self.targets.remove(target)
                self._decide(target, "pruned", reason)

    def _watch_still(self, frame: Frame, dt: float) -> None:
        still = (frame.evidence > 1) & (frame.motion == 0) & (self.scene.claimed == 0)
        if self.targets:
            # What hangs together with a person may be the person's: arms on a table, a back wider than the model.
            labels = frame.blobs.labels
            theirs = np.zeros(len(frame.blobs), np.bool_)
            theirs[labels[self.scene.claimed > 0]] = True
            still &= ~theirs[labels]
        self._still_s = np.where(still, self._still_s + np.float32(dt), np.float32(0.0))

    def _state_of(self, target: Target) -> TrackState:
        x, y, vx, vy = (float(v) for v in target.kalman.state)
        state: State = "tentative" if not target.confirmed else "confirmed" if target.matched else "lost"
        height = self.model.height_m * target.drawn
        return TrackState(target.track_id, state, x, y, vx, vy, height, self._box(target))

    def _box(self, target: Target) -> tuple[float, float, float, float]:
        """Box of the whole model where the footprint is, as wide as the person was seen; hidden parts are in it."""
        foot = self.camera.project(np.append(target.kalman.state[:2], 0.0))
        hull = self.scene.hull(foot, target.drawn)
        if hull is None:
            return (np.nan, np.nan, np.nan, np.nan)
        (left, top), (right, bottom) = hull.min(axis=0), hull.max(axis=0)
        middle, half = 0.5 * (left + right), 0.5 * (right - left) * target.half_width
        return float(middle - half), float(top), float(2 * half), float(bottom - top)

    def _touch(self, first: Target, second: Target) -> bool:
        """Whether the boxes overlap by at least half of the smaller width."""
        a, b = (self._boxes.get(id(t)) or self._boxes.setdefault(id(t), self._box(t)) for t in (first, second))
        wide = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0]) > 0.5 * min(a[2], b[2])
        return wide and min(a[1] + a[3], b[1] + b[3]) > max(a[1], b[1])
