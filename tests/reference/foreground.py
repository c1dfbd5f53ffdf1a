"""What planview's foreground kernels compute, in plain numpy: all pixels at once, mixtures as (K, N) arrays.

float32 throughout, as the kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planview.foreground._kernels import NEW_VARIANCE, Constants
from planview.foreground.params import BACKGROUND, FOREGROUND, NEARER, PERSON, SHADOW

F32 = np.float32


class Rates(NamedTuple):
    """Shares of the new observation: of weights, of means and variances, of both where the background is known or was
    uncovered, of the activity."""

    weight: float
    mean: float
    fast: float
    activity: float


@dataclass
class Mixtures:
    """Mixtures of N pixels in order of rank; arrays are (K, N) float32, activity and last_y (N,)."""

    weight: np.ndarray
    depth_fraction: np.ndarray
    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    d: np.ndarray
    var_y: np.ndarray
    var_u: np.ndarray
    var_v: np.ndarray
    var_d: np.ndarray
    activity: np.ndarray
    last_y: np.ndarray

    NUMBERS = ("weight", "depth_fraction", "y", "u", "v", "d", "var_y", "var_u", "var_v", "var_d")


@dataclass
class Pixels:
    """Observations of N pixels, (N,) each; d is NaN where there is none."""

    y: np.ndarray
    u: np.ndarray
    v: np.ndarray
    d: np.ndarray
    chroma: np.ndarray


def observe(image: np.ndarray, disparity: np.ndarray | None, s: Constants) -> Pixels:
    """Y, U, V in the exposure of the model, and whether chroma is usable, from (N,) grey or (N, 3) BGR uint8."""
    none = np.full(len(image), np.nan, F32) if disparity is None else disparity
    inv_gain = F32(1) / s.gain
    zero = np.zeros(len(image), F32)
    if image.ndim == 1:
        return Pixels(np.minimum((image.astype(F32) - s.offset) * inv_gain, s.clip), zero, zero, none, zero > 0)
    b, g, r = image.astype(F32).T
    luma = F32(0.299) * r + F32(0.587) * g + F32(0.114) * b
    clipped = (image.max(axis=1) >= s.clip_image) & (luma >= F32(0.75) * s.clip_image)
    y = np.minimum((luma - s.offset) * inv_gain, s.clip)
    return Pixels(y, F32(0.492) * (b - luma) * inv_gain, F32(0.877) * (r - luma) * inv_gain, none, ~clipped)


def start(o: Pixels, k: int, s: Constants) -> Mixtures:
    """The first frame: one Gaussian with all the weight."""
    n = len(o.y)
    ones = {name: np.ones((k, n), F32) for name in Mixtures.NUMBERS}
    m = Mixtures(**ones, activity=np.zeros(n, F32), last_y=o.y.copy())
    m.weight[1:] = 0
    _start_gaussians(m, np.zeros(n, int), np.ones(n, bool), o, s)
    return m


def update(m: Mixtures, o: Pixels, feedback: np.ndarray, s: Constants, rates: Rates) -> np.ndarray:
    """One frame: changes the mixtures, returns the mask (N,): 0, SHADOW (by colour), NEARER (by depth), FOREGROUND."""
    learns = rates.weight > 0
    if learns:
        m.activity += rates.activity * (np.abs(o.y - m.last_y) - m.activity)
        m.last_y = o.y.copy()
    slow = np.where(feedback == PERSON, F32(0), np.where(m.activity > s.active, s.slow_active, F32(1)))
    rate_w = np.where(feedback == BACKGROUND, rates.fast, rates.weight * slow)
    rate_m = np.where(feedback == BACKGROUND, rates.fast, rates.mean * slow)
    kinds = np.stack([_match_kind(m, k, o, s) for k in range(len(m.weight))])
    matched = (kinds > 0) & (m.weight > 0)
    matched[0] = kinds[0] > 0
    found = np.where(matched.any(axis=0), matched.argmax(axis=0), -1)
    unclipped, behind = _uncovered(m, o, s)
    mask = _classify(m, found, unclipped, o, s)
    if learns:
        at = np.maximum(found, 0)
        pixels = np.arange(len(found))
        young = (found < 0) | (m.weight[at, pixels] <= s.deepest_weight)
        quick = (found != 0) & (unclipped | behind) & young & (rate_w > 0)
        rate_w = np.where(quick, np.maximum(rate_w, rates.fast), rate_w)
        rate_m = np.where(quick, np.maximum(rate_m, rates.fast), rate_m)
        _learn(m, found, kinds[at, pixels], o, rate_w, rate_m, s)
    return mask


def count_shown(m: Mixtures, o: Pixels, s: Constants) -> tuple[int, int, int]:
    """Pixels neither dark nor saturated, those of them that show the background, and those with depth to compare."""
    kinds = np.stack([_match_kind(m, k, o, s) for k in range(len(m.weight))])
    matched = (kinds > 0) & (m.weight > 0)
    matched[0] = kinds[0] > 0
    found = np.where(matched.any(axis=0), matched.argmax(axis=0), -1)
    known = np.isin(_classify(m, found, _uncovered(m, o, s)[0], o, s), (0, SHADOW))
    lit = (o.y > s.dark) & (o.y < s.clip)
    compared = ~np.isnan(o.d) & (m.depth_fraction[0] >= s.min_depth_fraction)
    return int(lit.sum()), int((known & lit).sum()), int(compared.sum())


def _shown(m: Mixtures, k: int, s: Constants) -> np.ndarray:
    return np.maximum(np.minimum(m.y[k], s.clip), s.black)


def _chroma(m: Mixtures, k: int, o: Pixels, s: Constants) -> np.ndarray:
    return o.chroma & (np.minimum(_shown(m, k, s), o.y) > s.dark) & (m.var_y[k] > 0) & (m.var_u[k] > 0)


def _noisy(var_y: np.ndarray, s: Constants) -> np.ndarray:
    return np.where(var_y != 0, np.maximum(np.abs(var_y), s.floor_y), F32(0))


def _in_chroma(m: Mixtures, k: int, du: np.ndarray, dv: np.ndarray, s: Constants) -> np.ndarray:
    var_u, var_v = (np.maximum(var, s.floor_uv) for var in (m.var_u[k], m.var_v[k]))
    return du * du / var_u + dv * dv / var_v


def _other_light(m: Mixtures, k: int, o: Pixels, chroma: np.ndarray, darkest: float, s: Constants) -> np.ndarray:
    ratio = (o.y - s.black) / np.maximum(_shown(m, k, s) - s.black, F32(1))
    du, dv = o.u - ratio * m.u[k], o.v - ratio * m.v[k]
    like = (_in_chroma(m, k, du, dv, s) < s.beta) | ~chroma
    return like & (ratio >= darkest) & (ratio * darkest <= 1)


def _match_kind(m: Mixtures, k: int, o: Pixels, s: Constants) -> np.ndarray:
    """0 no match, 1 by colour, 2 other light where depth agrees."""
    dy, du, dv, dd = o.y - _shown(m, k, s), o.u - m.u[k], o.v - m.v[k], o.d - m.d[k]
    chroma = _chroma(m, k, o, s)
    far = dy * dy / _noisy(m.var_y[k], s)
    far = far + np.where(chroma, _in_chroma(m, k, du, dv, s), F32(0))
    both = ~np.isnan(o.d) & (m.depth_fraction[k] >= s.min_depth_fraction)
    agree = both & (dd * dd < s.beta * m.var_d[k])
    nearer = s.body_over_metre * m.d[k]
    body = nearer * m.d[k] / np.maximum(F32(1) - nearer, F32(0.1))
    evidence = np.maximum(body * (body - (dd + dd)) / m.var_d[k], F32(0))
    same = far < np.where(agree, np.minimum(s.beta + evidence, s.beta_relaxed), s.beta)
    unsure = np.maximum(F32(1) - evidence / s.beta, F32(0))
    darkest = s.shadow_ratio + unsure * (s.shadow_ratio_unsure - s.shadow_ratio)
    kind = np.where(same, 1, np.where(agree & _other_light(m, k, o, chroma, darkest, s), 2, 0))
    return np.where(both & ~agree, 0, kind)


def _uncovered(m: Mixtures, o: Pixels, s: Constants) -> tuple[np.ndarray, np.ndarray]:
    dd = o.d - m.d[0]
    both = ~np.isnan(o.d) & (m.depth_fraction[0] >= s.min_depth_fraction)
    agree = dd * dd < s.beta * m.var_d[0]
    unclipped = (m.var_y[0] < 0) & (o.y > m.y[0]) & (agree | ~both)
    return unclipped, both & ~agree & (dd < 0)


def _classify(m: Mixtures, found: np.ndarray, unclipped: np.ndarray, o: Pixels, s: Constants) -> np.ndarray:
    """The background set: leading weight up to T, and the deepest Gaussian above T_D (Harville et al. 2001)."""
    before = np.cumsum(m.weight, axis=0) - m.weight
    leading = before <= s.background_weight
    leading[0] = True
    reliable = (m.weight > s.deepest_weight) & (m.depth_fraction >= s.min_depth_fraction)
    deepest = np.where(reliable, m.d, np.inf).min(axis=0)
    background = leading | (reliable & (m.d <= deepest))
    pixels = np.arange(len(found))
    known = (found >= 0) & background[np.maximum(found, 0), pixels] | unclipped & (found != 0)
    darkest = s.colour_shadow_ratio
    shadow = (
        (darkest > 0) & np.isnan(o.d) & (o.y < m.y[0]) & _other_light(m, 0, o, o.chroma & (m.var_u[0] > 0), darkest, s)
    )
    dy, du, dv = o.y - _shown(m, 0, s), o.u - m.u[0], o.v - m.v[0]
    far = dy**2 / _noisy(m.var_y[0], s) + np.where(_chroma(m, 0, o, s), _in_chroma(m, 0, du, dv, s), 0)
    nearer = (far < s.beta) & (o.d > m.d[0]) & (m.depth_fraction[0] >= s.min_depth_fraction)
    return np.where(known, 0, np.where(shadow, SHADOW, np.where(nearer, NEARER, FOREGROUND))).astype(np.uint8)


def _learn(
    m: Mixtures, found: np.ndarray, kind: np.ndarray, o: Pixels, rate_w: np.ndarray, rate_m: np.ndarray, s: Constants
) -> None:
    frozen = (found != 0) & (rate_w <= 0)
    m.weight *= np.where(frozen, F32(1), F32(1) - rate_w)
    for k in range(len(m.weight)):
        chosen = (found == k) & ~frozen
        m.weight[k] += np.where(chosen, rate_w, F32(0))
        _learn_gaussian(m, k, chosen, kind, o, rate_m, s)
    last = len(m.weight) - 1
    new = (found < 0) & ~frozen
    m.weight[last] = np.where(new, rate_w, m.weight[last])
    _start_gaussians(m, np.full(len(found), last), new, o, s)
    m.weight = np.where(found == 0, m.weight, m.weight / m.weight.sum(axis=0))
    _order(m, (found != 0) & ~frozen)


def _learn_gaussian(
    m: Mixtures, k: int, chosen: np.ndarray, kind: np.ndarray, o: Pixels, rate: np.ndarray, s: Constants
) -> None:
    rate_var = np.where(kind == 1, rate, F32(0))
    bound, clipped, same = m.var_y[k] < 0, o.y >= s.clip, kind == 1
    still = np.where(same, clipped & (bound | (m.y[k] <= s.clip)), bound)
    dy, du, dv = o.y - _shown(m, k, s), o.u - m.u[k], o.v - m.v[k]
    chroma = _chroma(m, k, o, s)
    has_depth = ~np.isnan(o.d)
    depth_fraction = m.depth_fraction[k] + rate * (has_depth.astype(F32) - m.depth_fraction[k])
    learns_d = has_depth & (rate > 0)
    rate_d = np.where(learns_d, rate / np.maximum(depth_fraction, np.maximum(rate, F32(1e-30))), F32(0))
    dd = np.where(has_depth, o.d - m.d[k], F32(0))
    var_y = np.maximum(np.abs(m.var_y[k]) + rate_var * (dy * dy - np.abs(m.var_y[k])), s.least_y)
    var_d = np.maximum(m.var_d[k] + rate_d * (dd * dd - m.var_d[k]), _smallest_var_d(m.d[k], s))
    first_depth = learns_d & (m.depth_fraction[k] <= 0)
    new = {
        "var_y": np.where(still, -var_y, var_y),
        "var_d": np.where(first_depth, NEW_VARIANCE * _smallest_var_d(o.d, s), var_d),
        "y": np.where(still & same, np.maximum(m.y[k], s.clip), m.y[k] + rate * dy),
        "d": m.d[k] + rate_d * dd,
        "depth_fraction": depth_fraction,
    }
    for mean, var, change in (("u", "var_u", du), ("v", "var_v", dv)):
        old, old_var = getattr(m, mean)[k], getattr(m, var)[k]
        first = (old_var <= 0) & o.chroma & (rate > 0)
        new[mean] = np.where(first, getattr(o, mean), old + np.where(chroma, rate, F32(0)) * change)
        step = np.where(chroma, rate_var, F32(0)) * (change * change - old_var)
        started = np.where(first, NEW_VARIANCE * s.floor_uv, F32(0))
        new[var] = np.where(old_var > 0, np.maximum(old_var + step, s.least_uv), started)
    for name, values in new.items():
        array = getattr(m, name)
        array[k] = np.where(chosen, values, array[k])


def _start_gaussians(m: Mixtures, k: np.ndarray, chosen: np.ndarray, o: Pixels, s: Constants) -> None:
    has_depth = ~np.isnan(o.d)
    d, var_y = np.where(has_depth, o.d, F32(0)), NEW_VARIANCE * s.floor_y
    values = {
        "depth_fraction": has_depth.astype(F32), "y": o.y, "u": o.u, "v": o.v, "d": d,
        "var_y": np.where(o.y >= s.clip, -var_y, var_y), "var_u": np.where(o.chroma, NEW_VARIANCE * s.floor_uv, F32(0)),
        "var_v": np.where(o.chroma, NEW_VARIANCE * s.floor_uv, F32(0)), "var_d": NEW_VARIANCE * _smallest_var_d(d, s),
    }  # fmt: skip
    pixels = np.flatnonzero(chosen)
    for name, value in values.items():
        getattr(m, name)[k[pixels], pixels] = np.broadcast_to(value, chosen.shape)[pixels]


def _smallest_var_d(d: np.ndarray, s: Constants) -> np.ndarray:
    return s.floor_d + s.floor_d_per_d4 * ((d * d) * (d * d))


def _order(m: Mixtures, chosen: np.ndarray) -> None:
    """By decreasing weight / sigma of luma; ties keep their order."""
    rank = m.weight * m.weight / np.abs(m.var_y)
    order = np.argsort(-rank, axis=0, kind="stable")
    order = np.where(chosen, order, np.arange(len(rank))[:, None])
    for name in Mixtures.NUMBERS:
        setattr(m, name, np.take_along_axis(getattr(m, name), order, axis=0))
