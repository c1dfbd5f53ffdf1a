"""Sitting down without being observed: people found again on seats, and standing models that are sitters in truth.

Where nobody has sat yet, a part of a person who stands behind a sign is not taken for a sitter.
"""

from __future__ import annotations

import math

import numpy as np

from calib.types import U8
from planview.tracking.human_model.fitting import Fitter
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.missing import Missing
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.sitters import Seated, Sitter, SitterFinder
from planview.tracking.human_model.target import Build, Target
from planview.tracking.human_model.unclaimed import Unclaimed
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import LifeCycle

MIN_GAIN = 0.15
"""Gain of sitters over a standing model, in its areas, that seats people (our choice): a head and shoulders more."""

MIN_REGION = 0.09
"""Smallest region that may be a sitter, as a fraction of the smallest model's box (our choice): a head."""
REVIEW_EVERY = 8
"""Frames between two reviews of a standing model (our choice, for speed): ``settle_s`` at 10 Hz holds two of them."""


class Seating:
    """Seats people who were lost, or whose standing model accounts for less than sitters would.

    Attributes:
        seats: somebody has sat in this view.
    """

    def __init__(
        self, params: HumanModelParams, scene: ModelScene, life: LifeCycle, fitter: Fitter, missing: Missing
    ) -> None:
        self.params, self._scene, self._life, self._fitter, self._missing = params, scene, life, fitter, missing
        self._sitters = SitterFinder(scene, params)
        self.reset()

    def reset(self) -> None:
        """Nobody has sat."""
        self.seats = False

    def review(self, targets: list[Target], unclaimed: Unclaimed, frame: ModelFrame) -> None:
        """Seat people; ``targets`` gets those who are found again."""
        for target in list(targets):
            self._review_standing(target, targets, frame)
        self.seats |= any(t.seat is not None and frame.now_s - t.seat.since_s >= self.params.settle_s for t in targets)
        if self.seats and self._lost(targets):
            self._find_again(targets, unclaimed, frame)

    def _find_again(self, targets: list[Target], unclaimed: Unclaimed, frame: ModelFrame) -> None:
        """Lost people are what stays and moves near to where they were lost."""
        evidence, regions = unclaimed.resting()
        smallest, cover = MIN_REGION * self._scene.map_inside.min(), self._cover(targets)
        for label in np.flatnonzero(regions.area_px[1:] >= smallest) + 1:
            if not unclaimed.moves_on(regions.labels == label):
                continue
            sitter = self._sitters.on_region(evidence, cover, regions, int(label))
            target = None if sitter is None else self._nearest_lost(sitter, targets)
            if sitter is not None and target is not None and self._is_free(sitter, targets):
                self._seat(target, sitter, targets, frame, "sits where this person was lost")

    def _nearest_lost(self, sitter: Sitter, targets: list[Target]) -> Target | None:
        """The nearest person who was lost within reach of a seat."""
        xy = self._fitter.camera.back_project(sitter.foot_px)
        reach_m = self.params.prune.vanished_m
        lost = self._lost(targets)
        near = [(float(np.hypot(*(t.xy_m - xy))), i) for i, t in enumerate(lost)]
        distance, i = min(near, default=(math.inf, -1))
        return lost[i] if distance <= reach_m else None

    def _lost(self, targets: list[Target]) -> list[Target]:
        """People who were lost inside the view not too long ago to be found sitting."""
        recent_s = self.params.prune.vanished_s
        missing = [t for t in self._missing if self._life.unobserved_s(t.existence) <= recent_s]
        return [t for t in targets if t.existence.lost and t.inside == 1.0] + missing

    def _review_standing(self, target: Target, targets: list[Target], frame: ModelFrame) -> None:
        """A standing model that sitters have outdone for ``settle_s`` is those sitters."""
        who = target.existence
        stands = (
            target.seat is None and who.confirmed and who.observed and target.motion != "moving" and not target.hidden
        )
        if not stands:
            target.outdone_since_s = math.nan
        elif target.matches % REVIEW_EVERY == 0:
            others = self._cover([t for t in targets if t is not target])
            seated = self._sitters.instead(target.foot_px, target.model_scale, frame.evidence, others)
            if seated is None or seated.gain <= self.params.posture.advantage:
                target.outdone_since_s = math.nan
            elif math.isnan(target.outdone_since_s):
                target.outdone_since_s = frame.now_s
            elif frame.now_s - target.outdone_since_s >= self.params.settle_s and seated.gain > MIN_GAIN:
                self._seat_standing(target, seated, targets, frame)

    def _seat_standing(self, target: Target, seated: Seated, targets: list[Target], frame: ModelFrame) -> None:
        if not self._is_free(seated.front, [t for t in targets if t is not target]):
            return
        self._life.log(target.existence, "state", "sits", seated.gain)
        self._seat(target, seated.front, targets, frame)
        if seated.back is not None and self._is_free(seated.back, targets):
            other = self._nearest_lost(seated.back, targets) or self._newcomer(seated.back)
            self._seat(other, seated.back, targets, frame, "sits behind another")
            self._life.confirm(other.existence, "sits behind another", seated.gain)

    def _newcomer(self, sitter: Sitter) -> Target:
        """A target for a person whom another's standing model has hidden."""
        existence = self._life.spawn("sits behind another", sitter.score, "split")
        kalman = self._standing_on(sitter)
        return Target(existence, kalman, Build(1.0, np.array([kalman.x_m, kalman.y_m])), sitter.foot_px)

    def _seat(self, target: Target, sitter: Sitter, targets: list[Target], frame: ModelFrame, reason: str = "") -> None:
        """Seat a person, and give a reason if the person was not observed before."""
        self._missing.remove(target)
        if target not in targets:
            targets.append(target)
        kalman = self._standing_on(sitter)
        target.restart(kalman, sitter.foot_px, sitter.scale / self.params.posture.sitting)
        target.seat = self._fitter.posture.seat(target.xy_m, sitter.foot_px, sitter.scale, frame)
        target.outdone_since_s = math.nan
        target.support_s = max(target.support_s, self.params.settle_s)
        target.remember(frame.now_s, 1.0, sitter.precision, self.params.states.window_s)
        if reason:
            self._life.observe(target.existence, reason, sitter.score)

    def _is_free(self, sitter: Sitter, others: list[Target]) -> bool:
        """Whether there is floor at a seat, and no other person on it."""
        xy = self._fitter.camera.back_project(sitter.foot_px)
        return bool(np.isfinite(xy).all()) and self._fitter.posture.is_free(xy, others)

    def _standing_on(self, sitter: Sitter) -> FloorKalman:
        x_m, y_m = (float(v) for v in self._fitter.camera.back_project(sitter.foot_px))
        return FloorKalman.at(x_m, y_m, self.params.posture.place_m, speed_std_mps=0.0)

    def _cover(self, targets: list[Target]) -> U8:
        """(H, W) number of observed people at each pixel."""
        cover = np.zeros_like(self._scene.cover)
        for target in targets:
            if target.existence.observed:
                self._scene.paint(cover, target.foot_px, target.model_scale, 1)
        return cover
