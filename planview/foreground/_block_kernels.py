"""Blocks of pixels in memory, without checks; tests/reference/foreground.py has them as plain arrays.

The leading Gaussians of BLOCK pixels lie together, one plane per field, and so do the observations of the block that is
being updated: loops over a block then run on vector registers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground._gaussian_kernels import (
    DEPTH_FRACTION,
    ONE,
    VAR_D,
    VAR_U,
    VAR_V,
    VAR_Y,
    ZERO,
    D,
    F,
    Gaussian,
    Pixel,
    U,
    UpdateConstants,
    V,
    Y,
)

BLOCK = 128
"""Pixels whose leading Gaussians lie together; all their planes fit the first-level cache."""

# Kept per pixel beside its leading Gaussian: the mean absolute change of luma, and the last luma.
ACTIVITY, LAST_Y = 10, 11
N_LEAD = 12
# Planes of the scratch block beside Y, U, V and D of the observation: what else is known, and what the first pass
# leaves to the second.
CHROMA, FEEDBACK, RATE_W, RATE_M, UNMATCHED, MEASURED, KIND_LEADER = 0, 1, 6, 7, 8, 9, 10
N_SCRATCH = 11
# Unsigned indices: those that cannot be negative let LLVM vectorise a loop.
AT_Y, AT_U, AT_V = np.uintp(Y * BLOCK), np.uintp(U * BLOCK), np.uintp(V * BLOCK)
AT_D, AT_CHROMA, AT_FEEDBACK = np.uintp(D * BLOCK), np.uintp(CHROMA * BLOCK), np.uintp(FEEDBACK * BLOCK)
AT_MEASURED = np.uintp(MEASURED * BLOCK)
ONE_STEP, TWO_STEPS, THREE = np.uintp(1), np.uintp(2), np.uintp(3)


@njit(cache=True, nogil=True)
def stage_grey(image: U8, n: int, s: UpdateConstants, obs: F32) -> None:
    """Luma of n grey pixels into the scratch block."""
    inv_gain = ONE / s.gain
    for i in range(np.uintp(n)):
        obs[AT_Y + i] = min((F(image[i]) - s.offset) * inv_gain, s.clip)
        obs[AT_U + i] = ZERO
        obs[AT_V + i] = ZERO
        obs[AT_CHROMA + i] = ZERO


@njit(cache=True, nogil=True)
def stage_colour(image: U8, n: int, s: UpdateConstants, obs: F32) -> None:
    """Luma and chroma (BT.601, analogue scale) of n BGR pixels into the scratch block."""
    inv_gain = ONE / s.gain
    bright = F(0.75) * s.clip_image
    for i in range(np.uintp(n)):
        j = THREE * i
        blue, green, red = F(image[j]), F(image[j + ONE_STEP]), F(image[j + TWO_STEPS])
        luma = F(0.299) * red + F(0.587) * green + F(0.114) * blue
        obs[AT_Y + i] = min((luma - s.offset) * inv_gain, s.clip)
        obs[AT_U + i] = F(0.492) * (blue - luma) * inv_gain
        obs[AT_V + i] = F(0.877) * (red - luma) * inv_gain
        # A clipped channel shifts the hue; a dim saturated colour keeps it.
        clipped = (max(max(blue, green), red) >= s.clip_image) & (luma >= bright)
        obs[AT_CHROMA + i] = ZERO if clipped else ONE


@njit(cache=True, nogil=True)
def stage(
    image: U8,
    disparity: F32,
    feedback: U8,
    measured: U8,
    start: int,
    n: int,
    colour: bool,
    s: UpdateConstants,
    obs: F32,
) -> None:
    """Observation of n pixels into the scratch block; flat arrays, disparity and feedback empty for none, measured
    empty for everywhere."""
    if colour:
        stage_colour(image[3 * start : 3 * (start + n)], n, s, obs)
    else:
        stage_grey(image[start : start + n], n, s, obs)
    # Loops, since assigned slices are tested for overlap and copied number by number.
    if disparity.size:
        depths = disparity[start : start + n]
        for i in range(np.uintp(n)):
            obs[AT_D + i] = depths[i]
    else:
        obs[D * BLOCK : (D + 1) * BLOCK] = F(np.nan)
    if feedback.size:
        known = feedback[start : start + n]
        for i in range(np.uintp(n)):
            obs[AT_FEEDBACK + i] = F(known[i])
    else:
        obs[FEEDBACK * BLOCK : (FEEDBACK + 1) * BLOCK] = ZERO
    if measured.size:
        here = measured[start : start + n]
        for i in range(np.uintp(n)):
            obs[AT_MEASURED + i] = ONE if here[i] > 0 else ZERO
    else:
        obs[MEASURED * BLOCK : (MEASURED + 1) * BLOCK] = ONE


@njit(cache=True, nogil=True)
def load(a: F32, base: int, stride: int) -> Gaussian:
    """A Gaussian whose numbers are ``stride`` apart."""
    return Gaussian(
        a[base + DEPTH_FRACTION * stride],
        a[base + Y * stride],
        a[base + U * stride],
        a[base + V * stride],
        a[base + D * stride],
        a[base + VAR_Y * stride],
        a[base + VAR_U * stride],
        a[base + VAR_V * stride],
        a[base + VAR_D * stride],
    )


@njit(cache=True, nogil=True)
def store(a: F32, base: int, stride: int, g: Gaussian) -> None:
    """Undo ``load``."""
    a[base + DEPTH_FRACTION * stride] = g.depth_fraction
    a[base + Y * stride] = g.y
    a[base + U * stride] = g.u
    a[base + V * stride] = g.v
    a[base + D * stride] = g.d
    a[base + VAR_Y * stride] = g.var_y
    a[base + VAR_U * stride] = g.var_u
    a[base + VAR_V * stride] = g.var_v
    a[base + VAR_D * stride] = g.var_d


@njit(cache=True, nogil=True)
def observed(obs: F32, i: int) -> Pixel:
    """Observation i of the scratch block."""
    return Pixel(
        obs[Y * BLOCK + i],
        obs[U * BLOCK + i],
        obs[V * BLOCK + i],
        obs[D * BLOCK + i],
        obs[CHROMA * BLOCK + i],
        obs[MEASURED * BLOCK + i],
    )


@njit(cache=True, nogil=True)
def any_measured(measured: U8, start: int, n: int) -> bool:
    """Whether disparity was looked for at one of n pixels."""
    here, total = measured[start : start + n], np.uint8(0)
    for i in range(np.uintp(n)):
        total |= here[i]
    return bool(total > 0)
