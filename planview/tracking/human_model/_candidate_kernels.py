"""Compiled search for the places of new people; ``tests/reference/human_model.py`` defines it in plain numpy."""

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, Bool


class BoxLimits(NamedTuple):
    """Which models a blob may be: least share of a model's box that lies over the blob's, least area of the blob as a
    share of the box inside the image, and shortest longest side of the box [px]."""

    common: float
    blob: float
    side_px: float


@njit(cache=True, nogil=True)
def boxes_over(boxes: F32, inside: F32, blob: F64, area_px: float, limits: BoxLimits, fits: Bool) -> None:
    """Mark the models that a blob may be.

    boxes: (N, 4) left, top, width, height of all models; inside: (N,) area of each inside the image;
    blob: (4,) box of the blob. fits: (N,) is filled.
    """
    left, top = blob[0], blob[1]
    right, bottom = left + blob[2], top + blob[3]
    for i in range(np.uintp(len(boxes))):
        box = boxes[i]
        fits[i] = False
        if area_px < np.float32(limits.blob) * inside[i] or max(box[2], box[3]) < limits.side_px:
            continue
        width = min(box[0] + box[2], right) - max(box[0], left)
        height = min(box[1] + box[3], bottom) - max(box[1], top)
        fits[i] = max(0.0, width) * max(0.0, height) >= limits.common * inside[i]
