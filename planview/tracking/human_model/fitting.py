"""Prediction, matching and update of the targets that exist (section 4)."""

from __future__ import annotations

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64, I64
from planview.foreground.blobs import Blobs
from planview.tracking.human_model.frame import Decide, Frame
from planview.tracking.human_model.identity import Mingling
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.posture import MAX_SHARED, Posture
from planview.tracking.human_model.scene import Measurement, ModelScene, similarity
from planview.tracking.human_model.target import FootprintKalman, Target

SILHOUETTE = 2.45
"""Half width over the standard deviation of a silhouette's columns: they fall off about like a triangle, sqrt(6)."""
WIDTH_GAIN = 0.1
"""Share of a frame in the learned width of a person (our choice)."""
COLOUR_GAIN = 0.1
"""Share of a frame in the learned colours of a person (our choice)."""


class Fitter:
    """Moves targets to what the frame shows of them."""

    def __init__(
        self, params: HumanModelParams, camera: GroundCamera, scene: ModelScene, mingling: Mingling, decide: Decide
    ) -> None:
        self.params, self.camera, self.scene = params, camera, scene
        self._mingling, self._decide = mingling, decide
        self._posture = Posture(params, camera, scene, decide)

    def predict(self, targets: list[Target], dt_s: float) -> None:
        """Advance all footprints; who has no blob slows down, who sits stays."""
        for target in targets:
            if target.seat is not None:
                self._posture.predict(target, target.seat)
                continue
            target.kalman.predict(dt_s, self.params.match.acceleration_mps2)
            if not target.matched:
                target.kalman.state[2:] *= np.exp(-dt_s / self.params.match.coast_s)

    def fit(self, targets: list[Target], frame: Frame) -> None:
        """Targets with a blob are matched together; those without one may then take what is left."""
        self.scene.clear()
        active = [t for t in targets if t.matched]
        lost = [t for t in targets if not t.matched]
        for group in (active, lost):
            if group:
                self._fit_group(group, targets, frame)

    def start(self, foot_px: F64, scale: float) -> FootprintKalman | None:
        """Filter of a new target at a (2,) foot pixel; None where that is not on the floor."""
        xy = self.camera.back_project(foot_px)
        return FootprintKalman(xy, self._floor_noise(foot_px, scale)) if np.isfinite(xy).all() else None

    def _fit_group(self, group: list[Target], targets: list[Target], frame: Frame) -> None:
        position = self.scene.match(frame.evidence, *self._prediction(group))
        self._posture.review(group, position, targets, frame)
        scale = np.array([t.drawn for t in group])
        measured = self.scene.measure(frame.evidence, frame.motion, frame.blobs, position, scale)
        for i, target in enumerate(group):
            if not target.matched and self._is_other(target, position[i], frame):
                measured.counts[i, 1:] = 0
            self._refine(target, i, measured, frame)
            self._update(target, i, measured, targets, frame)
            target.score = _score(measured.counts[i], frame.blobs)
            self._learn_width(target, i, measured)
            self._learn_colours(target, i, measured, frame)

    def _prediction(self, group: list[Target]) -> tuple[F64, F64, F64, I64]:
        """Foot pixels, scales, covariances [px^2] and the order of targets, nearest to the camera first."""
        xy = np.array([t.kalman.state[:2] for t in group])
        scale = np.array([t.drawn for t in group])
        predicted, jacobian = foot_pixels(self.camera, xy)
        spread = np.array([t.kalman.covariance[:2, :2] for t in group])
        limit = self.params.life.reattach_m**2 / self.params.match.search_sigmas**2
        spread *= np.minimum(1.0, limit / np.maximum(np.trace(spread, axis1=1, axis2=2), 1e-9))[:, None, None]
        noise = self._pixel_noise(predicted, scale)
        covariance = jacobian @ spread @ jacobian.transpose(0, 2, 1) + noise[:, None, None] ** 2 * np.eye(2)
        return predicted, scale, covariance, np.argsort(np.hypot(xy[:, 0], xy[:, 1]), kind="stable")

    def _pixel_noise(self, foot: F64, scale: F64) -> F64:
        """(N,) standard deviation of an observed foot pixel [px]."""
        entry = self.scene.model_map.entry_at(foot)
        height = np.linalg.norm(self.scene.map_boxes[entry, 2:], axis=1)
        return np.asarray(1.0 + self.params.match.position_noise * height * scale)

    def _floor_noise(self, foot: F64, scale: float) -> F64:
        """(2, 2) covariance [m^2] of the floor point of an observed (2,) foot pixel."""
        noise = float(self._pixel_noise(foot[None], np.array([scale]))[0])
        _, jacobian = foot_pixels(self.camera, self.camera.back_project(foot)[None])
        inverse = np.linalg.inv(jacobian[0])
        return np.asarray(noise**2 * inverse @ inverse.T)

    def _is_other(self, target: Target, position: F64, frame: Frame) -> bool:
        """Whether what a target lost for a while could take has another's colours."""
        recent = frame.now_s - target.seen_s < self.params.states.window_s
        if recent or frame.image is None or target.colours is None:
            return False
        seen = self.scene.colours(frame.image, frame.evidence, position, target.drawn)
        return similarity(target.colours, seen) < self.params.life.alike

    def _refine(self, target: Target, i: int, measured: Measurement, frame: Frame) -> None:
        """Lay head and foot of a model on the ends of its blob, and learn the person's height, when all of it shows."""
        p = self.params.match
        if (
            target.seat is not None
            or target.inside < 1.0
            or measured.shared[i] > 0
            or measured.precision[i] < p.min_precision
        ):
            return
        found = self.scene.extent(frame.evidence, measured.position[i], target.scale)
        if found is None or found[1] > p.refine_reach or abs(found[2] - 1.0) > p.refine_height:
            return
        measured.position[i] += found[0]
        if target.stability == "stable":
            scale = target.scale * (1.0 + p.height_gain * (found[2] - 1.0))
            target.scale = float(np.clip(scale, self.params.min_height, self.params.max_height))

    def _update(self, target: Target, i: int, measured: Measurement, targets: list[Target], frame: Frame) -> None:
        p, now_s = self.params, frame.now_s
        precision, target.shared = float(measured.precision[i]), float(measured.shared[i])
        hidden = target.matched and 1.0 - target.shared < p.match.min_free
        # Who was lost is not found again on somebody else.
        own = target.matched or float(measured.alone[i]) >= p.life.merge_alone
        target.matched = hidden or (own and precision >= p.match.min_precision) or target.seat is not None
        target.foot_px, target.precision = measured.position[i], precision
        target.inside = self.scene.visibility(target.foot_px)
        if target.matched:
            target.seen_s = now_s
            target.matches += 1
        if target.matched and not hidden:
            uncertain = target.stability in ("disappearing", "occlusion")
            noise = self._floor_noise(target.foot_px, target.drawn)
            weight = p.states.uncertain_noise**2 if uncertain else 1.0
            target.kalman.update(self.camera.back_project(target.foot_px), weight * noise)
        else:
            target.foot_px = self.camera.project(np.append(target.kalman.state[:2], 0.0))
        self._posture.watch(target, targets, frame)
        visible = target.inside * (1.0 if hidden else precision)
        target.remember(now_s, float(measured.internal_motion[i]), visible, p.states.window_s)
        self._advance_states(target, float(measured.alone[i]), now_s)

    def _advance_states(self, target: Target, alone: float, now_s: float) -> None:
        motion = target.next_motion(self.params.states)
        stability = target.next_stability(target.shared, self.params.states)
        if motion != target.motion:
            self._decide(target, "state", f"{target.motion} -> {motion}")
        if stability != target.stability:
            self._decide(target, "state", f"{target.stability} -> {stability}", target.trail[-1][4])
        target.motion, target.stability = motion, stability
        target.advance(now_s, alone < self.params.life.merge_alone and target.shared > 0.0)

    def _learn_width(self, target: Target, i: int, measured: Measurement) -> None:
        _, square, n = measured.extent[i]
        if target.stability == "stable" and target.matched and target.shared == 0 and n > 0:
            half = 0.5 * self.scene.box_width(target.foot_px) * target.drawn
            ratio = float(np.clip(SILHOUETTE * np.sqrt(square / n) / max(half, 1.0), 1.0, 2.0))
            target.half_width += WIDTH_GAIN * (ratio - target.half_width)

    def _learn_colours(self, target: Target, i: int, measured: Measurement, frame: Frame) -> None:
        """Mean colours of who is seen alone; while an identity is in doubt they are only collected."""
        if frame.image is None or not target.matched or target.shared > MAX_SHARED:
            return
        if float(measured.precision[i]) < self.params.birth.min_precision:
            return
        seen = self.scene.colours(frame.image, frame.evidence, target.foot_px, target.drawn)
        if self._mingling.busy(target.track_id):
            self._mingling.see(target, seen)
        elif target.colours is None:
            target.colours = seen
        else:
            target.colours = target.colours + np.float32(COLOUR_GAIN) * (seen - target.colours)


def foot_pixels(camera: GroundCamera, xy_m: F64) -> tuple[F64, F64]:
    """Pixels (N, 2) of floor points (N, 2), and (N, 2, 2) their derivative [px/m]."""
    step = 0.01
    points = np.zeros((len(xy_m), 3, 3))
    points[:, :, :2] = xy_m[:, None, :]
    points[:, 1, 0] += step
    points[:, 2, 1] += step
    pixels = camera.project(points)
    jacobian = (pixels[:, 1:] - pixels[:, :1]) / step
    return pixels[:, 0], jacobian.transpose(0, 2, 1)


def _score(counts: I64, blobs: Blobs) -> float:
    """M of equation 1 for one target and the blob it covers most."""
    area, evidence, label = max(1.0, float(counts[0])), 0.5 * float(counts[1]), int(counts[6])
    blob = max(1.0, float(blobs.area_px[label])) if label else 1.0
    return min(1.0, evidence / blob) + evidence / area - float(counts[3]) / area
