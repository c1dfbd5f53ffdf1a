"""The grid of cells that ellipses are fitted on, which follows the size of people."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from calib.types import F32, U8
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.planes import PlaneView

LONGEST, LONG = 56.0, 40.0
"""Where people are longer than ``LONGEST`` cells in the median, the grid is made coarser until they are ``LONG``: time
per ellipse stays bounded, and limbs average out. Our choice."""
SHORT, FINER = 22.0, 2.0
"""Where people are shorter than ``SHORT`` cells, the grid is made finer until they are not, at most ``FINER`` times: of
a person 3 or 4 cells wide legs are lost, and two side by side are one. Our choice."""
COLUMNS_MIN = 24


def averaged(foreground: U8, image_size: tuple[int, int], columns: int, observation: Observation) -> PlaneView:
    """Foreground averaged over cells.

    Args:
        foreground: (h, w) uint8, of the image or reduced.
        image_size: (width, height) of the image [px].
        columns: of the grid; at most those of the foreground.
    """
    width, height = image_size
    cols = min(foreground.shape[1], columns)
    rows = max(1, round(height * cols / width))
    cells = cv2.resize(foreground, (cols, rows), interpolation=cv2.INTER_AREA)
    mask: F32 = np.asarray(cells, dtype=np.float32) / np.float32(255)
    scale = width / cols
    return PlaneView(mask, scale, ((scale - 1) / 2, (scale - 1) / 2), observation)


def columns_for(length: float, columns: int) -> int:
    """Columns of the grid for people who are so many cells long on one of so many columns."""
    if SHORT <= length <= LONGEST:
        return columns
    wanted = min(FINER, SHORT / length) if length < SHORT else LONG / length
    return max(COLUMNS_MIN, round(columns * wanted / 8) * 8)


def regridded(prior: SizePrior, before: PlaneView, after: PlaneView) -> SizePrior:
    """The prior of one grid in cells of another."""
    ratio = before.scale / after.scale
    shift = (after.origin[1] - before.origin[1]) / before.scale
    level = ratio * (prior.half_length_0 + prior.half_length_slope * shift)
    return replace(prior, half_length_0=level, half_length_min=ratio * prior.half_length_min)
