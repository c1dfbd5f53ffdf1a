"""How large people of other heights than the average are in the image.

An outline of the map is the average person's. Who is taller has the head nearer to the camera, and looks larger by more
than that: where the camera hangs 0.5 m above a head, 5 % of the height are a quarter of the size.
"""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64, I32, U8
from planview.tracking.human_model import _kernels as kernels
from planview.tracking.human_model.model_map import HumanModelMap

LOW = 0.5
"""How much nearer heads must be than feet, over the distance of the feet, for perspective to be minded (our choice):
one per cent of the height is then two of the size. Elsewhere sizes are in proportion to heights: with perspective
everywhere, remains of people became short people in conference rooms."""
MIN_AXIS = 0.5
"""Length of the head-foot axis over the model's longest side below which head and foot say little (our choice)."""


class ImageSizes:
    """Sizes in the image by entry of a model map, over the average person's there (``_kernels.image_size``).

    Attributes:
        model_map: of the average person.
        boxes: (N, 4) float32 left, top, width, height of the average person [px].
        areas: (N,) of the average person's outline [px^2].
        proportional: people are as much larger as they are taller.
        nearer: (N,) how much nearer to the camera's plane the head is than the foot, over the foot's distance; 0 where
            sizes are in proportion.
    """

    def __init__(self, model_map: HumanModelMap) -> None:
        self.model_map, self.boxes = model_map, model_map.boxes()
        hull, after = model_map.hull_px, np.roll(model_map.hull_px, -1, axis=1)
        self.areas: F64 = 0.5 * np.abs(
            (hull[..., 0] * after[..., 1] - after[..., 0] * hull[..., 1]).sum(axis=1, dtype=np.float64)
        )
        camera, away_m = model_map.camera, model_map.floor_m[:, 1].astype(np.float64)
        ahead, down = math.sin(camera.tilt_rad), math.cos(camera.tilt_rad)
        nearer = model_map.model.height_m * down / (away_m * ahead + camera.height_m * down)
        self.proportional = bool(np.median(nearer) < LOW)
        self.nearer: F64 = np.zeros(len(nearer)) if self.proportional else nearer

    def at(self, entry: int, scale: float) -> float:
        """Size of a person of ``scale`` times the average height; where no person is possible (-1), as far away."""
        return float(kernels.image_size(self._nearer(entry), scale))

    def of(self, entries: I32, scale: F64) -> F64:
        """(N,) sizes at (N,) entries of people of (N,) scales."""
        out = np.empty(len(entries))
        kernels.image_sizes(np.where(entries >= 0, self.nearer[entries], 0.0), scale, out)
        return out

    def boxes_at(self, entries: I32, scale: F64, foot_px: F64) -> F64:
        """(N, 4) left, top, width, height of people of (N,) scales at (N, 2) foot pixels, nearest to (N,) entries."""
        size = self.of(entries, scale)[:, None]
        box, foot = self.boxes[entries].astype(np.float64), self.model_map.foot_px[entries]
        return np.hstack([foot_px + size * (box[:, :2] - foot), size * box[:, 2:]])

    def visible(self, entries: I32, scale: F64, foot_px: F64, shown_px: F64) -> F64:
        """(N,) part of people that is inside the image.

        Args:
            entries, scale, foot_px: as for ``boxes_at``.
            shown_px: (N,) pixels of their models inside the image.
        """
        width, height = self.model_map.camera.size
        left, top, wide, high = self.boxes_at(entries, scale, foot_px).T
        whole = (left >= -0.5) & (top >= -0.5) & (left + wide <= width - 0.5) & (top + high <= height - 0.5)
        area = self.of(entries, scale) ** 2 * self.areas[entries]
        return np.where(whole, 1.0, np.minimum(shown_px / np.maximum(area, 1.0), 1.0 - 1e-6))

    def height_of(self, entry: int, size: float) -> float:
        """The scale of who has a size: ``at`` the other way round."""
        near = self._nearer(entry)
        return size / (1.0 - near + near * size)

    def _nearer(self, entry: int) -> float:
        return float(self.nearer[entry]) if entry >= 0 else 0.0


def inside(boxes: F32, size: tuple[int, int]) -> F32:
    """(N,) area of (N, 4) boxes inside an image of a width and height [px^2]."""
    low, high = np.maximum(boxes[:, :2], 0), np.minimum(boxes[:, :2] + boxes[:, 2:], size)
    return np.asarray(np.prod(np.maximum(high - low, 0), axis=1), np.float32)


def upright(model_map: HumanModelMap) -> U8:
    """(N,) uint8, 1 where the head is above the foot in the image by half of the model's longest side."""
    up = model_map.foot_px[:, 1] - model_map.head_px[:, 1]
    return np.asarray(up >= MIN_AXIS * model_map.boxes()[:, 2:].max(axis=1), np.uint8)
