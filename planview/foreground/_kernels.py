"""Mixtures of Gaussians in (Y, U, V, disparity), pixel by pixel; tests/reference/foreground.py defines the results.

Helpers are inlined, but those that few pixels need: they are compiled once. All numbers are float32.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from calib.kernels import helper, inlined, kernel
from calib.types import F32, U8, AnyArray
from planview.foreground.params import BACKGROUND, FOREGROUND, NEARER, PERSON, SHADOW

GAUSSIAN = np.dtype(
    [(n, "f4") for n in ("weight", "depth_fraction", "y", "u", "v", "d", "var_y", "var_u", "var_v", "var_d")]
)
"""A Gaussian: weight, fraction of its observations with depth, means and variances. A negative variance of luma marks a
mean learned from clipped pixels, which is a lower bound of the surface's luma. Variances of chroma are 0 until it has
been seen: by night, cameras show none."""

F = np.float32
ZERO = F(0)
ONE = F(1)
NEW_VARIANCE = F(4)
"""Variances of a new Gaussian, over those of a frame's noise: twice its deviation."""
NO_MATCH = 0
SAME = 1
OTHER_LIGHT = 2
"""Ways in which an observation matches a Gaussian: not, by colour, or by depth under a shadow or a patch of light."""

Real = Any
"""float32; numpy's scalar and Python's float do not mix for a type checker."""
Gaussian = Any
"""Record of GAUSSIAN."""


class Constants(NamedTuple):
    """The same for all pixels of an update, float32; luma and chroma in the exposure of the model."""

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
    floor_y: Real  # variances of the frame's noise
    floor_uv: Real
    least_y: Real  # least variances learned: a dark frame's noise is not the surface's
    least_uv: Real
    floor_d: Real
    floor_d_per_d4: Real  # growth of the disparity's smallest variance with its fourth power
    active: Real  # mean |dY| above which a pixel is active
    slow_active: Real  # factor on the rates of active pixels
    background_weight: Real  # T
    deepest_weight: Real  # T_D
    shadow_ratio: Real
    shadow_ratio_unsure: Real  # the same where depth is no evidence
    colour_shadow_ratio: Real  # darkest shadow recognised by colour alone, 0: none


class PixelMixtures(NamedTuple):
    """The background model: a mixture and an activity per pixel."""

    gaussians: AnyArray  # (K, H, W) GAUSSIAN, by decreasing weight / deviation of luma; weights add up to 1
    activity: F32  # (H, W) mean absolute change of luma
    last_y: F32  # (H, W) luma when the pixel last learned


class FrameArrays(NamedTuple):
    """The images of a frame."""

    image: U8  # (H, W, 1) grey or (H, W, 3) BGR
    disparity: F32  # (H, W) [px], NaN where there is none
    feedback: U8  # (H, W) NO_FEEDBACK, PERSON or BACKGROUND


class Pixel(NamedTuple):
    """An observation: luma, chroma and disparity (NaN: none), and whether its chroma is usable."""

    y: Real
    u: Real
    v: Real
    d: Real
    chroma: bool


@inlined
def observe(image: U8, row: int, column: int, d: Real, s: Constants) -> Pixel:
    """A pixel's luma and chroma (BT.601, analogue scale) in the exposure of the model."""
    inv_gain = ONE / s.gain
    blue = F(image[row, column, 0])
    if image.shape[2] == 1:
        return Pixel(min((blue - s.offset) * inv_gain, s.clip), ZERO, ZERO, d, False)
    green = F(image[row, column, 1])
    red = F(image[row, column, 2])
    luma = F(0.299) * red + F(0.587) * green + F(0.114) * blue
    # A clipped channel shifts the hue; a dim saturated colour keeps it.
    clipped = (max(max(blue, green), red) >= s.clip_image) & (luma >= F(0.75) * s.clip_image)
    u = F(0.492) * (blue - luma) * inv_gain
    v = F(0.877) * (red - luma) * inv_gain
    return Pixel(min((luma - s.offset) * inv_gain, s.clip), u, v, d, not clipped)


@inlined
def shown_luma(g: Gaussian, s: Constants) -> Real:
    """The mean luma as the camera can show it now."""
    return max(min(g.y, s.clip), s.black)


@inlined
def chroma_counts(g: Gaussian, o: Pixel, s: Constants) -> Any:
    """Chroma is compared unless one side is dark, clipped or without (Harville, Gordon, Woodfill 2001: dark pixels)."""
    return o.chroma and min(shown_luma(g, s), o.y) > s.dark and g.var_y > ZERO and g.var_u > ZERO


@inlined
def both_have_depth(g: Gaussian, o: Pixel, s: Constants) -> Any:
    """True if depth can be compared (Harville et al. 2001: enough of the Gaussian's observations had depth)."""
    return o.d == o.d and g.depth_fraction >= s.min_depth_fraction


@inlined
def distance_in_chroma(g: Gaussian, du: Real, dv: Real, s: Constants) -> Real:
    """Squared normalised distance in chroma."""
    return du * du / max(g.var_u, s.floor_uv) + dv * dv / max(g.var_v, s.floor_uv)


@inlined
def colour_distance(g: Gaussian, o: Pixel, s: Constants) -> Real:
    """Squared normalised distance in luma, and in chroma where that counts; NaN or infinite for an empty Gaussian."""
    dy = o.y - shown_luma(g, s)
    du = o.u - g.u
    dv = o.v - g.v
    noise_y = s.floor_y if g.var_y != ZERO else ZERO
    in_chroma = distance_in_chroma(g, du, dv, s) if chroma_counts(g, o, s) else ZERO
    return dy * dy / max(abs(g.var_y), noise_y) + in_chroma


@inlined
def is_other_light(g: Gaussian, o: Pixel, chroma: bool, darkest: Real, s: Constants) -> Any:
    """The same surface under a shadow or a patch of light: luma off by a plausible ratio, chroma scaled alike."""
    ratio = (o.y - s.black) / max(shown_luma(g, s) - s.black, ONE)
    du = o.u - ratio * g.u
    dv = o.v - ratio * g.v
    like = not chroma or distance_in_chroma(g, du, dv, s) < s.beta
    return like and ratio >= darkest and ratio * darkest <= ONE


@inlined
def match(g: Gaussian, o: Pixel, s: Constants) -> int:
    """NO_MATCH, SAME or OTHER_LIGHT: depth overrules colour where both have it (Harville et al. 2001).

    It does so by its evidence, the likelihood of the disparity on the surface over that on a body before it: far away
    the two look the same.
    """
    distance = colour_distance(g, o, s)
    if not both_have_depth(g, o, s):
        return SAME if distance < s.beta else NO_MATCH
    dd = o.d - g.d
    if dd * dd >= s.beta * g.var_d:
        return NO_MATCH
    nearer = s.body_over_metre * g.d  # that distance over the background's
    body = nearer * g.d / max(ONE - nearer, F(0.1))  # by which disparity a body is nearer
    evidence = max(body * (body - (dd + dd)) / g.var_d, ZERO)  # twice the logarithm of the ratio
    if distance < min(s.beta + evidence, s.beta_relaxed):
        return SAME
    unsure = max(ONE - evidence / s.beta, ZERO)
    darkest = s.shadow_ratio + unsure * (s.shadow_ratio_unsure - s.shadow_ratio)
    return OTHER_LIGHT if is_other_light(g, o, chroma_counts(g, o, s), darkest, s) else NO_MATCH


@inlined
def smallest_var_d(d: Real, s: Constants) -> Real:
    """A deviation sigma_z of depth is sigma_z d^2 / (f b) in disparity: its variance grows with d^4."""
    return s.floor_d + s.floor_d_per_d4 * ((d * d) * (d * d))


@inlined
def learn(g: Gaussian, o: Pixel, kind: int, rate: Real, s: Constants) -> None:
    """Update a Gaussian by an observation that matches it; other light moves the means but not the variances."""
    rate_var = rate if kind == SAME else ZERO
    chroma = chroma_counts(g, o, s)
    rate_c = rate if chroma else ZERO
    rate_var_c = rate_var if chroma else ZERO
    dy = o.y - shown_luma(g, s)
    du = o.u - g.u
    dv = o.v - g.v
    is_bound = g.var_y < ZERO
    if kind == SAME:
        is_bound = o.y >= s.clip and (is_bound or g.y <= s.clip)
    var_y = max(abs(g.var_y) + rate_var * (dy * dy - abs(g.var_y)), s.least_y)
    g.y = max(g.y, s.clip) if is_bound and kind == SAME else g.y + rate * dy
    g.var_y = -var_y if is_bound else var_y
    g.u += rate_c * du
    g.v += rate_c * dv
    if g.var_u > ZERO:
        g.var_u = max(g.var_u + rate_var_c * (du * du - g.var_u), s.least_uv)
        g.var_v = max(g.var_v + rate_var_c * (dv * dv - g.var_v), s.least_uv)
    elif o.chroma and rate > ZERO:
        g.u = o.u
        g.v = o.v
        g.var_u = NEW_VARIANCE * s.floor_uv
        g.var_v = NEW_VARIANCE * s.floor_uv

    # The mean of the valid disparities only: an exponential mean of d over one of validity.
    has_depth = o.d == o.d
    had_none = g.depth_fraction <= ZERO
    g.depth_fraction += rate * ((ONE if has_depth else ZERO) - g.depth_fraction)
    learns_depth = has_depth and rate > ZERO
    rate_d = rate / max(g.depth_fraction, rate) if learns_depth else ZERO
    dd = o.d - g.d if has_depth else ZERO
    g.var_d = max(g.var_d + rate_d * (dd * dd - g.var_d), smallest_var_d(g.d, s))
    g.d += rate_d * dd
    if learns_depth and had_none:
        g.var_d = NEW_VARIANCE * smallest_var_d(o.d, s)


@helper
def start(g: Gaussian, weight: Real, o: Pixel, s: Constants) -> None:
    """Begin a Gaussian at an observation."""
    has_depth = o.d == o.d
    g.weight = weight
    g.depth_fraction = ONE if has_depth else ZERO
    g.y = o.y
    g.u = o.u
    g.v = o.v
    g.d = o.d if has_depth else ZERO
    g.var_y = -NEW_VARIANCE * s.floor_y if o.y >= s.clip else NEW_VARIANCE * s.floor_y
    g.var_u = g.var_v = NEW_VARIANCE * s.floor_uv if o.chroma else ZERO
    g.var_d = NEW_VARIANCE * smallest_var_d(g.d, s)


@helper
def is_deep(g: Gaussian, s: Constants) -> Any:
    """True if a Gaussian has depth and a weight above T_D."""
    return g.weight > s.deepest_weight and g.depth_fraction >= s.min_depth_fraction


@helper
def is_background(mixture: AnyArray, index: int, s: Constants) -> Any:
    """True if a Gaussian is one of the leading ones up to weight T, or the deepest above T_D (Harville et al. 2001)."""
    before = ZERO
    for k in range(index):
        before += mixture[k].weight
    deepest = is_deep(mixture[index], s)
    for k in range(len(mixture)):
        deepest &= not is_deep(mixture[k], s) or mixture[k].d >= mixture[index].d
    return before <= s.background_weight or deepest


@helper
def classify(leader: Gaussian, o: Pixel, s: Constants) -> int:
    """Kind of a pixel that is not background: SHADOW by its colour, NEARER by depth alone, or FOREGROUND."""
    dim = o.d != o.d and o.y < leader.y and s.colour_shadow_ratio > ZERO
    if dim and is_other_light(leader, o, o.chroma and leader.var_u > ZERO, s.colour_shadow_ratio, s):
        return SHADOW
    in_front = both_have_depth(leader, o, s) and o.d > leader.d
    return NEARER if in_front and colour_distance(leader, o, s) < s.beta else FOREGROUND


@helper
def sort(mixture: AnyArray, spare: AnyArray, s: Constants) -> None:
    """Make the weights add up to 1 and order by decreasing weight / deviation of luma (insertion sort, stable)."""
    total = ZERO
    for k in range(len(mixture)):
        total += mixture[k].weight
    scale = ONE / total
    for k in range(len(mixture)):
        mixture[k].weight *= scale
        spare[0] = mixture[k]
        place = k
        while place > 0 and rank(spare[0], s) > rank(mixture[place - 1], s):
            mixture[place] = mixture[place - 1]
            place -= 1
        mixture[place] = spare[0]


@helper
def rank(g: Gaussian, s: Constants) -> Real:
    """Squared weight / deviation of luma; 0 where nothing was learned."""
    return g.weight * g.weight / max(abs(g.var_y), s.floor_y)


@helper
def settle(
    mixture: AnyArray, spare: AnyArray, o: Pixel, rate_w: Real, rate_m: Real, fast: Real, s: Constants
) -> int:  # fmt: skip
    """Find what a pixel is that its leader does not match, and learn it by another Gaussian or in place of the last."""
    leader = mixture[0]
    last = len(mixture) - 1
    matched = 0
    kind = NO_MATCH
    while matched < last and kind == NO_MATCH:
        matched += 1
        kind = match(mixture[matched], o, s)
    # Background not observed so far: a surface that was clipped may turn out brighter than that; what appears behind
    # the background was hidden by a person or a thing before: none can stand there.
    dd = o.d - leader.d
    both = both_have_depth(leader, o, s)
    agree = dd * dd < s.beta * leader.var_d
    unclipped = leader.var_y < ZERO and o.y > leader.y and (agree or not both)
    behind = both and not agree and dd < ZERO
    background = unclipped or (kind != NO_MATCH and is_background(mixture, matched, s))
    what = 0 if background else classify(leader, o, s)
    if rate_w <= ZERO:
        return what
    if (unclipped or behind) and (kind == NO_MATCH or mixture[matched].weight <= s.deepest_weight):
        rate_w = max(rate_w, fast)
        rate_m = max(rate_m, fast)
    for k in range(len(mixture)):
        mixture[k].weight *= ONE - rate_w
    if kind != NO_MATCH:
        mixture[matched].weight += rate_w
        learn(mixture[matched], o, kind, rate_m, s)
    else:
        start(mixture[last], rate_w, o, s)
    sort(mixture, spare, s)
    return what


@kernel
def count_shown(model: PixelMixtures, frame: FrameArrays, s: Constants, step: int) -> tuple[int, int, int, int]:
    """Counts over every ``step``-th row and column: pixels; those neither dark nor saturated; which of these show the
    background; and all whose depth can be compared with that of the background."""
    spare = np.empty(1, GAUSSIAN)
    n = 0
    lit = 0
    shown = 0
    compared = 0
    for row in range(0, frame.image.shape[0], step):
        for column in range(0, frame.image.shape[1], step):
            n += 1
            o = observe(frame.image, row, column, frame.disparity[row, column], s)
            leader = model.gaussians[0, row, column]
            compared += both_have_depth(leader, o, s)
            if s.dark < o.y < s.clip:
                lit += 1
                if match(leader, o, s) != NO_MATCH:
                    shown += 1
                else:
                    what = settle(model.gaussians[:, row, column], spare, o, ZERO, ZERO, ZERO, s)
                    shown += what == 0 or what == SHADOW
    return n, lit, shown, compared


@kernel
def update(model: PixelMixtures, frame: FrameArrays, mask: U8, s: Constants, turns: F32) -> None:
    """Match and classify each pixel, which writes the mask, and learn those whose turn it is.

    A model of zeros matches nothing and begins with the frame.

    Args:
        mask: (H, W) uint8.
        turns: (T, 4) rates of rows r = t modulo T: of weights, of means and variances, of both where the background is
            known or was uncovered, of the activity. Rows of zeros do not learn.
    """
    gaussians, activities, last_y = model
    spare = np.empty(1, GAUSSIAN)
    for row in range(mask.shape[0]):
        rates = turns[row % len(turns)]
        fast = rates[2]
        for column in range(mask.shape[1]):
            mask[row, column] = 0
            o = observe(frame.image, row, column, frame.disparity[row, column], s)
            rate_w = rate_m = ZERO
            if fast > ZERO:
                activity = activities[row, column]
                activity += rates[3] * (abs(o.y - last_y[row, column]) - activity)
                activities[row, column] = activity
                last_y[row, column] = o.y
                # Activity slows learning (Harville et al. 2001), a person stops it, and known background learns fast
                # (Harville 2002, ECCV).
                feedback = frame.feedback[row, column]
                if feedback == BACKGROUND:
                    rate_w = rate_m = fast
                elif feedback != PERSON:
                    slow = s.slow_active if activity > s.active else ONE
                    rate_w = slow * rates[0]
                    rate_m = slow * rates[1]
            leader = gaussians[0, row, column]
            kind = match(leader, o, s)
            if kind == NO_MATCH:
                mask[row, column] = settle(gaussians[:, row, column], spare, o, rate_w, rate_m, fast, s)
            elif fast > ZERO:
                # Nearly every pixel. A view of its mixture would cost more than the loop.
                for k in range(len(gaussians)):
                    gaussians[k, row, column].weight *= ONE - rate_w
                leader.weight += rate_w
                learn(leader, o, kind, rate_m, s)
