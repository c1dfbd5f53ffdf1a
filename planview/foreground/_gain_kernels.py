"""Kernels of the gain estimate, without checks; tests/reference/gain.py defines them."""

from __future__ import annotations

import math

from numba import njit

from calib.types import F32, U8
from planview.foreground._gaussian_kernels import VAR_Y, Y
from planview.foreground._mixture_kernels import BLOCK

LADDER_STEP = 0.05
"""Distance of the gains tried, in log gain: 5 % of mid grey is within the tolerance of an unchanged pixel."""
LADDER_STEPS = 40
"""Gains tried on either side of 1: a factor 7, as between lamps off and on."""
PAIRS = 150
"""Lines tried: if only 30 % of the pixels are unchanged, 13 of them join two such pixels."""
PAIR_STEP = 1009
"""Walks through the pixels in a fixed, scattered order (a prime)."""
LEAST_RUN = 15.0
"""Least difference of luma of two pixels that fix a line [levels]: four times the noise."""
THINNING = 4
"""Candidates are ranked on every fourth pixel."""
LARGEST_GAIN, LARGEST_OFFSET = 8.0, 100.0
"""Lines outside are no camera's: veiling glare and tone curves look like offsets of up to 80 levels."""
BLACK = 2.0
"""Luma that tells nothing: outside the lens, or below the black level [levels]."""
ROUNDS = 6
"""Rounds of refinement; the tolerance settles in three or four."""
NARROWEST = 3.0
"""Narrowest tolerance [levels of 255]: rounding and compression."""
OFFSET_PRIOR = 0.002
"""Weight of "the offset is 0" beside the pixels: decides where all pixels are alike."""
FEWEST = 16
"""Fewest pixels a fit may rest on."""


@njit(cache=True, nogil=True)
def sample_lumas(lead: F32, image: U8, colour: bool, n_pixels: int, stride: int, model: F32, seen: F32) -> int:
    """Background luma and image luma of every stride-th pixel; bounds and black tell nothing. Returns how many."""
    n = 0
    for p in range(0, n_pixels, stride):
        block, i = p // BLOCK, p % BLOCK
        if lead[block, VAR_Y * BLOCK + i] <= 0 or lead[block, Y * BLOCK + i] <= BLACK:
            continue
        model[n] = lead[block, Y * BLOCK + i]
        if not colour:
            seen[n] = image[p]
        else:
            seen[n] = 0.114 * image[3 * p] + 0.587 * image[3 * p + 1] + 0.299 * image[3 * p + 2]
        n += 1
    return n


@njit(cache=True, nogil=True)
def count_inliers(model: F32, seen: F32, gain: float, offset: float, clip: float, tolerance: float, step: int) -> int:
    """Pixels, of every step-th, whose luma is explained; what must clip at either end and does is explained."""
    n = 0
    for i in range(0, model.size, step):
        expected = min(max(gain * model[i] + offset, 0.0), clip)
        n += abs(min(seen[i], clip) - expected) <= tolerance
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def likeliest_gain(
    model: F32, seen: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """The line through two pixels, or the given one, that explains most pixels (consensus over fixed pairs)."""
    best = gain, offset
    best_count = count_inliers(model, seen, gain, offset, clip, tolerance, THINNING)
    n = model.size
    for k in range(PAIRS):
        i, j = (k * PAIR_STEP) % n, (k * PAIR_STEP + n // 2 + k) % n
        run = model[j] - model[i]
        if abs(run) < LEAST_RUN or max(seen[i], seen[j]) >= clip or min(seen[i], seen[j]) <= BLACK:
            continue
        gain = (seen[j] - seen[i]) / run
        offset = seen[i] - gain * model[i]
        if 1.0 / LARGEST_GAIN < gain < LARGEST_GAIN and abs(offset) < LARGEST_OFFSET:
            count = count_inliers(model, seen, gain, offset, clip, tolerance, THINNING)
            if count > best_count:
                best, best_count = (gain, offset), count
    return best


@njit(cache=True, nogil=True)
def likeliest_scale(model: F32, seen: F32, clip: float, tolerance: float) -> float:
    """The smallest gain of a ladder that explains most pixels, without offset: it works on clipped images, too."""
    best, best_count = 1.0, 0
    for k in range(-LADDER_STEPS, LADDER_STEPS + 1):
        gain = math.exp(k * LADDER_STEP)
        count = count_inliers(model, seen, gain, 0.0, clip, tolerance, THINNING)
        if count > best_count:
            best, best_count = gain, count
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def refine_gain(
    model: F32, seen: F32, gain: float, offset: float, clip: float, tolerance: float
) -> tuple[float, float]:
    """Least squares of seen = gain * model + offset over inliers, again and again with a narrower tolerance.

    Pixels are chosen by what they should show, not by what they show, so that clipping does not bias the fit.
    """
    reach = tolerance
    for _ in range(ROUNDS):
        n, sm, sy, smm, smy, rest = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(model.size):
            m, y = float(model[i]), float(seen[i])
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
        if n < FEWEST or det <= 0.0:
            break
        gain, offset = (smy * held - sm * sy) / det, (smm * sy - sm * smy) / det
        reach = min(max(3.0 * rest / n, NARROWEST), tolerance)
    return gain, offset
