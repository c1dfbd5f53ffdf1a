"""The camera's gain and exposure, followed against the background model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.types import F32, U8, AnyArray
from planview.foreground import _gain_kernels as kernels

INLIERS_MIN = 0.3
"""Fraction of inliers, and of all pixels' evidence, below which the last gain is kept: the scene changed, not the
camera (our choice)."""
KEPT_GAIN_MAX = 32.0
"""A refined gain beyond this, or below its reciprocal, is not taken over: the fit failed (our choice)."""

BGR_TO_LUMA = np.array([0.114, 0.587, 0.299], np.float32)


class Exposure(NamedTuple):
    """Image luma = gain * reference luma + offset [levels of 255]."""

    gain: float = 1.0
    offset: float = 0.0

    def after(self, step: Exposure) -> Exposure:
        """This exposure, and then another step on top of it."""
        return Exposure(step.gain * self.gain, step.gain * self.offset + step.offset)


_Pixels = tuple[F32, F32, F32]
"""(N,) luma of the model and of the image, and the evidence of each pixel."""


class _Line(NamedTuple):
    """A gain and an offset, how many pixels lie on that line, and their evidence."""

    gain: float
    offset: float
    inliers: int
    evidence: float


class GainFollower:
    """Finds image luma = gain * model luma + offset by consensus of subsampled pixels (our method).

    The last gain, refined, competes with the line through two pixels and the pure gain of largest evidence: pixels
    of a common luma weigh little, so that a plain shirt which fills most of the image is no change of the exposure.
    Clipped pixels count as inliers but take no part in the fit.

    Attributes:
        gain, offset: as of the last update.
    """

    def __init__(self, shape: tuple[int, int], clip: float, tolerance: float) -> None:
        """Args: levels of 255; tolerance is how far from its prediction an unchanged pixel may be."""
        self.gain, self.offset = 1.0, 0.0
        # Pixels sampled: a gain of 1 % is then found to 0.01 %, in a tenth of a millisecond.
        self._stride = max(1, shape[0] * shape[1] // 4096)
        while math.gcd(self._stride, shape[1]) > 1:
            self._stride += 1
        self._clip, self._tolerance = clip, tolerance

    def reset(self) -> None:
        """Back to gain 1: the model is in the exposure of the image."""
        self.gain, self.offset = 1.0, 0.0

    def update(self, leaders: AnyArray, image: U8) -> None:
        """Follow one image.

        Args:
            leaders: (H, W) leading Gaussians. image: (H, W, 1) grey or (H, W, 3) BGR uint8.
        """
        model, bgr = leaders.reshape(-1)[:: self._stride], image.reshape(-1, image.shape[2])[:: self._stride]
        # Bounds and black are left out.
        known = (model["var_y"] > 0) & (model["y"] > kernels.BLACK)
        model, bgr = model["y"][known], bgr[known]
        luma = bgr @ BGR_TO_LUMA if image.shape[2] == 3 else bgr[:, 0].astype(np.float32)
        n = len(model)
        pixels = model, luma, np.empty(n, np.float32)
        kernels.fill_information(pixels[1], self._tolerance, pixels[2])
        best = self._refined(pixels, self.gain, self.offset)
        # Fraction of inliers above which no other gain is searched (our choice).
        if best.inliers < 0.7 * n:
            best = self._searched(pixels, best)
        if best.inliers >= max(INLIERS_MIN * n, kernels.PIXELS_MIN) and self._is_exposure(best, pixels):
            self.gain, self.offset = best.gain, best.offset

    def _is_exposure(self, line: _Line, pixels: _Pixels) -> bool:
        """Whether a line keeps enough of the scene.

        Whatever fills the image in one luma lies on a line almost without slope, on which the model would forget the
        scene; a camera that made it as bright would show more of it.
        """
        if not 1 / KEPT_GAIN_MAX < line.gain < KEPT_GAIN_MAX:
            return False
        model, _, information = pixels
        mean = float(model.mean())
        brightness = (line.gain * mean + line.offset) / mean
        kernels.fill_information(np.clip(brightness * model, 0.0, 255.0), self._tolerance, information)
        return line.evidence >= INLIERS_MIN * float(information.sum())

    def _searched(self, pixels: _Pixels, best: _Line) -> _Line:
        """The line given, or one with more evidence in the image."""
        line = kernels.consensus_line(*pixels, best.gain, best.offset, self._clip, self._tolerance)
        scale = kernels.consensus_scale(*pixels, self._clip, self._tolerance)
        for start in (line, (scale, 0.0)):
            other = self._refined(pixels, *start)
            # The inliers of a new gain must weigh 10 % more than those of the last one: a large person is no
            # gain step (our choice).
            if other.evidence > 1.1 * best.evidence:
                best = other
        return best

    def _refined(self, pixels: _Pixels, gain: float, offset: float) -> _Line:
        gain, offset = kernels.refine_gain(*pixels[:2], gain, offset, self._clip, self._tolerance)
        return _Line(gain, offset, *kernels.weigh_inliers(*pixels, gain, offset, self._clip, self._tolerance, 1))
