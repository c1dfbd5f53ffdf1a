"""Where unclaimed foreground looks like a new person (section 4, the four criteria)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, F64, I32, I64, U8
from planview.foreground.blobs import Blobs
from planview.tracking.human_model import _candidate_kernels as kernels
from planview.tracking.human_model._kernels import image_size
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.image_size import inside
from planview.tracking.human_model.model_map import HumanModelMap
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene
from planview.tracking.human_model.unclaimed import Unclaimed

MIN_BLOB = 0.3
"""Smallest blob, as a fraction of the model's box, that may be a person (our choice): slim legs and a torso."""
MIN_COMMON = 0.5
"""Smallest fraction of the model's box that must lie over the blob's (our choice)."""
HEIGHTS = 5
"""Heights tried between the smallest and the tallest person."""
COARSE = 1.5
"""Ratio of the sizes of models that blobs are first compared with (our choice): one half as large again as a person
covers most of the person."""
HEIGHT_PRICE = 0.3
"""Price of a height that differs from the average by all of it, in matching scores (our choice): equal outlines are
taken for a person of average height."""
APART_TAKEN = 0.1
"""Part of a model that others may cover while it still stands apart from them (our choice)."""
APART_VISIBLE = 0.5
"""Part of a model inside the image from which on a person who fills less of it is told (our choice)."""
WHOLE_BLOB = 0.95
"""Part of a blob from which on a candidate has it to itself (our choice)."""


class ModelCandidate(NamedTuple):
    """A model that covers a blob.

    Attributes:
        foot_px: (2,) where it stands.
        scale: height over the average person's.
        score: how well it fits.
        precision: foreground fraction of the model's free part.
        splits: whether the rest of the blob is another target's.
        whole: whether it is a whole person, with few gaps.
    """

    foot_px: F64
    scale: float
    score: float
    precision: float
    splits: bool
    whole: bool = True


class _Partial(NamedTuple):
    """A candidate in part: its (2,) foot pixel, since when and when last it was found [s]."""

    foot_px: F64
    since_s: float
    last_s: float


class _Outlines(NamedTuple):
    """Boxes (N, 4) left, top, width, height of people of one height at all places, and (N,) areas in the image [px]."""

    scale: float
    boxes: F32
    inside: F32


class CandidateFinder:
    """Looks for new people in what the existing targets leave of a frame."""

    def __init__(self, scene: ModelScene, params: HumanModelParams) -> None:
        self._scene, self._params = scene, params
        middle, spawn = 0.5 * np.array(scene.model_map.camera.size, dtype=np.float64), params.spawn
        middle_px = scene.longest_side(middle) if scene.visibility(middle) > 0 else math.inf
        self._min_px = min(spawn.min_height_px, spawn.min_share * middle_px)
        self._part_precision = min(spawn.alone_precision, spawn.min_precision)
        self._outlines = _outlines(scene, params.height_spread)
        self._smallest_px = min(float(outline.inside.min()) for outline in self._outlines)
        self._apart_precision = spawn.min_precision + _steepness(scene.model_map) * (
            self._part_precision - spawn.min_precision
        )
        self.reset()

    def reset(self) -> None:
        """No candidates in part."""
        self._partial: list[_Partial] = []

    def __call__(self, frame: ModelFrame, unclaimed: Unclaimed) -> list[ModelCandidate]:
        """The best model of each unclaimed blob that meets the criteria; at most one per blob and frame.

        ``scene.cover`` and ``scene.claimed`` hold the existing targets.
        """
        scene, evidence, rest = self._scene, unclaimed.evidence, unclaimed.blobs
        large = np.flatnonzero(rest.area_px[1:] >= MIN_BLOB * self._smallest_px) + 1
        if not len(large):
            return []
        scene.prepare_candidates(evidence, scene.cover)
        found = [self._whole_or_part(rest, int(label), frame.blobs) for label in large]
        moving = [c for c in found if c is not None and self._moves(c, evidence, frame.motion)]
        return self._lasting(moving, frame.now_s)

    def _lasting(self, candidates: list[ModelCandidate], now_s: float) -> list[ModelCandidate]:
        """Those that show whole people, and those in part that have been found for half of ``states.window_s``."""
        lasting_s, whole, partial = 0.5 * self._params.states.window_s, [], []
        recent = [p for p in self._partial if now_s - p.last_s < lasting_s]
        for candidate in candidates:
            if candidate.whole:
                whole.append(candidate)
                continue
            reach_px = self._scene.box_width(candidate.foot_px)
            before = [p for p in recent if np.hypot(*(p.foot_px - candidate.foot_px)) <= reach_px]
            since_s = min((p.since_s for p in before), default=now_s)
            partial.append(_Partial(candidate.foot_px, since_s, now_s))
            if now_s - since_s >= lasting_s - 1e-6:
                whole.append(candidate)
        self._partial = partial + recent
        return whole

    def _whole_or_part(self, rest: Blobs, label: int, frame: Blobs) -> ModelCandidate | None:
        """A whole person or, where none fits and no target has a part of the blob, a person in part."""
        coarse, splits = self._coarse(rest, label), _attached(rest, label, frame)
        blob_px = int(rest.area_px[label])
        whole = self._best(coarse, blob_px, splits, False)
        if whole is not None or splits:
            return whole
        part = self._best(coarse, blob_px, splits, True)
        return None if part is None else part._replace(whole=False)

    def _best(self, candidates: F64, blob_px: int, splits: bool, in_part: bool) -> ModelCandidate | None:
        """The best of (N, 3) coarse candidates, then fine over places and heights about it."""
        coarse = self._pick(candidates, blob_px, splits, in_part)
        if coarse is None:
            return None
        step, spread = self._scene.model_map.params.step_px, self._params.height_spread
        near = around(coarse.foot_px, step, np.linspace(1 - spread, 1 + spread, HEIGHTS))
        return self._pick(near, blob_px, splits, in_part)

    def _coarse(self, blobs: Blobs, label: int) -> F64:
        """(N, 3) foot pixels and scales of models that are mostly over a blob's box and of a size to match its area."""
        scene = self._scene
        box, area_px = blobs.box_px[label].astype(np.float64), float(blobs.area_px[label])
        limits = kernels.BoxLimits(MIN_COMMON, MIN_BLOB, self._min_px)
        fits = np.zeros(len(scene.model_map), np.bool_)
        found = []
        for outline in self._outlines:
            kernels.boxes_over(outline.boxes, outline.inside, box, area_px, limits, fits)
            feet = scene.model_map.foot_px[fits].astype(np.float64)
            found.append(np.column_stack([feet, np.full(len(feet), outline.scale)]))
        return np.concatenate(found)

    def _pick(self, candidates: F64, blob_px: int, splits: bool, in_part: bool) -> ModelCandidate | None:
        """The (N, 3) candidate of the highest score among those of plausible shape, visibility and freedom."""
        if not len(candidates):
            return None
        spawn, model_map = self._params.spawn, self._scene.model_map
        counts = self._scene.score(candidates)
        inner, ring = 0.5 * counts.free, 0.5 * counts.ring
        precision = inner / np.maximum(1.0, counts.area - counts.taken)
        local = inner / np.maximum(1.0, inner + ring)
        entry = model_map.entry_at(candidates[:, :2])
        visible = self._visible(candidates, entry, counts.area)
        apart = (counts.taken <= APART_TAKEN * counts.area) & (visible >= APART_VISIBLE) & (not splits)
        minimum = np.where(apart, self._apart_precision[entry], spawn.min_precision)
        ok = (counts.area > 0) & (precision >= (self._part_precision if in_part else minimum))
        ok &= visible >= self._params.prune.gone_visible
        # A person's height does not show while the head or the feet are outside the image.
        ok &= (visible == 1.0) | (candidates[:, 2] == 1.0)
        if not ok.any():
            return None
        # Recall over the whole blob, plus the local one so that an outline inside a group is centred on a person.
        recall = np.minimum(1.0, inner / max(1, blob_px))
        score = precision + 0.5 * (recall + local) - HEIGHT_PRICE * np.abs(candidates[:, 2] - 1.0)
        best = int(np.argmax(np.where(ok, score, -np.inf)))
        foot, scale = candidates[best, :2].copy(), float(candidates[best, 2])
        return ModelCandidate(foot, scale, float(score[best]), float(precision[best]), splits)

    def _visible(self, candidates: F64, entry: I32, shown_px: I64) -> F64:
        """(N,) part of each candidate inside the image; 0 where no person is possible."""
        visible = self._scene.model_map.visibility[entry].astype(np.float64)
        other = (candidates[:, 2] != 1.0) & (not self._scene.sizes.proportional)
        feet, scale = candidates[other, :2], candidates[other, 2]
        visible[other] = self._scene.sizes.visible(entry[other], scale, feet, shown_px[other].astype(np.float64))
        return np.where(entry >= 0, visible, 0.0)

    def _moves(self, candidate: ModelCandidate, evidence: U8, motion: U8) -> bool:
        """Motion salience: enough of the model's foreground proper moves; a ghost of a person who left does not."""
        mask = np.zeros_like(evidence)
        self._scene.paint(mask, candidate.foot_px, candidate.scale, 1)
        window = self._scene.window(candidate.foot_px, candidate.scale)
        salient = (mask[window] > 0) & (evidence[window] > 1)
        moving = int((salient & (motion[window] > 0)).sum())
        return moving >= 0.5 * self._params.states.internal_motion * int(salient.sum())


def _outlines(scene: ModelScene, spread: float) -> list[_Outlines]:
    """Of so many heights that neighbours differ by ``COARSE`` in size: mostly one, more where the camera hangs low."""
    sizes, n = scene.sizes, len(scene.model_map)
    nearest = float(np.median(sizes.nearer))
    low, high = (image_size(nearest, 1.0 + d) for d in (-spread, spread))
    heights = np.linspace(1.0 - spread, 1.0 + spread, max(1, math.ceil(math.log(high / low) / math.log(COARSE))))
    entries, feet = np.arange(n, dtype=np.int32), scene.model_map.foot_px.astype(np.float64)
    found = []
    for scale in heights if len(heights) > 1 else [1.0]:
        boxes = sizes.boxes_at(entries, np.full(n, scale), feet).astype(np.float32)
        found.append(_Outlines(float(scale), boxes, inside(boxes, scene.model_map.camera.size)))
    return found


def _steepness(model_map: HumanModelMap) -> F64:
    """(N,) how steeply the camera looks down at the middle of each entry's body: 0 up to 45 degrees, 1 from 60 on."""
    above_m = model_map.camera.height_m - 0.5 * model_map.model.height_m
    away_m = np.hypot(model_map.floor_m[:, 0], model_map.floor_m[:, 1]).astype(np.float64)
    # 2 (sin^2 - cos^2) of the angle.
    return np.asarray(np.clip(-2.0 * np.cos(2.0 * np.arctan2(above_m, away_m)), 0.0, 1.0), np.float64)


def around(foot_px: F64, step: int, scales: F64) -> F64:
    """(N, 3) candidates within a step of the map about a (2,) foot pixel, at each of (M,) scales."""
    offsets = np.arange(-step, step + 1, max(1, step // 4))
    du, dv, scale = np.meshgrid(offsets, offsets, scales)
    return np.column_stack([foot_px[0] + du.ravel(), foot_px[1] + dv.ravel(), scale.ravel()])


def _attached(rest: Blobs, label: int, whole: Blobs) -> bool:
    """Whether other targets claim a part of the same blob: a new target would split it."""
    left, top, width, height = rest.box_px[label]
    window = np.s_[top : top + height, left : left + width]
    parent = int(whole.labels[window][rest.labels[window] == label][0])
    return int(rest.area_px[label]) < WHOLE_BLOB * int(whole.area_px[parent])
