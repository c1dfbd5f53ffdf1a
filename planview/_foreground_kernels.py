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


class Step(NamedTuple):
    """Numbers of one update, all float32; colour in the model's reference exposure."""

    beta: np.float32  # squared normalised distance of a match
    beta_relaxed: np.float32  # the same for colour where depth agrees
    min_seen: np.float32  # fraction of observations with depth that makes depth reliable
    dark: np.float32  # luma below which chroma is noise
    clip: np.float32  # luma at which the sensor saturates
    clip_image: np.float32  # the same as the image shows it, 0-255
    gain: np.float32  # image luma = gain * model luma + offset
    offset: np.float32
    floor_y: np.float32  # variance floors
    floor_uv: np.float32
    floor_d: np.float32
    init_y: np.float32  # variances of a new Gaussian
    init_uv: np.float32
    init_d: np.float32
    rate_w: np.float32  # learning rates of this step: weights, means and variances, known background
    rate_m: np.float32
    rate_fast: np.float32
    rate_activity: np.float32
    active: np.float32  # mean |dY| above which a pixel is active
    slow_active: np.float32  # factors on the rates of active pixels and of pixels under a person
    slow_person: np.float32
    background_weight: np.float32
    deepest_weight: np.float32
    shadow_ratio: np.float32
    colour_shadows: np.float32  # 1: shadows are removed by colour alone where there is no depth


F = np.float32
ZERO, ONE = F(0), F(1)


@njit(cache=True, nogil=True)
def stage_grey(image: U8, start: int, n: int, s: Step, obs: F32) -> None:
    """Luma of n pixels from a grey image (N, 1) into the scratch block."""
    inv_gain = ONE / s.gain
    for i in range(n):
        obs[Y, i] = min((F(image[start + i, 0]) - s.offset) * inv_gain, s.clip)
        obs[U, i] = ZERO
        obs[V, i] = ZERO
        obs[CHROMA_OK, i] = ZERO


@njit(cache=True, nogil=True)
def stage_colour(image: U8, start: int, n: int, s: Step, obs: F32) -> None:
    """Luma and chroma (BT.601) of n pixels from a BGR image (N, 3) into the scratch block."""
    inv_gain = ONE / s.gain
    bright = F(0.75) * s.clip_image
    for i in range(n):
        b = F(image[start + i, 0])
        g = F(image[start + i, 1])
        r = F(image[start + i, 2])
        luma = F(0.299) * r + F(0.587) * g + F(0.114) * b
        obs[Y, i] = min((luma - s.offset) * inv_gain, s.clip)
        obs[U, i] = F(0.492) * (b - luma) * inv_gain
        obs[V, i] = F(0.877) * (r - luma) * inv_gain
        clipped = (max(max(b, g), r) >= s.clip_image) & (luma >= bright)
        obs[CHROMA_OK, i] = ZERO if clipped else ONE


@njit(cache=True, nogil=True, error_model="numpy")
def match_leaders(lead: F32, obs: F32, n: int, s: Step) -> None:
    """Test n pixels against their leading Gaussian and learn where it matches: no branches, so that it vectorises."""
    for i in range(n):
        y, u, v, d = obs[Y, i], obs[U, i], obs[V, i], obs[D, i]
        # Activity sets the rates (section 2 of the notes: divided by about 5).
        activity = lead[ACTIVITY, i] + s.rate_activity * (abs(y - lead[LAST_Y, i]) - lead[ACTIVITY, i])
        lead[ACTIVITY, i] = activity
        lead[LAST_Y, i] = y
        opinion = obs[OPINION, i]
        slow = s.slow_active if activity > s.active else ONE
        slow = s.slow_person if opinion == ONE else slow
        known = opinion == F(2)
        rate_w = s.rate_fast if known else s.rate_w * slow
        rate_m = s.rate_fast if known else s.rate_m * slow
        obs[RATE_W, i] = rate_w
        obs[RATE_M, i] = rate_m

        # A negative luma variance marks a mean learned from clipped pixels: it is only a lower bound.
        bound = lead[VAR_Y, i] < ZERO
        var_y = abs(lead[VAR_Y, i])
        mean_y, seen = lead[Y, i], lead[SEEN, i]
        shown = min(mean_y, s.clip)
        beyond = bound & (y > shown)
        dy = ZERO if beyond else y - shown
        du, dv, dd = u - lead[U, i], v - lead[V, i], d - lead[D, i]
        chroma = (obs[CHROMA_OK, i] > ZERO) & (min(shown, y) > s.dark) & (not bound)
        inv_u, inv_v = ONE / lead[VAR_U, i], ONE / lead[VAR_V, i]
        far = dy * dy / var_y + (du * du * inv_u + dv * dv * inv_v if chroma else ZERO)

        has_depth = d == d
        both = has_depth & (seen >= s.min_seen)
        near = dd * dd < s.beta * lead[VAR_D, i]
        agree = both & near
        veto = both & (not near)
        same_colour = far < (s.beta_relaxed if agree else s.beta)
        ratio = y / shown
        su, sv = u - ratio * lead[U, i], v - ratio * lead[V, i]
        shade = su * su * inv_u + sv * sv * inv_v < s.beta
        shade = agree & (ratio >= s.shadow_ratio) & (ratio < ONE) & (shade | (not chroma))
        match = (not veto) & (same_colour | shade)
        obs[MATCHED, i] = ONE if match else ZERO

        # Learn; a shadow teaches depth and weight only.
        lead[WEIGHT, i] = lead[WEIGHT, i] + (rate_w * (ONE - lead[WEIGHT, i]) if match else ZERO)
        learn = match & same_colour
        clipped = y >= s.clip
        fresh = learn & bound & (not clipped)
        step = rate_m if learn else ZERO
        new_var = max(var_y + step * (dy * dy - var_y), s.floor_y)
        new_var = s.init_y if fresh else new_var
        still = bound & (not fresh) | learn & clipped & (mean_y <= s.clip)
        lead[VAR_Y, i] = -new_var if still else new_var
        lead[Y, i] = y if fresh else mean_y + step * dy
        step_c = ONE if fresh else (step if chroma else ZERO)
        lead[U, i] = lead[U, i] + step_c * du
        lead[V, i] = lead[V, i] + step_c * dv
        step_c = ZERO if fresh else step_c
        lead[VAR_U, i] = max(lead[VAR_U, i] + step_c * (du * du - lead[VAR_U, i]), s.floor_uv)
        lead[VAR_V, i] = max(lead[VAR_V, i] + step_c * (dv * dv - lead[VAR_V, i]), s.floor_uv)
        new_seen = seen + (rate_m * ((ONE if has_depth else ZERO) - seen) if match else ZERO)
        lead[SEEN, i] = new_seen
        # Mean of the valid observations only: an exponential mean of d over one of validity.
        step_d = rate_m / new_seen if match & has_depth & (new_seen > ZERO) else ZERO
        dd = dd if has_depth else ZERO
        lead[D, i] = lead[D, i] + step_d * dd
        new_var = max(lead[VAR_D, i] + step_d * (dd * dd - lead[VAR_D, i]), s.floor_d)
        lead[VAR_D, i] = s.init_d if (step_d > ZERO) & (seen <= ZERO) else new_var


@njit(cache=True, nogil=True, error_model="numpy")
def gaussian_matches(g: F32, o: F32, s: Step) -> int:
    """0 no match, 1 match by colour, 2 shadow where depth agrees; g is one Gaussian, o the pixel's observation."""
    bound = g[VAR_Y] < ZERO
    shown = min(g[Y], s.clip)
    dy = ZERO if bound and o[Y] > shown else o[Y] - shown
    du, dv, dd = o[U] - g[U], o[V] - g[V], o[D] - g[D]
    chroma = o[CHROMA_OK] > ZERO and min(shown, o[Y]) > s.dark and not bound
    inv_u, inv_v = ONE / g[VAR_U], ONE / g[VAR_V]
    far = dy * dy / abs(g[VAR_Y]) + (du * du * inv_u + dv * dv * inv_v if chroma else ZERO)
    both = o[D] == o[D] and g[SEEN] >= s.min_seen
    near = dd * dd < s.beta * g[VAR_D]
    if both and not near:
        return 0
    if far < (s.beta_relaxed if both else s.beta):
        return 1
    ratio = o[Y] / shown
    if both and s.shadow_ratio <= ratio < ONE:
        su, sv = o[U] - ratio * g[U], o[V] - ratio * g[V]
        if not chroma or su * su * inv_u + sv * sv * inv_v < s.beta:
            return 2
    return 0


@njit(cache=True, nogil=True, error_model="numpy")
def learn_gaussian(g: F32, o: F32, kind: int, rate: float, s: Step) -> None:
    """Move a matched Gaussian towards the observation, except its weight."""
    bound = g[VAR_Y] < ZERO
    if kind == 1:
        shown = min(g[Y], s.clip)
        clipped = o[Y] >= s.clip
        du, dv = o[U] - g[U], o[V] - g[V]
        if bound and not clipped:
            g[Y], g[U], g[V], g[VAR_Y] = o[Y], o[U], o[V], s.init_y
        else:
            dy = ZERO if bound and o[Y] > shown else o[Y] - shown
            var = max(abs(g[VAR_Y]) + rate * (dy * dy - abs(g[VAR_Y])), s.floor_y)
            g[VAR_Y] = -var if bound or (clipped and g[Y] <= s.clip) else var
            chroma = o[CHROMA_OK] > ZERO and min(shown, o[Y]) > s.dark and not bound
            g[Y] = g[Y] + rate * dy
            if chroma:
                g[U] = g[U] + rate * du
                g[V] = g[V] + rate * dv
                g[VAR_U] = max(g[VAR_U] + rate * (du * du - g[VAR_U]), s.floor_uv)
                g[VAR_V] = max(g[VAR_V] + rate * (dv * dv - g[VAR_V]), s.floor_uv)
    has_depth = o[D] == o[D]
    seen = g[SEEN]
    g[SEEN] = seen + rate * ((ONE if has_depth else ZERO) - seen)
    if has_depth and g[SEEN] > ZERO:
        step, dd = rate / g[SEEN], o[D] - g[D]
        g[D] = g[D] + step * dd
        g[VAR_D] = s.init_d if seen <= ZERO else max(g[VAR_D] + step * (dd * dd - g[VAR_D]), s.floor_d)


@njit(cache=True, nogil=True)
def new_gaussian(g: F32, o: F32, weight: float, s: Step) -> None:
    """Start a Gaussian at an observation."""
    has_depth = o[D] == o[D]
    g[WEIGHT] = weight
    g[SEEN] = ONE if has_depth else ZERO
    g[Y], g[U], g[V] = o[Y], o[U], o[V]
    g[D] = o[D] if has_depth else ZERO
    g[VAR_Y] = -s.init_y if o[Y] >= s.clip else s.init_y
    g[VAR_U], g[VAR_V], g[VAR_D] = s.init_uv, s.init_uv, s.init_d


@njit(cache=True, nogil=True)
def is_background(g: F32, k: int, s: Step) -> bool:
    """Whether Gaussian k of an ordered mixture (K, 10) is in the background set: leading weight, or deepest."""
    before = ZERO
    for j in range(k):
        before += g[j, WEIGHT]
    if before <= s.background_weight:
        return True
    if g[k, WEIGHT] <= s.deepest_weight or g[k, SEEN] < s.min_seen:
        return False
    for j in range(g.shape[0]):
        if g[j, WEIGHT] > s.deepest_weight and g[j, SEEN] >= s.min_seen and g[j, D] < g[k, D]:
            return False
    return True


@njit(cache=True, nogil=True)
def first_by_rank(a: F32, b: F32) -> bool:
    """Whether weight / sigma of a exceeds that of b, without square roots."""
    return bool(a[WEIGHT] * a[WEIGHT] * abs(b[VAR_Y]) > b[WEIGHT] * b[WEIGHT] * abs(a[VAR_Y]))


@njit(cache=True, nogil=True, error_model="numpy")
def order_mixture(g: F32) -> None:
    """Normalise the weights and sort by decreasing weight / luma deviation (insertion sort, stable)."""
    total = ZERO
    for k in range(g.shape[0]):
        total += g[k, WEIGHT]
    for k in range(g.shape[0]):
        g[k, WEIGHT] /= total
    for k in range(1, g.shape[0]):
        j = k
        while j > 0 and first_by_rank(g[j], g[j - 1]):
            for f in range(N_FIELDS):
                g[j, f], g[j - 1, f] = g[j - 1, f], g[j, f]
            j -= 1


@njit(cache=True, nogil=True, error_model="numpy")
def update_mixture(g: F32, o: F32, s: Step) -> bool:
    """One pixel whose leader (k = 0) did not match: the rest of the mixture (K, 10). Returns foreground."""
    n = g.shape[0]
    found, kind = -1, 0
    for k in range(1, n):
        if g[k, WEIGHT] > ZERO:
            kind = gaussian_matches(g[k], o, s)
            if kind > 0:
                found = k
                break
    rate_w, rate_m = o[RATE_W], o[RATE_M]
    gap = o[D] - g[0, D]
    behind = g[0, SEEN] >= s.min_seen and gap < ZERO and gap * gap >= s.beta * g[0, VAR_D]
    if behind and rate_w > ZERO and (found < 0 or g[found, WEIGHT] <= s.deepest_weight):
        # Nobody stands behind the background: what appears there was hidden, learn it quickly.
        rate_w, rate_m = max(rate_w, s.rate_fast), max(rate_m, s.rate_fast)
    if found < 0:
        shaded = s.colour_shadows > ZERO and o[D] != o[D] and is_colour_shadow(g[0], o, s)
        if rate_w > ZERO and not shaded:
            for k in range(n - 1):
                g[k, WEIGHT] *= ONE - rate_w
            new_gaussian(g[n - 1], o, rate_w, s)
            order_mixture(g)
        return not shaded
    foreground = not is_background(g, found, s)
    for k in range(n):
        g[k, WEIGHT] *= ONE - rate_w
    g[found, WEIGHT] += rate_w
    learn_gaussian(g[found], o, kind, rate_m, s)
    order_mixture(g)
    return foreground


@njit(cache=True, nogil=True, error_model="numpy")
def is_colour_shadow(g: F32, o: F32, s: Step) -> bool:
    """Darker than the background by a plausible ratio, chroma scaled alike."""
    shown = min(g[Y], s.clip)
    ratio = o[Y] / shown
    if ratio < s.shadow_ratio or ratio >= ONE:
        return False
    if o[CHROMA_OK] <= ZERO or o[Y] <= s.dark:
        return True
    su, sv = o[U] - ratio * g[U], o[V] - ratio * g[V]
    return bool(su * su / g[VAR_U] + sv * sv / g[VAR_V] < s.beta)


@njit(cache=True, nogil=True)
def update_pixel(lead: F32, rest: F32, obs: F32, i: int, g: F32, o: F32, s: Step) -> bool:
    """Unpack the mixture of pixel i of a block, update it, pack it again. Returns foreground."""
    for f in range(N_FIELDS):
        g[0, f] = lead[f, i]
    left = ONE - g[0, WEIGHT]
    for k in range(1, g.shape[0]):
        for f in range(N_FIELDS):
            g[k, f] = rest[k - 1, f]
        g[k, WEIGHT] *= left
    for f in range(N_SCRATCH):
        o[f] = obs[f, i]
    foreground = update_mixture(g, o, s)
    for f in range(N_FIELDS):
        lead[f, i] = g[0, f]
    left = ONE - g[0, WEIGHT]
    inv_left = ONE / left if left > ZERO else ZERO
    for k in range(1, g.shape[0]):
        for f in range(N_FIELDS):
            rest[k - 1, f] = g[k, f]
        rest[k - 1, WEIGHT] = g[k, WEIGHT] * inv_left
    return foreground


@njit(cache=True, nogil=True)
def stage(image: U8, disparity: F32, opinion: U8, start: int, n: int, s: Step, obs: F32) -> None:
    """Observation of n pixels into the scratch block; image (N, 1 or 3), the others (N,) or empty for none."""
    if image.shape[1] == 3:
        stage_colour(image, start, n, s, obs)
    else:
        stage_grey(image, start, n, s, obs)
    if disparity.size:
        for i in range(n):
            obs[D, i] = disparity[start + i]
    else:
        obs[D, :] = F(np.nan)
    if opinion.size:
        for i in range(n):
            obs[OPINION, i] = F(opinion[start + i])
    else:
        obs[OPINION, :] = ZERO


@njit(cache=True, nogil=True)
def update_blocks(
    lead: F32, rest: F32, image: U8, disparity: F32, opinion: U8, mask: U8, first: int, last: int, s: Step
) -> None:
    """Update blocks first..last-1 and write their part of the mask.

    Args:
        lead: (n_blocks, N_LEAD, BLOCK) leading Gaussians. rest: (N, K-1, N_FIELDS) the others.
        image: (N, C) uint8. disparity: (N,) float32 or empty. opinion: (N,) uint8 or empty. mask: (N,) uint8.
    """
    obs = np.zeros((N_SCRATCH, BLOCK), np.float32)
    g = np.zeros((rest.shape[1] + 1, N_FIELDS), np.float32)
    o = np.zeros(N_SCRATCH, np.float32)
    for block in range(first, last):
        start = block * BLOCK
        n = min(BLOCK, mask.size - start)
        stage(image, disparity, opinion, start, n, s, obs)
        match_leaders(lead[block], obs, n, s)
        for i in range(n):
            mask[start + i] = 0
            if obs[MATCHED, i] <= ZERO and update_pixel(lead[block], rest[start + i], obs, i, g, o, s):
                mask[start + i] = 255


@njit(cache=True, nogil=True)
def start_blocks(lead: F32, rest: F32, image: U8, disparity: F32, s: Step) -> None:
    """First frame: every leader starts at the observation, the others have no weight."""
    obs = np.zeros((N_SCRATCH, BLOCK), np.float32)
    g = np.zeros(N_FIELDS, np.float32)
    rest[:, :, :] = ZERO
    rest[:, :, VAR_Y] = s.init_y
    rest[:, :, VAR_U : VAR_V + 1] = s.init_uv
    rest[:, :, VAR_D] = s.init_d
    lead[:, :, :] = ONE
    no_opinion = np.zeros(0, np.uint8)
    for block in range(lead.shape[0]):
        start = block * BLOCK
        n = min(BLOCK, image.shape[0] - start)
        stage(image, disparity, no_opinion, start, n, s, obs)
        for i in range(n):
            new_gaussian(g, obs[:, i], ONE, s)
            lead[block, :N_FIELDS, i] = g
            lead[block, ACTIVITY, i] = ZERO
            lead[block, LAST_Y, i] = obs[Y, i]
