"""What the tracker sees of a frame: a grid of foreground cells, in the image or on the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import F32, F64, U8
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.background import Background
from planview.tracking.ellipse_particle.fit.ellipses import SizePrior
from planview.tracking.ellipse_particle.params import DetectionParams, SizeParams

CELLS_PER_HALF = 4
"""Half a body's length on the floor spans at least so many cells; maps finer than that are averaged."""
SPECKLED = 0.02
"""A frame with more specks than this share of its pixels is noisy. The outlines of ten people, each a tenth of the
image high, lose a quarter of it to the same filter. Our choice."""


@dataclass(frozen=True, eq=False)
class PlaneView:
    """Foreground of one frame on the tracker's grid.

    Attributes:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        scale: plane units per cell (px in the image, m on the floor).
        origin: (x, y) of the centre of cell (0, 0) in plane units.
    """

    mask: F32
    scale: float
    origin: tuple[float, float]

    def to_plane(self, xy: F64) -> F64:
        """(..., 2) plane coordinates of fractional cells."""
        return np.asarray(np.asarray(xy) * self.scale + np.asarray(self.origin))


class ImagePlane:
    """Foreground of the image: mixture of Gaussians with shadows removed, specks removed, cells averaged."""

    def __init__(self, params: DetectionParams) -> None:
        self._params = params
        self.reset()

    def reset(self) -> None:
        self._background = Background(self._params)

    def __call__(self, observation: Observation) -> PlaneView | None:
        """The frame's cells; None when the observation has no image or foreground to work on.

        Raises:
            ValueError: image or foreground is not uint8 of (H, W) or, for images, (H, W, 3).
        """
        foreground = self._foreground(observation)
        if foreground is None:
            return None
        height, width = foreground.shape if observation.image is None else observation.image.shape[:2]
        clean = cv2.medianBlur(foreground, 3)
        # Averaging whole pixels has removed most specks already where the foreground is smaller than the image, and
        # the filter would eat thin people too; but not the specks of a frame that the codec or a jolt fills with them.
        if foreground.shape[1] != width and float(cv2.subtract(foreground, clean).mean()) < 255 * SPECKLED:
            clean = foreground
        cols = min(width, self._params.columns)
        rows = max(1, round(height * cols / width))
        cells = cv2.resize(clean, (cols, rows), interpolation=cv2.INTER_AREA)
        mask = np.asarray(cells, dtype=np.float32) / np.float32(255)
        scale = width / cols
        return PlaneView(mask, scale, ((scale - 1) / 2, (scale - 1) / 2))

    def protect(self, outlines: Sequence[F32]) -> None:
        """Keep what is inside these outlines (N, 2) [px] out of the background."""
        self._background.protect(outlines)

    def _foreground(self, observation: Observation) -> U8 | None:
        if self._params.source == "given":
            given = observation.foreground
            if given is not None and (given.ndim != 2 or given.dtype != np.uint8):
                raise ValueError(f"expected a (H, W) uint8 foreground, got {given.shape} {given.dtype}")
            return given
        image = observation.image
        if image is None:
            return None
        if image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise ValueError(f"expected a (H, W[, 3]) uint8 image, got {image.shape} {image.dtype}")
        return self._background.update(image)


class FloorPlane:
    """Foreground of the floor: occupancy against the density of a person's visible surface over its ellipse."""

    def __init__(self, params: DetectionParams, size: SizeParams) -> None:
        body = math.pi * size.floor_half_length_m**2 * size.floor_aspect
        self._half_length_m = size.floor_half_length_m
        self._full_density = 0.5 * params.person_area_m2 / body

    def reset(self) -> None:
        """Nothing is remembered."""

    def protect(self, outlines: Sequence[F32]) -> None:
        """The maps' background is not the tracker's to keep."""

    def __call__(self, observation: Observation) -> PlaneView | None:
        """The frame's cells; None when the observation has no maps."""
        maps = observation.maps
        if maps is None:
            return None
        grid = maps.grid
        step = max(1, int(self._half_length_m / (CELLS_PER_HALF * grid.cell_m)))
        rows, cols = max(1, grid.n_rows // step), max(1, grid.n_cols // step)
        density = cv2.resize(maps.occupancy[: rows * step, : cols * step], (cols, rows), interpolation=cv2.INTER_AREA)
        mask = np.clip(density / np.float32(self._full_density * grid.cell_m**2), 0, 1).astype(np.float32)
        middle = (step - 1) / 2
        return PlaneView(mask, step * grid.cell_m, grid.centre_of(middle, middle))


def floor_prior(size: SizeParams, view: PlaneView) -> SizePrior:
    """The constant metric size in cells of a view."""
    return SizePrior(size.floor_half_length_m / view.scale, 0.0, size.floor_aspect)


def given_prior(size: SizeParams, view: PlaneView) -> SizePrior | None:
    """The given image size in cells of a view; None when it is to be learned."""
    if size.half_length_px is None:
        return None
    middle = (view.mask.shape[0] - 1) / 2
    at_zero = size.half_length_px / view.scale - size.slope * middle
    return SizePrior(at_zero, size.slope, size.aspect)
