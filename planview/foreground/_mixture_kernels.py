"""Kernels of the foreground stage, without checks; tests/reference/foreground.py defines them.

One test of the leading Gaussian settles nearly every pixel. The others are touched only where the leader did not match;
their weights are stored as shares of what the leader leaves, so that a match of the leader changes none of them.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8, U64
from planview.foreground._block_kernels import (
    ACTIVITY,
    BLOCK,
    LAST_Y,
    N_SCRATCH,
    RATE_M,
    RATE_W,
    UNMATCHED,
    any_measured,
    load,
    observed,
    stage,
    store,
)
from planview.foreground._gaussian_kernels import (
    N_FIELDS,
    ONE,
    VAR_U,
    VAR_V,
    VAR_Y,
    WEIGHT,
    ZERO,
    F,
    Rates,
    Real,
    U,
    UpdateConstants,
    V,
    Y,
    learned,
    started,
)
from planview.foreground._leader_kernels import learn_leaders, match_colours, match_leaders
from planview.foreground._rank_kernels import settle_order
from planview.foreground._rest_kernels import (
    BEHIND,
    FAST,
    FOUND,
    KIND,
    MASK,
    OTHERS,
    UNCLIPPED,
    find_matches,
    gather,
    gather_others,
)

# Functions of single pixels are inlined by force: passing a UpdateConstants by value costs more than they do.


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def learn_rest(
    lead: F32, i: int, rest: F32, first: int, end: int, found: int, side: F32, j: int, rates: tuple[Real, Real],
    s: UpdateConstants,
) -> None:  # fmt: skip
    """Learn a pixel whose leader did not match: by the Gaussian at rest[found], or a new one for the last.

    Args:
        i: the pixel in its block. j: the same among those gathered. rates: of weight and of mean.
    """
    keep = ONE - rates[0]
    left = (ONE - lead[WEIGHT * BLOCK + i]) * keep
    lead[WEIGHT * BLOCK + i] *= keep
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= left
    o = observed(side, j)
    if found >= 0:
        rest[found + WEIGHT] += rates[0]
        store(rest, found, 1, learned(load(rest, found, 1), o, side[KIND * BLOCK + j], rates[1], s))
    else:
        rest[end - N_FIELDS + WEIGHT] = rates[0]
        store(rest, end - N_FIELDS, 1, started(o, s))
    settle_order(lead, i, rest, first, end)


@njit(cache=True, nogil=True)
def learn_gathered(lead: F32, rest: F32, side: F32, chosen: U64, s: UpdateConstants) -> None:
    """Learn those of the gathered pixels that may learn."""
    size = len(side) // BLOCK - OTHERS
    for j in range(len(chosen)):
        rate_w, rate_m, fast = side[RATE_W * BLOCK + j], side[RATE_M * BLOCK + j], side[FAST * BLOCK + j]
        if fast <= ZERO or rate_w <= ZERO:
            continue
        pixel = int(chosen[j])
        leaders, i = lead[pixel // BLOCK], pixel % BLOCK
        first, other = pixel * size, int(side[FOUND * BLOCK + j])
        found = first + (other - 1) * N_FIELDS if other > 0 else -1
        young = found < 0 or (ONE - leaders[WEIGHT * BLOCK + i]) * rest[found + WEIGHT] <= s.deepest_weight
        if young and side[UNCLIPPED * BLOCK + j] + side[BEHIND * BLOCK + j] > ZERO:
            rate_w, rate_m = max(rate_w, fast), max(rate_m, fast)
        learn_rest(leaders, i, rest, first, first + size, found, side, j, (rate_w, rate_m), s)


@njit(cache=True, nogil=True)
def settle(lead: F32, rest: F32, side: F32, chosen: U64, mask: U8, s: UpdateConstants) -> None:
    """Mask of the gathered pixels, and what they learn."""
    gather_others(rest, chosen, len(chosen), side)
    find_matches(side, s)
    for j in range(len(chosen)):
        mask[chosen[j]] = int(side[MASK * BLOCK + j])
    learn_gathered(lead, rest, side, chosen, s)


@njit(cache=True, nogil=True)
def unmatched(obs: F32, n: int, places: U64) -> int:
    """Fill in which of a block's n pixels are UNMATCHED, and return their number."""
    m = 0
    for i in range(n):
        places[m] = i
        m += obs[UNMATCHED * BLOCK + i] > ZERO
    return m


@njit(cache=True, nogil=True)
def update_blocks(
    lead: F32,
    rest: F32,
    image: U8,
    disparity: F32,
    feedback: U8,
    measured: U8,
    mask: U8,
    first: int,
    last: int,
    s: UpdateConstants,
    turns: F32,
) -> None:
    """Update blocks first..last-1 and write their part of the mask.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. rest: (N * (K-1) * N_FIELDS,) the others.
        image: (N,) or (3 N,) uint8. disparity: (N,) float32 or empty. feedback: (N,) uint8 or empty. mask: (N,) uint8.
        measured: (N,) uint8, 0 where disparity was not looked for, or empty: such a pixel is background, and what it
            teaches is the colour of its leader, if it matches that.
        turns: (T, 4) the rates of blocks b = t modulo T; a row of zeros does not learn.
    """
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    side = np.zeros((OTHERS + rest.size // mask.size) * BLOCK, np.float32)
    places, chosen, taken = np.zeros(BLOCK + 1, np.uint64), np.zeros(BLOCK, np.uint64), 0
    mask[first * BLOCK : last * BLOCK] = 0
    for block in range(first, last):
        start = block * BLOCK
        n = min(BLOCK, mask.size - start)
        turn = block % turns.shape[0]
        rates = Rates(turns[turn, 0], turns[turn, 1], turns[turn, 2], turns[turn, 3])
        learns = rates.weight > ZERO
        if measured.size and not learns and not any_measured(measured, start, n):
            continue
        stage(image, disparity, feedback, measured, start, n, image.size > mask.size, s, obs)
        if learns:
            learn_leaders(lead[block], obs, s, rates, disparity.size > 0)
        elif disparity.size:
            match_leaders(lead[block], obs, s)
        else:
            match_colours(lead[block], obs, s)
        m, done = unmatched(obs, n, places), 0
        while done < m:
            some = places[done : min(m, done + BLOCK - taken)]
            gather(lead[block], obs, some, start, rates.fast if learns else ZERO, side, chosen, taken)
            done, taken = done + len(some), taken + len(some)
            if taken == BLOCK:
                settle(lead, rest, side, chosen, mask, s)
                taken = 0
    settle(lead, rest, side, chosen[:taken], mask, s)


@njit(cache=True, nogil=True)
def start_blocks(lead: F32, rest: F32, image: U8, disparity: F32, n_pixels: int, s: UpdateConstants) -> None:
    """First frame: every leader starts at the observation with all the weight, the rest without any."""
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    empty = np.zeros(0, np.uint8)
    lead[:, :] = ONE
    rest[:] = ONE
    for b in range(0, rest.size, N_FIELDS):
        rest[b + WEIGHT] = ZERO
    for block in range(lead.shape[0]):
        start = block * BLOCK
        n = min(BLOCK, n_pixels - start)
        stage(image, disparity, empty, empty, start, n, image.size > n_pixels, s, obs)
        for i in range(n):
            o = observed(obs, i)
            store(lead[block], i, BLOCK, started(o, s))
            lead[block, ACTIVITY * BLOCK + i] = ZERO
            lead[block, LAST_Y * BLOCK + i] = o.y


@njit(cache=True, nogil=True)
def rebase(lead: F32, rest: F32, gain: Real, offset: Real) -> None:
    """Bring all means, variances and lumas into the exposure of the image: luma = gain * luma + offset."""
    factor, shift = F(gain), F(offset)
    for block in range(lead.shape[0]):
        for i in range(BLOCK):
            for f in (Y, LAST_Y):
                lead[block, f * BLOCK + i] = factor * lead[block, f * BLOCK + i] + shift
            for f in (U, V, ACTIVITY):
                lead[block, f * BLOCK + i] *= factor
            for f in (VAR_Y, VAR_U, VAR_V):
                lead[block, f * BLOCK + i] *= factor * factor
    for b in range(0, rest.size, N_FIELDS):
        rest[b + Y] = factor * rest[b + Y] + shift
        for f in (U, V):
            rest[b + f] *= factor
        for f in (VAR_Y, VAR_U, VAR_V):
            rest[b + f] *= factor * factor
