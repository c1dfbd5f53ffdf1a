"""Prediction, matching and update of the targets that exist (section 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64, I64
from planview.tracking.appearance_model import Appearance
from planview.tracking.human_model import _floor_kernels as kernels
from planview.tracking.human_model.frame import LESS_SALIENT, SALIENT, ModelFrame
from planview.tracking.human_model.measurement import Measurement
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.posture import MAX_SHARED, Posture
from planview.tracking.human_model.refining import Refiner
from planview.tracking.human_model.scene import SEARCH_SIGMAS, ModelScene
from planview.tracking.human_model.target import SPEED_STD_MPS, Target
from planview.tracking.identity import IdentityLayer
from planview.tracking.kalman import FloorKalman, PositionNoise
from planview.tracking.lifecycle import LifeCycle

SILHOUETTE = 2.45
"""Half width over the standard deviation of a silhouette's columns: they fall off about like a triangle, sqrt(6)."""
JACOBIAN_STEP_M = 0.01
"""Step over which the derivative of the projection is taken [m]."""
DEPTH_M = 1.0
"""Standard deviation of the distance from the camera of a person neither of whose ends shows [m] (our choice): a table
hides legs whose feet are so far behind its edge."""
MAX_WIDTH = 2.0
"""Largest width learned of a person, over the model's (our choice): an umbrella or a pram is no part of the body."""


class _Place(NamedTuple):
    """Floor point [m] of a measured foot pixel."""

    x_m: float
    y_m: float
    noise: PositionNoise


class Fitter:
    """Moves targets to what the frame shows of them."""

    def __init__(
        self,
        params: HumanModelParams,
        camera: GroundCamera,
        scene: ModelScene,
        life: LifeCycle,
        identity: IdentityLayer,
    ) -> None:
        self.params, self.camera, self.scene = params, camera, scene
        self._life, self._identity = life, identity
        self._refiner = Refiner(params, camera, scene)
        self.posture = Posture(params, camera, scene, life, self._refiner)
        self._dt_s = 0.0

    def predict(self, targets: Sequence[Target], dt_s: float) -> None:
        """Advance all footprints; unobserved people slow down, seated ones stay."""
        self._dt_s, p = dt_s, self.params.match
        for target in targets:
            if target.seat is not None:
                self.posture.predict(target, target.seat)
                continue
            target.kalman = target.kalman.predicted(dt_s, p.acceleration_mps2)
            if not target.existence.observed:
                target.kalman = target.kalman.slowed(dt_s, p.coast_s)

    def fit(self, targets: Sequence[Target], frame: ModelFrame) -> None:
        """Observed targets are matched together; the others may then take what is left.

        Foreground beside an observed person's model may be that person's arm or bag: to a lost one it is less salient.
        """
        self.scene.clear()
        active = [t for t in targets if t.existence.observed]
        lost = [t for t in targets if not t.existence.observed]
        if active:
            self._fit_group(active, targets, frame, frame)
        if lost:
            most = np.where(self.scene.claimed > 0, LESS_SALIENT, SALIENT)
            evidence = np.minimum(frame.evidence, most)
            self._fit_group(lost, targets, frame, replace(frame, evidence=evidence))

    def start(self, foot_px: F64, scale: float) -> FloorKalman | None:
        """Filter of a new target at a (2,) foot pixel; None where that is not on the floor."""
        x, y = (float(v) for v in self.camera.back_project(foot_px))
        if not (math.isfinite(x) and math.isfinite(y)):
            return None
        (place,) = self._places(foot_px[None], np.array([scale]))
        return FloorKalman.measured(x, y, place.noise, SPEED_STD_MPS)

    def appearance(self, foot_px: F64, scale: float, frame: ModelFrame) -> Appearance | None:
        """Colours of what only the model at a (2,) foot pixel covers; None without colour images."""
        if frame.image is None:
            return None
        return Appearance(self.scene.colours(frame.image, frame.evidence, foot_px, scale))

    def _fit_group(
        self, group: Sequence[Target], targets: Sequence[Target], frame: ModelFrame, left: ModelFrame
    ) -> None:
        """Match a group to what others have ``left`` of a frame."""
        position = self.scene.match(left.evidence, *self._prediction(group))
        self.posture.review(group, position, targets, frame)
        scale = np.array([t.model_scale for t in group])
        measured = self.scene.measure(left, position, scale)
        for i, target in enumerate(group):
            if not target.existence.observed and self._is_other(target, position[i], frame):
                measured.discard(i)
            self._refine(target, i, measured, frame)
        places = self._places(position, np.array([t.model_scale for t in group]))
        for i, target in enumerate(group):
            self._update(target, i, measured, places[i], frame)
            self.posture.watch(target, targets, frame)
            self._remember(target, i, measured, frame)
            target.score = measured.score(i, self.params.match.overlap_weight)
            self._learn_width(target, i, measured)
            self._learn_hiding(target, i, measured, frame)
            self._learn_colours(target, i, measured, frame)

    def _prediction(self, group: Sequence[Target]) -> tuple[F64, F64, F64, I64]:
        """Foot pixels, scales, covariances [px^2] and the order of targets, nearest to the camera first."""
        xy = np.array([t.xy_m for t in group])
        scale = np.array([t.model_scale for t in group])
        predicted, jacobian = foot_pixels(self.camera, xy)
        kalmans = [t.kalman for t in group]
        spread = np.array([((k.c_xx, k.c_xy), (k.c_xy, k.c_yy)) for k in kalmans])
        limit = self.params.prune.reacquire_m**2 / SEARCH_SIGMAS**2
        spread *= np.minimum(1.0, limit / np.maximum(np.trace(spread, axis1=1, axis2=2), 1e-9))[:, None, None]
        noise = self._pixel_noise(predicted, scale)
        covariance = jacobian @ spread @ jacobian.transpose(0, 2, 1) + noise[:, None, None] ** 2 * np.eye(2)
        return predicted, scale, covariance, np.argsort(np.hypot(xy[:, 0], xy[:, 1]), kind="stable")

    def _pixel_noise(self, foot: F64, scale: F64) -> F64:
        """(N,) standard deviation of a measured foot pixel [px]."""
        entry = self.scene.model_map.entry_at(foot)
        height = np.linalg.norm(self.scene.map_boxes[entry, 2:], axis=1)
        return np.asarray(1.0 + self.params.match.position_noise * height * self.scene.sizes.of(entry, scale))

    def _places(self, foot: F64, scale: F64) -> list[_Place]:
        """Floor points of measured (N, 2) foot pixels of people of (N,) scales."""
        xy = np.asarray(self.camera.back_project(foot))
        inverse = np.linalg.inv(foot_pixels(self.camera, xy)[1])
        noise = self._pixel_noise(foot, scale)
        covariance = noise[:, None, None] ** 2 * inverse @ inverse.transpose(0, 2, 1)
        rows = zip(xy.tolist(), covariance.tolist(), strict=True)
        return [_Place(x, y, PositionNoise(xx, cross, yy)) for (x, y), ((xx, cross), (_, yy)) in rows]

    def _is_other(self, target: Target, position: F64, frame: ModelFrame) -> bool:
        """Whether what a target unobserved for a while could take has another person's colours."""
        if self._life.unobserved_s(target.existence) < self.params.states.window_s:
            return False
        appearance = self.appearance(position, target.model_scale, frame)
        if appearance is None:
            return False
        return math.exp(-self._identity.unlikelihood(target.existence, appearance)) < self.params.prune.min_likeness

    def _refine(self, target: Target, i: int, measured: Measurement, frame: ModelFrame) -> None:
        """Lay head and foot of a standing model on the ends of its blob."""
        enough = target.inside == 1.0 and measured.precision[i] >= self.params.match.min_precision
        target.depth_known = (
            target.seat is not None
            or not enough
            or self._refiner(target, measured.position[i], frame.evidence, self._dt_s)
        )

    def _update(self, target: Target, i: int, measured: Measurement, place: _Place, frame: ModelFrame) -> None:
        p, precision = self.params, float(measured.precision[i])
        was_observed = target.existence.observed
        target.shared = float(measured.shared[i])
        hidden = was_observed and 1.0 - target.shared < p.match.min_free
        # A lost person is not reacquired on another's foreground.
        own = was_observed or float(measured.alone[i]) >= p.prune.merge_alone
        matched = hidden or (own and precision >= p.match.min_precision) or target.seat is not None
        target.foot_px, target.precision = measured.position[i], precision
        target.inside = self.scene.visibility(target.foot_px, target.model_scale)
        self._observe(target, matched, precision)
        target.weigh(self._dt_s, hidden or target.seat is not None, p.existence)
        if matched and not hidden:
            uncertain = target.stability in ("disappearing", "occlusion")
            noise = place.noise.scaled(p.states.uncertain_noise if uncertain else 1.0)
            if not target.depth_known:
                noise = noise.stretched(place.x_m, place.y_m, DEPTH_M)
            target.kalman = target.kalman.corrected(place.x_m, place.y_m, noise)
        else:
            target.foot_px = self.camera.project(np.append(target.xy_m, 0.0))
        target.hidden = hidden

    def _remember(self, target: Target, i: int, measured: Measurement, frame: ModelFrame) -> None:
        """The recent past and the states that follow from it."""
        visible = target.inside * (1.0 if target.hidden else target.precision)
        target.remember(frame.now_s, float(measured.moving[i]), visible, self.params.states.window_s)
        self._advance_states(target, frame.now_s)

    def _observe(self, target: Target, matched: bool, precision: float) -> None:
        lost = target.existence.state == "lost"
        reason = f"precision {precision:.2f}"
        if matched:
            target.matches += 1
            self._life.observe(target.existence, reason if lost else "", precision)
        elif target.existence.observed:
            self._life.miss(target.existence, reason, precision)

    def _advance_states(self, target: Target, now_s: float) -> None:
        motion = target.next_motion(self.params.states)
        stability = target.next_stability(self.params.states)
        if motion != target.motion:
            self._life.log(target.existence, "state", f"{target.motion} -> {motion}")
        if stability != target.stability:
            change = f"{target.stability} -> {stability}"
            self._life.log(target.existence, "state", change, target.trail[-1].visible)
        target.motion, target.stability = motion, stability
        if motion != "stationary":
            target.still_since_s = math.nan
        elif math.isnan(target.still_since_s):
            target.still_since_s = now_s

    def _gain(self) -> float:
        """Weight of this frame in what is learned of a person."""
        return 1.0 - math.exp(-self._dt_s / self.params.match.learning_s)

    def _learn_width(self, target: Target, i: int, measured: Measurement) -> None:
        n = int(measured.counts.breadth_n[i])
        if target.stability == "stable" and target.existence.observed and measured.hidden[i] == 0 and n > 0:
            half = 0.5 * self.scene.box_width(target.foot_px, target.model_scale)
            width = SILHOUETTE * math.sqrt(measured.counts.breadth_px2[i] / n) / max(half, 1.0)
            target.build.width += self._gain() * (min(max(width, 1.0), MAX_WIDTH) - target.build.width)

    def _learn_hiding(self, target: Target, i: int, measured: Measurement, frame: ModelFrame) -> None:
        """A person who walks shows where the scene hides people."""
        sure = target.existence.confirmed and target.existence.observed and target.motion == "moving"
        if sure and target.seat is None and float(measured.precision[i]) >= self.params.match.min_precision:
            self.scene.learn_hiding(frame.evidence, target.foot_px, target.model_scale, self._dt_s)

    def _learn_colours(self, target: Target, i: int, measured: Measurement, frame: ModelFrame) -> None:
        """Colours of a person who is clear of others."""
        clear = target.existence.observed and target.shared <= MAX_SHARED
        if not clear or float(measured.precision[i]) < self.params.spawn.min_precision:
            return
        appearance = self.appearance(target.foot_px, target.model_scale, frame)
        if appearance is not None:
            self._identity.learn(target.existence, appearance)


@lru_cache(maxsize=16)
def floor_view(camera: GroundCamera) -> kernels.FloorView:
    """The camera as kernels take it."""
    tilt, roll = camera.tilt_rad, camera.roll_rad
    centre = (camera.width - 1) / 2, (camera.height - 1) / 2
    lens = float(camera.height_m), float(camera.focal_px), camera.distortion_k
    return kernels.FloorView(math.sin(tilt), math.cos(tilt), math.sin(roll), math.cos(roll), *lens, *centre)


def foot_pixels(camera: GroundCamera, xy_m: F64) -> tuple[F64, F64]:
    """Pixels (N, 2) of floor points (N, 2), and (N, 2, 2) their derivative [px/m]."""
    pixels, jacobian = np.empty((len(xy_m), 2)), np.empty((len(xy_m), 2, 2))
    kernels.project_floor(floor_view(camera), np.ascontiguousarray(xy_m), JACOBIAN_STEP_M, pixels, jacobian)
    return pixels, jacobian
