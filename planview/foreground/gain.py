"""The camera's gain and exposure, followed against the background model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, U8
from planview.foreground import _gain_kernels as kernels

SAMPLES = 4096
"""Pixels sampled: a gain of 1 % is then found to 0.01 %, in a tenth of a millisecond."""
INLIERS_TRUSTED = 0.7
"""Fraction of inliers above which no other gain is searched (our choice)."""
INLIERS_MIN = 0.3
"""Fraction of inliers below which the last gain is kept: the scene changed, not the camera (our choice)."""
INLIER_RATIO_MIN = 1.1
"""A new gain must have so many times the inliers of the last one: a large person is no gain step (our choice)."""
KEPT_GAIN_MAX = 32.0
"""A refined gain beyond this, or below its reciprocal, is not taken over: the fit failed (our choice)."""


class Exposure(NamedTuple):
    """Image luma = gain * reference luma + offset [levels of 255]."""

    gain: float = 1.0
    offset: float = 0.0

    def after(self, step: Exposure) -> Exposure:
        """This exposure, and then another step on top of it."""
        return Exposure(step.gain * self.gain, step.gain * self.offset + step.offset)


class GainFollower:
    """Finds image luma = gain * model luma + offset by consensus of subsampled pixels (our method).

    The last gain, refined, competes with the line through two pixels and the pure gain that have most inliers: all
    survive people in nearly half of the image. Clipped pixels count as inliers but take no part in the fit.

    Attributes:
        gain, offset: as of the last update.
    """

    def __init__(self, shape: tuple[int, int], clip: float, tolerance: float) -> None:
        """Args: levels of 255; tolerance is how far from its prediction an unchanged pixel may be."""
        self.gain, self.offset = 1.0, 0.0
        self._n_pixels = shape[0] * shape[1]
        self._stride = max(1, self._n_pixels // SAMPLES)
        while math.gcd(self._stride, shape[1]) > 1:
            self._stride += 1
        size = -(-self._n_pixels // self._stride)
        self._model, self._luma = np.zeros(size, np.float32), np.zeros(size, np.float32)
        self._clip, self._tolerance = clip, tolerance

    def reset(self) -> None:
        """Back to gain 1: the model is in the exposure of the image."""
        self.gain, self.offset = 1.0, 0.0

    def update(self, lead: F32, image: U8) -> None:
        """Follow one image.

        Args:
            lead: the leading Gaussians of ``Foreground``. image: (N,) grey or (3 N,) BGR uint8.
        """
        colour = image.size > self._n_pixels
        n = kernels.sample_lumas(lead, image, colour, self._n_pixels, self._stride, self._model, self._luma)
        model, luma = self._model[:n], self._luma[:n]
        gain, offset, inliers = self._refined(model, luma, self.gain, self.offset)
        if inliers < INLIERS_TRUSTED * n:
            for start in self._candidates(model, luma, gain, offset):
                other = self._refined(model, luma, *start)
                if other[2] > INLIER_RATIO_MIN * inliers:
                    gain, offset, inliers = other
        if inliers >= max(INLIERS_MIN * n, kernels.PIXELS_MIN) and 1 / KEPT_GAIN_MAX < gain < KEPT_GAIN_MAX:
            self.gain, self.offset = gain, offset

    def _candidates(self, model: F32, luma: F32, gain: float, offset: float) -> tuple[tuple[float, float], ...]:
        line = kernels.consensus_line(model, luma, gain, offset, self._clip, self._tolerance)
        return line, (kernels.consensus_scale(model, luma, self._clip, self._tolerance), 0.0)

    def _refined(self, model: F32, luma: F32, gain: float, offset: float) -> tuple[float, float, int]:
        gain, offset = kernels.refine_gain(model, luma, gain, offset, self._clip, self._tolerance)
        return gain, offset, kernels.count_inliers(model, luma, gain, offset, self._clip, self._tolerance, 1)
