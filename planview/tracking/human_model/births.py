"""Where unexplained foreground looks like a new person (section 4, the four criteria)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64, U8
from planview.foreground.blobs import Blobs, find_blobs
from planview.tracking.human_model.frame import Frame
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model that explains a blob.

    Attributes:
        foot_px: (2,) where it stands.
        scale: height over the average person's.
        precision, recall: parts of its matching score.
        splits: whether the rest of the blob is another target's.
    """

    foot_px: F64
    scale: float
    precision: float
    recall: float
    splits: bool

    @property
    def score(self) -> float:
        """M of equation 1; no overlap, since nobody else claims these pixels."""
        return self.precision + self.recall


def find_candidates(scene: ModelScene, params: HumanModelParams, evidence: U8, frame: Frame) -> list[Candidate]:
    """The best model of each unexplained blob that meets the criteria; at most one per blob and frame.

    Args:
        scene: models of the camera; ``scene.cover`` holds the existing targets.
        params: of the tracker.
        evidence: (H, W) uint8, the frame's without what the targets claim.
        frame: the whole frame.
    """
    rest = find_blobs(evidence)
    large = np.flatnonzero(rest.area_px[1:] >= 0.3 * scene.map_seen.min()) + 1
    if not len(large):
        return []
    scene.prepare_candidates(evidence, scene.cover)
    found = [_best(scene, params, rest, int(label), _attached(rest, int(label), frame.blobs)) for label in large]
    return [c for c in found if c is not None and _salient(scene, params, c, evidence, frame.motion)]


def _feet(scene: ModelScene, blobs: Blobs, label: int, min_height_px: float) -> F64:
    """Foot pixels of the map whose models are mostly over the blob's box and of a size to match its area."""
    boxes = scene.map_boxes
    left, top, width, height = blobs.box_px[label]
    u0 = np.maximum(boxes[:, 0], left)
    v0 = np.maximum(boxes[:, 1], top)
    u1 = np.minimum(boxes[:, 0] + boxes[:, 2], left + width)
    v1 = np.minimum(boxes[:, 1] + boxes[:, 3], top + height)
    common = np.maximum(0, u1 - u0) * np.maximum(0, v1 - v0)
    fits = (common >= 0.5 * scene.map_seen) & (blobs.area_px[label] >= 0.3 * scene.map_seen)
    fits &= boxes[:, 2:].max(axis=1) >= min_height_px
    return np.asarray(scene.model_map.foot_px[fits], dtype=np.float64)


def _attached(rest: Blobs, label: int, whole: Blobs) -> bool:
    """Whether other targets claim a part of the same blob: a new target would split it."""
    left, top, width, height = rest.box_px[label]
    window = np.s_[top : top + height, left : left + width]
    parent = int(whole.labels[window][rest.labels[window] == label][0])
    return int(rest.area_px[label]) < 0.95 * int(whole.area_px[parent])


def _best(scene: ModelScene, params: HumanModelParams, blobs: Blobs, label: int, splits: bool) -> Candidate | None:
    feet = _feet(scene, blobs, label, params.birth.min_height_px)
    if not len(feet):
        return None
    best = _pick(scene, params, np.column_stack([feet, np.ones(len(feet))]), int(blobs.area_px[label]), splits)
    if best is None:
        return None
    step = scene.model_map.params.step_px
    offsets = np.arange(-step, step + 1, max(1, step // 4))
    du, dv, scale = np.meshgrid(offsets, offsets, np.linspace(params.min_height, params.max_height, 5))
    near = np.column_stack([best.foot_px[0] + du.ravel(), best.foot_px[1] + dv.ravel(), scale.ravel()])
    return _pick(scene, params, near, int(blobs.area_px[label]), splits)


def _pick(scene: ModelScene, params: HumanModelParams, candidates: F64, blob_px: int, splits: bool) -> Candidate | None:
    """The (N, 3) candidate of the highest score among those of plausible shape, visibility and freedom."""
    birth = params.birth
    counts = scene.score(candidates)
    least = birth.split_precision if splits else birth.min_precision
    area, inner, taken, ring = (counts[:, k] * unit for k, unit in enumerate((1.0, 0.5, 1.0, 0.5)))
    precision = inner / np.maximum(1.0, area - taken)
    recall = np.minimum(1.0, inner / max(1, blob_px))
    local = inner / np.maximum(1.0, inner + ring)
    entry = scene.model_map.entry_at(candidates[:, :2])
    visible = np.where(entry >= 0, scene.model_map.visibility[entry], 0.0)
    ok = (area > 0) & (precision >= least) & (local >= birth.min_recall)
    ok &= (visible >= birth.min_visible) & (taken <= birth.max_shared * area)
    # Nobody's height shows while the head or the feet are outside the image.
    ok &= (visible == 1.0) | (candidates[:, 2] == 1.0)
    if not ok.any():
        return None
    # Recall over the whole blob, plus the local one so that an outline inside a group is centred on a person.
    score = np.where(ok, precision + 0.5 * (recall + local) - 0.3 * np.abs(candidates[:, 2] - 1), -1.0)
    best = int(np.argmax(score))
    return Candidate(
        candidates[best, :2].copy(), float(candidates[best, 2]), float(precision[best]), float(recall[best]), splits
    )


def _salient(scene: ModelScene, params: HumanModelParams, candidate: Candidate, evidence: U8, motion: U8) -> bool:
    """Enough of the model must be more than a shadow, and enough of that must move."""
    mask = np.zeros_like(evidence)
    scene.paint(mask, candidate.foot_px, candidate.scale, 1)
    core = (mask > 0) & (evidence > 1)
    n = int(core.sum())
    moving = int((core & (motion > 0)).sum())
    return bool(n >= params.birth.min_core * mask.sum() and moving >= params.birth.min_motion * n)
