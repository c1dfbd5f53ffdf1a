"""Ghosts: foreground where a person stood when the background was learned, and has left since.

A person or a thing has an outline in the image that the background lacks; a ghost has it in the background. So the
stronger edges along the boundary of a blob decide between the two (Cucchiara et al. 2003 separate ghosts from objects
by optical flow; edges in its place are our choice).
"""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, U8
from planview.foreground.blobs import find_blobs

_STEP_GAIN = 4.0
"""Response of the 3x3 Sobel operator to a step of one level."""


class GhostParams(Params):
    """When foreground that does not move is a ghost; our choices."""

    interval_s: float = Field(0.5, gt=0, le=10)
    """Time between two searches for ghosts [s]."""
    edge_ratio: float = Field(1.5, ge=1, le=10)
    """Edges along a ghost's boundary are so many times stronger in the background than in the image. Edges of the
    scene behind are in both and pull the ratio towards 1."""
    edge_levels: float = Field(5.0, gt=0, le=100)
    """Smallest mean step along that boundary in the background [levels of 255]: more than noise makes."""
    area_px: int = Field(20, ge=1, le=100_000)
    """Smallest area of a ghost [px]: smaller blobs have too short a boundary to compare."""
    motion: float = Field(0.02, ge=0, le=1)
    """Largest moving share of a ghost's pixels, for noise. A passer-by merges with it into one blob, which is examined
    again when the person has passed."""


def find_ghosts(luma: U8, background: U8, mask: U8, motion: U8, params: GhostParams) -> U8:
    """Blobs of the foreground whose outline is in the background and not in the image.

    Args:
        luma: (H, W) uint8, the image.
        background: (H, W) uint8, luma of the learned background.
        mask, motion: (H, W) uint8, foreground and moving pixels are not 0.
    Returns:
        (H, W) uint8, 255 in ghosts.
    """
    blobs = find_blobs(mask)
    count, labels = len(blobs), blobs.labels
    if count < 2:
        return np.zeros(mask.shape, np.uint8)
    rim = (mask > 0) & (cv2.erode(mask, np.ones((3, 3), np.uint8)) == 0)
    which = labels[rim]
    length = np.maximum(1, np.bincount(which, minlength=count))
    inside = _edges(luma)[rim], _edges(background)[rim]
    here, before = (np.bincount(which, values, minlength=count) / length for values in inside)
    moving = np.bincount(labels[motion > 0], minlength=count) / np.maximum(1, blobs.area_px)
    ghost = (before >= params.edge_levels) & (before >= params.edge_ratio * here) & (moving <= params.motion)
    ghost &= blobs.area_px >= params.area_px
    ghost[0] = False
    return np.asarray(np.where(ghost[labels], 255, 0), dtype=np.uint8)


def _edges(luma: U8) -> F32:
    """(H, W) float32 steps [levels] across each pixel."""
    right, down = (cv2.Sobel(luma, cv2.CV_32F, dx, 1 - dx, ksize=3) for dx in (1, 0))
    return np.asarray(cv2.magnitude(right, down) / _STEP_GAIN, dtype=np.float32)
