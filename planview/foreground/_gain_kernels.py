"""Kernels of the gain estimate, without checks; tests/reference/gain.py defines them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from calib.types import F32

LADDER_STEP = 0.05
"""Distance of the gains tried, in log gain: 5 % of mid grey is within the tolerance of an unchanged pixel."""
LADDER_STEPS = 40
"""Gains tried on either side of 1: a factor 7, as between lamps off and on."""
PAIR_STEP = 1009
"""Walks through the pixels in a fixed, scattered order (a prime)."""
THINNING = 4
"""Candidates are ranked on every fourth pixel."""
GAIN_MAX, OFFSET_MAX = 8.0, 100.0
"""Gains and offsets beyond are no camera's: veiling glare and tone curves look like offsets of up to 80 levels."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def fill_information(luma: F32, tolerance: float, information: F32) -> None:
    """Evidence of each pixel for a line that it lies on [nat]: the less, the more of the image has its luma by chance.

    Whatever covers most of the image in one luma lies on any line of that luma.
    """
    below = np.zeros(257)
    for i in range(luma.size):
        below[int(luma[i]) + 1] += 1.0 / luma.size
    for level in range(256):
        below[level + 1] += below[level]
    reach = int(tolerance)
    of_level = np.empty(256, np.float32)
    for level in range(256):
        first, last = max(level - reach, 0), min(level + reach, 255)
        by_chance = (1.0 - ANY_LUMA) * (below[last + 1] - below[first]) + ANY_LUMA * (last + 1 - first) / 256.0
        of_level[level] = -math.log(by_chance)
    for i in range(luma.size):
        information[i] = of_level[int(luma[i])]


@njit(cache=True, nogil=True, error_model="numpy")
def weigh_inliers(
    model: F32, luma: F32, information: F32, gain: float, offset: float, clip: float, tolerance: float, step: int
) -> tuple[int, float]:
    """Number of the pixels, of every step-th, within the tolerance of the line (clipped at both ends), and what they
    weigh."""
    n, evidence = 0, 0.0
    for i in range(0, model.size, step):
        expected = min(max(gain * model[i] + offset, 0.0), clip)
        if abs(min(luma[i], clip) - expected) <= tolerance:
            n += 1
            evidence += information[i]
    return n, evidence


@njit(cache=True, nogil=True, error_model="numpy")
def consensus_line(
    model: F32, luma: F32, information: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """The line through two pixels, or the given one, with the largest evidence (consensus over fixed pairs)."""
    best = gain, offset
    most = weigh_inliers(model, luma, information, gain, offset, clip, tolerance, THINNING)[1]
    n = model.size
    # Lines tried: if only 30 % of the pixels are unchanged, 13 of them join two such pixels.
    for k in range(150):
        i, j = (k * PAIR_STEP) % n, (k * PAIR_STEP + n // 2 + k) % n
        run = model[j] - model[i]
        # Smallest difference of luma of two pixels that define a line [levels]: four times the noise.
        if abs(run) < 15.0 or max(luma[i], luma[j]) >= clip or min(luma[i], luma[j]) <= BLACK:
            continue
        gain = (luma[j] - luma[i]) / run
        offset = luma[i] - gain * model[i]
        if 1.0 / GAIN_MAX < gain < GAIN_MAX and abs(offset) < OFFSET_MAX:
            evidence = weigh_inliers(model, luma, information, gain, offset, clip, tolerance, THINNING)[1]
            if evidence > most:
                best, most = (gain, offset), evidence
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def consensus_scale(model: F32, luma: F32, information: F32, clip: float, tolerance: float) -> float:
    """The smallest gain of a ladder with the largest evidence, without offset: it works on clipped images, too."""
    best, most = 1.0, 0.0
    for k in range(-LADDER_STEPS, LADDER_STEPS + 1):
        gain = math.exp(k * LADDER_STEP)
        evidence = weigh_inliers(model, luma, information, gain, 0.0, clip, tolerance, THINNING)[1]
        if evidence > most:
            best, most = gain, evidence
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def refine_gain(
    model: F32, luma: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """Least squares of luma = gain * model + offset over inliers, repeated with a narrower tolerance.

    Pixels are chosen by their expected luma, not by their own, so that clipping does not bias the fit.
    """
    reach = tolerance
    for _ in range(ROUNDS):
        n, sm, sy, smm, smy, rest = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(model.size):
            m, y = float(model[i]), float(luma[i])
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
        gain, offset = (smy * held - sm * sy) / det, (smm * sy - sm * smy) / det
        reach = min(max(3.0 * rest / n, TOLERANCE_MIN), tolerance)
        if gain == before[0] and offset == before[1] and reach == before[2]:
            break  # further rounds would repeat this one
    return gain, offset
