"""Kernels of the foreground stage, without checks; tests/reference/foreground.py defines them.

The leading Gaussian of BLOCK pixels lies together, one plane per number, so that the test which settles nearly
every pixel runs on vector registers. The other Gaussians are touched only where the leader did not match. Their
weights are stored as shares of what the leader leaves: a match of the leader then changes none of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, U8

BLOCK = 128
"""Pixels whose leading Gaussians lie together; all their planes fit the first-level cache."""

# One Gaussian: weight (leader) or share of the rest (others), fraction of observations with depth, means, variances.
WEIGHT, SEEN, Y, U, V, D, VAR_Y, VAR_U, VAR_V, VAR_D = range(10)
N_FIELDS = 10
# Kept per pixel in the leader's block: mean absolute change of luma, and the last luma.
ACTIVITY, LAST_Y = 10, 11
N_LEAD = 12
# Planes of the scratch block: the observation, and what the first pass leaves to the second.
CHROMA_OK, OPINION, RATE_W, RATE_M, MATCHED = 5, 6, 7, 8, 9
N_SCRATCH = 10
# Where these planes start, as unsigned numbers: an index that cannot be negative lets LLVM vectorise the loop.
AT_Y, AT_U, AT_V = np.uintp(Y * BLOCK), np.uintp(U * BLOCK), np.uintp(V * BLOCK)
AT_CHROMA, AT_OPINION = np.uintp(CHROMA_OK * BLOCK), np.uintp(OPINION * BLOCK)
ONE_STEP, TWO_STEPS, THREE = np.uintp(1), np.uintp(2), np.uintp(3)


class Step(NamedTuple):
    """Numbers of one update, all float32; colour in the model's reference exposure."""

    beta: float  # squared normalised distance of a match
    beta_relaxed: float  # the same for colour where depth agrees
    min_seen: float  # fraction of observations with depth that makes depth reliable
    dark: float  # luma below which chroma is noise
    clip: float  # luma at which the sensor saturates
    clip_image: float  # the same as the image shows it, 0-255
    gain: float  # image luma = gain * model luma + offset
    offset: float
    floor_y: float  # variance floors
    floor_uv: float
    floor_d: float
    init_y: float  # variances of a new Gaussian
    init_uv: float
    init_d: float
    rate_w: float  # learning rates of this step: weights, means and variances, known background
    rate_m: float
    rate_fast: float
    rate_activity: float
    active: float  # mean |dY| above which a pixel is active
    slow_active: float  # factors on the rates of active pixels and of pixels under a person
    slow_person: float
    background_weight: float
    deepest_weight: float
    shadow_ratio: float
    colour_shadows: float  # 1: shadows are removed by colour alone where there is no depth


F = np.float32
ZERO, ONE = F(0), F(1)


@njit(cache=True, nogil=True)
def stage_grey(image: U8, n: int, s: Step, obs: F32) -> None:
    """Luma of n grey pixels into the scratch block. Unsigned indices let LLVM vectorise these loops."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, n: int, s: Step) -> None:
    """Test n pixels against their leading Gaussian and learn where it matches: no branches, so that it vectorises."""
    for i in range(n):
        y, u, v, d = obs[Y * BLOCK + i], obs[U * BLOCK + i], obs[V * BLOCK + i], obs[D * BLOCK + i]
        # Activity sets the rates (section 2 of the notes: divided by about 5).
        activity = lead[ACTIVITY * BLOCK + i] + s.rate_activity * (
            abs(y - lead[LAST_Y * BLOCK + i]) - lead[ACTIVITY * BLOCK + i]
        )
        lead[ACTIVITY * BLOCK + i] = activity
        lead[LAST_Y * BLOCK + i] = y
        opinion = obs[OPINION * BLOCK + i]
        slow = s.slow_active if activity > s.active else ONE
        slow = s.slow_person if opinion == ONE else slow
        known = opinion == F(2)
        rate_w = s.rate_fast if known else s.rate_w * slow
        rate_m = s.rate_fast if known else s.rate_m * slow
        obs[RATE_W * BLOCK + i] = rate_w
        obs[RATE_M * BLOCK + i] = rate_m

        # A negative luma variance marks a mean learned from clipped pixels: it is only a lower bound.
        bound = lead[VAR_Y * BLOCK + i] < ZERO
        var_y = abs(lead[VAR_Y * BLOCK + i])
        mean_y, seen = lead[Y * BLOCK + i], lead[SEEN * BLOCK + i]
        shown = min(mean_y, s.clip)
        beyond = bound & (y > shown)
        dy = ZERO if beyond else y - shown
        du, dv, dd = u - lead[U * BLOCK + i], v - lead[V * BLOCK + i], d - lead[D * BLOCK + i]
        chroma = (obs[CHROMA_OK * BLOCK + i] > ZERO) & (min(shown, y) > s.dark) & (not bound)
        inv_u, inv_v = ONE / lead[VAR_U * BLOCK + i], ONE / lead[VAR_V * BLOCK + i]
        far = dy * dy / var_y + (du * du * inv_u + dv * dv * inv_v if chroma else ZERO)

        has_depth = d == d
        both = has_depth & (seen >= s.min_seen)
        near = dd * dd < s.beta * lead[VAR_D * BLOCK + i]
        agree = both & near
        veto = both & (not near)
        same_colour = far < (s.beta_relaxed if agree else s.beta)
        ratio = y / shown
        su, sv = u - ratio * lead[U * BLOCK + i], v - ratio * lead[V * BLOCK + i]
        shade = su * su * inv_u + sv * sv * inv_v < s.beta
        shade = agree & (ratio >= s.shadow_ratio) & (ratio < ONE) & (shade | (not chroma))
        match = (not veto) & (same_colour | shade)
        obs[MATCHED * BLOCK + i] = ONE if match else ZERO

        # Learn; a shadow teaches depth and weight only.
        lead[WEIGHT * BLOCK + i] = lead[WEIGHT * BLOCK + i] + (
            rate_w * (ONE - lead[WEIGHT * BLOCK + i]) if match else ZERO
        )
        learn = match & same_colour
        clipped = y >= s.clip
        fresh = learn & bound & (not clipped)
        step = rate_m if learn else ZERO
        new_var = max(var_y + step * (dy * dy - var_y), s.floor_y)
        new_var = s.init_y if fresh else new_var
        still = bound & (not fresh) | learn & clipped & (mean_y <= s.clip)
        lead[VAR_Y * BLOCK + i] = -new_var if still else new_var
        lead[Y * BLOCK + i] = y if fresh else mean_y + step * dy
        step_c = ONE if fresh else (step if chroma else ZERO)
        lead[U * BLOCK + i] = lead[U * BLOCK + i] + step_c * du
        lead[V * BLOCK + i] = lead[V * BLOCK + i] + step_c * dv
        step_c = ZERO if fresh else step_c
        lead[VAR_U * BLOCK + i] = max(
            lead[VAR_U * BLOCK + i] + step_c * (du * du - lead[VAR_U * BLOCK + i]), s.floor_uv
        )
        lead[VAR_V * BLOCK + i] = max(
            lead[VAR_V * BLOCK + i] + step_c * (dv * dv - lead[VAR_V * BLOCK + i]), s.floor_uv
        )
        new_seen = seen + (rate_m * ((ONE if has_depth else ZERO) - seen) if match else ZERO)
        lead[SEEN * BLOCK + i] = new_seen
        # Mean of the valid observations only: an exponential mean of d over one of validity.
        step_d = rate_m / new_seen if match & has_depth & (new_seen > ZERO) else ZERO
        dd = dd if has_depth else ZERO
        lead[D * BLOCK + i] = lead[D * BLOCK + i] + step_d * dd
        new_var = max(lead[VAR_D * BLOCK + i] + step_d * (dd * dd - lead[VAR_D * BLOCK + i]), s.floor_d)
        lead[VAR_D * BLOCK + i] = s.init_d if (step_d > ZERO) & (seen <= ZERO) else new_var


class Pixel(NamedTuple):
    """Observation and rates of one pixel, all float32."""

    y: float
    u: float
    v: float
    d: float
    chroma: float
    rate_w: float
    rate_m: float


@njit(cache=True, nogil=True, error_model="numpy")
def gaussian_matches(g: F32, b: int, o: Pixel, s: Step) -> int:
    """0 no match, 1 match by colour, 2 shadow where depth agrees; the Gaussian starts at g[b]."""
    bound = g[b + VAR_Y] < ZERO
    shown = min(g[b + Y], s.clip)
    dy = ZERO if bound and o.y > shown else o.y - shown
    du, dv, dd = o.u - g[b + U], o.v - g[b + V], o.d - g[b + D]
    chroma = o.chroma > ZERO and min(shown, o.y) > s.dark and not bound
    inv_u, inv_v = ONE / g[b + VAR_U], ONE / g[b + VAR_V]
    far = dy * dy / abs(g[b + VAR_Y]) + (du * du * inv_u + dv * dv * inv_v if chroma else ZERO)
    both = o.d == o.d and g[b + SEEN] >= s.min_seen
    if both and not dd * dd < s.beta * g[b + VAR_D]:
        return 0
    if far < (s.beta_relaxed if both else s.beta):
        return 1
    ratio = o.y / shown
    if both and ratio >= s.shadow_ratio and ratio < ONE:
        su, sv = o.u - ratio * g[b + U], o.v - ratio * g[b + V]
        if not chroma or su * su * inv_u + sv * sv * inv_v < s.beta:
            return 2
    return 0


@njit(cache=True, nogil=True, error_model="numpy")
def learn_colour(g: F32, b: int, o: Pixel, rate: float, s: Step) -> None:
    """Move the colour of the Gaussian at g[b] towards the observation."""
    bound = g[b + VAR_Y] < ZERO
    shown = min(g[b + Y], s.clip)
    clipped = o.y >= s.clip
    du, dv = o.u - g[b + U], o.v - g[b + V]
    if bound and not clipped:
        g[b + Y], g[b + U], g[b + V], g[b + VAR_Y] = o.y, o.u, o.v, s.init_y
        return
    dy = ZERO if bound and o.y > shown else o.y - shown
    var_y = abs(g[b + VAR_Y])
    var_y = max(var_y + rate * (dy * dy - var_y), s.floor_y)
    g[b + VAR_Y] = -var_y if bound or (clipped and g[b + Y] <= s.clip) else var_y
    if o.chroma > ZERO and min(shown, o.y) > s.dark and not bound:
        g[b + U] += rate * du
        g[b + V] += rate * dv
        g[b + VAR_U] = max(g[b + VAR_U] + rate * (du * du - g[b + VAR_U]), s.floor_uv)
        g[b + VAR_V] = max(g[b + VAR_V] + rate * (dv * dv - g[b + VAR_V]), s.floor_uv)
    g[b + Y] += rate * dy


@njit(cache=True, nogil=True, error_model="numpy")
def learn_depth(g: F32, b: int, o: Pixel, rate: float, s: Step) -> None:
    """Move the disparity of the Gaussian at g[b], and how often it is seen, towards the observation."""
    has_depth = o.d == o.d
    seen = g[b + SEEN]
    g[b + SEEN] = seen + rate * ((ONE if has_depth else ZERO) - seen)
    if has_depth and g[b + SEEN] > ZERO:
        step, dd = rate / g[b + SEEN], o.d - g[b + D]
        g[b + D] += step * dd
        new_var = max(g[b + VAR_D] + step * (dd * dd - g[b + VAR_D]), s.floor_d)
        g[b + VAR_D] = s.init_d if step > ZERO and seen <= ZERO else new_var


@njit(cache=True, nogil=True)
def new_gaussian(g: F32, b: int, o: Pixel, weight: float, s: Step) -> None:
    """Start a Gaussian at g[b] from an observation."""
    has_depth = o.d == o.d
    g[b + WEIGHT] = weight
    g[b + SEEN] = ONE if has_depth else ZERO
    g[b + Y], g[b + U], g[b + V] = o.y, o.u, o.v
    g[b + D] = o.d if has_depth else ZERO
    g[b + VAR_Y] = -s.init_y if o.y >= s.clip else s.init_y
    g[b + VAR_U], g[b + VAR_V], g[b + VAR_D] = s.init_uv, s.init_uv, s.init_d


@njit(cache=True, nogil=True)
def is_background(lead: F32, i: int, g: F32, first: int, end: int, b: int, s: Step) -> bool:
    """Whether the Gaussian at g[b] is in the background set: by leading weight, or deepest; weights are true ones."""
    before = lead[WEIGHT * BLOCK + i]
    for j in range(first, b, N_FIELDS):
        before += g[j + WEIGHT]
    if before <= s.background_weight:
        return True
    if g[b + WEIGHT] <= s.deepest_weight or g[b + SEEN] < s.min_seen:
        return False
    if (
        lead[WEIGHT * BLOCK + i] > s.deepest_weight
        and lead[SEEN * BLOCK + i] >= s.min_seen
        and lead[D * BLOCK + i] < g[b + D]
    ):
        return False
    for j in range(first, end, N_FIELDS):
        if g[j + WEIGHT] > s.deepest_weight and g[j + SEEN] >= s.min_seen and g[j + D] < g[b + D]:
            return False
    return True


@njit(cache=True, nogil=True)
def sort_rest(g: F32, first: int, end: int) -> None:
    """Sort Gaussians by decreasing weight / luma deviation (insertion sort, stable)."""
    for start in range(first + N_FIELDS, end, N_FIELDS):
        b = start
        while b > first and outranks(g[b + WEIGHT], g[b + VAR_Y], g[b - N_FIELDS + WEIGHT], g[b - N_FIELDS + VAR_Y]):
            for f in range(b, b + N_FIELDS):
                g[f], g[f - N_FIELDS] = g[f - N_FIELDS], g[f]
            b -= N_FIELDS


@njit(cache=True, nogil=True)
def outranks(weight: float, var: float, other_weight: float, other_var: float) -> bool:
    """Whether weight / sigma exceeds that of another Gaussian, without square roots."""
    return bool(weight * weight * abs(other_var) > other_weight * other_weight * abs(var))


@njit(cache=True, nogil=True, error_model="numpy")
def settle_order(lead: F32, i: int, g: F32, first: int, end: int) -> None:
    """Normalise the true weights, put the mixture in order and turn the weights of the rest into shares."""
    total = lead[WEIGHT * BLOCK + i]
    for b in range(first, end, N_FIELDS):
        total += g[b + WEIGHT]
    scale = ONE / total
    lead[WEIGHT * BLOCK + i] *= scale
    for b in range(first, end, N_FIELDS):
        g[b + WEIGHT] *= scale
    sort_rest(g, first, end)
    if outranks(g[first + WEIGHT], g[first + VAR_Y], lead[WEIGHT * BLOCK + i], lead[VAR_Y * BLOCK + i]):
        for f in range(N_FIELDS):
            g[first + f], lead[f * BLOCK + i] = lead[f * BLOCK + i], g[first + f]
        sort_rest(g, first, end)
    left = ONE - lead[WEIGHT * BLOCK + i]
    inv_left = ONE / left if left > ZERO else ZERO
    for b in range(first, end, N_FIELDS):
        g[b + WEIGHT] *= inv_left


@njit(cache=True, nogil=True, error_model="numpy")
def is_colour_shadow(lead: F32, i: int, o: Pixel, s: Step) -> bool:
    """Darker than the leading Gaussian by a plausible ratio, chroma scaled alike."""
    ratio = o.y / min(lead[Y * BLOCK + i], s.clip)
    if ratio < s.shadow_ratio or ratio >= ONE:
        return False
    if o.chroma <= ZERO or o.y <= s.dark:
        return True
    su, sv = o.u - ratio * lead[U * BLOCK + i], o.v - ratio * lead[V * BLOCK + i]
    return bool(su * su / lead[VAR_U * BLOCK + i] + sv * sv / lead[VAR_V * BLOCK + i] < s.beta)


@njit(cache=True, nogil=True)
def first_match(g: F32, first: int, end: int, o: Pixel, s: Step) -> tuple[int, int]:
    """Where the first matching Gaussian of the rest starts (-1: none does), and how it matches."""
    for b in range(first, end, N_FIELDS):
        if g[b + WEIGHT] > ZERO:
            kind = gaussian_matches(g, b, o, s)
            if kind > 0:
                return b, kind
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def update_rest(lead: F32, i: int, g: F32, first: int, end: int, o: Pixel, s: Step) -> bool:
    """Pixel i of a block, whose leader did not match: its other Gaussians are g[first:end]. Returns foreground."""
    found, kind = first_match(g, first, end, o, s)
    if found < 0 and s.colour_shadows > ZERO and o.d != o.d and is_colour_shadow(lead, i, o, s):
        return False
    left = ONE - lead[WEIGHT * BLOCK + i]
    for b in range(first, end, N_FIELDS):
        g[b + WEIGHT] *= left
    foreground = found < 0 or not is_background(lead, i, g, first, end, found, s)
    rate_w, rate_m = o.rate_w, o.rate_m
    gap = o.d - lead[D * BLOCK + i]
    behind = lead[SEEN * BLOCK + i] >= s.min_seen and gap < ZERO and gap * gap >= s.beta * lead[VAR_D * BLOCK + i]
    if behind and rate_w > ZERO and (found < 0 or g[found + WEIGHT] <= s.deepest_weight):
        # Nobody stands behind the background: what appears there was hidden, learn it quickly.
        rate_w, rate_m = max(rate_w, s.rate_fast), max(rate_m, s.rate_fast)
    keep = ONE - rate_w
    lead[WEIGHT * BLOCK + i] *= keep
    for b in range(first, end, N_FIELDS):
        g[b + WEIGHT] *= keep
    if found >= 0:
        g[found + WEIGHT] += rate_w
        if kind == 1:
            learn_colour(g, found, o, rate_m, s)
        learn_depth(g, found, o, rate_m, s)
    elif rate_w > ZERO:
        new_gaussian(g, end - N_FIELDS, o, rate_w, s)
    settle_order(lead, i, g, first, end)
    return foreground


@njit(cache=True, nogil=True)
def pixel_of(obs: F32, i: int) -> Pixel:
    """Observation i of the scratch block."""
    return Pixel(
        obs[Y * BLOCK + i],
        obs[U * BLOCK + i],
        obs[V * BLOCK + i],
        obs[D * BLOCK + i],
        obs[CHROMA_OK * BLOCK + i],
        obs[RATE_W * BLOCK + i],
        obs[RATE_M * BLOCK + i],
    )


@njit(cache=True, nogil=True)
def update_blocks(
    lead: F32, rest: F32, image: U8, disparity: F32, opinion: U8, mask: U8, first: int, last: int, s: Step
) -> None:
    """Update blocks first..last-1 and write their part of the mask.

    Args:
        lead: (n_blocks, N_LEAD * BLOCK) leading Gaussians. rest: (N * (K-1) * N_FIELDS,) the others.
        image: (N,) or (3 N,) uint8. disparity: (N,) float32 or empty. opinion: (N,) uint8 or empty. mask: (N,) uint8.
    """
    colour = image.size > mask.size
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    size = rest.size // mask.size
    for block in range(first, last):
        start = block * BLOCK
        n = min(BLOCK, mask.size - start)
        stage(image, disparity, opinion, start, n, colour, s, obs)
        leaders = lead[block]
        match_leaders(leaders, obs, n, s)
        unmatched = 0
        for i in range(n):
            mask[start + i] = 0
            unmatched += obs[MATCHED * BLOCK + i] <= ZERO
        if unmatched == 0:
            continue
        for i in range(n):
            if obs[MATCHED * BLOCK + i] <= ZERO:
                base = (start + i) * size
                if update_rest(leaders, i, rest, base, base + size, pixel_of(obs, i), s):
                    mask[start + i] = 255


@njit(cache=True, nogil=True)
def start_blocks(lead: F32, image: U8, disparity: F32, n_pixels: int, s: Step) -> None:
    """First frame: every leader starts at the observation with all the weight."""
    obs = np.zeros(N_SCRATCH * BLOCK, np.float32)
    g = np.zeros(N_FIELDS, np.float32)
    lead[:, :] = ONE
    no_opinion = np.zeros(0, np.uint8)
    for block in range(lead.shape[0]):
        start = block * BLOCK
        n = min(BLOCK, n_pixels - start)
        stage(image, disparity, no_opinion, start, n, image.size > n_pixels, s, obs)
        for i in range(n):
            new_gaussian(g, 0, pixel_of(obs, i), ONE, s)
            for f in range(N_FIELDS):
                lead[block, f * BLOCK + i] = g[f]
            lead[block, ACTIVITY * BLOCK + i] = ZERO
            lead[block, LAST_Y * BLOCK + i] = g[Y]


@njit(cache=True, nogil=True)
def rebase(lead: F32, rest: F32, gain: float, offset: float) -> None:
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
