"""What planview's foreground kernels compute, in plain numpy: all pixels at once, mixtures as (K, N) records.

float32 throughout, as the kernels.
"""

from typing import NamedTuple

import numpy as np

from planview.foreground._kernels import GAUSSIAN, NEW_VARIANCE, Constants, Pixel, PixelMixtures
from planview.foreground.params import BACKGROUND, FOREGROUND, NEARER, PERSON, SHADOW

F32 = np.float32


class Rates(NamedTuple):
    """Shares of the new observation: of weights, of means and variances, of both where the background is known or was
    uncovered, of the activity."""

    weight: float
    mean: float
    fast: float
    activity: float


def observe(image: np.ndarray, disparity: np.ndarray | None, s: Constants) -> Pixel:
    """Y, U, V in the exposure of the model, and whether chroma is usable, from (N,) grey or (N, 3) BGR uint8."""
    none = np.full(len(image), np.nan, F32) if disparity is None else disparity
    inv_gain = F32(1) / s.gain
    zero = np.zeros(len(image), F32)
    if image.ndim == 1:
        return Pixel(np.minimum((image.astype(F32) - s.offset) * inv_gain, s.clip), zero, zero, none, zero > 0)
    b, g, r = image.astype(F32).T
    luma = F32(0.299) * r + F32(0.587) * g + F32(0.114) * b
    clipped = (image.max(axis=1) >= s.clip_image) & (luma >= F32(0.75) * s.clip_image)
    y = np.minimum((luma - s.offset) * inv_gain, s.clip)
    return Pixel(y, F32(0.492) * (b - luma) * inv_gain, F32(0.877) * (r - luma) * inv_gain, none, ~clipped)


def start(o: Pixel, k: int, s: Constants) -> PixelMixtures:
    """The first frame: one Gaussian with all the weight."""
    n = len(o.y)
    g = np.ones((k, n), GAUSSIAN)
    g["weight"][1:] = 0
    _start_gaussians(g[0], np.ones(n, bool), o, s)
    return PixelMixtures(g, np.zeros(n, F32), o.y.copy())


def update(m: PixelMixtures, o: Pixel, feedback: np.ndarray, s: Constants, rates: Rates) -> np.ndarray:
    """One frame: changes the mixtures, returns the mask (N,): 0, SHADOW (by colour), NEARER (by depth), FOREGROUND."""
    g, activity, last_y = m
    learns = rates.weight > 0
    if learns:
        activity += rates.activity * (np.abs(o.y - last_y) - activity)
        last_y[:] = o.y
    slow = np.where(feedback == PERSON, F32(0), np.where(activity > s.active, s.slow_active, F32(1)))
    rate_w = np.where(feedback == BACKGROUND, rates.fast, rates.weight * slow)
    rate_m = np.where(feedback == BACKGROUND, rates.fast, rates.mean * slow)
    found, kind = _found(g, o, s)
    unclipped, behind = _uncovered(g[0], o, s)
    mask = _classify(g, found, unclipped, o, s)
    if learns:
        young = (found < 0) | (g["weight"][np.maximum(found, 0), np.arange(len(found))] <= s.deepest_weight)
        quick = (found != 0) & (unclipped | behind) & young & (rate_w > 0)
        rate_w = np.where(quick, np.maximum(rate_w, rates.fast), rate_w)
        rate_m = np.where(quick, np.maximum(rate_m, rates.fast), rate_m)
        _learn(g, found, kind, o, rate_w, rate_m, s)
    return mask


def count_shown(m: PixelMixtures, o: Pixel, s: Constants) -> tuple[int, int, int]:
    """Pixels neither dark nor saturated, those of them that show the background, and those with depth to compare."""
    leader = m.gaussians[0]
    what = _classify(m.gaussians, _found(m.gaussians, o, s)[0], _uncovered(leader, o, s)[0], o, s)
    lit = (o.y > s.dark) & (o.y < s.clip)
    return int(lit.sum()), int((np.isin(what, (0, SHADOW)) & lit).sum()), int(_both(leader, o, s).sum())


def _found(g: np.ndarray, o: Pixel, s: Constants) -> tuple[np.ndarray, np.ndarray]:
    """The first Gaussian that matches each pixel, -1 for none, and how (``_match_kind``)."""
    kinds = np.stack([_match_kind(each, o, s) for each in g])
    matched = (kinds > 0) & (g["weight"] > 0)
    matched[0] = kinds[0] > 0
    found = np.where(matched.any(axis=0), matched.argmax(axis=0), -1)
    return found, kinds[np.maximum(found, 0), np.arange(len(found))]


def _both(g: np.ndarray, o: Pixel, s: Constants) -> np.ndarray:
    return ~np.isnan(o.d) & (g["depth_fraction"] >= s.min_depth_fraction)


def _far(g: np.ndarray, o: Pixel, s: Constants) -> np.ndarray:
    """Squared normalised distance in colour."""
    dy, du, dv = o.y - _shown(g, s), o.u - g["u"], o.v - g["v"]
    noisy = np.where(g["var_y"] != 0, np.maximum(np.abs(g["var_y"]), s.floor_y), F32(0))
    return dy * dy / noisy + np.where(_chroma(g, o, s), _in_chroma(g, du, dv, s), F32(0))


def _shown(g: np.ndarray, s: Constants) -> np.ndarray:
    return np.maximum(np.minimum(g["y"], s.clip), s.black)


def _chroma(g: np.ndarray, o: Pixel, s: Constants) -> np.ndarray:
    return o.chroma & (np.minimum(_shown(g, s), o.y) > s.dark) & (g["var_y"] > 0) & (g["var_u"] > 0)


def _in_chroma(g: np.ndarray, du: np.ndarray, dv: np.ndarray, s: Constants) -> np.ndarray:
    var_u, var_v = (np.maximum(g[name], s.floor_uv) for name in ("var_u", "var_v"))
    return du * du / var_u + dv * dv / var_v


def _other_light(g: np.ndarray, o: Pixel, chroma: np.ndarray, darkest: float, s: Constants) -> np.ndarray:
    ratio = (o.y - s.black) / np.maximum(_shown(g, s) - s.black, F32(1))
    like = (_in_chroma(g, o.u - ratio * g["u"], o.v - ratio * g["v"], s) < s.beta) | ~chroma
    return like & (ratio >= darkest) & (ratio * darkest <= 1)


def _match_kind(g: np.ndarray, o: Pixel, s: Constants) -> np.ndarray:
    """0 no match, 1 by colour, 2 other light where depth agrees."""
    dd, both = o.d - g["d"], _both(g, o, s)
    agree = both & (dd * dd < s.beta * g["var_d"])
    nearer = s.body_over_metre * g["d"]
    body = nearer * g["d"] / np.maximum(F32(1) - nearer, F32(0.1))
    evidence = np.maximum(body * (body - (dd + dd)) / g["var_d"], F32(0))
    same = _far(g, o, s) < np.where(agree, np.minimum(s.beta + evidence, s.beta_relaxed), s.beta)
    unsure = np.maximum(F32(1) - evidence / s.beta, F32(0))
    darkest = s.shadow_ratio + unsure * (s.shadow_ratio_unsure - s.shadow_ratio)
    kind = np.where(same, 1, np.where(agree & _other_light(g, o, _chroma(g, o, s), darkest, s), 2, 0))
    return np.where(both & ~agree, 0, kind)


def _uncovered(leader: np.ndarray, o: Pixel, s: Constants) -> tuple[np.ndarray, np.ndarray]:
    dd, both = o.d - leader["d"], _both(leader, o, s)
    agree = dd * dd < s.beta * leader["var_d"]
    unclipped = (leader["var_y"] < 0) & (o.y > leader["y"]) & (agree | ~both)
    return unclipped, both & ~agree & (dd < 0)


def _classify(g: np.ndarray, found: np.ndarray, unclipped: np.ndarray, o: Pixel, s: Constants) -> np.ndarray:
    """The background set: leading weight up to T, and the deepest Gaussian above T_D (Harville et al. 2001)."""
    leading = np.cumsum(g["weight"], axis=0) - g["weight"] <= s.background_weight
    leading[0] = True
    reliable = (g["weight"] > s.deepest_weight) & (g["depth_fraction"] >= s.min_depth_fraction)
    deepest = np.where(reliable, g["d"], np.inf).min(axis=0)
    background = leading | (reliable & (g["d"] <= deepest))
    pixels, leader, darkest = np.arange(len(found)), g[0], s.colour_shadow_ratio
    known = (found >= 0) & background[np.maximum(found, 0), pixels] | unclipped & (found != 0)
    shadow = _other_light(leader, o, o.chroma & (leader["var_u"] > 0), darkest, s)
    shadow &= (darkest > 0) & np.isnan(o.d) & (o.y < leader["y"])
    nearer = (_far(leader, o, s) < s.beta) & (o.d > leader["d"]) & _both(leader, o, s)
    return np.where(known, 0, np.where(shadow, SHADOW, np.where(nearer, NEARER, FOREGROUND))).astype(np.uint8)


def _learn(
    g: np.ndarray, found: np.ndarray, kind: np.ndarray, o: Pixel, rate_w: np.ndarray, rate_m: np.ndarray, s: Constants
) -> None:
    frozen = (found != 0) & (rate_w <= 0)
    weight = g["weight"]
    weight *= np.where(frozen, F32(1), F32(1) - rate_w)
    for k in range(len(g)):
        chosen = (found == k) & ~frozen
        weight[k] += np.where(chosen, rate_w, F32(0))
        _learn_gaussian(g[k], chosen, kind, o, rate_m, s)
    new = (found < 0) & ~frozen
    weight[-1] = np.where(new, rate_w, weight[-1])
    _start_gaussians(g[-1], new, o, s)
    weight[:] = np.where(found == 0, weight, weight / weight.sum(axis=0))
    # By decreasing weight / sigma of luma; ties keep their order.
    order = np.argsort(-weight * weight / np.abs(g["var_y"]), axis=0, kind="stable")
    order = np.where((found != 0) & ~frozen, order, np.arange(len(g))[:, None])
    g[:] = np.take_along_axis(g, order, axis=0)


def _learn_gaussian(
    g: np.ndarray, chosen: np.ndarray, kind: np.ndarray, o: Pixel, rate: np.ndarray, s: Constants
) -> None:
    rate_var = np.where(kind == 1, rate, F32(0))
    bound, clipped, same = g["var_y"] < 0, o.y >= s.clip, kind == 1
    still = np.where(same, clipped & (bound | (g["y"] <= s.clip)), bound)
    dy, chroma, has_depth = o.y - _shown(g, s), _chroma(g, o, s), ~np.isnan(o.d)
    depth_fraction = g["depth_fraction"] + rate * (has_depth.astype(F32) - g["depth_fraction"])
    learns_d = has_depth & (rate > 0)
    rate_d = np.where(learns_d, rate / np.maximum(depth_fraction, np.maximum(rate, F32(1e-30))), F32(0))
    dd = np.where(has_depth, o.d - g["d"], F32(0))
    var_y = np.maximum(np.abs(g["var_y"]) + rate_var * (dy * dy - np.abs(g["var_y"])), s.least_y)
    var_d = np.maximum(g["var_d"] + rate_d * (dd * dd - g["var_d"]), _smallest_var_d(g["d"], s))
    first_depth = learns_d & (g["depth_fraction"] <= 0)
    new = {
        "var_y": np.where(still, -var_y, var_y),
        "var_d": np.where(first_depth, NEW_VARIANCE * _smallest_var_d(o.d, s), var_d),
        "y": np.where(still & same, np.maximum(g["y"], s.clip), g["y"] + rate * dy),
        "d": g["d"] + rate_d * dd,
        "depth_fraction": depth_fraction,
    }
    for mean, var, seen in (("u", "var_u", o.u), ("v", "var_v", o.v)):
        change, first = seen - g[mean], (g[var] <= 0) & o.chroma & (rate > 0)
        new[mean] = np.where(first, seen, g[mean] + np.where(chroma, rate, F32(0)) * change)
        step = np.where(chroma, rate_var, F32(0)) * (change * change - g[var])
        started = np.where(first, NEW_VARIANCE * s.floor_uv, F32(0))
        new[var] = np.where(g[var] > 0, np.maximum(g[var] + step, s.least_uv), started)
    for name, values in new.items():
        np.copyto(g[name], values, where=chosen)


def _start_gaussians(g: np.ndarray, chosen: np.ndarray, o: Pixel, s: Constants) -> None:
    has_depth = ~np.isnan(o.d)
    d, var_y = np.where(has_depth, o.d, F32(0)), NEW_VARIANCE * s.floor_y
    var_uv = np.where(o.chroma, NEW_VARIANCE * s.floor_uv, F32(0))
    values = {
        "depth_fraction": has_depth.astype(F32), "y": o.y, "u": o.u, "v": o.v, "d": d,
        "var_y": np.where(o.y >= s.clip, -var_y, var_y), "var_u": var_uv, "var_v": var_uv,
        "var_d": NEW_VARIANCE * _smallest_var_d(d, s),
    }  # fmt: skip
    for name, value in values.items():
        np.copyto(g[name], value, where=chosen)


def _smallest_var_d(d: np.ndarray, s: Constants) -> np.ndarray:
    return s.floor_d + s.floor_d_per_d4 * ((d * d) * (d * d))
