"""One Gaussian of a mixture over (Y, U, V, disparity): how it matches and how it learns, without branches or checks.

The same two functions serve vector loops and single pixels. tests/reference/foreground.py defines them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

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
    beta_relaxed: Real  # the same for colour where depth agrees
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


@njit(cache=True, nogil=True)
def shown_luma(g: Gaussian, s: UpdateConstants) -> Real:
    """The mean luma as the camera can show it now."""
    return max(min(g.y, s.clip), s.black)


@njit(cache=True, nogil=True)
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
    """NO_MATCH, SAME or OTHER_LIGHT: depth overrules colour where both have it (Harville et al. 2001)."""
    dy, du, dv, dd = o.y - shown_luma(g, s), o.u - g.u, o.v - g.v, o.d - g.d
    chroma = chroma_counts(g, o, s)
    far = dy * dy / abs(g.var_y) + (du * du / g.var_u + dv * dv / g.var_v if chroma else ZERO)
    both = (o.d == o.d) & (g.depth_fraction >= s.min_depth_fraction)
    agree = both & (dd * dd < s.beta * g.var_d)
    same = far < (s.beta_relaxed if agree else s.beta)
    kind = SAME if same else (OTHER_LIGHT if agree & is_other_light(g, o, chroma, s.shadow_ratio, s) else NO_MATCH)
    return NO_MATCH if both & (not agree) else kind


@njit(cache=True, nogil=True)
def fourth_power(d: Real) -> Real:
    """d^4: a deviation sigma_z of depth is sigma_z d^2 / (f b) in disparity, and its variance grows with d^4."""
    return (d * d) * (d * d)


@njit(cache=True, nogil=True, error_model="numpy")
def is_nearer(g: Gaussian, o: Pixel, s: UpdateConstants) -> Real:
    """Whether depth alone tells an observation from a Gaussian: the same colour, but in front of it."""
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


@njit(cache=True, nogil=True)
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
