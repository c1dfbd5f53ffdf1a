"""How dark the shadows of a scene are: what is darker, and of the ground's colour all the same, is dark clothes.

One lamp or sun, and what is left where it does not reach, give all shadows on the ground about the same share of its
luma (Prati et al. 2003 bound that share by two constants; learning it is our choice).
"""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F64, U8

BINS = 100
"""Bins of the histogram of ratios from 0 to 1: steps of 1 %."""
GROUND_MIN = 40.0
"""Darker ground tells nothing: noise of 4 levels is a tenth of its luma. Our choice."""
SMOOTHED_PX = 3
"""Ratios are those of means over so many pixels each way: noise would widen the histogram. Our choice."""


class ShadowDepthParams(Params):
    """What is too dark for a shadow of the scene; our choices."""

    darker: float = Field(0.15, ge=0, le=1)
    """Share of the pixels called shadow, over the time constant, that are too dark. On drawn platforms in the sun a
    tenth to a quarter of them is clothes, and the ground makes up hardly any of the darkest tenth. 0 learns nothing."""
    ratio_max: float = Field(0.7, gt=0, le=1)
    """What is brighter than this share of the ground's luma stays a shadow, however bright others are."""
    memory_s: float = Field(60.0, gt=0, le=3600)
    """Time constant of what is learned [s]: clouds pass, and a person alone is not the scene."""
    pixels_min: int = Field(500, ge=1, le=10_000_000)
    """Pixels of shadow before the darkest are told: a person or two."""


class ShadowDepth:
    """Learns the scene's shadows from what is called one."""

    def __init__(self, params: ShadowDepthParams) -> None:
        self._params = params
        self.reset()

    def reset(self) -> None:
        """Forget all shadows."""
        self._counts: F64 = np.zeros(BINS)

    def darkest(self) -> float:
        """Share of the ground's luma below which nothing is a shadow; 0 before enough was observed."""
        total = self._counts.sum()
        if total < self._params.pixels_min or self._params.darker == 0:
            return 0.0
        limit = int(np.searchsorted(np.cumsum(self._counts), self._params.darker * total)) / BINS
        return min(limit, self._params.ratio_max)

    def update(self, luma: U8, background: U8, shadow: U8, dt_s: float) -> U8:
        """Learn from a frame, and tell which of its shadows are none.

        Args:
            luma, background: (H, W) uint8, the image and the background in its exposure.
            shadow: (H, W) uint8, not 0 where the colour is that of a shadow.
            dt_s: time since the last frame [s].
        Returns:
            (H, W) uint8, 255 where a shadow is too dark to be one.
        """
        clothes = np.zeros(shadow.shape, np.uint8)
        self._counts *= np.exp(-dt_s / self._params.memory_s)
        left, top, width, height = cv2.boundingRect(shadow)
        if not width:
            return clothes
        rows, cols = slice(top, top + height), slice(left, left + width)
        size = (SMOOTHED_PX, SMOOTHED_PX)
        here, ground = (cv2.blur(a[rows, cols], size).astype(np.float32) for a in (luma, background))
        inside = (shadow[rows, cols] > 0) & (ground >= GROUND_MIN)
        ratio = np.minimum(here / np.maximum(ground, 1.0), 0.999)
        self._counts += np.bincount((BINS * ratio[inside]).astype(np.int64), minlength=BINS)
        clothes[rows, cols][inside & (ratio < self.darkest())] = 255
        return clothes
