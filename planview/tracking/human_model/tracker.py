"""Human-model tracker of one calibrated camera (Zhang et al. 2008, section 4, figure 8)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.human_model import HumanModel
from calib.human_model_map import HumanModelMap, build_model_map
from calib.types import F32, F64, I64, U8
from planview.blobs import Blobs, find_blobs
from planview.foreground import BACKGROUND, PERSON
from planview.tracking.base import Decision, DecisionKind, Observation, TrackerDebug, TrackState
from planview.tracking.human_model.births import Candidate, Unexplained, find_candidates
from planview.tracking.human_model.drawing import draw
from planview.tracking.human_model.identity import Mingling
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import Measurement, ModelScene, similarity
from planview.tracking.human_model.target import FootprintKalman, Target


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
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self.targets: list[Target] = []
        self._ids: Iterator[int] = itertools.count(1)
        self._decisions: list[Decision] = []
        self._now_s = np.nan
        self._mingling = Mingling(self.params.life)
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
        foreground, motion = self._checked(observation)
        now = observation.timestamp_s
        dt = 0.0 if np.isnan(self._now_s) else max(0.0, now - self._now_s)
        self._now_s = now
        self._decisions = []
        evidence = salience(foreground, observation.shadow)
        blobs = find_blobs(evidence)
        self._predict(dt)
        self._match_and_update(observation.image, evidence, motion, blobs)
        self._tell_apart()
        self._new_targets(observation.image, evidence, motion, blobs)
        self._merge()
        self._clean()
        self._watch_still(foreground, motion, dt)
        return tuple(self._state_of(target) for target in self.targets)

    def feedback(self) -> U8:
        """(H, W) uint8 for ``Foreground``: people who are tracked, and what has been still and unexplained for long."""
        mask = np.zeros(self.camera.size[::-1], np.uint8)
        mask[self._still_s >= self.params.life.still_s] = BACKGROUND
        if any(target.confirmed for target in self.targets):
            mask[self.scene.claimed > 0] = PERSON
        return mask

    def debug(self) -> TrackerDebug:
        """Models with their states, and the search ranges."""
        return draw(self.targets, [self._drawn(t) for t in self.targets], self.scene)

    def _checked(self, observation: Observation) -> tuple[U8, U8]:
        foreground, motion = observation.foreground, observation.motion
        if foreground is None or motion is None:
            raise ValueError("the human-model tracker needs foreground and motion")
        width, height = self.camera.size
        if foreground.shape != (height, width):
            raise InputError(
                f"expected images of {width}x{height} px, for which the camera was calibrated, "
                f"found {foreground.shape[1]}x{foreground.shape[0]}"
            )
        return foreground, motion

    def _decide(self, target: Target, kind: DecisionKind, reason: str, value: float = np.nan) -> None:
        self._decisions.append(Decision(target.track_id, kind, reason, value))

    def _predict(self, dt: float) -> None:
        for target in self.targets:
            target.kalman.predict(dt, self.params.match.acceleration_mps2)
            if not target.matched:
                target.kalman.state[2:] *= np.exp(-dt / self.params.match.coast_s)

    def _match_and_update(self, image: U8 | None, evidence: U8, motion: U8, blobs: Blobs) -> None:
        """Targets with a blob are matched together; those without one may then take what is left."""
        self._drop_outside()
        self.scene.clear()
        active = [t for t in self.targets if t.matched]
        lost = [t for t in self.targets if not t.matched]
        for group in (active, lost):
            if group:
                prediction = self._prediction(group)
                position = self.scene.match(evidence, *prediction, fresh=False)
                self._sit_or_stand(group, position, evidence)
                scale = np.array([self._drawn(t) for t in group])
                measured = self.scene.measure(evidence, motion, blobs, position, scale)
                for i, target in enumerate(group):
                    if not target.matched and self._is_other(target, measured.position[i], image, evidence):
                        measured.counts[i, 1:] = 0
                    self._refine(target, i, measured, evidence)
                    self._update_target(target, i, measured, blobs)
                    self._learn_colours(target, i, measured, image, evidence)

    def _prediction(self, group: list[Target]) -> tuple[F64, F64, F64, I64]:
        """Foot pixels, scales, their covariances [px^2] and the order of targets, nearest to the camera first."""
        xy = np.array([t.kalman.state[:2] for t in group])
        scale = np.array([self._drawn(t) for t in group])
        predicted, jacobian = foot_pixels(self.camera, xy)
        spread = np.array([t.kalman.covariance[:2, :2] for t in group])
        limit = self.params.life.reattach_m**2 / self.params.match.search_sigmas**2
        spread *= np.minimum(1.0, limit / np.maximum(np.trace(spread, axis1=1, axis2=2), 1e-9))[:, None, None]
        noise = self._pixel_noise(predicted, scale)
        covariance = jacobian @ spread @ jacobian.transpose(0, 2, 1) + noise[:, None, None] ** 2 * np.eye(2)
        return predicted, scale, covariance, np.argsort(np.hypot(xy[:, 0], xy[:, 1]), kind="stable")

    def _drop_outside(self) -> None:
        """Targets whose prediction left the places where people are possible are gone."""
        xy = np.array([t.kalman.state[:2] for t in self.targets]).reshape(-1, 2)
        entry = self.scene.model_map.entry_at(self.camera.project(np.column_stack([xy, np.zeros(len(xy))])))
        for target, e in zip(list(self.targets), entry, strict=True):
            if e < 0:
                self._decide(target, "removed", "predicted outside the view")
                self.targets.remove(target)

    def _pixel_noise(self, foot: F64, scale: F64) -> F64:
        """(N,) standard deviation of an observed foot pixel [px]."""
        entry = self.scene.model_map.entry_at(foot)
        height = np.linalg.norm(self.scene.map_boxes[entry, 2:], axis=1)
        return np.asarray(1.0 + self.params.match.position_noise * height * scale)

    def _drawn(self, target: Target) -> float:
        """Scale of the model as it is drawn: seated people are lower."""
        return target.scale * (self.params.posture.sitting if target.sitting else 1.0)

    def _sit_or_stand(self, group: list[Target], position: F64, evidence: U8) -> None:
        """Change the model of who is not walking when the other posture explains the blob better."""
        p = self.params.posture
        for target, foot in zip(group, position, strict=True):
            if not target.confirmed or (target.motion == "moving" and not target.sitting):
                continue
            self.scene.paint(self.scene.cover, foot, self._drawn(target), -1)
            scores = [self.scene.best_near(evidence, foot, target.scale * k, target.scale) for k in (1.0, p.sitting)]
            (stand, _), (sit, _) = scores
            change = (sit - stand if not target.sitting else stand - sit) > p.advantage
            if change:
                target.sitting = not target.sitting
                foot[:] = scores[target.sitting][1]
                self._decide(target, "state", "sits down" if target.sitting else "stands up", sit - stand)
            self.scene.paint(self.scene.cover, foot, self._drawn(target), 1)

    def _is_other(self, target: Target, position: F64, image: U8 | None, evidence: U8) -> bool:
        """Whether what a lost target could take has another's colours."""
        recent = self._now_s - target.seen_s < self.params.states.window_s
        if recent or image is None or image.ndim != 3 or target.colours is None:
            return False
        seen = self.scene.colours(image, evidence, position, self._drawn(target))
        return similarity(target.colours, seen) < self.params.life.alike

    def _refine(self, target: Target, i: int, measured: Measurement, evidence: U8) -> None:
        """Lay head and foot of a model on the ends of its blob, and learn the person's height, when all of it shows."""
        p = self.params
        if measured.shared[i] > 0 or measured.precision[i] < p.match.min_precision or target.inside < 1.0:
            return
        if target.sitting:
            return
        found = self.scene.extent(evidence, measured.position[i], target.scale)
        if found is None or found[1] > p.match.refine_reach or abs(found[2] - 1.0) > p.match.refine_height:
            return
        measured.position[i] += found[0]
        if target.stability == "stable":
            scale = target.scale * (1.0 + p.match.height_gain * (found[2] - 1.0))
            target.scale = float(np.clip(scale, p.min_height, p.max_height))

    def _update_target(self, target: Target, i: int, measured: Measurement, blobs: Blobs) -> None:
        p, now = self.params, self._now_s
        noise = self._pixel_noise(measured.position[i : i + 1], np.array([self._drawn(target)]))[0]
        shared, precision = float(measured.shared[i]), float(measured.precision[i])
        hidden = target.matched and 1.0 - shared < p.match.min_free
        target.shared = shared
        target.matched = hidden or precision >= p.match.min_precision
        target.foot_px = measured.position[i]
        entry = int(self.scene.model_map.entry_at(target.foot_px))
        target.inside = float(self.scene.model_map.visibility[entry]) if entry >= 0 else 0.0
        if target.matched:
            target.seen_s = now
            target.matches += 1
        if target.matched and not hidden:
            factor = p.states.uncertain_noise if target.stability in ("disappearing", "occlusion") else 1.0
            xy = self.camera.back_project(target.foot_px)
            _, jacobian = foot_pixels(self.camera, xy[None])
            inverse = np.linalg.inv(jacobian[0])
            target.kalman.update(xy, (factor * noise) ** 2 * inverse @ inverse.T)
        else:
            target.foot_px = self.camera.project(np.append(target.kalman.state[:2], 0.0))
        visible = target.inside * (precision if not hidden else 1.0)
        target.visible = visible if target.matched else target.visible
        target.remember(now, float(measured.internal_motion[i]), visible, p.states.window_s)
        self._advance_states(target, shared, float(measured.alone[i]))
        target.score = self._score(i, measured, blobs)
        if target.stability == "stable" and target.matched and shared == 0 and measured.extent[i, 2] > 0:
            # Columns of a silhouette fall off towards arms and feet: about a triangle, half width sqrt(6) sigma.
            spread = 2.45 * np.sqrt(measured.extent[i, 1] / measured.extent[i, 2])
            half = 0.5 * self.scene.map_boxes[entry, 2] * self._drawn(target)
            target.half_width += 0.1 * (float(np.clip(spread / max(half, 1.0), 1.0, 2.0)) - target.half_width)
        if not target.confirmed and self._believable(target):
            target.confirmed = True
            self._decide(target, "confirmed", f"walked {target.travel_m:.2f} m", target.travel_m)

    def _score(self, i: int, measured: Measurement, blobs: Blobs) -> float:
        """M of equation 1 for one target and the blob it covers most."""
        area, foreground, _, shared, _, _, label = measured.counts[i]
        blob = float(max(1, blobs.area_px[label])) if label else 1.0
        return float(min(1.0, 0.5 * foreground / blob) + 0.5 * foreground / max(1, area) - shared / max(1, area))

    def _advance_states(self, target: Target, shared: float, alone: float) -> None:
        motion = target.next_motion(self.params.states)
        stability = target.next_stability(shared, self.params.states)
        if motion != target.motion:
            self._decide(target, "state", f"{target.motion} -> {motion}")
        if stability != target.stability:
            self._decide(target, "state", f"{target.stability} -> {stability}", target.visible)
        target.motion, target.stability = motion, stability
        target.advance(self._now_s, alone < self.params.life.merge_alone and shared > 0.0)

    def _believable(self, target: Target) -> bool:
        b = self.params.birth
        return target.matches >= b.min_matches and target.travel_m >= b.min_travel_m

    def _learn_colours(self, target: Target, i: int, measured: Measurement, image: U8 | None, evidence: U8) -> None:
        """Mean colours of who is seen alone; while an identity is in doubt they are only collected."""
        if image is None or image.ndim != 3 or not target.matched:
            return
        if float(measured.shared[i]) > 0.1 or float(measured.precision[i]) < self.params.birth.min_precision:
            return
        seen = self.scene.colours(image, evidence, target.foot_px, self._drawn(target))
        if self._mingling.busy(target.track_id):
            self._mingling.see(target, seen)
        else:
            target.colours = (
                seen if target.colours is None else np.float32(0.9) * target.colours + np.float32(0.1) * seen
            )

    def _tell_apart(self) -> None:
        """After an occlusion, swap two people whose colours say so."""
        for first, second in itertools.combinations(self.targets, 2):
            if min(first.shared, second.shared) > 0.05 and self._touch(first, second):
                self._mingling.close(first, second, self._now_s)
        for first, second, gain in self._mingling.swapped(self.targets, self._now_s):
            first.swap_with(second)
            self._decide(first, "state", f"colours say: swapped with {second.track_id} (gain {gain:.2f})", gain)

    def _new_targets(self, image: U8 | None, evidence: U8, motion: U8, blobs: Blobs) -> None:
        rest = np.where(self.scene.claimed > 0, 0, evidence).astype(np.uint8)
        for candidate in find_candidates(self.scene, self.params, Unexplained(rest, motion, blobs)):
            self._add(candidate, image, evidence)

    def _add(self, candidate: Candidate, image: U8 | None, evidence: U8) -> None:
        xy = self.camera.back_project(candidate.foot_px)
        if not np.isfinite(xy).all():
            return
        _, jacobian = foot_pixels(self.camera, xy[None])
        inverse = np.linalg.inv(jacobian[0])
        noise = self._pixel_noise(candidate.foot_px[None], np.array([candidate.scale]))[0]
        kalman = FootprintKalman(xy, noise**2 * inverse @ inverse.T)
        self.scene.paint(self.scene.cover, candidate.foot_px, candidate.scale, 1)
        colours = None
        if image is not None and image.ndim == 3:
            colours = self.scene.colours(image, evidence, candidate.foot_px, candidate.scale)
        lost = self._same_as_lost(xy, colours)
        if lost is not None:
            lost.kalman, lost.foot_px, lost.seen_s, lost.matched = kalman, candidate.foot_px, self._now_s, True
            lost.scale = candidate.scale
            self._decide(lost, "reattached", f"seen again with score {candidate.score:.2f}", candidate.score)
            return
        target = Target(
            next(self._ids), kalman, self._now_s, self._now_s, xy, candidate.foot_px, candidate.scale, colours=colours
        )
        target.remember(self._now_s, 0.0, candidate.precision, self.params.states.window_s)
        self.targets.append(target)
        self._decide(target, "born", f"score {candidate.score:.2f}", candidate.score)

    def _same_as_lost(self, xy: F64, colours: F32 | None) -> Target | None:
        best, best_m = None, self.params.life.reattach_m
        for target in self.targets:
            if target.matched or not target.confirmed:
                continue
            distance = float(np.hypot(*(target.kalman.state[:2] - xy)))
            if target.colours is not None and colours is not None:
                alike = similarity(target.colours, colours)
                if alike < self.params.life.alike:
                    continue
            if distance < best_m:
                best, best_m = target, distance
        return best

    def _merge(self) -> None:
        """A target that others cover for long while all of them walk is one of them: without it M is higher."""
        for target in sorted(self.targets, key=lambda t: -t.covered_since_s if t.covered_since_s > 0 else 0.0):
            others = [t for t in self.targets if t is not target and not t.merged and self._touch(t, target)]
            clocks = [target.covered_since_s, target.moving_since_s, *(t.moving_since_s for t in others)]
            since = float(np.max(clocks))  # NaN where one of them does not run
            if others and self._now_s - since >= self.params.life.merge_after_s:
                target.merged = True
                self._decide(target, "merged", f"walks on {others[0].track_id}")
        self.targets = [t for t in self.targets if not t.merged]

    def _touch(self, first: Target, second: Target) -> bool:
        """Whether the models' boxes overlap by at least half of the smaller width."""
        a, b = self._box(first), self._box(second)
        return min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0]) > 0.5 * min(a[2], b[2]) and (
            min(a[1] + a[3], b[1] + b[3]) > max(a[1], b[1])
        )

    def _height_px(self, target: Target) -> float:
        entry = int(self.scene.model_map.entry_at(target.foot_px))
        return float(self.scene.map_boxes[entry, 2:].max()) * target.scale if entry >= 0 else 0.0

    def _clean(self) -> None:
        life, now = self.params.life, self._now_s
        for target in list(self.targets):
            reason = ""
            if not target.confirmed and now - target.born_s > self.params.birth.tentative_s:
                reason = "never walked"
            elif (
                not target.confirmed
                and target.matches > 2
                and max(row[3] for row in target.trail) < self.params.birth.min_motion
            ):
                reason = "does not move"
            elif not target.confirmed and not target.matched:
                reason = "no blob before it was believed"
            elif now - target.still_since_s >= life.inanimate_s:
                reason = "stationary: a thing"
            elif target.inside < life.gone_visible:
                reason = "left the view"
            elif not target.matched:
                if target.inside < life.border_visible or now - target.seen_s > life.patience_s * target.inside:
                    reason = f"no blob for {now - target.seen_s:.1f} s"
            if reason:
                self.targets.remove(target)
                self._decide(target, "removed", reason)

    def _watch_still(self, foreground: U8, motion: U8, dt: float) -> None:
        still = (foreground > 0) & (motion == 0) & (self.scene.claimed == 0)
        self._still_s = np.where(still, self._still_s + np.float32(dt), np.float32(0.0))

    def _state_of(self, target: Target) -> TrackState:
        x, y, vx, vy = (float(v) for v in target.kalman.state)
        state = "tentative" if not target.confirmed else "confirmed" if target.matched else "lost"
        return TrackState(
            target.track_id, state, x, y, vx, vy, self.model.height_m * self._drawn(target), self._box(target)
        )

    def _box(self, target: Target) -> tuple[float, float, float, float]:
        foot = self.camera.project(np.append(target.kalman.state[:2], 0.0))
        hull = self.scene.hull(foot, self._drawn(target))
        if hull is None:
            return (np.nan, np.nan, np.nan, np.nan)
        (left, top), (right, bottom) = hull.min(axis=0), hull.max(axis=0)
        middle, half = 0.5 * (left + right), 0.5 * (right - left) * target.half_width
        return float(middle - half), float(top), float(2 * half), float(bottom - top)


def salience(foreground: U8, shadow: U8 | None) -> U8:
    """(H, W) uint8: 2 where foreground, 1 where less salient (removed as a shadow), else 0."""
    salient = (foreground > 0).view(np.uint8) << 1
    return salient if shadow is None else np.maximum(salient, (shadow > 0).view(np.uint8))


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
