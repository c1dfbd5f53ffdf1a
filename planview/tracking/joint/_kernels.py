"""Compiled kernels of the joint explanation; ``tests/reference/explain.py`` defines them in plain numpy.

A sample is one pixel near a person: its camera, ray, kind, range and weight. ``pose`` is (x, y, height, facing, lean):
where the feet are [m], how high the head is and how far before the feet [m], and where the chest points [rad],
counterclockwise from x. Arrays that belong together are passed as one tuple: ``samples`` (``SampleArrays``), ``people``
(``People.arrays``), ``table`` (``BodyTable``), ``view`` (``ViewArrays``) and ``model`` (an array of one ``Model``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8
from planview.maps.view import BACKGROUND_SEEN as SEEN
from planview.maps.view import NO_DEPTH, SHADOW, SURFACE, UNKNOWN
from planview.tracking.body import LEAN_M, TURNS, TURNS_PER_RAD

"""Kind of pixels besides those of views: a shadow or furniture, which is no evidence but hides a body."""
AT, THROUGH, BEFORE, REST = range(4)
LAYERS = 4
"""Other people on one ray, the nearest first."""
TINY = 1e-12
MAX_TURNS = 3
"""Most rounds of the ascent with one step."""
ONE_LOG = 12
"""Ratios of likelihoods, each within 1e-12 and 1e12, whose product one logarithm is taken of."""
PARTS = 3
LEGS_TO, TORSO_TO = 0.45, 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
FURNITURE_TO = 0.72
"""Relative height up to which nearer background may hide a person."""
AROUND_M = 0.25
"""Margin of samples beyond a body's reach [m]."""
BODY_SOFTNESS_M = 0.07
"""Deviation of the least distance of two bodies' axes [m]."""
SLOPE_MAX = 4.0
"""Most that a step along a flat ray is lengthened."""
GOLDEN = 0.6180339887498949, 0.7548776662466927
"""Shares whose multiples spread evenly: which of two neighbouring tables a sample takes."""


class Known(NamedTuple):
    """What is known of a pose before the frame.

    Attributes:
        xx, xy, yy, height: inverse covariance of place and height [1/m^2].
        turn, back: concentration of the facing about the predicted one, and how probably this is back to front.
        walk, heading: concentration of the facing about the direction of walking, and that direction [rad].
    """

    xx: float
    xy: float
    yy: float
    height: float
    turn: float
    back: float
    walk: float
    heading: float


class Model(NamedTuple):
    """What is assumed of sensors and bodies, as kernels take it.

    Attributes:
        body, background: pF and pB, shares of a body's and of the background's pixels that are foreground.
        near_people: pB within ``reach_m`` of a person.
        hidden, hidden_sitting: how probably unseen furniture hides a pixel below ``hidden_to`` (relative height) of
            somebody who stands, or who is lower than ``sitting_from`` of the own height.
        no_depth, outliers, range_m: share of a body's foreground without depth, share of wrong depths, and how far
            these spread [m].
        unknown: kappa, share of surface before which something unknown stands.
        surface_var: of a body's surface about its table [m^2].
        colour: weight of the colours.
        low_share, sits, sitting: shares of people who are of any lower height, and who sit at ``sitting`` of theirs.
        masks: 1 where no pixel has a range.
        patch_m, patch_px, spacing_m: errors of nearer pixels are one error; distance of samples on a body.
        body_m: height of the table's body [m]; ``apart_m``: least distance of two axes [m].
        height_min_m, height_max_m: of people [m].
    """

    body: float
    background: float
    near_people: float
    hidden: float
    hidden_sitting: float
    hidden_to: float
    sitting_from: float
    no_depth: float
    outliers: float
    range_m: float
    unknown: float
    surface_var: float
    colour: float
    low_share: float
    sits: float
    sitting: float
    masks: float
    patch_m: float
    patch_px: float
    spacing_m: float
    body_m: float
    reach_m: float
    apart_m: float
    height_min_m: float
    height_max_m: float
    lean_std_m: float


class ViewArrays(NamedTuple):
    """One view as kernels take it: what ``PixelRays`` and ``View`` hold, and

    Attributes:
        lens: K of r' = r + K r^2 and the image's middle [px].
        std_per_m2: deviation of a range over its square, in the middle of the image [1/m].
    """

    centre_m: F64
    direction: F32
    level: F32
    stretch: F32
    matched_m: F32
    projection: F64
    lens: tuple[float, float, float]
    kind: U8
    range_m: F32
    colour: U8
    pixel_sr: float
    std_per_m2: float


class SampleArrays(NamedTuple):
    """Pixels near a person, one entry each; those of the first ``size[0]`` hold.

    Attributes:
        cx, cy, cz: the camera [m].
        ex, ey, cos, sin: level direction of the ray, and its depression.
        range_m, weight, std_per_m2, matched_m: as of a view; ``weight`` in patches.
        kind, code, angle: kind of pixel, colour, index of the depression in the body's table.
        layers, n_layers: other people on the ray, see ``lay_others``.
        u, w, ahead, which: of the body that is being tried, see ``_covered``.
        turn, slant: direction of the ray [of TURNS], less by an even spread over one of them, so that samples of a
            direction between two tables take both in its proportion; and the share of a lean from which they lean.
    """

    cx: F32
    cy: F32
    cz: F32
    ex: F32
    ey: F32
    cos: F32
    sin: F32
    range_m: F32
    weight: F32
    std_per_m2: F32
    matched_m: F32
    u: F32
    w: F32
    ahead: F32
    turn: F32
    slant: F32
    kind: U8
    code: U8
    angle: U8
    which: I64
    n_layers: I64
    layers: F32
    size: I64

    @staticmethod
    def of(n: int) -> SampleArrays:
        """Room for n samples, of which none is there."""
        arrays = *np.empty((16, n), np.float32), *np.empty((3, n), np.uint8), *np.empty((2, n), np.int64)
        return SampleArrays._make([*arrays, np.empty((n, 4, LAYERS + 1), np.float32), np.zeros(1, np.int64)])


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _angle(depression, table):  # type: ignore[no-untyped-def]
    """Index of a ray's depression in the body's table."""
    angle = int((depression - table.angle_min_rad) / table.angle_step_rad + 0.5)
    return min(max(angle, 0), table.cover.shape[1] - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _posture(facing, lean, turn, slant, table):  # type: ignore[no-untyped-def]
    """Index of a posture, seen along a ray, in the body's table."""
    if len(table.cover) == 1:
        return 0
    way = int(facing * TURNS_PER_RAD + (4 * TURNS) - turn) & (TURNS - 1)
    return way + TURNS if lean > slant * LEAN_M else way


@njit(cache=True, nogil=True, error_model="numpy")
def _covered(x: float, y: float, h: float, samples, table, m) -> int:  # type: ignore[no-untyped-def]
    """The samples within a body's table: their number, and which; fills rows u, w and range at the centre [m].

    One loop without branches in float32, which processors take eight at a time; three samples in five end here.
    """
    n, which = samples.size[0], samples.which
    u, w, ahead = samples.u, samples.w, samples.ahead
    cx, cy, cz, ex, ey = samples.cx, samples.cy, samples.cz, samples.ex, samples.ey
    cos, sin = samples.cos, samples.sin
    per_m, w_min = np.float32(m.body_m / h / table.cell_m), np.float32(table.w_min_m / table.cell_m)
    zero, u_middle = np.float32(0.0), np.float32(table.cover.shape[2] // 2)
    x_m, y_m, z_m = np.float32(x), np.float32(y), np.float32(0.5 * h)
    for i in range(n):
        dx, dy, dz = x_m - cx[i], y_m - cy[i], z_m - cz[i]
        along = dx * ex[i] + dy * ey[i]
        u[i] = (dx * ey[i] - dy * ex[i]) * per_m + u_middle
        w[i] = -(along * sin[i] + dz * cos[i]) * per_m - w_min
        ahead[i] = along * cos[i] - dz * sin[i]
    us, ws, k = np.float32(table.cover.shape[2]), np.float32(table.cover.shape[3]), 0
    for i in range(n):
        which[k] = i
        k += (u[i] >= zero) & (u[i] < us) & (w[i] >= zero) & (w[i] < ws)
    return k


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _on_body(kind, seen, at, std, matched, hidden, colour, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on a body whose surface is at a range; the right camera sees nothing before ``matched``.

    ``hidden``: how probably furniture is in the way; ``colour``: ratio of the person's colours to anybody's.
    """
    if kind >= UNKNOWN:
        return 0.5
    if kind == SEEN:
        return (1.0 - hidden) * (1.0 - m.body) + hidden * (1.0 - m.background)
    shown = (1.0 - hidden) * m.body + hidden * m.background
    if kind == NO_DEPTH:
        return shown * (1.0 if at < matched else m.no_depth)
    if seen <= 0.0:
        return shown * colour
    var = m.surface_var + std * std * at * at * at * at
    off = seen - at
    normal = math.exp(-0.5 * off * off / var) / math.sqrt(2.0 * math.pi * var)
    return shown * (1.0 - m.no_depth) * ((1.0 - m.outliers) * normal + m.outliers / m.range_m) * colour


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _on_ground(kind, seen, near, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on which nobody is; ``near`` people there are arms, shadows and what is carried."""
    if kind >= UNKNOWN:
        return 0.5
    if kind == SEEN:
        return 1.0 - m.background
    if kind == NO_DEPTH:
        return 0.5 * m.background
    if seen <= 0.0:
        return m.near_people if near else m.background
    return 0.5 * (m.near_people / (2 * m.reach_m) if near else m.background / m.range_m)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _hidden(h, tall, z, m):  # type: ignore[no-untyped-def]
    """How probably furniture hides a pixel at a relative height of a person ``tall`` when upright."""
    if z >= m.hidden_to:
        return 0.0
    return m.hidden_sitting if h < m.sitting_from * tall else m.hidden


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _behind(kind, seen, at, std, z, m):  # type: ignore[no-untyped-def]
    """Whether background nearer than a body hides it."""
    if kind != SEEN or seen <= 0.0 or z >= FURNITURE_TO:
        return False
    return seen < at - 3 * math.sqrt(m.surface_var + (std * at * at) ** 2)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _ratio(ratios, z, code, m):  # type: ignore[no-untyped-def]
    """Ratio of a person's colours to anybody's, as far as colours count."""
    return 1.0 - m.colour + m.colour * ratios[0 if z < LEGS_TO else (1 if z < TORSO_TO else 2), code]


@njit(cache=True, nogil=True, error_model="numpy")
def boxes(poses: F64, half_m: float, above_m: float, projection: F64, lens, out: F64) -> None:  # type: ignore[no-untyped-def]
    """Left, top, right, bottom (N, 4) [px] of boxes around bodies: ``half_m`` to each side, ``above_m`` their heads.

    ``lens``: K of r' = r + K r^2 and the image's middle [px]; beyond the lens's reach a box is the whole image.
    """
    k, middle_u, middle_v = lens
    for a in range(len(poses)):
        out[a, :2], out[a, 2:] = 1e4, -1e4
        for corner in range(8):
            x = poses[a, 0] + (half_m if corner & 1 else -half_m)
            y = poses[a, 1] + (half_m if corner & 2 else -half_m)
            z = poses[a, 2] + above_m if corner & 4 else 0.0
            depth = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
            depth = max(depth, 0.15)
            u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / depth
            v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / depth
            if k != 0.0:
                r = math.hypot(u - middle_u, v - middle_v)
                if 1.0 + 2.0 * k * r <= 0.0:
                    out[a, :2], out[a, 2:] = -1e4, 1e4
                    break
                u, v = middle_u + (u - middle_u) * (1.0 + k * r), middle_v + (v - middle_v) * (1.0 + k * r)
            u, v = min(max(u, -1e4), 1e4), min(max(v, -1e4), 1e4)
            out[a, 0], out[a, 1] = min(out[a, 0], u), min(out[a, 1], v)
            out[a, 2], out[a, 3] = max(out[a, 2], u), max(out[a, 3], v)


@njit(cache=True, nogil=True, error_model="numpy")
def gather(pose: F64, reach_m: float, view, samples, table, model) -> None:  # type: ignore[no-untyped-def]
    """Append the samples of one camera within ``reach_m`` of a body."""
    m = model[0]
    centre, projection = view.centre_m, view.projection
    rows, cols = view.stretch.shape
    half, box = reach_m + AROUND_M, np.empty((1, 4))
    boxes(pose.reshape(1, -1), half, 0.1, projection, view.lens, box)
    x0, y0, x1, y1 = box[0]
    if x1 < 0 or y1 < 0 or x0 > cols - 1 or y0 > rows - 1:
        return
    c0, c1, r0, r1 = max(0, int(x0)), min(cols - 1, int(x1) + 1), max(0, int(y0)), min(rows - 1, int(y1) + 1)
    dx, dy, dz = pose[0] - centre[0], pose[1] - centre[1], 0.5 * pose[2] - centre[2]
    step = max(1, int(m.spacing_m / math.sqrt((dx * dx + dy * dy + dz * dz) * view.pixel_sr) + 0.5))
    while ((c1 - c0) // step + 1) * ((r1 - r0) // step + 1) > 3000:
        step += 1
    depth = projection[2, 0] * pose[0] + projection[2, 1] * pose[1] + 0.5 * projection[2, 2] * pose[2]
    depth = max(depth + projection[2, 3], 0.15)
    weight = (step / max(m.patch_m / (depth * math.sqrt(view.pixel_sr)), m.patch_px)) ** 2
    n = samples.size[0]
    for r in range(r0 + (-r0) % step, r1 + 1, step):
        # In masks every other row half a step aside: edges of bodies are upright.
        shift = (r // step % 2) * (step // 2) if m.masks > 0.0 else 0
        for c in range(c0 + (shift - c0) % step, c1 + 1, step):
            if n >= len(samples.kind):
                break
            ex, ey, depression, azimuth = view.level[r, c]
            ux, uy, uz = view.direction[r, c]
            if abs(dy * ex - dx * ey) > half or dx * ux + dy * uy + dz * uz < 0.15:
                continue
            samples.cx[n], samples.cy[n], samples.cz[n] = centre[0], centre[1], centre[2]
            samples.ex[n], samples.ey[n], samples.cos[n], samples.sin[n] = ex, ey, ux * ex + uy * ey, -uz
            samples.range_m[n], samples.weight[n], samples.matched_m[n] = (
                view.range_m[r, c],
                weight,
                view.matched_m[r, c],
            )
            samples.std_per_m2[n] = view.std_per_m2 / view.stretch[r, c]
            samples.kind[n], samples.code[n] = view.kind[r, c], view.colour[r, c]
            samples.angle[n] = _angle(depression, table)
            samples.turn[n], samples.slant[n] = azimuth * TURNS_PER_RAD - GOLDEN[0] * n % 1.0, GOLDEN[1] * n % 1.0
            n += 1
    samples.size[0] = n


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_near(x: float, y: float, h: float, samples, near, m) -> None:  # type: ignore[no-untyped-def]
    """Mark the samples within a person's reach: by where their surface is, in masks by where their ray passes."""
    for i in range(samples.size[0]):
        flat = samples.cos[i] * samples.range_m[i]
        if m.masks > 0.0:
            along = (x - samples.cx[i]) * samples.ex[i] + (y - samples.cy[i]) * samples.ey[i]
            at = along * samples.cos[i] - (0.5 * h - samples.cz[i]) * samples.sin[i]
            flat, z = along, samples.cz[i] - samples.sin[i] * at
            if z < -0.1 or z > h + 0.2:
                continue
        ox, oy = samples.cx[i] + samples.ex[i] * flat - x, samples.cy[i] + samples.ey[i] * flat - y
        near[i] |= ox * ox + oy * oy < m.reach_m * m.reach_m


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_layers(ray: F32, n: int, ground: float) -> None:
    """Cover and likelihood of each of n people on a ray to what passes them and what they explain (``lay_others``)."""
    ray[REST, n] = ground
    for j in range(n - 1, -1, -1):
        ray[REST, j] = ray[THROUGH, j] * ray[BEFORE, j] + (1.0 - ray[THROUGH, j]) * ray[REST, j + 1]
    passing, explained = 1.0, 0.0
    for j in range(n):
        pi, like = ray[THROUGH, j], ray[BEFORE, j]
        ray[THROUGH, j], ray[BEFORE, j] = passing, explained
        explained += passing * pi * like
        passing *= 1.0 - pi
    ray[THROUGH, n], ray[BEFORE, n] = passing, explained


@njit(cache=True, nogil=True, error_model="numpy")
def lay_others(samples, people, who: I64, table, model) -> None:  # type: ignore[no-untyped-def]
    """The other people on every sample's ray, the nearest first, each covering as surely as it exists.

    Fills ``layers`` (N, 4, LAYERS + 1): ranges, the share of the ray that passes the first k people, the likelihood
    that these explain, and what all behind them explains of what passes; ``n_layers`` (N,), how many they are.
    """
    m = model[0]
    layers, count = samples.layers, samples.n_layers
    poses, sure, tall, ratios = people
    cover, front, n = table.cover, table.front, samples.size[0]
    near = np.zeros(n, np.bool_)
    count[:n] = 0
    for a in range(len(who)):
        k = who[a]
        x, y, h, facing, lean = poses[k, 0], poses[k, 1], poses[k, 2], poses[k, 3], poses[k, 4]
        if sure[k] > 0.5:
            _mark_near(x, y, h, samples, near, m)
        for q in range(_covered(x, y, h, samples, table, m)):
            i = samples.which[q]
            angle, iu, iw, kind = samples.angle[i], int(samples.u[i]), int(samples.w[i]), samples.kind[i]
            k_on, posture = count[i], _posture(facing, lean, samples.turn[i], samples.slant[i], table)
            pi = cover[posture, angle, iu, iw] * sure[k]
            at = samples.ahead[i] - front[posture, angle, iu, iw] * h / m.body_m
            z = (samples.cz[i] - samples.sin[i] * at) / h
            if pi < 0.01 or z < 0.0:
                continue
            std, seen = samples.std_per_m2[i], samples.range_m[i]
            if _behind(kind, seen, at, std, z, m):
                continue
            colour = _ratio(ratios[k], z, samples.code[i], m) if kind == SURFACE else 1.0
            like = _on_body(kind, seen, at, std, samples.matched_m[i], _hidden(h, tall[k, 0], z, m), colour, m)
            ray, j = layers[i], k_on
            while j > 0 and ray[AT, j - 1] > at:
                for row in (AT, THROUGH, BEFORE):
                    ray[row, j] = ray[row, j - 1]
                j -= 1
            ray[AT, j], ray[THROUGH, j], ray[BEFORE, j] = at, pi, like
            count[i] = min(k_on + 1, LAYERS)
    for i in range(n):
        _sum_layers(layers[i], count[i], _on_ground(samples.kind[i], samples.range_m[i], near[i], m))


@njit(cache=True, nogil=True, error_model="numpy")
def log_ratio(pose, tall_m: float, ratios: F32, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Lam of all samples with one person at a pose among the others, less Lam without that person."""
    m = model[0]
    layers, count = samples.layers, samples.n_layers
    cover, front = table.cover, table.front
    total, product, factors, weight = 0.0, 1.0, 0, 0.0
    floor_seen = m.unknown / m.range_m / (1.0 - m.unknown)
    x, y, h, facing, lean = pose
    for q in range(_covered(x, y, h, samples, table, m)):
        i = samples.which[q]
        angle, iu, iw, kind = samples.angle[i], int(samples.u[i]), int(samples.w[i]), samples.kind[i]
        posture = _posture(facing, lean, samples.turn[i], samples.slant[i], table)
        pi = cover[posture, angle, iu, iw]
        at = samples.ahead[i] - front[posture, angle, iu, iw] * h / m.body_m
        z = (samples.cz[i] - samples.sin[i] * at) / h
        if pi < 0.005 or z < 0.0:
            continue
        std, seen = samples.std_per_m2[i], samples.range_m[i]
        if _behind(kind, seen, at, std, z, m):
            continue
        colour = _ratio(ratios, z, samples.code[i], m) if kind == SURFACE else 1.0
        like = _on_body(kind, seen, at, std, samples.matched_m[i], _hidden(h, tall_m, z, m), colour, m)
        ray, j = layers[i], 0
        while j < count[i] and ray[AT, j] < at:
            j += 1
        without = ray[BEFORE, j] + ray[THROUGH, j] * ray[REST, j] + (floor_seen if kind == SURFACE else TINY)
        if factors == ONE_LOG or samples.weight[i] != weight:
            total += weight * math.log(product)
            product, factors, weight = 1.0, 0, samples.weight[i]
        product *= 1.0 + ray[THROUGH, j] * pi * (like - ray[REST, j]) / without
        factors += 1
    return float(total + weight * math.log(product))


@njit(cache=True, nogil=True, error_model="numpy")
def log_prior(pose, tall, others, model):  # type: ignore[no-untyped-def]
    """Logarithm of the prior of a pose: upright, rarely lower or with the head ahead, and no body inside another.

    ``tall``: height when upright and its deviation; ``others``: poses, existence and which. Relative to standing so
    with nobody near.
    """
    m = model[0]
    poses, sure, who = others
    (x, y, h, _, lean), (tall_m, std) = pose, tall
    up, sits, down = (h - tall_m) / std, 0.5 * m.sits / (1.0 - m.sits), (h - m.sitting * tall_m) / (2.0 * std)
    lower = m.low_share / (1.0 - m.low_share) * std * math.sqrt(2 * math.pi) / tall_m
    density = math.exp(-0.5 * up * up) + lower + sits * math.exp(-0.5 * down * down)
    value = math.log(density / (1.0 + lower + sits)) - 0.5 * (lean / m.lean_std_m) ** 2
    for a in range(len(who)):
        k = who[a]
        gap = math.sqrt((x - poses[k, 0]) ** 2 + (y - poses[k, 1]) ** 2)
        if gap < m.apart_m:
            value -= 0.5 * sure[k] * ((m.apart_m - gap) / BODY_SOFTNESS_M) ** 2
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def log_known(pose, predicted, known):  # type: ignore[no-untyped-def]
    """Logarithm of the density of a pose before the frame, relative to the predicted one."""
    x, y, h, facing, _ = pose
    ox, oy, oh = x - predicted[0], y - predicted[1], h - predicted[2]
    away = known.xx * ox * ox + 2 * known.xy * ox * oy + known.yy * oy * oy + known.height * oh * oh
    if known.turn > 0.0:
        turned = math.sin(0.5 * (facing - predicted[3])) ** 2
        ahead = (1.0 - known.back) * math.exp(-2.0 * known.turn * turned)
        back = known.back * math.exp(-2.0 * known.turn * (1.0 - turned))
        away -= 2.0 * math.log(ahead + back + TINY)
    if known.walk > 0.0:
        away += 4.0 * known.walk * math.sin(0.5 * (facing - known.heading)) ** 2
    return float(-0.5 * away)


@njit(cache=True, nogil=True, error_model="numpy")
def _posterior(pose, prior, me, others, samples, table, model):  # type: ignore[no-untyped-def]
    """Lam plus what is known before plus the logarithm of the prior of a pose; Lam alone."""
    (predicted, known, _), (tall_m, std, ratios) = prior, me
    lam = log_ratio(pose, tall_m, ratios, samples, table, model)
    return lam + log_known(pose, predicted, known) + log_prior(pose, (tall_m, std), others, model), lam


@njit(cache=True, nogil=True, error_model="numpy")
def _along_head(pose, height_m: float, camera):  # type: ignore[no-untyped-def]
    """A pose of another height whose head is on the same ray."""
    (x, y, h, facing, lean), (cx, cy, cz) = pose, camera
    if cz - max(h, height_m) < 0.3:
        return x, y, height_m, facing, lean
    f = (cz - height_m) / (cz - h)
    return cx + (x - cx) * f, cy + (y - cy) * f, height_m, facing, lean


@njit(cache=True, nogil=True, error_model="numpy")
def _postured(pose, facing, lean):  # type: ignore[no-untyped-def]
    """A pose that faces and leans otherwise, with the shoulders where they were: half as far ahead as the head."""
    x, y, h, was, leant = pose
    ox = 0.5 * (leant * math.cos(was) - lean * math.cos(facing))
    oy = 0.5 * (leant * math.sin(was) - lean * math.sin(facing))
    return x + ox, y + oy, h, facing, lean


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _moved(pose, way, far, ahead, camera, m):  # type: ignore[no-untyped-def]
    """A pose moved along (0) or across (1) the level direction ``ahead``, up (2), turned (3), leant (4), or moved up
    along the head's ray (5)."""
    x, y, h, facing, lean = pose
    height_m = max(m.height_min_m, min(m.height_max_m, h + far))
    if way == 0:
        return x + far * ahead[0], y + far * ahead[1], h, facing, lean
    if way == 1:
        return x - far * ahead[1], y + far * ahead[0], h, facing, lean
    if way == 2:
        return x, y, height_m, facing, lean
    if way == 3:
        return _postured(pose, facing + far, lean)
    if way == 4:
        return _postured(pose, facing, max(0.0, min(LEAN_M, lean + far)))
    return _along_head(pose, height_m, camera)


@njit(cache=True, nogil=True, error_model="numpy")
def _best_posture(at, best, lam, prior, me, others, samples, table, model):  # type: ignore[no-untyped-def]
    """Of the postures 45 degrees apart where nothing is known of them, else of this one and that back to front: pose,
    posterior, Lam. Upright, front and back look the same."""
    start, wide = at, prior[1].turn < 1.0
    for lean in range(2 if wide else 1):
        for way in range(4 << lean if wide else 1):
            if wide:
                new = _postured(start, 0.25 * math.pi * way, lean * LEAN_M)
            else:
                new = _postured(start, start[3] + math.pi, start[4])
            value, lam_new = _posterior(new, prior, me, others, samples, table, model)
            if value > best:
                best, lam, at = value, lam_new, new
    return at, best, lam


@njit(cache=True, nogil=True, error_model="numpy")
def ascend(pose: F64, curvature: F64, prior, me, others, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Ascent on Lam plus what is known before by parabolas along and across the first camera's ray, in height, facing
    and lean and, in masks, in height along the ray of the head.

    Moves ``pose``; fills ``curvature`` (4,), how sharply Lam curves there in the first four [1/m^2, 1/rad^2].

    Args:
        prior: (5,) predicted pose, what is ``Known`` of it, and steps.
        me: height when upright and its deviation, (PARTS, CODES) ratios of colours.
        others: poses, existence and which: bodies that cannot be entered.

    Returns:
        Lam at the end plus the logarithm of the prior of such a pose.
    """
    m = model[0]
    camera, ax, ay, slope = (pose[0] - 1.0, pose[1], 1e6), 1.0, 0.0, 1.0
    if samples.size[0] > 0:
        camera = float(samples.cx[0]), float(samples.cy[0]), float(samples.cz[0])
        ax, ay = pose[0] - camera[0], pose[1] - camera[1]
        norm = math.sqrt(ax * ax + ay * ay)
        ax, ay = (ax / norm, ay / norm) if norm > 1e-6 else (1.0, 0.0)
        if m.masks > 0.0:  # one step in the image, whatever the slope of the ray
            slope = min(math.sqrt(norm * norm + camera[2] ** 2) / camera[2], SLOPE_MAX)
    at = pose[0], pose[1], pose[2], pose[3], pose[4]
    best, lam = _posterior(at, prior, me, others, samples, table, model)
    for posture in range(2 if m.masks > 0.0 else 1):
        tall_m = me[0] * (m.sitting if posture == 1 else 1.0)
        new = _along_head(at, tall_m, camera) if m.masks > 0.0 else (at[0], at[1], tall_m, at[3], at[4])
        value, lam_new = _posterior(new, prior, me, others, samples, table, model)
        if value > best:
            best, lam, at = value, lam_new, new
    turns = len(table.cover) > 1
    if turns:
        at, best, lam = _best_posture(at, best, lam, prior, me, others, samples, table, model)
    for step in prior[2]:
        for again in range(MAX_TURNS):
            farthest = 0.0
            for way in range(6):
                if (way in (3, 4) and (again or not turns)) or (way == 5 and m.masks == 0.0):
                    continue
                unit = slope if way == 0 else (1.0 if way in (1, 4) else (0.5 if way != 3 else 1.0 / LEAN_M))
                start, value, at_start = at, best, lam
                up, down, f, jump = 0.0, 0.0, 0.0, 0.0
                for trial in range(3):
                    f = step if trial == 0 else -step
                    if trial == 2:
                        curve, rise = up + down - 2 * value, up - down
                        if curve < 0:
                            f = max(-2 * step, min(2 * step, -0.5 * step * rise / curve))
                        else:
                            f = 2 * step if rise > 0 else -2 * step
                        if abs(f) < 0.1 * step:
                            break
                    new = _moved(start, way, f * unit, (ax, ay), camera, m)
                    reached, lam_new = _posterior(new, prior, me, others, samples, table, model)
                    if trial == 0:
                        up = reached
                        if way < 4:
                            curvature[way] = 2 * at_start - lam_new
                    elif trial == 1:
                        down = reached
                        if way < 4:
                            curvature[way] = (curvature[way] - lam_new) / (step * unit) ** 2
                    if reached > best + 1e-6:
                        best, lam, at, jump = reached, lam_new, new, f
                farthest = max(farthest, abs(jump))
            if farthest < 0.5 * step:
                break
    for i in range(5):
        pose[i] = at[i]
    return float(lam + log_prior(at, (me[0], me[1]), others, model))


@njit(cache=True, nogil=True, error_model="numpy")
def visible(pose: F64, tall_m: float, samples, table, model):  # type: ignore[no-untyped-def]
    """Patches of a body that it explains better than all else, those that show something, and those in view."""
    m = model[0]
    layers, count = samples.layers, samples.n_layers
    cover, front = table.cover, table.front
    h, mine, known, total = pose[2], 0.0, 0.0, 0.0
    for q in range(_covered(pose[0], pose[1], h, samples, table, m)):
        i = samples.which[q]
        angle, iu, iw, kind = samples.angle[i], int(samples.u[i]), int(samples.w[i]), samples.kind[i]
        posture = _posture(pose[3], pose[4], samples.turn[i], samples.slant[i], table)
        pi = cover[posture, angle, iu, iw]
        if pi < 0.02:
            continue
        total += pi * samples.weight[i]
        if kind == UNKNOWN:
            continue
        known += pi * samples.weight[i]
        if kind in (SEEN, SHADOW):
            continue
        at = samples.ahead[i] - front[posture, angle, iu, iw] * h / m.body_m
        hidden = _hidden(h, tall_m, (samples.cz[i] - samples.sin[i] * at) / h, m)
        like = _on_body(kind, samples.range_m[i], at, samples.std_per_m2[i], samples.matched_m[i], hidden, 1.0, m)
        ray, j = layers[i], 0
        while j < count[i] and ray[AT, j] < at:
            j += 1
        unknown = m.unknown / m.range_m if kind == SURFACE else 0.0
        if ray[THROUGH, j] * pi * like > ray[BEFORE, j] + ray[THROUGH, j] * (1 - pi) * ray[REST, j] + unknown:
            mine += pi * samples.weight[i]
    return mine, known, total


@njit(cache=True, nogil=True, error_model="numpy")
def assign_pixels(pixels: I64, people, around: I64, view, table, model, owned) -> None:  # type: ignore[no-untyped-def]
    """The owner of each of some pixels of one kind, see ``Owned``; ``around``: (N, 4) boxes of people [px]."""
    m = model[0]
    poses, sure, tall, ratios = people
    centre, direction, level, stretch, range_m = view.centre_m, view.direction, view.level, view.stretch, view.range_m
    owner, share, height, patches, lacking, reached = owned
    cover, front = table.cover, table.front
    cols, camera_z = range_m.shape[1], centre[2]
    ats, pis, likes, zs = np.empty((4, LAYERS + 1))
    ks = np.empty(LAYERS + 1, np.int64)
    for i in range(len(pixels)):
        r, c = pixels[i] // cols, pixels[i] % cols
        far, std, n, near = range_m[r, c], view.std_per_m2 / stretch[r, c], 0, False
        ex, ey, sin = level[r, c, 0], level[r, c, 1], -direction[r, c, 2]
        cos = direction[r, c, 0] * ex + direction[r, c, 1] * ey
        x, y = centre[0] + direction[r, c, 0] * far, centre[1] + direction[r, c, 1] * far
        kind, angle = view.kind[r, c], _angle(level[r, c, 2], table)
        for k in range(len(poses)):
            ox, oy, h = x - poses[k, 0], y - poses[k, 1], poses[k, 2]
            if far > 0.0:
                near = near or (sure[k] > 0.5 and ox * ox + oy * oy < m.reach_m * m.reach_m)
            if c < around[k, 0] or c > around[k, 2] or r < around[k, 1] or r > around[k, 3]:
                continue
            if far <= 0.0:
                near = near or sure[k] > 0.5
            dx, dy, dz = poses[k, 0] - centre[0], poses[k, 1] - centre[1], 0.5 * h - camera_z
            along, scale = dx * ex + dy * ey, m.body_m / h
            u = (dx * ey - dy * ex) * scale / table.cell_m + cover.shape[2] // 2
            iw = int((-(along * sin + dz * cos) * scale - table.w_min_m) / table.cell_m)
            if u < 0.0 or u >= cover.shape[2] or iw < 0 or iw >= cover.shape[3]:
                continue
            iu, posture = int(u), _posture(poses[k, 3], poses[k, 4], level[r, c, 3] * TURNS_PER_RAD - 0.5, 0.5, table)
            pi, at = (
                sure[k] * cover[posture, angle, iu, iw],
                along * cos - dz * sin - front[posture, angle, iu, iw] / scale,
            )
            if pi < 0.01:
                continue
            z = (camera_z - sin * at) / h
            ratio = _ratio(ratios[k], z, view.colour[r, c], m)
            like = _on_body(kind, far, at, std, view.matched_m[r, c], _hidden(h, tall[k, 0], z, m), ratio, m)
            j = n
            while j > 0 and ats[j - 1] > at:
                ats[j], pis[j], likes[j], ks[j], zs[j] = ats[j - 1], pis[j - 1], likes[j - 1], ks[j - 1], zs[j - 1]
                j -= 1
            ats[j], pis[j], likes[j], ks[j], zs[j] = at, pi, like, k, z
            n = min(n + 1, LAYERS)
        passing, total, best, who, at_z, at = 1.0, 0.0, 0.0, -1, 0.0, far
        for j in range(n):
            like = passing * pis[j] * likes[j]
            passing *= 1.0 - pis[j]
            total += like
            if like > best:
                best, who, at_z = like, ks[j], zs[j]
                if far <= 0.0:
                    at = ats[j]
        other = passing * _on_ground(kind, far, near, m) + m.unknown / m.range_m
        owner[i], reached[i] = (who if best > other else -1), near
        share[i], height[i] = best / (total + other), at_z
        patches[i] = (at / stretch[r, c]) ** 2 * view.pixel_sr / m.patch_m**2
        if far > 0.0:  # a body's surface there, as an expected logarithm
            surface = m.surface_var + (std * far * far) ** 2
            typical = m.body * (1.0 - m.no_depth) * (1.0 - m.outliers) / math.sqrt(2.0 * math.pi * math.e * surface)
            lacking[i] = patches[i] * math.log(typical / (total + other))
        else:  # one more person behind all others
            typical = passing * _on_body(kind, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, m)
            lacking[i] = math.log((total + typical) / (total + other))


@njit(cache=True, nogil=True, error_model="numpy")
def map_lacking(points: F32, low_m: F64, cell_m: float, out: F32) -> None:
    """Add what points lack of an explanation, as ``assign_pixels`` gives it, to the cells of a map of the floor."""
    for i in range(points.shape[1]):
        row, col = int((points[0, i] - low_m[0]) / cell_m), int((points[1, i] - low_m[1]) / cell_m)
        out[row, col] += points[3, i]


@njit(cache=True, nogil=True, error_model="numpy")
def fresh_points(pixels: I64, lacking: F32, codes: U8, view, tried_m: F32, deviations, which: I64, out: F32) -> int:  # type: ignore[no-untyped-def]
    """Points of the pixels whose surface is not where it has been tried: x, y, z [m], what they lack of an explanation
    and the colour, in ``out`` (5, M); their indices in ``which``; their number.

    ``deviations``: of a body's surface [m], and how many of them make another surface.
    """
    surface_m, changed = deviations
    centre, cols, n = view.centre_m, view.range_m.shape[1], 0
    for i in range(len(pixels)):
        r, c = pixels[i] // cols, pixels[i] % cols
        far = view.range_m[r, c]
        if abs(far - tried_m[r, c]) < changed * math.hypot(surface_m, view.std_per_m2 * far * far):
            continue
        for axis in range(3):
            out[axis, n] = centre[axis] + view.direction[r, c, axis] * far
        out[3, n], out[4, n], which[n] = lacking[i], codes[i], i
        n += 1
    return n
