"""The camera's gain and exposure, followed against the background model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from calib.kernels import kernel
from calib.types import F32, U8, AnyArray

INLIERS_MIN = 0.3
"""Fraction of inliers, and of all pixels' evidence, below which the last gain is kept: the scene changed, not the
camera (our choice)."""
KEPT_GAIN_MAX = 32.0
"""A refined gain beyond this, or below its reciprocal, is not taken over: the fit failed (our choice)."""
LADDER_STEP = 0.05
"""Distance of the gains tried, in log gain: 5 % of mid grey is within the tolerance of an unchanged pixel."""
LADDER_STEPS = 40
"""Gains tried on either side of 1: a factor 7, as between lamps off and on."""
PAIR_STEP = 1009
"""Walks through the pixels in a fixed, scattered order (a prime)."""
THINNING = 4
"""Candidates are ranked on every fourth pixel."""
GAIN_MAX = 8.0
OFFSET_MAX = 100.0
"""Limits of the gains and offsets of cameras: veiling glare and tone curves look like offsets of up to 80 levels."""
BLACK = 2.0
"""Luma without information: outside the lens, or below the black level [levels]."""
ROUNDS = 6
"""Rounds of refinement; the tolerance settles in three or four."""
TOLERANCE_MIN = 3.0
"""Smallest tolerance of the refinement [levels of 255]: rounding and compression."""
OFFSET_PRIOR = 0.002
"""Weight of "the offset is 0" against the pixels: decides where all pixels are alike."""
PIXELS_MIN = 16
"""Smallest number of pixels for a fit."""
ANY_LUMA = 0.1
"""Share of the pixels that may have any luma, all alike: a wall all of one luma carries a little information, too."""
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


class GainFinder:
    """Finds image luma = gain * model luma + offset by consensus of subsampled pixels (our method).

    The last gain, refined, competes with the line through two pixels and the pure gain of largest evidence: pixels
    of a common luma weigh little, so that a plain shirt which fills most of the image is no change of the exposure.
    Clipped pixels count as inliers but take no part in the fit.
    """

    def __init__(self, shape: tuple[int, int], clip: float, tolerance: float) -> None:
        """Args: levels of 255; tolerance is how far from its prediction an unchanged pixel may be."""
        # Pixels sampled: a gain of 1 % is then found to 0.01 %, in a tenth of a millisecond.
        self._stride = max(1, shape[0] * shape[1] // 4096)
        while math.gcd(self._stride, shape[1]) > 1:
            self._stride += 1
        self._clip = clip
        self._tolerance = tolerance

    def __call__(self, leaders: AnyArray, image: U8, last: Exposure) -> Exposure:
        """Exposure of one image over the model, or the last one where the scene has changed.

        Args:
            leaders: (H, W) leading Gaussians. image: (H, W, 1) grey or (H, W, 3) BGR uint8.
        """
        model = leaders.reshape(-1)[:: self._stride]
        bgr = image.reshape(-1, image.shape[2])[:: self._stride]
        # Bounds and black are left out.
        is_measured = (model["var_y"] > 0) & (model["y"] > BLACK)
        model = model["y"][is_measured]
        bgr = bgr[is_measured]
        luma = bgr @ BGR_TO_LUMA if image.shape[2] == 3 else bgr[:, 0].astype(np.float32)
        n = len(model)
        pixels = (model, luma, information_of(luma, self._tolerance))
        best = self._refine(pixels, *last)
        # Fraction of inliers above which no other gain is searched (our choice).
        if best.inliers < 0.7 * n:
            best = self._search(pixels, best)
        if best.inliers >= max(INLIERS_MIN * n, PIXELS_MIN) and self._is_exposure(best, pixels):
            return Exposure(best.gain, best.offset)
        return last

    def _is_exposure(self, line: _Line, pixels: _Pixels) -> bool:
        """True if a line keeps enough of the scene.

        Whatever fills the image in one luma lies on a line almost without slope, on which the model would forget the
        scene; a camera that made it as bright would show more of it.
        """
        if not 1 / KEPT_GAIN_MAX < line.gain < KEPT_GAIN_MAX:
            return False
        model = pixels[0]
        mean = float(pixels[0].mean())
        brightness = (line.gain * mean + line.offset) / mean
        information = information_of(np.clip(brightness * model, 0.0, 255.0), self._tolerance)
        return line.evidence >= INLIERS_MIN * float(information.sum())

    def _search(self, pixels: _Pixels, best: _Line) -> _Line:
        """The line given, or one with more evidence in the image."""
        line = consensus_line(*pixels, best.gain, best.offset, self._clip, self._tolerance)
        scale = consensus_scale(*pixels, self._clip, self._tolerance)
        for start in (line, (scale, 0.0)):
            other = self._refine(pixels, *start)
            # The inliers of a new gain must weigh 10 % more than those of the last one: a large person is no
            # gain step (our choice).
            if other.evidence > 1.1 * best.evidence:
                best = other
        return best

    def _refine(self, pixels: _Pixels, gain: float, offset: float) -> _Line:
        model, luma, _ = pixels
        gain, offset = refine_gain(model, luma, gain, offset, self._clip, self._tolerance)
        inliers, evidence = weigh_inliers(*pixels, gain, offset, self._clip, self._tolerance, 1)
        return _Line(gain, offset, inliers, evidence)


def information_of(luma: F32, tolerance: float) -> F32:
    """Evidence of each pixel for a line that it lies on [nat]: the less, the more of the image has its luma by chance.

    Whatever covers most of the image in one luma lies on any line of that luma.
    """
    levels = np.arange(256)
    level = luma.astype(np.int64)
    reach = int(tolerance)
    below = np.append(0.0, np.bincount(level, minlength=256).cumsum() / max(luma.size, 1))
    first = np.maximum(levels - reach, 0)
    last = np.minimum(levels + reach, 255) + 1
    by_chance = (1.0 - ANY_LUMA) * (below[last] - below[first]) + ANY_LUMA * (last - first) / 256.0
    return np.asarray(-np.log(by_chance), np.float32)[level]


@kernel
def weigh_inliers(
    model: F32, luma: F32, information: F32, gain: float, offset: float, clip: float, tolerance: float, step: int
) -> tuple[int, float]:
    """Number of the pixels, of every step-th, within the tolerance of the line (clipped at both ends), and what they
    weigh."""
    n = 0
    evidence = 0.0
    for i in range(0, model.size, step):
        expected = min(max(gain * model[i] + offset, 0.0), clip)
        if abs(min(luma[i], clip) - expected) <= tolerance:
            n += 1
            evidence += information[i]
    return n, evidence


@kernel
def consensus_line(
    model: F32, luma: F32, information: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """The line through two pixels, or the given one, with the largest evidence (consensus over fixed pairs)."""
    best = gain, offset
    most = weigh_inliers(model, luma, information, gain, offset, clip, tolerance, THINNING)[1]
    n = model.size
    # Lines tried: if only 30 % of the pixels are unchanged, 13 of them join two such pixels.
    for k in range(150):
        i = (k * PAIR_STEP) % n
        j = (k * PAIR_STEP + n // 2 + k) % n
        run = model[j] - model[i]
        # Smallest difference of luma of two pixels that define a line [levels]: four times the noise.
        if abs(run) < 15.0 or max(luma[i], luma[j]) >= clip or min(luma[i], luma[j]) <= BLACK:
            continue
        gain = (luma[j] - luma[i]) / run
        offset = luma[i] - gain * model[i]
        if 1.0 / GAIN_MAX < gain < GAIN_MAX and abs(offset) < OFFSET_MAX:
            evidence = weigh_inliers(model, luma, information, gain, offset, clip, tolerance, THINNING)[1]
            if evidence > most:
                best = (gain, offset)
                most = evidence
    return best


@kernel
def consensus_scale(model: F32, luma: F32, information: F32, clip: float, tolerance: float) -> float:
    """The smallest gain of a ladder with the largest evidence, without offset: it works on clipped images, too."""
    best = 1.0
    most = 0.0
    for k in range(-LADDER_STEPS, LADDER_STEPS + 1):
        gain = math.exp(k * LADDER_STEP)
        evidence = weigh_inliers(model, luma, information, gain, 0.0, clip, tolerance, THINNING)[1]
        if evidence > most:
            best = gain
            most = evidence
    return best


@kernel
def refine_gain(
    model: F32, luma: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """Least squares of luma = gain * model + offset over inliers, repeated with a narrower tolerance.

    Pixels are chosen by their expected luma, not by their own, so that clipping does not bias the fit.
    """
    reach = tolerance
    for _ in range(ROUNDS):
        n = 0
        sm = 0.0
        sy = 0.0
        smm = 0.0
        smy = 0.0
        rest = 0.0
        for i in range(model.size):
            m = float(model[i])
            y = float(luma[i])
            expected = gain * m + offset
            if tolerance < expected < clip - tolerance and abs(y - expected) <= reach:
                n += 1
                sm += m
                sy += y
                smm += m * m
                smy += m * y
                rest += abs(y - expected)
        held = n * (1.0 + OFFSET_PRIOR)
        det = smm * held - sm * sm
        if n < PIXELS_MIN or det <= 0.0:
            break
        before = gain, offset, reach
        gain = (smy * held - sm * sy) / det
        offset = (smm * sy - sm * smy) / det
        reach = min(max(3.0 * rest / n, TOLERANCE_MIN), tolerance)
        if gain == before[0] and offset == before[1] and reach == before[2]:
            break  # further rounds would repeat this one
    return gain, offset
