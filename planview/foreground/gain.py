"""The camera's gain and exposure, followed against the background model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, U8
from planview.foreground import _gain_kernels as kernels

SAMPLES = 4096
"""Pixels looked at: a gain of 1 % is then found to 0.01 %, in a tenth of a millisecond."""
TRUSTED_INLIERS = 0.7
"""Fraction of explained pixels above which no other gain is searched."""
FEWEST_INLIERS = 0.3
"""Fraction of explained pixels below which the last gain is kept: the scene changed, not the camera."""
BETTER = 1.1
"""A new gain must explain so many times the pixels of the last one: a large person is no gain step."""
LARGEST_GAIN = 32.0


class Exposure(NamedTuple):
    """Image luma = gain * reference luma + offset [levels of 255]."""

    gain: float = 1.0
    offset: float = 0.0

    def after(self, step: Exposure) -> Exposure:
        """This exposure, and then another step on top of it."""
        return Exposure(step.gain * self.gain, step.gain * self.offset + step.offset)


class GainFollower:
    """Finds image luma = gain * model luma + offset by consensus of subsampled pixels (our method).

    The last gain, refined, competes with the line through two pixels and the pure gain that explain most pixels: all
    survive people in nearly half of the image. Clipped pixels vote but do not pull.

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
        self._model, self._seen = np.zeros(size, np.float32), np.zeros(size, np.float32)
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
        n = kernels.sample_lumas(lead, image, colour, self._n_pixels, self._stride, self._model, self._seen)
        model, seen = self._model[:n], self._seen[:n]
        gain, offset, inliers = self._refined(model, seen, self.gain, self.offset)
        if inliers < TRUSTED_INLIERS * n:
            for start in self._candidates(model, seen, gain, offset):
                other = self._refined(model, seen, *start)
                if other[2] > BETTER * inliers:
                    gain, offset, inliers = other
        if inliers >= max(FEWEST_INLIERS * n, kernels.FEWEST) and 1 / LARGEST_GAIN < gain < LARGEST_GAIN:
            self.gain, self.offset = gain, offset

    def _candidates(self, model: F32, seen: F32, gain: float, offset: float) -> tuple[tuple[float, float], ...]:
        line = kernels.likeliest_gain(model, seen, gain, offset, self._clip, self._tolerance)
        return line, (kernels.likeliest_scale(model, seen, self._clip, self._tolerance), 0.0)

    def _refined(self, model: F32, seen: F32, gain: float, offset: float) -> tuple[float, float, int]:
        gain, offset = kernels.refine_gain(model, seen, gain, offset, self._clip, self._tolerance)
        return gain, offset, kernels.count_inliers(model, seen, gain, offset, self._clip, self._tolerance, 1)
