"""Mixtures of Gaussians per pixel, without checks; tests/reference/foreground.py defines them.

One test of the leading Gaussian settles nearly every pixel. The others are touched only where the leader did not match;
their weights are stored as shares of what the leader leaves, so that a match of the leader changes none of them.
People cover few pixels, but each costs a test of all its Gaussians. They are gathered side by side, so that loops over
them run on vector registers. Loops run over all places, taken or not: a fixed number leaves no rest to be done one by
one. Indices are unsigned, which spares the test for negative ones.

Numba's cache of this file does not notice changes of _leader_kernels: change or touch both.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8, U64
from planview.foreground._leader_kernels import (
    ACTIVITY,
    BLOCK,
    DEPTH_FRACTION,
    LAST_Y,
    N_FIELDS,
    N_SCRATCH,
    NO_MATCH,
    ONE,
    RATE_M,
    RATE_W,
    UNMATCHED,
    VAR_U,
    VAR_V,
    VAR_Y,
    WEIGHT,
    ZERO,
    D,
    F,
    Rates,
    Real,
    U,
    UpdateConstants,
    V,
    Y,
    any_measured,
    is_nearer,
    is_other_light,
    learn_leaders,
    learned,
    load,
    match_colours,
    match_kind,
    match_leaders,
    observed,
    stage,
    started,
    store,
)
from planview.foreground.params import FOREGROUND, NEARER, SHADOW


@njit(cache=True, nogil=True, error_model="numpy")
def outranks(weight: Real, var: Real, other_weight: Real, other_var: Real) -> bool:
    """Whether weight / sigma exceeds that of another Gaussian, without square roots."""
    return bool(weight * weight * abs(other_var) > other_weight * other_weight * abs(var))


@njit(cache=True, nogil=True, error_model="numpy")
def sort_rest(rest: F32, first: int, end: int) -> None:
    """Sort Gaussians by decreasing weight / luma deviation (insertion sort, stable)."""
    for start in range(first + N_FIELDS, end, N_FIELDS):
        b = start
        while b > first and outranks(
            rest[b + WEIGHT], rest[b + VAR_Y], rest[b - N_FIELDS + WEIGHT], rest[b - N_FIELDS + VAR_Y]
        ):
            for f in range(b, b + N_FIELDS):
                rest[f], rest[f - N_FIELDS] = rest[f - N_FIELDS], rest[f]
            b -= N_FIELDS


@njit(cache=True, nogil=True, error_model="numpy")
def settle_order(lead: F32, i: int, rest: F32, first: int, end: int) -> None:
    """Normalise the true weights, put the mixture in order and turn the weights of the rest into shares."""
    total = lead[WEIGHT * BLOCK + i]
    for b in range(first, end, N_FIELDS):
        total += rest[b + WEIGHT]
    scale = ONE / total
    lead[WEIGHT * BLOCK + i] *= scale
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= scale
    sort_rest(rest, first, end)
    if outranks(rest[first + WEIGHT], rest[first + VAR_Y], lead[WEIGHT * BLOCK + i], lead[VAR_Y * BLOCK + i]):
        for f in range(N_FIELDS):
            rest[first + f], lead[f * BLOCK + i] = lead[f * BLOCK + i], rest[first + f]
        sort_rest(rest, first, end)
    left = ONE - lead[WEIGHT * BLOCK + i]
    inv_left = ONE / left if left > ZERO else ZERO
    for b in range(first, end, N_FIELDS):
        rest[b + WEIGHT] *= inv_left


# Planes of the gathered pixels: those of the scratch block, what is found, then the Gaussians, the leader first.
FAST, FOUND, KIND, BEFORE, IS_BACKGROUND, UNCLIPPED, BEHIND, MASK = range(N_SCRATCH, N_SCRATCH + 8)
FOUND_WEIGHT, FOUND_FRACTION, FOUND_D, KIND_NOW = range(MASK + 1, MASK + 5)
LEADER = KIND_NOW + 1
OTHERS = LEADER + N_FIELDS


@njit(cache=True, nogil=True, error_model="numpy")
def pick(source: F32, plane: int, places: U64, side: F32, target: int, taken: int) -> None:
    """Put the numbers of a block's plane that stand at some places behind those gathered so far."""
    values = source[plane * BLOCK : (plane + 1) * BLOCK]
    picked = side[target * BLOCK + taken : (target + 1) * BLOCK]
    for j in range(np.uintp(len(places))):
        picked[j] = values[places[j]]


@njit(cache=True, nogil=True, error_model="numpy")
def gather(lead: F32, obs: F32, places: U64, start: int, fast: Real, side: F32, chosen: U64, taken: int) -> None:
    """Put pixels of one block behind those gathered so far, which are ``taken``.

    Args:
        lead: the block's leading Gaussians. obs: its observations. start: its first pixel. fast: its fastest rate.
        places: of the pixels in the block; their pixels go to ``chosen``.
    """
    for j in range(len(places)):
        chosen[taken + j] = start + places[j]
    side[FAST * BLOCK + taken : FAST * BLOCK + taken + len(places)] = fast
    for plane in range(N_SCRATCH):
        pick(obs, plane, places, side, plane, taken)
    for f in range(N_FIELDS):
        pick(lead, f, places, side, LEADER + f, taken)


@njit(cache=True, nogil=True, error_model="numpy")
def gather_others(rest: F32, chosen: U64, taken: int, side: F32) -> None:
    """Add the other Gaussians of the gathered pixels."""
    size = len(side) // BLOCK - OTHERS
    for f in range(size):
        picked = side[(OTHERS + f) * BLOCK : (OTHERS + f + 1) * BLOCK]
        for j in range(np.uintp(taken)):
            picked[j] = rest[chosen[j] * np.uintp(size) + np.uintp(f)]


@njit(cache=True, nogil=True, error_model="numpy")
def begin_search(side: F32, s: UpdateConstants) -> None:
    """Whether what the leader does not match is (unclipped, behind) it.

    Both are background not observed so far. A surface that was clipped may turn out brighter than that; what
    appears behind the background was hidden by a person or a thing before: none can stand there.
    """
    for j in range(BLOCK):
        g, o = load(side, LEADER * BLOCK + j, BLOCK), observed(side, j)
        dd = o.d - g.d
        both = (o.d == o.d) & (g.depth_fraction >= s.min_depth_fraction)
        agree = dd * dd < s.beta * g.var_d
        unclipped = (g.var_y < ZERO) & (o.y > g.y) & (agree | (not both))
        behind = both & (not agree) & (dd < ZERO)
        side[UNCLIPPED * BLOCK + j] = ONE if unclipped else ZERO
        side[BEHIND * BLOCK + j] = ONE if behind else ZERO
        side[FOUND * BLOCK + j] = ZERO
        side[KIND * BLOCK + j] = NO_MATCH
        side[BEFORE * BLOCK + j] = side[(LEADER + WEIGHT) * BLOCK + j]
        side[IS_BACKGROUND * BLOCK + j] = ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def test_other(side: F32, other: int, s: UpdateConstants) -> None:
    """How pixels match their Gaussian number ``other``, from 1: KIND_NOW."""
    others = side[(LEADER + other * N_FIELDS) * BLOCK :]
    for j in range(BLOCK):
        side[KIND_NOW * BLOCK + j] = match_kind(load(others, j, BLOCK), observed(side, j), s)


@njit(cache=True, nogil=True, error_model="numpy")
def keep_first(side: F32, other: int, s: UpdateConstants) -> None:
    """Where Gaussian ``other`` is the first one that matches it is FOUND.

    It is in the background set if those before it have at most the weight T together.
    """
    others = side[(LEADER + other * N_FIELDS) * BLOCK :]
    number = F(other)
    for j in range(BLOCK):
        kind, weight = side[KIND_NOW * BLOCK + j], others[WEIGHT * BLOCK + j]
        before, left = side[BEFORE * BLOCK + j], ONE - side[(LEADER + WEIGHT) * BLOCK + j]
        # All is read before it is chosen from: a branch that reads would not run on vectors.
        found, old_kind, is_background = (
            side[FOUND * BLOCK + j],
            side[KIND * BLOCK + j],
            side[IS_BACKGROUND * BLOCK + j],
        )
        old_weight, old_fraction = side[FOUND_WEIGHT * BLOCK + j], side[FOUND_FRACTION * BLOCK + j]
        old_d, share = side[FOUND_D * BLOCK + j], left * weight
        fraction, d = others[DEPTH_FRACTION * BLOCK + j], others[D * BLOCK + j]
        hit = (found == ZERO) & (weight > ZERO) & (kind != NO_MATCH)
        first = ONE if before <= s.background_weight else ZERO
        side[FOUND * BLOCK + j] = number if hit else found
        side[KIND * BLOCK + j] = kind if hit else old_kind
        side[IS_BACKGROUND * BLOCK + j] = first if hit else is_background
        side[FOUND_WEIGHT * BLOCK + j] = share if hit else old_weight
        side[FOUND_FRACTION * BLOCK + j] = fraction if hit else old_fraction
        side[FOUND_D * BLOCK + j] = d if hit else old_d
        side[BEFORE * BLOCK + j] = before + share


@njit(cache=True, nogil=True, error_model="numpy")
def keep_deepest(side: F32, other: int, s: UpdateConstants) -> None:
    """Take the mark of the deepest, in MASK, from pixels whose Gaussian ``other`` has depth, weight and is deeper."""
    gaussian = side[(LEADER + other * N_FIELDS) * BLOCK :]
    for j in range(BLOCK):
        lead_weight = side[(LEADER + WEIGHT) * BLOCK + j]
        share = (ONE - lead_weight) * gaussian[WEIGHT * BLOCK + j]
        weight = lead_weight if other == 0 else share
        deep = (weight > s.deepest_weight) & (gaussian[DEPTH_FRACTION * BLOCK + j] >= s.min_depth_fraction)
        deeper = deep & (gaussian[D * BLOCK + j] < side[FOUND_D * BLOCK + j])
        mark = side[MASK * BLOCK + j]
        side[MASK * BLOCK + j] = ZERO if deeper else mark


@njit(cache=True, nogil=True, error_model="numpy")
def find_deepest(side: F32, gaussians: int, s: UpdateConstants) -> None:
    """Add to the background set what is found and is the deepest Gaussian with depth and a weight above T_D."""
    for j in range(BLOCK):
        deep = side[FOUND_WEIGHT * BLOCK + j] > s.deepest_weight
        deep &= side[FOUND_FRACTION * BLOCK + j] >= s.min_depth_fraction
        side[MASK * BLOCK + j] = ONE if deep & (side[FOUND * BLOCK + j] > ZERO) else ZERO
    for other in range(gaussians):
        keep_deepest(side, other, s)
    for j in range(BLOCK):
        side[IS_BACKGROUND * BLOCK + j] = max(side[IS_BACKGROUND * BLOCK + j], side[MASK * BLOCK + j])


@njit(cache=True, nogil=True, error_model="numpy")
def classify(side: F32, s: UpdateConstants) -> None:
    """MASK of pixels: FOREGROUND, NEARER, SHADOW or 0."""
    darkest = s.colour_shadow_ratio
    for j in range(BLOCK):
        g, o = load(side, LEADER * BLOCK + j, BLOCK), observed(side, j)
        value = F(NEARER) if is_nearer(g, o, s) else F(FOREGROUND)
        dim = (o.d != o.d) & (o.y < g.y) & (darkest > ZERO)
        value = F(SHADOW) if dim & is_other_light(g, o, o.chroma > ZERO, darkest, s) else value
        background = (side[UNCLIPPED * BLOCK + j] > ZERO) | (side[IS_BACKGROUND * BLOCK + j] > ZERO)
        side[MASK * BLOCK + j] = ZERO if background else value


@njit(cache=True, nogil=True, error_model="numpy")
def find_matches(side: F32, s: UpdateConstants) -> None:
    """Which of their other Gaussians the gathered pixels match, and what they are."""
    gaussians = (len(side) // BLOCK - LEADER) // N_FIELDS
    begin_search(side, s)
    for other in range(1, gaussians):
        test_other(side, other, s)
        keep_first(side, other, s)
    find_deepest(side, gaussians, s)
    classify(side, s)


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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def settle(lead: F32, rest: F32, side: F32, chosen: U64, mask: U8, s: UpdateConstants) -> None:
    """Mask of the gathered pixels, and what they learn."""
    gather_others(rest, chosen, len(chosen), side)
    find_matches(side, s)
    for j in range(len(chosen)):
        mask[chosen[j]] = int(side[MASK * BLOCK + j])
    learn_gathered(lead, rest, side, chosen, s)


@njit(cache=True, nogil=True, error_model="numpy")
def unmatched(obs: F32, n: int, places: U64) -> int:
    """Fill in which of a block's n pixels are UNMATCHED, and return their number."""
    m = 0
    for i in range(n):
        places[m] = i
        m += obs[UNMATCHED * BLOCK + i] > ZERO
    return m


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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
