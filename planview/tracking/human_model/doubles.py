"""Two models on one person: how many models a piece of foreground needs (Zhang et al. 2008, section 4, merging)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calib.types import F64, U8, Bool
from planview.tracking.human_model.fitting import foot_pixels
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import SEARCH_SIGMAS, SHIFT, CandidateCounts, ModelScene
from planview.tracking.human_model.target import Target

Touch = Callable[[Target, Target], bool]
BETWEEN = 5
"""Places tried on the way from one model to the other."""
REACH_M = 0.35
"""Distance of arms and stride from the axis of a body [m] (our choice, as for ``match.ring``)."""
LIMBS = 0.7
"""Share of the foreground left to a new model that is within reach of one known person, from which on it is that
person's arms and legs. Our choice: on 72 views 28 crossings missed and 4 false, 26 and 12 with a limit on the length of
limbs; on 28 unseen ones 91.4 % of the crossings in place of 91.0, 191 people of 194 in place of 196."""
_ANGLES = np.arange(16) * np.pi / 8
_IN_REACH_M = (
    REACH_M * np.where(np.arange(16) % 2, 0.5, 1.0)[:, None] * np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
)
"""(16, 2) places on the circle of ``REACH_M``, and half-way to it [m]."""


class Explained(NamedTuple):
    """Matching scores (equation 1) of two models together, of each by itself, and of the best one in place of both, in
    mean areas of the two."""

    two: float
    first: float
    second: float
    one: float


class Doubles:
    """Tells which targets are the doubles of others, by evidence over time.

    People are hidden by others for a moment, two models on one person never come apart. While both walk at one place,
    time counts in full where the second model gains nothing over one in place of both, not at all where it gains as
    much as tells a person (``prune.merge_alone``), and is taken back where it gains more or the two are apart: so it
    takes longer to take two for one who have been apart.

    Args:
        scene: scores models.
        params: of the tracker.
    """

    def __init__(self, scene: ModelScene, params: HumanModelParams) -> None:
        self._scene, self._params = scene, params
        self.reset()

    def reset(self) -> None:
        """Nothing is known of any pair."""
        self._one_s: dict[frozenset[int], float] = {}

    def find(self, targets: Sequence[Target], evidence: U8, dt_s: float, touch: Touch) -> list[tuple[Target, Target]]:
        """Pairs that have been one for ``settle_s``, the one whose model explains more first.

        Args:
            targets: all of them.
            evidence: (H, W) uint8 of the frame.
            dt_s: time since the last frame [s].
            touch: whether the boxes of two targets overlap.
        """
        before, self._one_s = self._one_s, {}
        cover: U8 | None = None
        found: list[tuple[Target, Target]] = []
        for first, second in itertools.combinations(targets, 2):
            pair = frozenset((first.existence.track_id, second.existence.track_id))
            one_s = before.get(pair, 0.0)
            if _observed(first) and _observed(second):
                if first.shared == 0.0 or second.shared == 0.0:
                    one_s -= dt_s
                elif (
                    first.motion == second.motion == "moving" and touch(first, second) and _at_one_place(first, second)
                ):
                    cover = self._cover(targets) if cover is None else cover
                    self._paint(cover, second, -1)
                    explained = self._explained(first, row_of(second), cover, evidence)
                    self._paint(cover, second, 1)
                    gain = (explained.two - explained.one) / self._params.prune.merge_alone
                    one_s += dt_s * min(1.0, max(-1.0, 1.0 - gain))
                    taken = any(t is first or t is second for t in itertools.chain(*found))
                    if one_s >= self._params.settle_s and not taken:
                        found.append((first, second) if explained.first >= explained.second else (second, first))
            self._one_s[pair] = max(one_s, -self._params.existence.patience_s)
        return found

    def needless(self, known: Target, new: F64, targets: Sequence[Target], evidence: U8) -> tuple[bool, bool]:
        """Whether one model would do for a target and a new (3,) model, and whether the new one explains more."""
        explained = self._explained(known, new, self._cover(targets), evidence)
        least = self._params.prune.merge_alone
        return explained.two - explained.one < least, explained.second - explained.first > least

    def is_limb(self, new: F64, targets: Sequence[Target], evidence: U8) -> bool:
        """Whether what a new (3,) model would explain of (H, W) evidence is the arms and legs of an observed person.

        A model is a body upright; arms and stride reach beyond it, farthest where the camera looks down.
        """
        scene, model = self._scene, np.zeros_like(self._scene.cover)
        scene.paint(model, new[:2], new[2], 1)
        window = scene.window(new[:2], new[2])
        own = (model[window] > 0) & (evidence[window] > 0) & (self._cover(targets)[window] == 0)
        least = LIMBS * np.count_nonzero(own)
        observed = (t for t in targets if t.existence.observed)
        return any(np.count_nonzero(own & self._in_reach(t)[window]) > least for t in observed)

    def _in_reach(self, target: Target) -> Bool:
        """(H, W) whether a person's arms and legs may be at a pixel."""
        reach = np.zeros_like(self._scene.cover)
        for foot in foot_pixels(self._scene.model_map.camera, target.xy_m + _IN_REACH_M)[0]:
            self._scene.paint(reach, foot, target.model_scale, 1)
        return reach > 0

    def _explained(self, first: Target, second: F64, cover: U8, evidence: U8) -> Explained:
        """What a target's model and another (3,) model explain of what others leave.

        The one in place of both has the height of either and stands between them, or ``SHIFT`` beside.

        Args:
            first: an observed target.
            second: the other model.
            cover: (H, W) uint8 number of models at each pixel, the first among them and the second not.
            evidence: (H, W) uint8 of the frame.
        """
        scene, one, two = self._scene, row_of(first), second
        reach = 2.0 * max(scene.longest_side(m[:2], m[2]) for m in (one, two))

        def counts(*models: F64) -> CandidateCounts:
            return scene.score_left(evidence, cover, np.vstack(models), reach)

        beside = counts(two)
        self._paint(cover, first, -1)
        apart = counts(one, two, self._between(one, two))
        scene.paint(cover, two[:2], two[2], 1)
        ring = counts(one).ring  # what is in the first model's ring and not the second's
        scene.paint(cover, two[:2], two[2], -1)
        self._paint(cover, first, 1)
        area = max(1.0, 0.5 * float(apart.area[0] + apart.area[1]))
        scores = scene.matching_scores(apart, area)
        first_beside = scores[0] + 0.25 * float(ring[0] - apart.ring[0]) / area
        together = first_beside + scene.matching_scores(beside, area)[0]
        return Explained(float(together), float(scores[0]), float(scores[1]), float(scores[2:].max()))

    def _between(self, first: F64, second: F64) -> F64:
        """(N, 3) models of either height on the way from one model to the other, and ``SHIFT`` beside it."""
        shift = SHIFT * self._scene.longest_side(first[:2], first[2])
        aside, scales = np.array([-shift, 0.0, shift]), np.array([first[2], second[2]])
        along, du, dv, scale = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 1.0, BETWEEN), aside, aside, scales))
        feet = first[:2] + along[:, None] * (second[:2] - first[:2]) + np.column_stack([du, dv])
        return np.column_stack([feet, scale])

    def _cover(self, targets: Sequence[Target]) -> U8:
        """(H, W) number of observed people at each pixel."""
        cover = np.zeros_like(self._scene.cover)
        for target in targets:
            if target.existence.observed:
                self._paint(cover, target, 1)
        return cover

    def _paint(self, cover: U8, target: Target, amount: int) -> None:
        self._scene.paint(cover, target.foot_px, target.model_scale, amount)


def _observed(target: Target) -> bool:
    """Whether a person who does not sit is observed."""
    return target.seat is None and target.existence.observed


def _at_one_place(first: Target, second: Target) -> bool:
    """Whether the places of two targets differ by no more than their errors may: people in file are apart."""
    a, b, off = first.kalman, second.kalman, first.xy_m - second.xy_m
    spread = np.array([[a.c_xx + b.c_xx, a.c_xy + b.c_xy], [a.c_xy + b.c_xy, a.c_yy + b.c_yy]])
    return bool(off @ np.linalg.solve(spread, off) <= SEARCH_SIGMAS**2)


def row_of(target: Target) -> F64:
    """(3,) foot pixel and scale of a target's model."""
    return np.array([*target.foot_px, target.model_scale])
