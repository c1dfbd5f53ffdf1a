"""Gaussians over (Y, U, V, disparity), and blocks of pixels against their leading one; without branches or checks.

tests/reference/foreground.py defines them. The leading Gaussians of BLOCK pixels lie together, one plane per field, and
so do the observations of the block that is being updated: loops over a block then run on vector registers.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, U8
from planview.foreground.params import BACKGROUND, PERSON

# Fields of a Gaussian: weight, fraction of observations with depth, means, variances. A negative luma variance marks
# a mean learned from clipped pixels, which is a lower bound of the surface's luma.
WEIGHT, DEPTH_FRACTION, Y, U, V, D, VAR_Y, VAR_U, VAR_V, VAR_D = range(10)
N_FIELDS = 10

Real = Any
"""float32; numpy's scalar and Python's float do not mix for a type checker."""

F = np.float32
ZERO, ONE = F(0), F(1)

NO_MATCH, SAME, OTHER_LIGHT = F(0), F(1), F(2)
"""How a Gaussian matches: not, by colour, or by depth under a shadow or a patch of light. As wide as all other numbers:
integers of 64 bits would halve the vectors."""


class UpdateConstants(NamedTuple):
    """What is the same for all pixels of one update, all float32; colour in the exposure of the model."""

    beta: Real  # squared normalised distance of a match
    beta_relaxed: Real  # the same for colour where depth alone shows the background
    body_over_metre: Real  # how far a body is before the background, over the disparity of a metre [1/px]
    min_depth_fraction: Real  # fraction of observations with depth that makes depth reliable
    dark: Real  # luma below which chroma is noise
    clip: Real  # luma at which the sensor saturates
    black: Real  # luma that the image shows as 0
    clip_image: Real  # clip as the image shows it, 0-255
    gain: Real  # image luma = gain * model luma + offset
    offset: Real
    floor_y: Real  # variance floors
    floor_uv: Real
    floor_d: Real
    init_y: Real  # variances of a new Gaussian
    init_uv: Real
    init_d: Real
    floor_d_per_d4: Real  # growth of the disparity's variances with its fourth power
    init_d_per_d4: Real
    active: Real  # mean |dY| above which a pixel is active
    slow_active: Real  # factor on the rates of active pixels
    background_weight: Real
    deepest_weight: Real
    shadow_ratio: Real
    shadow_ratio_unsure: Real  # the same where depth is no evidence
    colour_shadow_ratio: Real  # darkest shadow recognised by colour alone, 0: none


class Rates(NamedTuple):
    """Shares of the new observation, float32; all zero when it is not the pixel's turn to learn."""

    weight: Real
    mean: Real  # means and variances
    fast: Real  # all, where the background is known or was uncovered
    activity: Real


class Pixel(NamedTuple):
    """Luma, chroma and disparity of an observation (NaN: none), and 1 where its chroma is usable and where disparity
    was looked for; float32."""

    y: Real
    u: Real
    v: Real
    d: Real
    chroma: Real
    measured: Real


class Gaussian(NamedTuple):
    """All but the weight of a Gaussian, float32."""

    depth_fraction: Real
    y: Real
    u: Real
    v: Real
    d: Real
    var_y: Real
    var_u: Real
    var_v: Real
    var_d: Real


@njit(cache=True, nogil=True, error_model="numpy")
def shown_luma(g: Gaussian, s: UpdateConstants) -> Real:
    """The mean luma as the camera can show it now."""
    return max(min(g.y, s.clip), s.black)


@njit(cache=True, nogil=True, error_model="numpy")
def chroma_counts(g: Gaussian, o: Pixel, s: UpdateConstants) -> Real:
    """Chroma is compared unless one side is dark or clipped (Harville, Gordon, Woodfill 2001: dark pixels)."""
    return (o.chroma > ZERO) & (min(shown_luma(g, s), o.y) > s.dark) & (g.var_y > ZERO)


@njit(cache=True, nogil=True, error_model="numpy")
def is_other_light(g: Gaussian, o: Pixel, chroma: bool, darkest: Real, s: UpdateConstants) -> Real:
    """The same surface under a shadow or a patch of light: luma off by a plausible ratio, chroma scaled alike."""
    ratio = (o.y - s.black) / max(shown_luma(g, s) - s.black, ONE)
    du, dv = o.u - ratio * g.u, o.v - ratio * g.v
    like = (du * du / g.var_u + dv * dv / g.var_v < s.beta) | (not chroma)
    return like & (ratio >= darkest) & (ratio * darkest <= ONE)


@njit(cache=True, nogil=True, error_model="numpy")
def colour_distance(g: Gaussian, o: Pixel, s: UpdateConstants) -> Real:
    """Squared normalised distance in luma, and in chroma where that counts."""
    dy, du, dv = o.y - shown_luma(g, s), o.u - g.u, o.v - g.v
    return dy * dy / abs(g.var_y) + (du * du / g.var_u + dv * dv / g.var_v if chroma_counts(g, o, s) else ZERO)


@njit(cache=True, nogil=True, error_model="numpy")
def match_kind(g: Gaussian, o: Pixel, s: UpdateConstants) -> Real:
    """NO_MATCH, SAME or OTHER_LIGHT: depth overrules colour where both have it (Harville et al. 2001).

    It does so by its evidence, the likelihood of the disparity on the surface over that on a body before it: far away
    the two look the same.
    """
    dy, du, dv, dd = o.y - shown_luma(g, s), o.u - g.u, o.v - g.v, o.d - g.d
    chroma = chroma_counts(g, o, s)
    far = dy * dy / abs(g.var_y) + (du * du / g.var_u + dv * dv / g.var_v if chroma else ZERO)
    both = (o.d == o.d) & (g.depth_fraction >= s.min_depth_fraction)
    agree = both & (dd * dd < s.beta * g.var_d)
    nearer = s.body_over_metre * g.d  # that distance over the background's
    body = nearer * g.d / max(ONE - nearer, F(0.1))  # by which disparity a body is nearer
    evidence = max(body * (body - (dd + dd)) / g.var_d, ZERO)  # twice the logarithm of the ratio
    same = far < (min(s.beta + evidence, s.beta_relaxed) if agree else s.beta)
    unsure = max(ONE - evidence / s.beta, ZERO)
    darkest = s.shadow_ratio + unsure * (s.shadow_ratio_unsure - s.shadow_ratio)
    lit = agree & is_other_light(g, o, chroma, darkest, s)
    kind = SAME if same else (OTHER_LIGHT if lit else NO_MATCH)
    return NO_MATCH if both & (not agree) else kind


@njit(cache=True, nogil=True, error_model="numpy")
def fourth_power(d: Real) -> Real:
    """d^4: a deviation sigma_z of depth is sigma_z d^2 / (f b) in disparity, and its variance grows with d^4."""
    return (d * d) * (d * d)


@njit(cache=True, nogil=True, error_model="numpy")
def is_nearer(g: Gaussian, o: Pixel, s: UpdateConstants) -> Real:
    """Whether depth alone separates an observation from a Gaussian: the same colour, but in front of it."""
    return (colour_distance(g, o, s) < s.beta) & (o.d > g.d) & (g.depth_fraction >= s.min_depth_fraction)


@njit(cache=True, nogil=True, error_model="numpy")
def learned(g: Gaussian, o: Pixel, kind: Real, rate: Real, s: UpdateConstants) -> Gaussian:
    """The Gaussian after a match of some kind; other light moves the means but not the variances."""
    rate = rate if kind != NO_MATCH else ZERO
    rate_var = rate if kind == SAME else ZERO
    bound = g.var_y < ZERO
    clipped = o.y >= s.clip
    still_bound = clipped & (bound | (g.y <= s.clip)) if kind == SAME else bound
    raised = still_bound & (kind == SAME)

    dy, du, dv = o.y - shown_luma(g, s), o.u - g.u, o.v - g.v
    var_y = max(abs(g.var_y) + rate_var * (dy * dy - abs(g.var_y)), s.floor_y)
    chroma = chroma_counts(g, o, s)
    rate_c = rate if chroma else ZERO
    rate_cv = rate_var if chroma else ZERO

    # The mean of the valid disparities only: an exponential mean of d over one of validity.
    has_depth = o.d == o.d
    depth_fraction = g.depth_fraction + rate * o.measured * ((ONE if has_depth else ZERO) - g.depth_fraction)
    learns_d = has_depth & (rate > ZERO)
    rate_d = rate / max(depth_fraction, rate) if learns_d else ZERO
    dd = o.d - g.d if has_depth else ZERO
    var_d = max(g.var_d + rate_d * (dd * dd - g.var_d), s.floor_d + s.floor_d_per_d4 * fourth_power(g.d))
    return Gaussian(
        depth_fraction,
        max(g.y, s.clip) if raised else g.y + rate * dy,
        g.u + rate_c * du,
        g.v + rate_c * dv,
        g.d + rate_d * dd,
        -var_y if still_bound else var_y,
        max(g.var_u + rate_cv * (du * du - g.var_u), s.floor_uv),
        max(g.var_v + rate_cv * (dv * dv - g.var_v), s.floor_uv),
        s.init_d + s.init_d_per_d4 * fourth_power(o.d) if learns_d & (g.depth_fraction <= ZERO) else var_d,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def started(o: Pixel, s: UpdateConstants) -> Gaussian:
    """A new Gaussian at an observation."""
    has_depth = o.d == o.d
    return Gaussian(
        ONE if has_depth else ZERO,
        o.y,
        o.u,
        o.v,
        o.d if has_depth else ZERO,
        -s.init_y if o.y >= s.clip else s.init_y,
        s.init_uv,
        s.init_uv,
        s.init_d + s.init_d_per_d4 * fourth_power(o.d) if has_depth else s.init_d,
    )


BLOCK = 128
"""Pixels whose leading Gaussians lie together; all their planes fit the first-level cache."""

# Kept per pixel besides its leading Gaussian: the mean absolute change of luma, and the last luma.
ACTIVITY, LAST_Y = 10, 11
N_LEAD = 12
# Planes of the scratch block besides Y, U, V and D of the observation: what else is known, and what the first pass
# leaves to the second.
CHROMA, FEEDBACK, RATE_W, RATE_M, UNMATCHED, MEASURED, KIND_LEADER = 0, 1, 6, 7, 8, 9, 10
N_SCRATCH = 11
# Unsigned indices: those that cannot be negative let LLVM vectorise a loop.
AT_Y, AT_U, AT_V = np.uintp(Y * BLOCK), np.uintp(U * BLOCK), np.uintp(V * BLOCK)
AT_D, AT_CHROMA, AT_FEEDBACK = np.uintp(D * BLOCK), np.uintp(CHROMA * BLOCK), np.uintp(FEEDBACK * BLOCK)
AT_MEASURED = np.uintp(MEASURED * BLOCK)
ONE_STEP, TWO_STEPS, THREE = np.uintp(1), np.uintp(2), np.uintp(3)


@njit(cache=True, nogil=True, error_model="numpy")
def stage_grey(image: U8, n: int, s: UpdateConstants, obs: F32) -> None:
    """Luma of n grey pixels into the scratch block."""
    inv_gain = ONE / s.gain
    for i in range(np.uintp(n)):
        obs[AT_Y + i] = min((F(image[i]) - s.offset) * inv_gain, s.clip)
        obs[AT_U + i] = ZERO
        obs[AT_V + i] = ZERO
        obs[AT_CHROMA + i] = ZERO


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def any_measured(measured: U8, start: int, n: int) -> bool:
    """Whether disparity was looked for at one of n pixels."""
    here, total = measured[start : start + n], np.uint8(0)
    for i in range(np.uintp(n)):
        total |= here[i]
    return bool(total > 0)


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """Test a block of pixels against their leading Gaussian: no branches, so that it vectorises."""
    for i in range(BLOCK):
        kind = match_kind(load(lead, i, BLOCK), observed(obs, i), s)
        obs[KIND_LEADER * BLOCK + i] = kind
        obs[UNMATCHED * BLOCK + i] = obs[MEASURED * BLOCK + i] if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def set_rates(lead: F32, obs: F32, s: UpdateConstants, rates: Rates) -> None:
    """How much each pixel of a block learns.

    Activity slows learning (Harville et al. 2001), a person stops it, and known background learns fast (Harville 2002,
    ECCV).
    """
    for i in range(BLOCK):
        y = obs[Y * BLOCK + i]
        before = lead[ACTIVITY * BLOCK + i]
        activity = before + rates.activity * (abs(y - lead[LAST_Y * BLOCK + i]) - before)
        lead[ACTIVITY * BLOCK + i] = activity
        lead[LAST_Y * BLOCK + i] = y
        feedback = obs[FEEDBACK * BLOCK + i]
        slow = s.slow_active if activity > s.active else ONE
        slow = ZERO if feedback == F(PERSON) else slow
        known = feedback == F(BACKGROUND)
        obs[RATE_W * BLOCK + i] = rates.fast if known else rates.weight * slow
        obs[RATE_M * BLOCK + i] = rates.fast if known else rates.mean * slow


@njit(cache=True, nogil=True, error_model="numpy")
def learn_leaders(lead: F32, obs: F32, s: UpdateConstants, rates: Rates, depth: bool) -> None:
    """Test a block of pixels against their leading Gaussian and learn where it matches.

    No branches, so that it vectorises, and several short loops, since more of a short one is under way at a time.
    Without depth a Gaussian's disparity, its fraction and its variance stay what they are.
    """
    set_rates(lead, obs, s, rates)
    if not depth:
        match_colours(lead, obs, s)
        learn_colours(lead, obs, s)
        return
    match_leaders(lead, obs, s)
    for i in range(BLOCK):
        kind, rate_w = obs[KIND_LEADER * BLOCK + i], obs[RATE_W * BLOCK + i]
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        g = learned(load(lead, i, BLOCK), observed(obs, i), kind, obs[RATE_M * BLOCK + i], s)
        store(lead, i, BLOCK, g)


@njit(cache=True, nogil=True, error_model="numpy")
def match_colours(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """As ``match_leaders``, where no pixel has depth: colour alone decides, and fewer planes are read."""
    for i in range(BLOCK):
        g, o = load(lead, i, BLOCK), observed(obs, i)
        kind = SAME if colour_distance(g, o, s) < s.beta else NO_MATCH
        obs[KIND_LEADER * BLOCK + i] = kind
        obs[UNMATCHED * BLOCK + i] = obs[MEASURED * BLOCK + i] if kind == NO_MATCH else ZERO


@njit(cache=True, nogil=True, error_model="numpy")
def learn_colours(lead: F32, obs: F32, s: UpdateConstants) -> None:
    """What ``learn_leaders`` teaches leaders that match, where no pixel has depth."""
    for i in range(BLOCK):
        kind, rate_w = obs[KIND_LEADER * BLOCK + i], obs[RATE_W * BLOCK + i]
        weight = lead[WEIGHT * BLOCK + i]
        lead[WEIGHT * BLOCK + i] = weight + (rate_w * (ONE - weight) if kind != NO_MATCH else ZERO)
        g = learned(load(lead, i, BLOCK), observed(obs, i), kind, obs[RATE_M * BLOCK + i], s)
        lead[Y * BLOCK + i], lead[VAR_Y * BLOCK + i] = g.y, g.var_y
        lead[U * BLOCK + i], lead[VAR_U * BLOCK + i] = g.u, g.var_u
        lead[V * BLOCK + i], lead[VAR_V * BLOCK + i] = g.v, g.var_v


@njit(cache=True, nogil=True, error_model="numpy")
def find_changes(lead: F32, image: U8, channels: int, step: int, s: UpdateConstants, out: U8) -> None:
    """255 at every ``step``-th row and column whose leading Gaussian does not match by colour, is not background yet,
    or whose luma keeps changing; 0 elsewhere.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. image: (H, W * channels) uint8. out: (h, w) uint8.
    """
    rows, columns = out.shape
    width, flat = image.shape[1] // channels, image.reshape(-1)
    n_pixels = image.shape[0] * width
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    no_disparity, empty = np.zeros(0, np.float32), np.zeros(0, np.uint8)
    for row in range(rows):
        first, column = step * row * width, 0
        for block in range(first // BLOCK, (first + width - 1) // BLOCK + 1):
            start = block * BLOCK
            # All of a block, on vector registers, is faster than a part of it.
            stage(flat, no_disparity, empty, empty, start, min(BLOCK, n_pixels - start), channels > 1, s, obs)
            leaders = lead[block]
            match_colours(leaders, obs, s)
            while column < columns and first + step * column < start + BLOCK:
                i = first + step * column - start
                young = leaders[WEIGHT * BLOCK + i] <= s.background_weight
                active = leaders[ACTIVITY * BLOCK + i] > s.active
                out[row, column] = 255 if (obs[KIND_LEADER * BLOCK + i] == NO_MATCH) | young | active else 0
                column += 1
