"""One person in the view of one camera: the automata of Zhang et al. 2008, section 4, and the match of equation 1."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import cv2
import numpy as np

from calib.types import F64, U8
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.joint.person import Person

Motion = Literal["moving", "stopped", "stationary"]
Stability = Literal["appearing", "disappearing", "occlusion", "stable"]
Posture = Literal["standing", "sitting"]
OVERLAP = 0.15
"""R_overlap from which a person is in occlusion."""


class ModelMatch(NamedTuple):
    """How a hull matches the blobs that it touches (equation 1)."""

    recall: float = 0.0
    precision: float = 0.0
    overlap: float = 0.0

    @property
    def score(self) -> float:
        """M = R_recall + R_precision - R_overlap."""
        return self.recall + self.precision - self.overlap


NO_MATCH = ModelMatch()


class Sample(NamedTuple):
    """One frame in a person's recent past: time [s], place [m], and how much of the body is visible."""

    time_s: float
    x_m: float
    y_m: float
    visible: float


@dataclass(eq=False)
class Walker(Person):
    """A person followed by one camera.

    Attributes:
        head_in_view: always True: people seen in part are not searched for (``birth_visible``).
        motion, stability: the two automata.
        posture: as the height implies it.
        match: of the last frame.
        observed: whether enough of the person was visible in the last frame.
        trail: the recent past, oldest first.
    """

    head_in_view: bool = True
    motion: Motion = "moving"
    stability: Stability = "appearing"
    posture: Posture = "standing"
    match: ModelMatch = NO_MATCH
    observed: bool = True
    trail: deque[Sample] = field(default_factory=lambda: deque(maxlen=256))

    def judge(self, now_s: float, moving: float, params: HumanModelParams) -> None:
        """Advance the automata.

        Args:
            moving: share of the body in motion between two frames.
        """
        p, trail = params, self.trail
        trail.append(Sample(now_s, *self.at_m, self.share * self.inside))
        while len(trail) > 2 and trail[1].time_s <= now_s - p.window_s:
            trail.popleft()
        first, last = trail[0], trail[-1]
        way = math.hypot(last.x_m - first.x_m, last.y_m - first.y_m)
        walks = way > p.moving_mps * max(last.time_s - first.time_s, 0.5 * p.window_s)
        self.motion = "moving" if walks else ("stopped" if moving >= p.internal_motion else "stationary")
        change = last.visible - first.visible
        if self.match.overlap >= OVERLAP:
            self.stability = "occlusion"
        elif abs(change) >= p.trend:
            self.stability = "appearing" if change > 0 else "disappearing"
        else:
            self.stability = "stable"
        self.posture = "sitting" if self.height_m < 0.5 * (1.0 + p.sitting) * self.tall_m else "standing"


def matches(hulls: Sequence[F64 | None], surface: U8) -> list[ModelMatch]:
    """Matches of hulls (K, 2) [px] with a (H, W) mask of foreground; None where a hull has no outline."""
    if not hulls:
        return []
    # Statistics of all regions take eight times as long as the regions.
    n, labels = cv2.connectedComponents((surface > 0).view(np.uint8), connectivity=8)
    masks = np.zeros((len(hulls), *surface.shape), np.uint8)
    for mask, hull in zip(masks, hulls, strict=True):
        if hull is not None and np.isfinite(hull).all():
            cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    areas = np.bincount(labels.reshape(-1), minlength=n)
    shared = np.bincount(labels[masks.sum(axis=0, dtype=np.uint8) > 1], minlength=n)
    scores = []
    for mask in masks:
        own = np.bincount(labels[mask > 0], minlength=n)
        inner = own[1:].sum()
        touched = np.flatnonzero(own[1:] > 0.1 * inner) + 1
        blob = max(1, areas[touched].sum())
        parts = own[touched].sum() / blob, inner / max(1, own.sum()), shared[touched].sum() / blob
        scores.append(ModelMatch(*map(float, parts)))
    return scores
