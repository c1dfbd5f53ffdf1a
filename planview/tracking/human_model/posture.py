"""Sitting down, staying seated and getting up: the paper's model stands, but its conference room has chairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.refining import Refiner
from planview.tracking.human_model.scene import CLAIMED_RING, ModelScene
from planview.tracking.human_model.seat import Seat
from planview.tracking.human_model.target import SPEED_STD_MPS, Target
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle

JUDGE_EVERY = 4
"""Frames between two judgements of the posture: sitting down takes a second (our choice, for speed)."""
MAX_SHARED = 0.1
"""Part of a model that others may cover while it is judged to sit down or its colours are learned (our choice)."""
SEAT_APART_M = 0.4
"""Smallest distance between two people who sit [m]: a shoulder's breadth (our choice)."""

SIT_M = 0.3
"""Standard deviation of where a person sits down from where the person was on the way there [m] (our choice): the depth
of a seat."""
SIT_SIGMAS = 2.0
"""Largest deviation from there, in standard deviations: farther off is another's head (our choice)."""
SETTLE_GAIN = 0.25
"""Share of a frame in the place of a person who settles on a seat (our choice)."""
ODDS = 1.0
"""Logarithm of the odds from which on a person is taken to sit down (our choice)."""


class Posture:
    """Decides between the standing and the seated model of each target (our choice)."""

    def __init__(
        self, params: HumanModelParams, camera: GroundCamera, scene: ModelScene, life: LifeCycle, refiner: Refiner
    ) -> None:
        self.params, self.camera, self.scene = params, camera, scene
        self._life = life
        self._refiner = refiner

    def predict(self, target: Target, seat: Seat) -> None:
        """A seated person stays on the seat."""
        target.kalman = _standing_at(seat.xy, self.params.posture.place_m, speed_std_mps=0.0)

    def review(self, group: Sequence[Target], position: F64, targets: Sequence[Target], frame: ModelFrame) -> None:
        """Change the model of people who do not walk, or no longer look so, when the other posture covers more.

        Args:
            group: targets whose models are in ``scene.cover``.
            position: (N, 2) their foot pixels, moved where the posture changes.
            targets: all people.
            frame: the current one.
        """
        for target, foot in zip(group, position, strict=True):
            settled = target.seat is not None and frame.now_s - target.seat.since_s > self.params.settle_s
            known = not settled and target.existence.confirmed and target.existence.observed
            head = self._refiner.head(target, foot, frame.evidence) if known else None
            if head is not None and self._sits_down(target, foot, head, targets, frame):
                continue
            told = target.seat is None and head is not None
            place = None if told else self._place_to_judge(target, foot, frame)
            if place is None:
                continue
            self.scene.paint(self.scene.cover, foot, target.model_scale, -1)
            self._widen(group, position, target, 1)
            found, gain = self._other(target, foot, place, frame)
            if gain > self.params.posture.advantage and self._change(target, found, targets, frame):
                self._life.log(target.existence, "state", "sits down" if target.seat is not None else "stands up", gain)
                foot[:] = found
            self._widen(group, position, target, -1)
            self.scene.paint(self.scene.cover, foot, target.model_scale, 1)

    def _sits_down(self, target: Target, foot: F64, head: F64, targets: Sequence[Target], frame: ModelFrame) -> bool:
        """Sit a person down whose (2,) head [px] sank on the spot; moves the (2,) foot pixel.

        A head that sinks in the image is that of a person who walks towards the camera or of one who sits down. It
        tells a place for either, and the place and velocity of a moment ago tell which is likelier. Feet where the
        standing model has them settle it.
        """
        p = self.params
        height_m = target.build.scale * p.height_m
        stands, sits = (self.camera.back_project(head, h) for h in (height_m, p.posture.sitting * height_m))
        stands_px = self.camera.project(np.append(stands, 0.0))
        on_feet = self._refiner.has_feet(target, stands_px, frame.evidence)
        if target.seat is not None:
            if not self._is_near(target.seat.xy, sits, target):
                return False
            return self._settle(target, target.seat, foot, sits, frame)
        if on_feet or not self._sank(target, stands, sits, frame.now_s):
            if self._is_near(target.xy_m, stands, target):
                target.measure(frame.now_s, stands[0], stands[1], p.states.window_s)
            return False
        seat_px = self.camera.project(np.append(sits, 0.0))
        scale = target.build.scale
        self.scene.paint(self.scene.cover, foot, target.model_scale, -1)
        score, _ = self.scene.best_near(frame.evidence, seat_px, p.posture.sitting * scale, scale)
        enough = score > (2.0 * p.match.min_precision - 1.0) * p.posture.sitting
        if enough and self._change(target, seat_px, targets, frame):
            self._life.log(target.existence, "state", "sits down")
            foot[:] = seat_px
        self.scene.paint(self.scene.cover, foot, target.model_scale, 1)
        return enough

    def _is_near(self, seat: F64, sits: F64, target: Target) -> bool:
        """Whether a head is that of the person on a (2,) seat."""
        std_m = math.hypot(SIT_M, self._refiner.head_std_m(seat, target.build.scale))
        return float(np.hypot(*(sits - seat))) <= SIT_SIGMAS * std_m

    def _settle(self, target: Target, seat: Seat, foot: F64, sits: F64, frame: ModelFrame) -> bool:
        """Follow the head of a person who has just begun to sit down."""
        xy = seat.xy + SETTLE_GAIN * (sits - seat.xy)
        self.scene.paint(self.scene.cover, foot, target.model_scale, -1)
        foot[:] = self.camera.project(np.append(xy, 0.0))
        target.seat = replace(self.seat(xy, foot, seat.scale, frame), since_s=seat.since_s)
        self.scene.paint(self.scene.cover, foot, target.model_scale, 1)
        return True

    def _sank(self, target: Target, stands: F64, sits: F64, now_s: float) -> bool:
        """Whether a head is rather that of the person sitting at one (2,) place than standing at another."""
        window_s, known = self.params.states.window_s, target.way(now_s, self.params.states.window_s)
        head_std_m = self._refiner.head_std_m(target.xy_m, target.build.scale)
        # From far away and not much above, heads do not tell the posture.
        if known is None or np.hypot(*(stands - sits)) < SIT_SIGMAS * head_std_m:
            return False
        (before, velocity, scatter), walk_m = known, 0.5 * self.params.match.acceleration_mps2 * window_s**2
        way = window_s * velocity
        # Who walks may stop on the way; who sits down has stopped before.
        standing, seated = _off(stands - before, way), float(np.hypot(*(sits - before)))
        variance = 2.0 * head_std_m**2
        # Places that scatter are not all of one person's head.
        there = scatter <= SIT_SIGMAS**2 * 0.5 * variance and seated**2 <= SIT_SIGMAS**2 * (SIT_M**2 + variance)
        return there and _unlikelihood(seated, SIT_M**2 + variance) + ODDS < _unlikelihood(
            standing, walk_m**2 + variance
        )

    def watch(self, target: Target, targets: Sequence[Target], frame: ModelFrame) -> None:
        """Find out whether the seat that a target has, or seems to have left, is empty."""
        if target.seat is not None:
            self._watch_taken(target, target.seat, frame)
        elif target.left_seat is not None:
            self._watch_left(target, target.left_seat, targets, frame)

    def _watch_taken(self, target: Target, seat: Seat, frame: ModelFrame) -> None:
        """A person whose seat is empty has got up, and is looked for near it among what no other model covers."""
        p = self.params.posture
        kept = seat.observe(frame.evidence, self.scene.cover, frame.now_s, p)
        if frame.now_s - seat.empty_since_s >= p.empty_s:
            target.seat = None
            self._life.miss(target.existence, "the seat is empty", kept)
            target.kalman = _standing_at(seat.xy, p.rising_m, SPEED_STD_MPS)
            self._life.log(target.existence, "state", "the seat is empty", kept)

    def _watch_left(self, target: Target, seat: Seat, targets: Sequence[Target], frame: ModelFrame) -> None:
        """A person still visible on the seat has not got up: the standing model went off with another person."""
        p = self.params.posture
        kept = seat.observe(frame.evidence, self.scene.cover, frame.now_s, p)
        away = float(np.hypot(*(target.xy_m - seat.xy))) > 2.0 * p.rising_m or not target.existence.observed
        if frame.now_s - seat.empty_since_s >= p.empty_s or not self.is_free(seat.xy, targets):
            target.left_seat = None
        elif away and kept >= p.empty:
            target.seat, target.left_seat = seat, None
            self._life.observe(target.existence, "sits as before", kept)
            self.predict(target, seat)
            self._life.log(target.existence, "state", "sits as before", kept)

    def is_free(self, xy: F64, targets: Sequence[Target]) -> bool:
        """Whether there is room to sit at a (2,) floor point beside those who sit."""
        seats = [t.seat.xy for t in targets if t.seat is not None]
        return all(np.hypot(*(xy - seat)) >= SEAT_APART_M for seat in seats)

    def _place_to_judge(self, target: Target, foot: F64, frame: ModelFrame) -> F64 | None:
        """Foot pixel at which the other posture is tried; None for a person who is not to be judged now.

        A person who sits down sinks: the standing model follows the head towards the camera and seems to walk. So the
        seated one is then tried where the person stood before that. What others hide of a person is no sign of
        sitting.
        """
        who = target.existence
        if not who.confirmed or (target.seat is None and (not who.observed or target.shared > MAX_SHARED)):
            return None
        walks = target.motion == "moving" and target.seat is None
        place = self._stood_at(target) if walks else foot if target.matches % JUDGE_EVERY == 0 else None
        return None if place is None or (target.seat is None and self._as_long(target, foot, frame)) else place

    def _as_long(self, target: Target, foot: F64, frame: ModelFrame) -> bool:
        """Whether the body is as long as a standing one: a slim one fills the smaller, narrower seated model better."""
        found = self.scene.extent(frame.evidence, foot, target.build.scale)
        return found is not None and found.height > 0.5 * (1.0 + self.params.posture.sitting)

    def _stood_at(self, target: Target) -> F64 | None:
        """Where a person stood who seems to walk but fills the model badly: a walker has left that place by now."""
        first, last = target.trail[0], target.trail[-1]
        alone = target.existence.observed and target.shared <= MAX_SHARED
        known = last.time_s - first.time_s >= 0.5 * self.params.states.window_s
        if not (alone and known) or target.precision >= self.params.spawn.min_precision:
            return None
        foot = self.camera.project(np.array([first.x_m, first.y_m, 0.0]))
        return foot if self.scene.visibility(foot) == 1.0 else None

    def _other(self, target: Target, foot: F64, place: F64, frame: ModelFrame) -> tuple[F64, float]:
        """Best foot pixel of the other posture and its gain over the present one."""
        scene, p = self.scene, self.params
        now, other = target.model_scale, target.build.scale * (1.0 if target.seat is not None else p.posture.sitting)
        # A person who rises keeps the head where it is at first: the foot of the seated model is too high for that.
        rises = target.seat is not None
        places = (foot, scene.below(foot, scene.size(foot, other) - scene.size(foot, now)) if rises else place)
        best = max(scene.best_near(frame.evidence, at, now, target.build.scale)[0] for at in places)
        found = [
            scene.best_near(frame.evidence, at, other, target.build.scale) for at in (places if rises else places[1:])
        ]
        score, at = max(found, key=lambda pair: pair[0])
        # Where nothing shows, the lower model only has less to miss: it must have a matching blob.
        minimum = (2.0 * p.match.min_precision - 1.0) * other / target.build.scale
        return at, score - best if score > minimum else -np.inf

    def _change(self, target: Target, foot: F64, targets: Sequence[Target], frame: ModelFrame) -> bool:
        """Sit down or stand up on the spot, since what seemed to be a velocity was the change of height.

        Not where there is no floor, nor where another person sits.
        """
        xy = self.camera.back_project(foot)
        if not np.isfinite(xy).all() or (target.seat is None and not self.is_free(xy, targets)):
            return False
        if target.seat is None:
            target.left_seat = None
            target.seat = self.seat(xy, foot, target.build.scale * self.params.posture.sitting, frame)
        else:
            target.seat, target.left_seat = None, target.seat
            target.kalman = _standing_at(xy, self.params.posture.place_m, SPEED_STD_MPS)
        return True

    def seat(self, xy: F64, foot: F64, scale: float, frame: ModelFrame) -> Seat:
        """A seat at a (2,) floor point with its (2,) foot pixel, and what shows there now."""
        model = np.zeros_like(self.scene.cover)
        self.scene.paint(model, foot, scale, 1)
        window = self.scene.window(foot, scale)
        return Seat(xy, frame.now_s, scale, window, model[window] > 0, (frame.evidence[window] > 0).astype(np.float32))

    def _widen(self, group: Sequence[Target], position: F64, target: Target, amount: int) -> None:
        """Cover what is beside seated people who share pixels with a target: arms and knees are theirs."""
        for other, foot in zip(group, position, strict=True):
            if other is not target and other.seat is not None and min(other.shared, target.shared) > 0.0:
                aside = np.array(
                    [self.params.match.ring * CLAIMED_RING * self.scene.box_width(foot, other.model_scale), 0.0]
                )
                for place in (foot - aside, foot + aside):
                    self.scene.paint(self.scene.cover, place, other.model_scale, amount)


def _off(place: F64, way: F64) -> float:
    """Distance of a (2,) place from the way from 0 to a (2,) other one."""
    along = float(np.clip(place @ way / max(float(way @ way), 1e-9), 0.0, 1.0))
    return float(np.hypot(*(place - along * way)))


def _unlikelihood(error_m: float, variance_m2: float) -> float:
    """Negative log-likelihood of the distance of two places told by the head, up to a constant."""
    return 0.5 * error_m**2 / variance_m2 + math.log(variance_m2)


def _standing_at(xy_m: F64, std_m: float, speed_std_mps: float) -> FloorKalman:
    return FloorKalman.at(float(xy_m[0]), float(xy_m[1]), std_m, speed_std_mps)
