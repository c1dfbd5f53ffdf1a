"""Small pictures of a moment, which show whether anything moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.images import as_grey
from calib.types import F32, U8

STEP_PX = 2
"""Every n-th row and column is compared: a person at 8 m still has 100 pixels."""
OWN_VIEW = 8
"""The outer 1/n of each image, which the other camera may not show, is left out: a disparity of 80 px of 640."""


class Thumbnails(NamedTuple):
    """Every second pixel of a rectified pair where both cameras see the scene: (h, w) uint8 each; or of an image and of
    the disparity that its depth has, (h, w) float32, 0 where unknown.

    Attributes:
        is_pair: both are images.
    """

    left: U8
    right: U8 | F32
    is_pair: bool = True

    @staticmethod
    def of_pair(left: U8, right: U8) -> Thumbnails:
        """Thumbnails of rectified (H, W) grey images; rows of both still show the same part of the scene."""
        margin = left.shape[1] // OWN_VIEW
        left_inside = left[::STEP_PX, margin::STEP_PX]
        right_inside = right[::STEP_PX, : right.shape[1] - margin : STEP_PX]
        return Thumbnails(np.ascontiguousarray(left_inside), np.ascontiguousarray(right_inside))

    @staticmethod
    def of_depth(image: U8, disparity: F32) -> Thumbnails:
        """Thumbnails of an (H, W[, 3]) image and the disparity of its depth, NaN where unknown."""
        grey = as_grey(image)[::STEP_PX, ::STEP_PX].copy()
        return Thumbnails(grey, np.nan_to_num(disparity[::STEP_PX, ::STEP_PX]), is_pair=False)
