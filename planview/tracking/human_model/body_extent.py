"""Where observed bodies end along their axes."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64, U8
from planview.tracking.human_model import _extent_kernels as kernels
from planview.tracking.human_model.image_size import MIN_AXIS, ImageSizes
from planview.tracking.human_model.measurement import Extent
from planview.tracking.human_model.model_map import HumanModelMap

BINS = 60
"""Bins along a body's axis, 3 % of its height each."""


class BodyExtents:
    """Extents of bodies in evidence that no other model covers, each measured once: a head and then both ends are asked
    of the same place.

    Args:
        cover: (H, W) uint8 number of models at each pixel; whoever changes it calls ``forget``.
    """

    def __init__(self, model_map: HumanModelMap, sizes: ImageSizes, cover: U8) -> None:
        self._map, self._sizes, self._cover = model_map, sizes, cover
        self.forget()

    def forget(self) -> None:
        """The cover has changed."""
        self._evidence: U8 | None = None
        self._known: dict[tuple[float, float, float], Extent | None] = {}

    def of(self, evidence: U8, entry: int, position: F64, scale: float) -> Extent | None:
        """The extent of a body whose model stands at a (2,) foot pixel; None where its axis is too short to tell.

        Args:
            evidence: (H, W) uint8.
            entry: of the map at the foot pixel, negative where no person is possible.
            scale: height over the average person's.
        """
        if self._evidence is not evidence:
            self.forget()
            self._evidence = evidence
        asked = float(position[0]), float(position[1]), scale
        if asked not in self._known:
            self._known[asked] = self._measured(evidence, entry, position, scale) if entry >= 0 else None
        return self._known[asked]

    def _measured(self, evidence: U8, entry: int, position: F64, scale: float) -> Extent | None:
        people, size = self._map, self._sizes.at(entry, scale)
        line = kernels.line_of(people.foot_px[entry], people.head_px[entry], people.hull_px[entry], size, position)
        if line.length < MIN_AXIS * size * float(self._sizes.boxes[entry, 2:].max()):
            return None
        low, high, head = kernels.body_extent(evidence, self._cover, line.axis, np.zeros(BINS, np.int64))
        axis_px = np.array([line.axis.along_u, line.axis.along_v])
        head = head - line.high if head > 1.0 / BINS else math.nan
        if high <= low:
            return Extent(axis_px, math.nan, math.nan, head, math.nan)
        height = self._sizes.height_of(entry, size * (high - low) / (line.high - line.low)) / scale
        return Extent(axis_px, low - line.low, high - line.high, head, height)
