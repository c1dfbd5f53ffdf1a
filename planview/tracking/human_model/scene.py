"""The model map and workspaces that the kernels need, and one method per kernel."""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from calib.types import F32, F64, I64, U8, Bool
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model import _match_kernels as matching
from planview.tracking.human_model import _measure_kernels as measuring
from planview.tracking.human_model.body_extent import BodyExtents
from planview.tracking.human_model.frame import ModelFrame
from planview.tracking.human_model.hiding import Hiding
from planview.tracking.human_model.image_size import ImageSizes, inside, upright
from planview.tracking.human_model.measurement import Extent, Measurement
from planview.tracking.human_model.model_map import HumanModelMap
from planview.tracking.human_model.params import HumanMatchParams

SWEEPS = 2
"""Rounds of the joint maximisation over all targets: the second settles who owns shared pixels (our choice)."""
SEARCH_SIGMAS = 2.5
"""Search radius in standard deviations of the prediction: 1 % of the true positions lie outside (our choice)."""
CLAIMED_RING = 0.5
"""Inner part of the ring whose foreground starts no new target: in all of it, two people side by side would never be
told apart (our choice)."""
SHIFT = 0.05
"""How far the foot may move when the posture changes, as a fraction of the height (our choice): further, and a person
whose legs are hidden would seem to sit, higher up."""
CORE = 0.8
"""Part of a model, about its middle, that a person fills (our choice)."""
COLOUR_PARTS = 2
"""Parts of the body (upper, lower) with a colour histogram each."""
COLOUR_LEVELS = 6
"""Levels per colour channel, evenly spaced in its square root: clothes are dark more often than bright."""
_LEVEL = np.minimum(COLOUR_LEVELS - 1, np.sqrt(np.arange(256) / 256) * COLOUR_LEVELS).astype(np.uint8)


class CandidateCounts(NamedTuple):
    """``_kernels.MatchCounts`` of many models; (N,) columns."""

    area: I64
    free: I64
    taken: I64
    ring: I64
    hidden: I64
    legs: I64


class ModelScene:
    """Rasterises, scores and places models in the images of one camera."""

    def __init__(self, model_map: HumanModelMap, params: HumanMatchParams) -> None:
        self.model_map = model_map
        self.params = params
        width, height = model_map.camera.size
        self.cover = np.zeros((height, width), np.uint8)
        self.claimed = np.zeros((height, width), np.uint8)
        self._hiding = Hiding((height, width))
        self.hiding = self._hiding.mask
        self._nowhere = np.zeros((height, width), np.uint8)
        self._sums = np.zeros((height, width + 1), np.int64)
        self._spans = kernels.Spans.of(height)
        self.sizes = ImageSizes(model_map)
        self._people = kernels.MapArrays(
            np.ascontiguousarray(model_map.index),
            *model_map.origin_px,
            model_map.params.step_px,
            np.ascontiguousarray(model_map.foot_px),
            np.ascontiguousarray(model_map.hull_px),
            upright(model_map),
            self.sizes.nearer,
        )
        self.map_boxes = self.sizes.boxes
        self.map_inside = inside(self.map_boxes, model_map.camera.size)
        self._extents = BodyExtents(model_map, self.sizes, self.cover)

    def match(self, foreground: U8, predicted: F64, scale: F64, covariance: F64, order: I64) -> F64:
        """Joint best foot pixels (N, 2) of these targets; models placed since ``clear`` keep their pixels.

        Args:
            foreground: (H, W) uint8, 2 where salient, 1 where less salient, 0 elsewhere.
            predicted: (N, 2) predicted foot pixels.
            scale: (N,) heights over the average.
            covariance: (N, 2, 2) of the predictions [px^2].
            order: (N,) which target claims pixels first.
        """
        p = self.params
        self._extents.forget()
        inverse = np.linalg.inv(covariance)
        information = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], axis=1)
        sigma = np.sqrt(np.stack([covariance[:, 0, 0], covariance[:, 1, 1]], axis=1))
        radius = np.clip(SEARCH_SIGMAS * sigma, 1.0, 0.25 * max(foreground.shape))
        position = np.empty_like(predicted)
        targets = matching.Predictions(predicted, scale, information, radius, order)
        weights = matching.Weights(p.ring, p.overlap_weight, p.prior_weight)
        matching.match_models(
            foreground, self.cover, self.hiding, self._sums, self._spans, self._people, targets, position, SWEEPS,
            weights,
        )  # fmt: skip
        return position

    def measure(self, frame: ModelFrame, position: F64, scale: F64) -> Measurement:
        """What the models at (N, 2) foot pixels cover; also marks ``claimed``, which ``clear`` resets."""
        n, ring = len(scale), self.params.ring
        area, evidence, alone, shared, hidden, moving, blob, breadth_n = np.zeros((8, n), np.int64)
        counts = measuring.Coverage(area, evidence, alone, shared, hidden, moving, blob, np.zeros(n), breadth_n)
        images = measuring.Images(frame.evidence, frame.motion, self.cover, frame.blobs.labels, self.hiding)
        votes = np.empty(len(frame.blobs), np.int64)
        measuring.measure_models(
            images, self._spans, self._people, position, scale, ring, CLAIMED_RING * ring, self.claimed, votes, counts
        )
        return Measurement(position, counts)

    def clear(self) -> None:
        """No models placed."""
        self._extents.forget()
        self.cover[:] = 0
        self.claimed[:] = 0

    def reset(self) -> None:
        """No models placed, nothing learned."""
        self.clear()
        self._hiding.reset()

    def prepare_candidates(self, evidence: U8, taken: U8) -> None:
        """Count unclaimed evidence once, before ``score``; a new person is expected to show wherever it is."""
        height, width = evidence.shape
        kernels.row_prefix(evidence, taken, self._nowhere, kernels.Window(0, width, 0, height), self._sums)

    def score(self, candidates: F64) -> CandidateCounts:
        """Counts of models at (N, 3) foot pixels and scales, after ``prepare_candidates``."""
        counts = CandidateCounts(*np.zeros((6, len(candidates)), np.int64))
        kernels.score_candidates(self._sums, self._spans, self._people, candidates, self.params.ring, *counts)
        return counts

    def best_near(self, evidence: U8, position: F64, scale: float, reference: float) -> tuple[float, F64]:
        """Best score near a foot pixel (SHIFT along the rows, half of that across).

        Scores are in areas of the model at scale ``reference``; what ``cover`` holds belongs to other people.

        Returns:
            the score and its (2,) foot pixel.
        """
        reach = SHIFT * self.longest_side(position, reference)
        offsets = np.linspace(-reach, reach, 7)
        du, dv = np.meshgrid(offsets / 2, offsets)
        near = np.column_stack([position[0] + du.ravel(), position[1] + dv.ravel(), np.full(du.size, scale)])
        counts = self.score_left(evidence, self.cover, near, 2.0 * self.longest_side(position, max(scale, reference)))
        area = max(1, int(self.score(np.array([[*position, reference]])).area[0]))
        gains = self.matching_scores(counts, area)
        best = int(np.argmax(gains))
        return float(gains[best]), near[best, :2]

    def score_left(self, evidence: U8, cover: U8, models: F64, reach_px: float) -> CandidateCounts:
        """Counts of (N, 3) models that reach so far below or above their feet, on what a cover leaves of evidence."""
        height, width = evidence.shape
        top, bottom = int(models[:, 1].min() - reach_px), int(models[:, 1].max() + reach_px) + 1
        window = kernels.Window(0, width, max(0, top), min(height, bottom))
        kernels.row_prefix(evidence, cover, self.hiding, window, self._sums)
        return self.score(models)

    def matching_scores(self, counts: CandidateCounts, area_px: float) -> F64:
        """(N,) matching scores of equation 1 in units of an area [px^2]."""
        columns = cast("kernels.MatchCounts", counts)
        return np.asarray(kernels.matching_score.py_func(columns, area_px, self.params.overlap_weight), np.float64)

    def window(self, position: F64, scale: float) -> tuple[slice, slice]:
        """Rows and columns of the model's box inside the image; empty where no person is possible."""
        hull = self.hull(position, scale)
        if hull is None:
            return slice(0), slice(0)
        height, width = self.cover.shape
        (left, top), (right, bottom) = np.floor(hull.min(axis=0)), np.ceil(hull.max(axis=0)) + 1
        rows, columns = np.clip([top, bottom], 0, height).astype(int), np.clip([left, right], 0, width).astype(int)
        return slice(*rows), slice(*columns)

    def learn_hiding(self, evidence: U8, position: F64, scale: float, dt_s: float) -> None:
        """Note where the core of a person's model shows foreground and where it does not, after ``match``."""
        rows = self._fill_part(position, scale, 0.5 * (1.0 - CORE), CORE)
        self._hiding.learn(evidence, self.cover, self._spans, rows, self._away_m(position), dt_s)

    def share_in_the_open(self, pixels: Bool, position: F64) -> float:
        """Share of (H, W) pixels where people at least as far away as a (2,) foot pixel have been observed."""
        return self._hiding.share_in_the_open(pixels, self._away_m(position))

    def _away_m(self, position: F64) -> float:
        return float(np.hypot(*self.model_map.camera.back_project(position)))

    def watch_still(self, frame: ModelFrame, dt_s: float, still_s: F32) -> None:
        """Update (H, W) times [s] for which unclaimed foreground has been without motion.

        What hangs together with a person may be the person's: arms on a table, a back wider than the model.
        """
        images = measuring.Images(frame.evidence, frame.motion, self.cover, frame.blobs.labels, self.hiding)
        measuring.watch_still(images, self.claimed, np.zeros(len(frame.blobs), np.bool_), dt_s, still_s)

    def visibility(self, position: F64, scale: float = 1.0) -> float:
        """Fraction of the model at a (2,) foot pixel that is inside the image."""
        entry = self._entry(position)
        if entry < 0 or scale == 1.0 or self.sizes.proportional:
            return float(self.model_map.visibility[entry]) if entry >= 0 else 0.0
        top, bottom = self._fill(position, scale)
        shown = np.maximum(0, self._spans.right[top:bottom] - self._spans.left[top:bottom]).sum(keepdims=True)
        return float(self.sizes.visible(np.array([entry]), np.array([scale]), position[None], shown)[0])

    def size(self, position: F64, scale: float) -> float:
        """Size in the image of a person at a (2,) foot pixel, over the average person's there."""
        return self.sizes.at(self._entry(position), scale)

    def below(self, position: F64, heights: float) -> F64:
        """The (2,) foot pixel so many heights of the average model below a foot pixel, along the model's axis."""
        entry = self._entry(position)
        if entry < 0:
            return position
        axis = self.model_map.head_px[entry] - self.model_map.foot_px[entry]
        return np.asarray(position - heights * axis, np.float64)

    def box_width(self, position: F64, scale: float = 1.0) -> float:
        """Width of a person's box at a (2,) foot pixel [px]."""
        entry = self._entry(position)
        return float(self.map_boxes[entry, 2]) * self.sizes.at(entry, scale) if entry >= 0 else 1.0

    def _entry(self, position: F64) -> int:
        """As the map's ``entry_at`` for one pixel, without arrays: it is called many times per frame."""
        u, v = float(position[0]), float(position[1])
        index, step = self.model_map.index, self.model_map.params.step_px
        if not (math.isfinite(u) and math.isfinite(v)):
            return -1
        col = round((u - self.model_map.origin_px[0]) / step)
        row = round((v - self.model_map.origin_px[1]) / step)
        inside = 0 <= row < index.shape[0] and 0 <= col < index.shape[1]
        return int(index[row, col]) if inside else -1

    def longest_side(self, position: F64, scale: float = 1.0) -> float:
        """Longest side of a model's box at a (2,) foot pixel [px]; 1 where no person is possible."""
        entry = self._entry(position)
        return float(self.map_boxes[entry, 2:].max()) * self.sizes.at(entry, scale) if entry >= 0 else 1.0

    def colours(self, image: U8, evidence: U8, position: F64, scale: float) -> F32:
        """(COLOUR_PARTS, COLOUR_LEVELS^3) float32 histogram of what only this model covers (after ``match``)."""
        histogram = np.zeros((COLOUR_PARTS, COLOUR_LEVELS**3), np.float32)
        top, bottom = self._fill(position, scale)
        measuring.colour_histogram(
            image, evidence, self.cover, self._spans, top, bottom, _LEVEL, COLOUR_LEVELS, histogram
        )
        return histogram

    def extent(self, evidence: U8, position: F64, scale: float) -> Extent | None:
        """Where a body ends along its axis; None where the axis is too short in the image to tell."""
        return self._extents.of(evidence, self._entry(position), position, scale)

    def covered(self, position: F64, scale: float, from_foot: float, share: float) -> float:
        """Part of a piece of a placed model (see ``_fill_part``) that another covers or the scene hides."""
        top, bottom = self._fill_part(position, scale, from_foot, share)
        area, covered = measuring.count_covered(self.cover, self.hiding, self._spans, top, bottom)
        return covered / max(1, area)

    def paint(self, image: U8, position: F64, scale: float, amount: int) -> None:
        """Add ``amount`` to the pixels of the model at a (2,) foot pixel."""
        top, bottom = self._fill(position, scale)
        kernels.paint(image, self._spans, top, bottom, amount)
        if image is self.cover:
            self._extents.forget()

    def hull(self, position: F64, scale: float) -> F64 | None:
        """(HULL_POINTS, 2) outline [px] of the model at a (2,) foot pixel; None where no person is possible."""
        entry = self._entry(position)
        if entry < 0:
            return None
        size = self.sizes.at(entry, scale)
        return np.asarray(position + size * (self.model_map.hull_px[entry] - self.model_map.foot_px[entry]), np.float64)

    def _fill_part(self, position: F64, scale: float, from_foot: float, share: float) -> tuple[int, int]:
        """Rows of a piece of a model: a share of its size, the lower end at ``from_foot`` of it above the foot."""
        size = self.size(position, scale)
        low = self.below(position, -from_foot * size)
        return self._fill(low, self.sizes.height_of(self._entry(low), share * size))

    def _fill(self, position: F64, scale: float) -> tuple[int, int]:
        top, bottom, _ = kernels.fill_spans(
            self._people, float(position[0]), float(position[1]), scale, self.cover.shape[1], self._spans
        )
        return int(top), int(bottom)
