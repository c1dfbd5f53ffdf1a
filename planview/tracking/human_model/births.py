"""Where unexplained foreground looks like a new person (section 4, the four criteria)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import F64, I64, U8
from planview.blobs import Blobs, find_blobs
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that explains a blob: foot pixel (2,), scale, matching score M and its parts, label of the blob."""

    foot_px: F64
    scale: float
    precision: float
    recall: float
    label: int

    @property
    def score(self) -> float:
        """M of equation 1; no overlap, since nobody else claims these pixels."""
        return self.precision + self.recall


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What is left of a frame when the existing targets have taken theirs.

    Attributes:
        evidence: (H, W) uint8 that no target claims: 2 foreground, 1 less salient, 0 neither.
        motion: (H, W) uint8.
        everything: (H, W) uint8, the evidence of the whole frame.
        blobs: of ``everything``.
    """

    evidence: U8
    motion: U8
    everything: U8
    blobs: Blobs


def find_candidates(scene: ModelScene, params: HumanModelParams, frame: Unexplained) -> list[Candidate]:
    """The best model of each unexplained blob that meets the criteria; at most one per blob and frame.

    ``scene.cover`` must hold the existing targets.
    """
    rest = find_blobs(frame.evidence)
    large = np.flatnonzero(rest.area_px[1:] >= 0.3 * params.min_child**2 * scene.map_seen.min()) + 1
    if not len(large):
        return []
    scene.prepare_candidates(frame.evidence, scene.cover)
    found = [_best(scene, params, _feet(scene, rest, label), rest, label) for label in large]
    kept = [c for c in found if c is not None and _salient(scene, params, c, frame)]
    return kept or _children(scene, params, frame)


def _children(scene: ModelScene, params: HumanModelParams, frame: Unexplained) -> list[Candidate]:
    """Small people: whole blobs, once thin links such as a held hand are cut."""
    width = params.birth.link * float(np.median(scene.map_boxes[:, 2:].max(axis=1)))
    kernel = np.ones((2 * int(width / 2) + 1,) * 2, np.uint8)
    opened = np.asarray(cv2.morphologyEx(frame.everything, cv2.MORPH_OPEN, kernel), dtype=np.uint8)
    whole = find_blobs(opened)
    rest = find_blobs(np.where(frame.evidence > 0, opened, 0).astype(np.uint8))
    found = [_small(scene, params, rest, k) for k in range(1, len(rest)) if _isolated(rest, k, whole)]
    return [c for c in found if c is not None and _salient(scene, params, c, frame)]


def _feet(scene: ModelScene, blobs: Blobs, label: int, scale: float = 1.0) -> F64:
    """Foot pixels of the map whose models are mostly over the blob's box and of a size to match its area."""
    feet = scene.model_map.foot_px
    boxes = scene.map_boxes
    left, top, width, height = blobs.box_px[label]
    corner = feet + scale * (boxes[:, :2] - feet)
    size = scale * boxes[:, 2:]
    u0 = np.maximum(corner[:, 0], left)
    v0 = np.maximum(corner[:, 1], top)
    u1 = np.minimum(corner[:, 0] + size[:, 0], left + width)
    v1 = np.minimum(corner[:, 1] + size[:, 1], top + height)
    common = np.maximum(0, u1 - u0) * np.maximum(0, v1 - v0)
    seen = scale**2 * scene.map_seen
    fits = (common >= 0.5 * seen) & (blobs.area_px[label] >= 0.3 * seen)
    return np.asarray(feet[fits], dtype=np.float64)


def _best(scene: ModelScene, params: HumanModelParams, feet: F64, blobs: Blobs, label: int) -> Candidate | None:
    if not len(feet):
        return None
    candidates = np.column_stack([feet, np.ones(len(feet))])
    best = _pick(params, candidates, scene.score(candidates), blobs, label, scene)
    return best and _refined(scene, params, best, [params.min_height, 0.93, 1.0, 1.07, params.max_height], blobs)


def _refined(
    scene: ModelScene, params: HumanModelParams, best: Candidate, scales: list[float], blobs: Blobs
) -> Candidate | None:
    step = scene.model_map.params.step_px
    offsets = np.arange(-step, step + 1, max(1, step // 4))
    du, dv, scale = np.meshgrid(offsets, offsets, scales)
    near = np.column_stack([best.foot_px[0] + du.ravel(), best.foot_px[1] + dv.ravel(), scale.ravel()])
    return _pick(params, near, scene.score(near), blobs, best.label, scene)


def _isolated(rest: Blobs, label: int, everything: Blobs) -> bool:
    """Whether no target claims a part of the blob, and it does not touch the border of the image."""
    left, top, width, height = rest.box_px[label]
    rows, cols = rest.labels.shape
    if left <= 0 or top <= 0 or left + width >= cols or top + height >= rows:
        return False
    window = np.s_[top : top + height, left : left + width]
    whole = int(everything.labels[window][rest.labels[window] == label][0])
    return float(rest.area_px[label]) >= 0.8 * float(everything.area_px[whole])


def _small(scene: ModelScene, params: HumanModelParams, blobs: Blobs, label: int) -> Candidate | None:
    """A child: a whole blob that a smaller model covers."""
    found: Candidate | None = None
    for scale in np.arange(params.min_child, params.min_height, 0.08):
        feet = _feet(scene, blobs, label, float(scale))
        if len(feet):
            candidates = np.column_stack([feet, np.full(len(feet), scale)])
            best = _pick(params, candidates, scene.score(candidates), blobs, label, scene)
            best = best and _refined(scene, params, best, [float(scale)], blobs)
            if best and best.recall >= params.birth.min_child_recall and (not found or best.score > found.score):
                found = best
    return found


def _pick(
    params: HumanModelParams, candidates: F64, counts: I64, blobs: Blobs, label: int, scene: ModelScene
) -> Candidate | None:
    """The candidate of the highest score among those of plausible shape, visibility and freedom."""
    birth = params.birth
    area, inner, taken, ring = (counts[:, k] * unit for k, unit in enumerate((1.0, 0.5, 1.0, 0.5)))
    precision = inner / np.maximum(1.0, area - taken)
    recall = np.minimum(1.0, inner / max(1.0, float(blobs.area_px[label])))
    local = inner / np.maximum(1.0, inner + ring)
    entry = scene.model_map.entry_at(candidates[:, :2])
    visible = np.where(entry >= 0, scene.model_map.visibility[entry], 0.0)
    ok = (area > 0) & (precision >= birth.min_precision) & (local >= birth.min_recall)
    ok &= (visible >= birth.min_visible) & (taken <= birth.max_shared * area)
    if not ok.any():
        return None
    # Recall over the whole blob, plus the local one so that an outline inside a group is centred on a person.
    score = np.where(ok, precision + 0.5 * (recall + local) - 0.3 * np.abs(candidates[:, 2] - 1), -1.0)
    best = int(np.argmax(score))
    return Candidate(
        candidates[best, :2].copy(), float(candidates[best, 2]), float(precision[best]), float(recall[best]), label
    )


def _salient(scene: ModelScene, params: HumanModelParams, candidate: Candidate, frame: Unexplained) -> bool:
    """Enough of the model must be more than a shadow, and enough of that must move."""
    mask = np.zeros_like(frame.evidence)
    scene.paint(mask, candidate.foot_px, candidate.scale, 1)
    core = (mask > 0) & (frame.evidence == 2)
    n = int(core.sum())
    moving = int((core & (frame.motion > 0)).sum())
    return n >= params.birth.min_core * mask.sum() and moving >= params.birth.min_motion * n
