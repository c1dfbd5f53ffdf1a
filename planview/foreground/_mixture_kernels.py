"""Kernels of the foreground stage, without checks; tests/reference/foreground.py defines them.

One test of the leading Gaussian settles nearly every pixel. The others are touched only where the leader did not match;
their weights are stored as shares of what the leader leaves, so that a match of the leader changes none of them.

Numba's cache of this file does not notice changes of the other kernel files here: change or touch all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground._block_kernels import (
    ACTIVITY,
    BLOCK,
    FEEDBACK,
    LAST_Y,
    MEASURED,
    N_SCRATCH,
    RATE_M,
    RATE_W,
    UNMATCHED,
    load,
    observed,
    stage,
    store,
)
from planview.foreground._gaussian_kernels import (
    DEPTH_FRACTION,
    N_FIELDS,
    NO_MATCH,
    ONE,
    VAR_U,
    VAR_V,
    VAR_Y,
    WEIGHT,
    ZERO,
    D,
    F,
    Gaussian,
    Pixel,
    Rates,
    Real,
    U,
    UpdateConstants,
    V,
    Y,
    is_nearer,
    is_other_light,
    learned,
    match_kind,
    started,
)
from planview.foreground._rank_kernels import settle_order
from planview.foreground.masks import BACKGROUND, FOREGROUND, NEARER, PERSON, SHADOW

# The functions of the second pass are inlined by force: passing a UpdateConstants by value costs more than they do.


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, n: int, s: UpdateConstants) -> None:
    """Test n pixels against their leading Gaussian: no branches, so that it vectorises."""
    for i in range(n):
        kind = match_kind(load(lead, i, BLOCK), observed(obs, i), s)
        obs[UNMATCHED * BLOCK + i] = obs[MEASURED * BLOCK + i] if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def learn_leaders(lead: F32, obs: F32, n: int, s: UpdateConstants, rates: Rates) -> None:
    """Test n pixels against their leading Gaussian and learn where it matches: no branches, so that it vectorises."""
    for i in range(n):
        o = observed(obs, i)
        # Activity slows learning (Harville et al. 2001), a person stops it, and known background learns fast (Harville
        # 2002, ECCV).
        change = abs(o.y - lead[LAST_Y * BLOCK + i])
        activity = lead[ACTIVITY * BLOCK + i] + rates.activity * (change - lead[ACTIVITY * BLOCK + i])
        lead[ACTIVITY * BLOCK + i] = activity
        lead[LAST_Y * BLOCK + i] = o.y
        feedback = obs[FEEDBACK * BLOCK + i]
        slow = s.slow_active if activity > s.active else ONE
        slow = ZERO if feedback == F(PERSON) else slow
        known = feedback == F(BACKGROUND)
        rate_w = rates.fast if known else rates.weight * slow
        rate_m = rates.fast if known else rates.mean * slow
        obs[RATE_W * BLOCK + i] = rate_w
        obs[RATE_M * BLOCK + i] = rate_m

        g = load(lead, i, BLOCK)
        kind = match_kind(g, o, s)
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        store(lead, i, BLOCK, learned(g, o, kind, rate_m, s))
        obs[UNMATCHED * BLOCK + i] = o.measured if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, forceinline=True)
def first_match(rest: F32, first: int, end: int, o: Pixel, s: UpdateConstants) -> tuple[int, int]:
    """Where the first matching Gaussian of the rest starts (-1: none does), and how it matches."""
    for b in range(first, end, N_FIELDS):
        if rest[b + WEIGHT] > ZERO:
            kind = match_kind(load(rest, b, 1), o, s)
            if kind != NO_MATCH:
                return b, kind
    return -1, NO_MATCH


@njit(cache=True, nogil=True)
def is_background(lead: F32, i: int, rest: F32, first: int, end: int, b: int, s: UpdateConstants) -> bool:
    """Whether the Gaussian at rest[b] is in the background set: by leading weight, or as the deepest."""
    before = lead[WEIGHT * BLOCK + i]
    left = ONE - before
    for j in range(first, b, N_FIELDS):
        before += left * rest[j + WEIGHT]
    if before <= s.background_weight:
        return True
    if left * rest[b + WEIGHT] <= s.deepest_weight or rest[b + DEPTH_FRACTION] < s.min_depth_fraction:
        return False
    deep = lead[WEIGHT * BLOCK + i] > s.deepest_weight and lead[DEPTH_FRACTION * BLOCK + i] >= s.min_depth_fraction
    if deep and lead[D * BLOCK + i] < rest[b + D]:
        return False
    for j in range(first, end, N_FIELDS):
        deep = left * rest[j + WEIGHT] > s.deepest_weight and rest[j + DEPTH_FRACTION] >= s.min_depth_fraction
        if deep and rest[j + D] < rest[b + D]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_uncovered(g: Gaussian, o: Pixel, s: UpdateConstants) -> tuple[bool, bool]:
    """Whether an observation that its leader g does not match is (unclipped, behind) it.

    Both are background not observed so far. A surface that was clipped may turn out brighter than that; what
    appears behind the background was hidden by a person or a thing before: none can stand there.
    """
    dd = o.d - g.d
    both = o.d == o.d and g.depth_fraction >= s.min_depth_fraction
    agree = dd * dd < s.beta * g.var_d
    return g.var_y < ZERO and o.y > g.y and (agree or not both), both and not agree and dd < ZERO


@njit(cache=True, nogil=True, forceinline=True)
def classify(
    lead: F32, i: int, rest: F32, first: int, end: int, found: int, unclipped: bool, o: Pixel, s: UpdateConstants
) -> int:
    """FOREGROUND, NEARER, SHADOW or 0 for a pixel whose leader does not match but whose Gaussian at rest[found] may."""
    if unclipped or (found >= 0 and is_background(lead, i, rest, first, end, found, s)):
        return 0
    leader = load(lead, i, BLOCK)
    darkest = s.colour_shadow_ratio
    if darkest > ZERO and o.d != o.d and o.y < leader.y and is_other_light(leader, o, o.chroma > ZERO, darkest, s):
        return SHADOW
    return NEARER if is_nearer(leader, o, s) else FOREGROUND


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def learn_rest(
    lead: F32,
    i: int,
    rest: F32,
    first: int,
    end: int,
    found: int,
    kind: int,
    o: Pixel,
    rate_w: Real,
    rate_m: Real,
    s: UpdateConstants,
) -> None:
    """Learn a pixel whose leader did not match: by the Gaussian at rest[found], or a new one for the last."""
    keep = ONE - rate_w
    left = (ONE - lead[WEIGHT * BLOCK + i]) * keep
    lead[WEIGHT * BLOCK + i] *= keep
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= left
    if found >= 0:
        rest[found + WEIGHT] += rate_w
        store(rest, found, 1, learned(load(rest, found, 1), o, kind, rate_m, s))
    else:
        rest[end - N_FIELDS + WEIGHT] = rate_w
        store(rest, end - N_FIELDS, 1, started(o, s))
    settle_order(lead, i, rest, first, end)


@njit(cache=True, nogil=True, forceinline=True)
def update_pixel(lead: F32, i: int, rest: F32, first: int, end: int, obs: F32, s: UpdateConstants, rates: Rates) -> int:
    """Pixel i of a block, whose leader did not match: its other Gaussians are rest[first:end]. Returns its mask."""
    o = observed(obs, i)
    found, kind = first_match(rest, first, end, o, s)
    unclipped, behind = is_uncovered(load(lead, i, BLOCK), o, s)
    mask = classify(lead, i, rest, first, end, found, unclipped, o, s)
    rate_w, rate_m = obs[RATE_W * BLOCK + i], obs[RATE_M * BLOCK + i]
    if rates.weight > ZERO and rate_w > ZERO:
        young = found < 0 or (ONE - lead[WEIGHT * BLOCK + i]) * rest[found + WEIGHT] <= s.deepest_weight
        if (unclipped or behind) and young:
            rate_w, rate_m = max(rate_w, rates.fast), max(rate_m, rates.fast)
        learn_rest(lead, i, rest, first, end, found, kind, o, rate_w, rate_m, s)
    return mask


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
    colour = image.size > mask.size
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    size = rest.size // mask.size
    for block in range(first, last):
        start = block * BLOCK
        n = min(BLOCK, mask.size - start)
        turn = block % turns.shape[0]
        rates = Rates(turns[turn, 0], turns[turn, 1], turns[turn, 2], turns[turn, 3])
        if measured.size and rates.weight <= ZERO and not measured[start : start + n].any():
            mask[start : start + n] = 0
            continue
        stage(image, disparity, feedback, measured, start, n, colour, s, obs)
        leaders = lead[block]
        if rates.weight > ZERO:
            learn_leaders(leaders, obs, n, s, rates)
        else:
            match_leaders(leaders, obs, n, s)
        unmatched = 0
        for i in range(n):
            mask[start + i] = 0
            unmatched += obs[UNMATCHED * BLOCK + i] > ZERO
        if unmatched == 0:
            continue
        for i in range(n):
            if obs[UNMATCHED * BLOCK + i] > ZERO:
                at = (start + i) * size
                mask[start + i] = update_pixel(leaders, i, rest, at, at + size, obs, s, rates)


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
