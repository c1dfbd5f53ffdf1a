"""Kernels of the foreground stage, without checks; tests/reference/foreground.py defines them.

The leading Gaussians of BLOCK pixels lie together, one plane per number, so that the test which settles nearly every
pixel runs on vector registers. The other Gaussians are touched only where the leader did not match. Their weights are
stored as shares of what the leader leaves: a match of the leader then changes none of them.

Numba's cache of this file does not see changes of _gaussian_kernels.py: change or touch both.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground._gaussian_kernels import (
    N_FIELDS,
    NO_MATCH,
    ONE,
    SEEN,
    VAR_D,
    VAR_U,
    VAR_V,
    VAR_Y,
    WEIGHT,
    ZERO,
    Colour,
    D,
    F,
    Gaussian,
    Rates,
    Real,
    Step,
    U,
    V,
    Y,
    is_other_light,
    learned,
    match_kind,
    started,
)

# The functions of the second pass are inlined by force: passing a Step by value costs more than they do.
BLOCK = 128
"""Pixels whose leading Gaussians lie together; all their planes fit the first-level cache."""

# Kept per pixel beside its leading Gaussian: the mean absolute change of luma, and the last luma.
ACTIVITY, LAST_Y = 10, 11
N_LEAD = 12
# Planes of the scratch block beside Y, U, V and D of the observation: what else is known, and what the first pass
# leaves to the second.
CHROMA, OPINION, RATE_W, RATE_M, UNMATCHED = 0, 1, 6, 7, 8
N_SCRATCH = 9
# Values of the mask: other pixels are 0.
FOREGROUND, SHADOW = 255, 127
# Unsigned indices: those that cannot be negative let LLVM vectorise a loop.
AT_Y, AT_U, AT_V = np.uintp(Y * BLOCK), np.uintp(U * BLOCK), np.uintp(V * BLOCK)
AT_CHROMA, AT_OPINION = np.uintp(CHROMA * BLOCK), np.uintp(OPINION * BLOCK)
ONE_STEP, TWO_STEPS, THREE = np.uintp(1), np.uintp(2), np.uintp(3)


@njit(cache=True, nogil=True)
def stage_grey(image: U8, n: int, s: Step, obs: F32) -> None:
    """Luma of n grey pixels into the scratch block."""
    inv_gain = ONE / s.gain
    for i in range(np.uintp(n)):
        obs[AT_Y + i] = min((F(image[i]) - s.offset) * inv_gain, s.clip)
        obs[AT_U + i] = ZERO
        obs[AT_V + i] = ZERO
        obs[AT_CHROMA + i] = ZERO


@njit(cache=True, nogil=True)
def stage_colour(image: U8, n: int, s: Step, obs: F32) -> None:
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
def stage(image: U8, disparity: F32, opinion: U8, start: int, n: int, colour: bool, s: Step, obs: F32) -> None:
    """Observation of n pixels into the scratch block; flat arrays, disparity and opinion empty for none."""
    if colour:
        stage_colour(image[3 * start : 3 * (start + n)], n, s, obs)
    else:
        stage_grey(image[start : start + n], n, s, obs)
    if disparity.size:
        obs[D * BLOCK : D * BLOCK + n] = disparity[start : start + n]
    else:
        obs[D * BLOCK : D * BLOCK + n] = F(np.nan)
    if opinion.size:
        part = opinion[start : start + n]
        for i in range(np.uintp(n)):
            obs[AT_OPINION + i] = F(part[i])
    else:
        obs[OPINION * BLOCK : OPINION * BLOCK + n] = ZERO


@njit(cache=True, nogil=True)
def load(a: F32, base: int, stride: int) -> Gaussian:
    """A Gaussian whose numbers are ``stride`` apart."""
    return Gaussian(
        a[base + SEEN * stride],
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
    a[base + SEEN * stride] = g.seen
    a[base + Y * stride] = g.y
    a[base + U * stride] = g.u
    a[base + V * stride] = g.v
    a[base + D * stride] = g.d
    a[base + VAR_Y * stride] = g.var_y
    a[base + VAR_U * stride] = g.var_u
    a[base + VAR_V * stride] = g.var_v
    a[base + VAR_D * stride] = g.var_d


@njit(cache=True, nogil=True)
def observed(obs: F32, i: int) -> Colour:
    """Observation i of the scratch block."""
    return Colour(
        obs[Y * BLOCK + i], obs[U * BLOCK + i], obs[V * BLOCK + i], obs[D * BLOCK + i], obs[CHROMA * BLOCK + i]
    )


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, n: int, s: Step) -> None:
    """Test n pixels against their leading Gaussian: no branches, so that it vectorises."""
    for i in range(n):
        kind = match_kind(load(lead, i, BLOCK), observed(obs, i), s)
        obs[UNMATCHED * BLOCK + i] = ONE if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def learn_leaders(lead: F32, obs: F32, n: int, s: Step, rates: Rates) -> None:
    """Test n pixels against their leading Gaussian and learn where it matches: no branches, so that it vectorises."""
    for i in range(n):
        o = observed(obs, i)
        # Activity slows learning (notes, section 2), and so does a person; known background learns fast.
        change = abs(o.y - lead[LAST_Y * BLOCK + i])
        activity = lead[ACTIVITY * BLOCK + i] + rates.activity * (change - lead[ACTIVITY * BLOCK + i])
        lead[ACTIVITY * BLOCK + i] = activity
        lead[LAST_Y * BLOCK + i] = o.y
        opinion = obs[OPINION * BLOCK + i]
        slow = s.slow_active if activity > s.active else ONE
        slow = s.slow_person if opinion == ONE else slow
        known = opinion == F(2)
        rate_w = rates.fast if known else rates.weight * slow
        rate_m = rates.fast if known else rates.mean * slow
        obs[RATE_W * BLOCK + i] = rate_w
        obs[RATE_M * BLOCK + i] = rate_m

        g = load(lead, i, BLOCK)
        kind = match_kind(g, o, s)
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        store(lead, i, BLOCK, learned(g, o, kind, rate_m, s))
        obs[UNMATCHED * BLOCK + i] = ONE if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, forceinline=True)
def first_match(rest: F32, first: int, end: int, o: Colour, s: Step) -> tuple[int, int]:
    """Where the first matching Gaussian of the rest starts (-1: none does), and how it matches."""
    for b in range(first, end, N_FIELDS):
        if rest[b + WEIGHT] > ZERO:
            kind = match_kind(load(rest, b, 1), o, s)
            if kind != NO_MATCH:
                return b, kind
    return -1, NO_MATCH


@njit(cache=True, nogil=True)
def is_background(lead: F32, i: int, rest: F32, first: int, end: int, b: int, s: Step) -> bool:
    """Whether the Gaussian at rest[b] is in the background set: by leading weight, or as the deepest."""
    before = lead[WEIGHT * BLOCK + i]
    left = ONE - before
    for j in range(first, b, N_FIELDS):
        before += left * rest[j + WEIGHT]
    if before <= s.background_weight:
        return True
    if left * rest[b + WEIGHT] <= s.deepest_weight or rest[b + SEEN] < s.min_seen:
        return False
    deep = lead[WEIGHT * BLOCK + i] > s.deepest_weight and lead[SEEN * BLOCK + i] >= s.min_seen
    if deep and lead[D * BLOCK + i] < rest[b + D]:
        return False
    for j in range(first, end, N_FIELDS):
        deep = left * rest[j + WEIGHT] > s.deepest_weight and rest[j + SEEN] >= s.min_seen
        if deep and rest[j + D] < rest[b + D]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_uncovered(g: Gaussian, o: Colour, s: Step) -> tuple[bool, bool]:
    """Whether a pixel that its leader g does not match is (unclipped, behind) it: both are background not seen so far.

    A surface that was clipped may turn out brighter than that; what appears behind the background was hidden by
    somebody, for nobody stands there.
    """
    dd = o.d - g.d
    both = o.d == o.d and g.seen >= s.min_seen
    agree = dd * dd < s.beta * g.var_d
    return g.var_y < ZERO and o.y > g.y and (agree or not both), both and not agree and dd < ZERO


@njit(cache=True, nogil=True, forceinline=True)
def classify(
    lead: F32, i: int, rest: F32, first: int, end: int, found: int, unclipped: bool, o: Colour, s: Step
) -> int:
    """FOREGROUND, SHADOW or 0 for a pixel whose leader does not match but whose Gaussian at rest[found] may."""
    if unclipped or (found >= 0 and is_background(lead, i, rest, first, end, found, s)):
        return 0
    leader = load(lead, i, BLOCK)
    darkest = s.colour_shadow_ratio
    if darkest > ZERO and o.d != o.d and o.y < leader.y and is_other_light(leader, o, o.chroma > ZERO, darkest, s):
        return SHADOW
    return FOREGROUND


@njit(cache=True, nogil=True)
def outranks(weight: Real, var: Real, other_weight: Real, other_var: Real) -> bool:
    """Whether weight / sigma exceeds that of another Gaussian, without square roots."""
    return bool(weight * weight * abs(other_var) > other_weight * other_weight * abs(var))


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def learn_rest(
    lead: F32,
    i: int,
    rest: F32,
    first: int,
    end: int,
    found: int,
    kind: int,
    o: Colour,
    rate_w: Real,
    rate_m: Real,
    s: Step,
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
def update_pixel(lead: F32, i: int, rest: F32, first: int, end: int, obs: F32, s: Step, rates: Rates) -> int:
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
    lead: F32, rest: F32, image: U8, disparity: F32, opinion: U8, mask: U8, first: int, last: int, s: Step, turns: F32
) -> None:
    """Update blocks first..last-1 and write their part of the mask.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. rest: (N * (K-1) * N_FIELDS,) the others.
        image: (N,) or (3 N,) uint8. disparity: (N,) float32 or empty. opinion: (N,) uint8 or empty. mask: (N,) uint8.
        turns: (T, 4) the rates of blocks b = t modulo T; a row of zeros does not learn.
    """
    colour = image.size > mask.size
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    size = rest.size // mask.size
    for block in range(first, last):
        start = block * BLOCK
        n = min(BLOCK, mask.size - start)
        stage(image, disparity, opinion, start, n, colour, s, obs)
        leaders = lead[block]
        turn = block % turns.shape[0]
        rates = Rates(turns[turn, 0], turns[turn, 1], turns[turn, 2], turns[turn, 3])
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
def start_blocks(lead: F32, rest: F32, image: U8, disparity: F32, n_pixels: int, s: Step) -> None:
    """First frame: every leader starts at the observation with all the weight, the rest without any."""
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    no_opinion = np.zeros(0, np.uint8)
    lead[:, :] = ONE
    rest[:] = ONE
    for b in range(0, rest.size, N_FIELDS):
        rest[b + WEIGHT] = ZERO
    for block in range(lead.shape[0]):
        start = block * BLOCK
        n = min(BLOCK, n_pixels - start)
        stage(image, disparity, no_opinion, start, n, image.size > n_pixels, s, obs)
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
