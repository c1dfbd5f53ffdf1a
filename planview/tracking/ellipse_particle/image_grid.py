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
"""Where a person in the lower part of the image is longer than ``LONGEST`` cells, the grid is made coarser until it is
``LONG``: time per ellipse stays bounded, and limbs average out. Our choice."""
COLUMNS_MIN = 24
LOWER = 0.75
"""Row at which size is judged, as a share of the image's height."""


def averaged(foreground: U8, image_size: tuple[int, int], columns: int, observation: Observation) -> PlaneView:
    """Foreground averaged over cells.

    Args:
        foreground: (h, w) uint8, of the image or reduced.
        image_size: (width, height) of the image [px].
        columns: of the grid.
    """
    width, height = image_size
    cols = min(width, columns)
    rows = max(1, round(height * cols / width))
    cells = cv2.resize(foreground, (cols, rows), interpolation=cv2.INTER_AREA)
    mask: F32 = np.asarray(cells, dtype=np.float32) / np.float32(255)
    scale = width / cols
    return PlaneView(mask, scale, ((scale - 1) / 2, (scale - 1) / 2), observation)


def columns_for(prior: SizePrior, columns: int, rows: int) -> int:
    """Columns of the grid for people of a size.

    Args:
        prior: in cells of a grid of so many columns and rows.
        columns: the most there may be.
    """
    length = 2 * prior.half_length(LOWER * rows)
    if length <= LONGEST:
        return columns
    return max(COLUMNS_MIN, round(columns * LONG / length / 8) * 8)


def regridded(prior: SizePrior, before: PlaneView, after: PlaneView) -> SizePrior:
    """The prior of one grid in cells of another."""
    ratio = before.scale / after.scale
    shift = (after.origin[1] - before.origin[1]) / before.scale
    level = ratio * (prior.half_length_0 + prior.half_length_slope * shift)
    return replace(prior, half_length_0=level, half_length_min=ratio * prior.half_length_min)
