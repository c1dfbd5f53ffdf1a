"""Foreground that no target claims: which of it stays, and which of it moves within itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.types import F32, U8, Bool
from planview.foreground.blobs import Blobs, find_blobs
from planview.foreground.masks import PERSON, WALKER
from planview.tracking.human_model import _unclaimed_kernels as kernels
from planview.tracking.human_model.frame import SALIENT, ModelFrame
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.target import Target

LIVELY = 0.01
"""Share of a region's pixels that have moved lately in one that may be a person (our choice): a head that turns in a
small image is two or three pixels."""


class Unclaimed:
    """Watches what is left of each frame when all targets are matched.

    What stays and moves within itself may be a person whom no target follows; what stays without any motion is a
    thing, or the place that a person or a thing has left.

    Attributes:
        evidence: (H, W) uint8 of this frame, 0 where a target claims it.
        blobs: of the evidence.
        lively: (n,) bool, which of the blobs have foreground proper that has moved lately.
    """

    def __init__(self, scene: ModelScene, params: HumanModelParams) -> None:
        self._scene, self._params = scene, params
        self.reset()

    def reset(self) -> None:
        """Nothing has stayed."""
        shape = self._scene.cover.shape
        # Time since the reset, which single precision holds.
        self._clock_s = 0.0
        self._stay_s: F32 = np.zeros(shape, np.float32)
        self._moved_s: F32 = np.full(shape, -math.inf, np.float32)
        self.evidence: U8 = np.zeros(shape, np.uint8)
        self.blobs: Blobs = find_blobs(self.evidence)
        self.lively: Bool = np.zeros(len(self.blobs), np.bool_)

    def update(self, frame: ModelFrame, dt_s: float) -> None:
        """Take in what the targets in ``scene.claimed`` leave of a frame."""
        p = self._params
        self.evidence = frame.evidence * (self._scene.claimed == 0)
        self.blobs = find_blobs(self.evidence)
        self._clock_s += dt_s
        n = len(self.blobs)
        area, moved = np.zeros((2, n), np.int64)
        limits = kernels.Limits(p.prune.vanished_s, 2.0 * p.settle_s, p.prune.still_s)
        kernels.watch_unclaimed(
            self.evidence, frame.motion, self.blobs.labels, dt_s, self._clock_s, limits, self._stay_s, self._moved_s,
            area, moved,
        )  # fmt: skip
        self.lively = moved >= LIVELY * np.maximum(area, 1)
        self.lively[0] = False

    def known(self, still_s: F32, evidence: U8, people: bool, walkers: Sequence[Target]) -> U8:
        """(H, W) uint8 labels for ``Foreground``: see ``HumanModelTracker.feedback``.

        Args:
            still_s: (H, W) for how long pixels have been still and unclaimed.
            evidence: (H, W) uint8 of the last frame.
            people: whether any have been confirmed.
            walkers: those of them who are seen and have walked: none is a ghost of the background.
        """
        known = np.empty_like(evidence)
        limit_s, blobs, claimed = self._params.prune.still_s, self.blobs, self._scene.claimed
        kernels.mark_known(still_s, limit_s, blobs.labels, self.lively, claimed, evidence, people, known)
        models = np.zeros_like(known)
        for target in walkers:
            self._scene.paint(models, target.foot_px, target.model_scale, 1)
            part = self._scene.window(target.foot_px, target.model_scale)
            known[part][(models[part] > 0) & (known[part] == PERSON)] = WALKER
        return known

    def moves_on(self, region: Bool) -> bool:
        """Whether a (H, W) region has moved since it has stayed for ``settle_s``: what a person left has not."""
        late_s = self._clock_s - self._stay_s[region] + self._params.settle_s
        return bool((self._moved_s[region] >= late_s).mean() >= LIVELY)

    def resting(self) -> tuple[U8, Blobs]:
        """(H, W) uint8 evidence of what has stayed for ``settle_s``, and its regions."""
        stays = ((self._stay_s >= self._params.settle_s) & (self.evidence > 0)).astype(np.uint8) * SALIENT
        return stays, find_blobs(stays)
