"""Where unexplained foreground looks like a new person (section 4, the four criteria)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64, U8
from planview.blobs import Blobs
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


def find_candidates(scene: ModelScene, params: HumanModelParams, rest: U8, motion: U8, blobs: Blobs) -> list[Candidate]:
    """The best model of each unexplained blob that meets the criteria.

    Args:
        scene: models of the camera; ``scene.cover`` holds the existing targets.
        params: of the tracker.
        rest: (H, W) uint8 foreground that no target explains.
        motion: (H, W) uint8.
        blobs: of ``rest``.
    """
    found: list[Candidate] = []
    prepared = False
    for label in range(1, len(blobs)):
        feet = _feet(scene, blobs, label)
        if not len(feet):
            continue
        if not prepared:
            scene.prepare_candidates(2 * (rest > 0).view(np.uint8), scene.cover)
            prepared = True
        candidate = _best(scene, params, feet, blobs, label)
        if candidate is not None and _salient(scene, params, candidate, rest, motion):
            found.append(candidate)
    return found


def _feet(scene: ModelScene, blobs: Blobs, label: int) -> F64:
    """Foot pixels of the map whose models are mostly over the blob's box and of a size to match its area."""
    boxes, model_map = scene.map_boxes, scene.model_map
    left, top, width, height = blobs.box_px[label]
    u0 = np.maximum(boxes[:, 0], left)
    v0 = np.maximum(boxes[:, 1], top)
    u1 = np.minimum(boxes[:, 0] + boxes[:, 2], left + width)
    v1 = np.minimum(boxes[:, 1] + boxes[:, 3], top + height)
    common = np.maximum(0, u1 - u0) * np.maximum(0, v1 - v0)
    fits = (common >= 0.5 * scene.map_seen) & (blobs.area_px[label] >= 0.3 * scene.map_seen)
    return np.asarray(model_map.foot_px[fits], dtype=np.float64)


def _best(scene: ModelScene, params: HumanModelParams, feet: F64, blobs: Blobs, label: int) -> Candidate | None:
    candidates = np.column_stack([feet, np.ones(len(feet))])
    best = _pick(params, candidates, scene.score(candidates), blobs, label, scene)
    if best is None:
        return None
    step = scene.model_map.params.step_px
    offsets = np.arange(-step, step + 1, max(1, step // 4))
    du, dv, scale = np.meshgrid(offsets, offsets, [params.min_height, 0.93, 1.0, 1.07, params.max_height])
    near = np.column_stack([best.foot_px[0] + du.ravel(), best.foot_px[1] + dv.ravel(), scale.ravel()])
    return _pick(params, near, scene.score(near), blobs, label, scene)


def _pick(
    params: HumanModelParams, candidates: F64, counts: I64, blobs: Blobs, label: int, scene: ModelScene
) -> Candidate | None:
    """The candidate of the highest score among those of plausible shape, visibility and freedom."""
    birth = params.birth
    area, inner, taken, ring = (counts[:, k] * unit for k, unit in enumerate((1.0, 0.5, 1.0, 0.5)))
    precision = inner / np.maximum(1.0, area - taken)
    recall = inner / max(1.0, float(blobs.area_px[label]))
    local = inner / np.maximum(1.0, inner + ring)
    entry = scene.model_map.entry_at(candidates[:, :2])
    visible = np.where(entry >= 0, scene.model_map.visibility[entry], 0.0)
    ok = (area > 0) & (precision >= birth.min_precision) & (local >= birth.min_recall)
    ok &= (visible >= birth.min_visible) & (taken <= birth.max_shared * area)
    if not ok.any():
        return None
    # Recall over the whole blob, plus the local one so that an outline inside a group is centred on a person.
    score = np.where(ok, precision + 0.5 * (np.minimum(1.0, recall) + local) - 0.3 * np.abs(candidates[:, 2] - 1), -1.0)
    best = int(np.argmax(score))
    return Candidate(
        candidates[best, :2].copy(), float(candidates[best, 2]), float(precision[best]), float(recall[best]), label
    )


def _salient(scene: ModelScene, params: HumanModelParams, candidate: Candidate, rest: U8, motion: U8) -> bool:
    mask = np.zeros_like(rest)
    scene.paint(mask, candidate.foot_px, candidate.scale, 1)
    seen = (mask > 0) & (rest > 0)
    return float(((motion > 0) & seen).sum()) >= params.birth.min_motion * max(1, int(seen.sum()))
