"""Models of people who sit, laid on foreground of which a table or the back of a chair hides the lower part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.types import F64, U8, Bool
from planview.foreground.blobs import Blobs, find_blobs
from planview.tracking.human_model.candidates import HEIGHT_PRICE, HEIGHTS, around
from planview.tracking.human_model.params import HumanModelParams
from planview.tracking.human_model.scene import ModelScene

MIN_SHOWN = 0.2
"""Smallest part of a seated model that shows (our choice): a head and shoulders above the back of a chair."""
MIN_RECALL = 0.5
"""Smallest part of a region that its sitter covers (our choice)."""
TOP = 0.15
"""How far the head of a sitter may be from the top of the region, as a fraction of the model (our choice)."""
REACH = 0.15
"""How far below or above its feet a standing model may be a sitter's, as a fraction of the model (our choice)."""
MAX_OPEN = 0.5
"""Part of what does not show of a sitter above which it lies in the open, where nothing hides it (our choice)."""


class Sitter(NamedTuple):
    """A seated model on the foreground.

    Attributes:
        foot_px: (2,) where a standing person would have the feet.
        scale: height over the average standing person's.
        score: how well it fits.
        precision: foreground fraction of what is not hidden.
    """

    foot_px: F64
    scale: float
    score: float
    precision: float


class Seated(NamedTuple):
    """One or two sitters in place of one standing model: their gain over it, in areas of the standing model."""

    gain: float
    front: Sitter
    back: Sitter | None


class _Scores(NamedTuple):
    """(N,) of models whose background below the waist costs nothing: score, foreground within and beside them and area
    [px], precision."""

    score: F64
    inner: F64
    beside: F64
    area: F64
    precision: F64


class SitterFinder:
    """Lays seated models on regions of foreground."""

    def __init__(self, scene: ModelScene, params: HumanModelParams) -> None:
        self._scene, self._params = scene, params
        model_map, boxes = scene.model_map, scene.map_boxes
        self._sitting = params.posture.sitting
        everywhere = np.arange(len(model_map), dtype=np.int32)
        size = scene.sizes.of(everywhere, np.full(len(model_map), self._sitting))
        self._head_px = model_map.foot_px + size[:, None] * (model_map.head_px - model_map.foot_px)
        self._long_px = size * boxes[:, 2:].max(axis=1)
        self._whole = model_map.visibility == 1.0

    def on_region(self, evidence: U8, cover: U8, regions: Blobs, label: int) -> Sitter | None:
        """The sitter whose head is at the top of a region, unless what does not show lies in the open.

        Args:
            evidence: (H, W) uint8, 2 where something has stayed.
            cover: (H, W) uint8, not 0 where other people are.
            regions: of the evidence.
            label: of the region.
        """
        self._scene.prepare_candidates(evidence, cover)
        # Of a person who must be somewhere, a part is enough.
        sitter = self._at_top(regions, label, self._params.spawn.alone_precision, MIN_RECALL)
        if sitter is None:
            return None
        hidden: Bool = (self._mask(sitter.foot_px, sitter.scale) > 0) & (evidence == 0) & (cover == 0)
        return None if self._scene.share_in_the_open(hidden, sitter.foot_px) > MAX_OPEN else sitter

    def instead(self, foot_px: F64, scale: float, evidence: U8, cover: U8) -> Seated | None:
        """The one or two sitters that account best for what a standing model at a (2,) foot pixel covers.

        Args:
            foot_px, scale: of the standing model.
            evidence: (H, W) uint8 of the frame.
            cover: (H, W) uint8, not 0 where other people are.
        """
        mask = self._mask(foot_px, scale)
        self._scene.prepare_candidates(evidence, cover)
        standing = self._scores(np.array([[*foot_px, scale]]))
        found: list[tuple[float, Sitter, Sitter | None]] = []
        one = self._behind(mask, evidence, cover)
        if one is not None:
            found.append((one.score, one, None))
        front = self._before(foot_px, scale, evidence, cover)
        if front is not None:
            back = self._behind(mask, evidence, cover + self._mask(front.foot_px, front.scale))
            if back is not None:
                found.append((front.score + back.score, front, back))
        if not found:
            return None
        score, front, behind = max(found, key=lambda row: row[0])
        return Seated((score - float(standing.score[0])) / max(1.0, float(standing.area[0])), front, behind)

    def _before(self, foot_px: F64, scale: float, evidence: U8, cover: U8) -> Sitter | None:
        """A sitter with about the feet of a standing model."""
        self._scene.prepare_candidates(evidence, cover)
        reach = REACH * self._scene.longest_side(foot_px, scale)
        offsets = np.linspace(-reach, reach, 13)
        du, dv = np.meshgrid(offsets / 2, offsets)
        scales = np.full(du.size, self._sitting * scale)
        near = np.column_stack([foot_px[0] + du.ravel(), foot_px[1] + dv.ravel(), scales])
        found = self._scores(near)
        return _best(near, found, found.score, self._params.spawn.min_precision)

    def _behind(self, mask: U8, evidence: U8, cover: U8) -> Sitter | None:
        """A sitter with the head at the top of the largest region in the mask of a standing model."""
        self._scene.prepare_candidates(evidence, cover)
        regions = find_blobs(((mask > 0) & (cover == 0) & (evidence > 0)).astype(np.uint8))
        if len(regions) < 2:
            return None
        label = int(np.argmax(regions.area_px[1:])) + 1
        sitter = self._at_top(regions, label, self._params.spawn.min_precision, 0.0)
        if sitter is None:
            return None
        return sitter._replace(score=float(self._scores(np.array([[*sitter.foot_px, sitter.scale]])).score[0]))

    def _at_top(self, regions: Blobs, label: int, min_precision: float, min_recall: float) -> Sitter | None:
        """Coarse over the map, then fine over places and heights."""
        model_map, sitting = self._scene.model_map, self._sitting
        left, top, width, _ = (float(v) for v in regions.box_px[label])
        head = self._head_px
        ok = self._whole & (head[:, 0] >= left) & (head[:, 0] <= left + width)
        ok &= np.abs(head[:, 1] - top) <= TOP * self._long_px
        ok &= self._long_px >= sitting * self._params.spawn.min_height_px
        feet, region_px = model_map.foot_px[ok].astype(np.float64), int(regions.area_px[label])
        coarse = self._pick(np.column_stack([feet, np.full(len(feet), sitting)]), region_px, min_precision, min_recall)
        if coarse is None:
            return None
        step, spread = model_map.params.step_px, self._params.height_spread
        near = around(coarse.foot_px, step, sitting * np.linspace(1 - spread, 1 + spread, HEIGHTS))
        return self._pick(near, region_px, min_precision, min_recall)

    def _pick(self, candidates: F64, region_px: int, min_precision: float, min_recall: float) -> Sitter | None:
        """The (N, 3) candidate that covers most of a region, and hardly anything else."""
        if not len(candidates):
            return None
        found = self._scores(candidates)
        recall = np.minimum(1.0, found.inner / max(1, region_px))
        local = found.inner / np.maximum(1.0, found.inner + found.beside)
        score = found.precision + 0.5 * (recall + local)
        score -= HEIGHT_PRICE * np.abs(candidates[:, 2] / self._sitting - 1.0)
        return _best(candidates, found, np.where(recall >= min_recall, score, -np.inf), min_precision)

    def _scores(self, candidates: F64) -> _Scores:
        """Of (N, 3) candidates, after ``prepare_candidates``: equation 1 with legs that may be hidden."""
        counts, weight = self._scene.score(candidates), self._params.match.overlap_weight
        area, legs = counts.area.astype(np.float64), 0.5 * counts.legs
        inner, beside = np.asarray(0.5 * counts.free, np.float64), np.asarray(0.5 * counts.ring, np.float64)
        background = area - counts.taken - counts.hidden - inner - legs
        score = np.asarray(inner + 0.5 * beside - background - weight * counts.taken, np.float64)
        precision = np.asarray(inner / np.maximum(1.0, area - counts.taken - legs), np.float64)
        return _Scores(score, inner, beside, area, precision)

    def _mask(self, foot_px: F64, scale: float) -> U8:
        mask = np.zeros_like(self._scene.cover)
        self._scene.paint(mask, foot_px, scale, 1)
        return mask


def _best(candidates: F64, found: _Scores, score: F64, min_precision: float) -> Sitter | None:
    """The candidate of the highest (N,) score among those that show enough."""
    ok = (found.area > 0) & (found.precision >= min_precision) & (found.inner >= MIN_SHOWN * found.area)
    best = int(np.argmax(np.where(ok, score, -np.inf)))
    if not (ok[best] and np.isfinite(score[best])):
        return None
    u, v, scale = candidates[best]
    return Sitter(np.array([u, v]), float(scale), float(score[best]), float(found.precision[best]))
