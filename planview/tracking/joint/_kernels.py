"""Compiled kernels of the joint explanation; ``tests/reference/explain.py`` defines them in plain numpy.

A sample is one analysis pixel near a person: its camera, ray, kind, range and weight. ``pose`` is (x, y, height).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8

CX, CY, CZ, EX, EY, COS, SIN, RANGE, WEIGHT, STD, MATCHED = range(11)
SAMPLE_FIELDS = 11
KIND, CODE, ANGLE = range(3)
AT, THROUGH, BEFORE, REST = range(4)
LAYERS = 4
"""Other people on one ray, the nearest first."""
TINY = 1e-12
TURNS = 3
"""Most rounds of the ascent with one step."""
ONE_LOG = 12
"""Ratios of likelihoods, each within 1e-12 and 1e12, whose product one logarithm is taken of."""
PARTS = 3
SPACING = 0.7
"""Distance of samples on a body [patches]."""
LEGS_TO, TORSO_TO = 0.45, 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
HIDDEN_MAX = 0.72
"""Relative height up to which furniture may hide a person."""


class Beliefs(NamedTuple):
    """``JointParams`` as kernels take them."""

    outliers: float
    body: float
    background: float
    near_people: float
    no_depth: float
    range_m: float
    unknown: float
    surface_var: float
    colour: float
    body_m: float
    """Height of the table's body [m]."""
    reach_m: float
    apart_m: float
    low_share: float
    angle_min: float
    angle_step: float
    cell_m: float
    w_min: float


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def _look(  # type: ignore[no-untyped-def]
    x: float, y: float, h: float, cx: float, cy: float, cz: float, ex: float, ey: float, cos: float, sin: float,
    angle: int, cover: F32, front: F32, b: Beliefs,
):  # fmt: skip
    """Cover, range and relative height of a body's surface along a ray."""
    dx, dy, dz = x - cx, y - cy, 0.5 * h - cz
    along = dx * ex + dy * ey
    scale = b.body_m / h
    iu = int(abs(dy * ex - dx * ey) * scale / b.cell_m)
    iw = int((-(along * sin + dz * cos) * scale - b.w_min) / b.cell_m)
    if iu >= cover.shape[1] or iw < 0 or iw >= cover.shape[2]:
        return 0.0, 0.0, 0.0
    at = along * cos - dz * sin - front[angle, iu, iw] / scale
    return cover[angle, iu, iw], at, (cz - sin * at) / h


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _covered(
    x: float, y: float, h: float, values: F32, n: int, cover: F32, b: Beliefs, scratch: F32, which: I64
) -> int:  # fmt: skip
    """The samples within a body's table: their number, and which; fills rows u, w and range at the centre [m].

    One loop without branches in float32, which processors take eight at a time; three samples in five end here.
    """
    u, w, ahead = scratch[0], scratch[1], scratch[2]
    cx, cy, cz, ex, ey = values[CX], values[CY], values[CZ], values[EX], values[EY]
    cos, sin = values[COS], values[SIN]
    per_m, w_min, zero = np.float32(b.body_m / h / b.cell_m), np.float32(b.w_min / b.cell_m), np.float32(0.0)
    x_m, y_m, z_m = np.float32(x), np.float32(y), np.float32(0.5 * h)
    for i in range(n):
        dx, dy, dz = x_m - cx[i], y_m - cy[i], z_m - cz[i]
        along = dx * ex[i] + dy * ey[i]
        u[i] = abs(dy * ex[i] - dx * ey[i]) * per_m
        w[i] = -(along * sin[i] + dz * cos[i]) * per_m - w_min
        ahead[i] = along * cos[i] - dz * sin[i]
    us, ws, m = np.float32(cover.shape[1]), np.float32(cover.shape[2]), 0
    for i in range(n):
        which[m] = i
        m += (u[i] < us) & (w[i] >= zero) & (w[i] < ws)
    return m


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def _body_likelihood(  # type: ignore[no-untyped-def]
    kind: int, seen: float, at: float, std: float, matched: float, colour: float, b: Beliefs
):
    """Of a pixel that shows a body's surface at a range; nearer than ``matched`` the right camera cannot see it."""
    if kind == 0:
        return 1.0 - b.body
    if kind == 2:
        return b.body * (1.0 if at < matched else b.no_depth)
    var = b.surface_var + std * std * at * at * at * at
    off = seen - at
    normal = math.exp(-0.5 * off * off / var) / math.sqrt(2.0 * math.pi * var)
    return b.body * (1.0 - b.no_depth) * ((1.0 - b.outliers) * normal + b.outliers / b.range_m) * colour


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def _part(z: float) -> int:
    return 0 if z < LEGS_TO else (1 if z < TORSO_TO else 2)


@njit(cache=True, nogil=True, error_model="numpy")
def boxes(poses: F64, projection: F64, half: float, above: float, out: F64) -> None:
    """Left, top, right, bottom (N, 4) [px] of boxes around bodies: ``half`` [m] to each side, ``above`` their heads."""
    for a in range(len(poses)):
        out[a, :2], out[a, 2:] = 1e4, -1e4
        for corner in range(8):
            x = poses[a, 0] + (half if corner & 1 else -half)
            y = poses[a, 1] + (half if corner & 2 else -half)
            z = poses[a, 2] + above if corner & 4 else 0.0
            depth = projection[2, 0] * x + projection[2, 1] * y + projection[2, 2] * z + projection[2, 3]
            depth = max(depth, 0.15)
            u = (projection[0, 0] * x + projection[0, 1] * y + projection[0, 2] * z + projection[0, 3]) / depth
            v = (projection[1, 0] * x + projection[1, 1] * y + projection[1, 2] * z + projection[1, 3]) / depth
            u, v = min(max(u, -1e4), 1e4), min(max(v, -1e4), 1e4)
            out[a, 0], out[a, 1] = min(out[a, 0], u), min(out[a, 1], v)
            out[a, 2], out[a, 3] = max(out[a, 2], u), max(out[a, 3], v)


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    pose: F64, reach_m: float, spacing_m: float, patch_m: float, centre: F64, direction: F32, level: F32, stretch: F32,
    matched_m: F32, projection: F64, pixel_sr: float, kind: U8, range_m: F32, colour: U8, std_per_m2: float,
    values: F32, marks: U8, n: int, beliefs: Sequence[Beliefs],
) -> int:  # fmt: skip
    """Append the samples of one camera within ``reach_m`` of a body; the number of samples then."""
    b = beliefs[0]
    rows, cols = stretch.shape
    half, box = reach_m + 0.25, np.empty((1, 4))
    boxes(pose.reshape(1, 3), projection, half, 0.1, box)
    x0, y0, x1, y1 = box[0]
    away = math.sqrt((pose[0] - centre[0]) ** 2 + (pose[1] - centre[1]) ** 2)
    if x1 < 0 or y1 < 0 or x0 > cols - 1 or y0 > rows - 1:
        return n
    c0, c1, r0, r1 = max(0, int(x0)), min(cols - 1, int(x1) + 1), max(0, int(y0)), min(rows - 1, int(y1) + 1)
    middle = math.sqrt(away**2 + (centre[2] - 0.5 * pose[2]) ** 2)
    step = max(1, int(spacing_m / (middle * math.sqrt(pixel_sr)) + 0.5))
    while ((c1 - c0) // step + 1) * ((r1 - r0) // step + 1) > 3000:
        step += 1
    depth = (
        projection[2, 0] * pose[0] + projection[2, 1] * pose[1] + projection[2, 2] * 0.5 * pose[2] + projection[2, 3]
    )
    depth = max(depth, 0.15)
    weight = depth * depth * pixel_sr * step * step / (patch_m * patch_m)
    for r in range(r0 + (-r0) % step, r1 + 1, step):
        for c in range(c0 + (-c0) % step, c1 + 1, step):
            if n >= len(marks[0]):
                return n
            ex, ey = level[r, c, 0], level[r, c, 1]
            across = (pose[1] - centre[1]) * ex - (pose[0] - centre[0]) * ey
            if abs(across) > half:
                continue
            dx, dy, dz = direction[r, c, 0], direction[r, c, 1], direction[r, c, 2]
            ahead = (pose[0] - centre[0]) * dx + (pose[1] - centre[1]) * dy + (0.5 * pose[2] - centre[2]) * dz
            if ahead < 0.15:
                continue
            values[CX, n], values[CY, n], values[CZ, n] = centre[0], centre[1], centre[2]
            values[EX, n], values[EY, n], values[COS, n], values[SIN, n] = ex, ey, dx * ex + dy * ey, -dz
            values[RANGE, n], values[WEIGHT, n], values[MATCHED, n] = range_m[r, c], weight, matched_m[r, c]
            values[STD, n] = std_per_m2 / stretch[r, c]
            angle = min(max(int((level[r, c, 2] - b.angle_min) / b.angle_step + 0.5), 0), 24)
            marks[KIND, n], marks[CODE, n], marks[ANGLE, n] = kind[r, c], colour[r, c], angle
            n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def layer(
    values: F32, marks: U8, n: int, poses: F64, sure: F64, ratios: F32, who: I64, cover: F32, front: F32,
    beliefs: Sequence[Beliefs], layers: F32, count: I64, scratch: F32, which: I64,
) -> None:  # fmt: skip
    """The other people on every sample's ray, the nearest first, each covering as surely as it exists (``sure``).

    Fills ``layers`` (N, 4, LAYERS + 1): ranges, the share of the ray that passes the first k people, the likelihood
    that these explain, and what all behind them explains of what passes; ``count`` (N,), how many they are.
    """
    b = beliefs[0]
    near = np.zeros(n, np.bool_)
    count[:n] = 0
    for a in range(len(who)):
        k = who[a]
        x, y, h = poses[k, 0], poses[k, 1], poses[k, 2]
        if sure[k] > 0.5:
            for i in range(n):
                flat = values[COS, i] * values[RANGE, i]
                ox, oy = values[CX, i] + values[EX, i] * flat - x, values[CY, i] + values[EY, i] * flat - y
                near[i] |= ox * ox + oy * oy < b.reach_m * b.reach_m
        for q in range(_covered(x, y, h, values, n, cover, b, scratch, which)):
            i = which[q]
            angle, iu, iw, kind, m = marks[ANGLE, i], int(scratch[0, i]), int(scratch[1, i]), marks[KIND, i], count[i]
            pi = cover[angle, iu, iw] * sure[k]
            if pi < 0.01 or m >= LAYERS:
                continue
            range_m = scratch[2, i] - front[angle, iu, iw] * h / b.body_m
            z = (values[CZ, i] - values[SIN, i] * range_m) / h
            std, seen = values[STD, i], values[RANGE, i]
            hidden = kind == 0 and seen > 0 and z < HIDDEN_MAX
            if hidden and seen < range_m - 3 * math.sqrt(b.surface_var + (std * range_m * range_m) ** 2):
                continue
            colour = 1.0 - b.colour + b.colour * ratios[k, _part(z), marks[CODE, i]] if kind == 1 else 1.0
            like = _body_likelihood(kind, seen, range_m, std, values[MATCHED, i], colour, b)
            ray, j = layers[i], m
            while j > 0 and ray[AT, j - 1] > range_m:
                for row in (AT, THROUGH, BEFORE):
                    ray[row, j] = ray[row, j - 1]
                j -= 1
            ray[AT, j], ray[THROUGH, j], ray[BEFORE, j] = range_m, pi, like
            count[i] = m + 1
    for i in range(n):
        kind = marks[KIND, i]
        if kind == 0:
            ground = 1.0 - b.background
        elif kind == 2:
            ground = 0.5 * b.background
        else:
            ground = 0.5 * (b.near_people / (2 * b.reach_m) if near[i] else b.background / b.range_m)
        ray, m = layers[i], count[i]
        ray[REST, m] = ground
        for j in range(m - 1, -1, -1):
            ray[REST, j] = ray[THROUGH, j] * ray[BEFORE, j] + (1.0 - ray[THROUGH, j]) * ray[REST, j + 1]
        passing, explained = 1.0, 0.0
        for j in range(m):
            pi, like = ray[THROUGH, j], ray[BEFORE, j]
            ray[THROUGH, j], ray[BEFORE, j] = passing, explained
            explained += passing * pi * like
            passing *= 1.0 - pi
        ray[THROUGH, m], ray[BEFORE, m] = passing, explained


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def evaluate(
    x: float, y: float, h: float, values: F32, marks: U8, n: int, ratio: F32, cover: F32, front: F32,
    beliefs: Sequence[Beliefs], layers: F32, count: I64, scratch: F32, which: I64,
) -> float:  # fmt: skip
    """Lam of all samples with one person at a pose among the others, less Lam without that person."""
    b = beliefs[0]
    total, product, factors, weight = 0.0, 1.0, 0, 0.0
    floor_seen = b.unknown / b.range_m / (1.0 - b.unknown)
    for q in range(_covered(x, y, h, values, n, cover, b, scratch, which)):
        i = which[q]
        angle, iu, iw, kind = marks[ANGLE, i], int(scratch[0, i]), int(scratch[1, i]), marks[KIND, i]
        pi = cover[angle, iu, iw]
        range_m = scratch[2, i] - front[angle, iu, iw] * h / b.body_m
        z = (values[CZ, i] - values[SIN, i] * range_m) / h
        if pi < 0.005 or z < 0.0:
            continue
        std, seen = values[STD, i], values[RANGE, i]
        if kind == 0 and seen > 0 and z < HIDDEN_MAX:
            behind = 3 * math.sqrt(b.surface_var + (std * range_m * range_m) ** 2)
            if seen < range_m - behind:
                continue
        colour = 1.0 - b.colour + b.colour * ratio[_part(z), marks[CODE, i]] if kind == 1 else 1.0
        like = _body_likelihood(kind, seen, range_m, std, values[MATCHED, i], colour, b)
        ray, j = layers[i], 0
        while j < count[i] and ray[AT, j] < range_m:
            j += 1
        without = ray[BEFORE, j] + ray[THROUGH, j] * ray[REST, j] + (floor_seen if kind == 1 else TINY)
        if factors == ONE_LOG or values[WEIGHT, i] != weight:
            total += weight * math.log(product)
            product, factors, weight = 1.0, 0, values[WEIGHT, i]
        product *= 1.0 + ray[THROUGH, j] * pi * (like - ray[REST, j]) / without
        factors += 1
    return total + weight * math.log(product)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def believed(
    x: float, y: float, h: float, tall: float, tall_std: float, poses: F64, sure: F64, who: I64,
    beliefs: Sequence[Beliefs],
) -> float:  # fmt: skip
    """Logarithm of what is believed of a pose: upright, seldom lower, and no body inside another.

    ``tall``, ``tall_std``: what is known of the person's height when upright; ``who`` of ``poses`` are the others, as
    ``sure`` to be there. Relative to standing so with nobody near.
    """
    b = beliefs[0]
    off = (h - tall) / tall_std
    lower = b.low_share / (1.0 - b.low_share) * tall_std * math.sqrt(2 * math.pi) / tall
    value = math.log((math.exp(-0.5 * off * off) + lower) / (1.0 + lower))
    for a in range(len(who)):
        k = who[a]
        gap = math.sqrt((x - poses[k, 0]) ** 2 + (y - poses[k, 1]) ** 2)
        if gap < b.apart_m:
            value -= 0.5 * sure[k] * ((b.apart_m - gap) / 0.07) ** 2
    return value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _posterior(x: float, y: float, h: float, prior, pixels):  # type: ignore[no-untyped-def]
    """Lam - Mahalanobis / 2 plus what is believed of a pose; Lam alone."""
    predicted, information, tall, tall_std, poses, sure, who, beliefs = prior
    ox, oy, oh = x - predicted[0], y - predicted[1], h - predicted[2]
    away = information[0] * ox * ox + 2 * information[1] * ox * oy + information[2] * oy * oy
    away += information[3] * oh * oh
    lam = evaluate(x, y, h, *pixels)
    return lam - 0.5 * away + believed(x, y, h, tall, tall_std, poses, sure, who, beliefs), lam


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def ascend(  # type: ignore[no-untyped-def]
    pose: F64, bent: F64, predicted: F64, information: F64, tall: float, tall_std: float, poses: F64, sure: F64,
    who: I64, steps: F64, low: float, high: float, values: F32, marks: U8, n: int, ratio: F32, cover: F32, front: F32,
    beliefs: Sequence[Beliefs], layers: F32, count: I64, scratch: F32, which: I64,
):  # fmt: skip
    """Ascent on Lam - Mahalanobis / 2 by parabolas along and across the first camera's ray and in height.

    Moves ``pose``; fills ``bent`` (3,), how sharply Lam bends there in these directions [1/m^2].

    Args:
        information: (4,) xx, xy, yy of the place's and of the height's inverse covariance.
        poses, sure, who: other bodies, which cannot be entered, and how surely they exist.

    Returns:
        Lam at the end plus what is believed of such a pose.
    """
    ax, ay = 1.0, 0.0
    if n > 0:
        ax, ay = pose[0] - values[CX, 0], pose[1] - values[CY, 0]
        norm = math.sqrt(ax * ax + ay * ay)
        ax, ay = (ax / norm, ay / norm) if norm > 1e-6 else (1.0, 0.0)
    x, y, h = pose[0], pose[1], pose[2]
    prior = predicted, information, tall, tall_std, poses, sure, who, beliefs
    pixels = values, marks, n, ratio, cover, front, beliefs, layers, count, scratch, which
    best, lam = _posterior(x, y, h, prior, pixels)
    upright, standing = _posterior(x, y, tall, prior, pixels)
    if upright > best:
        best, lam, h = upright, standing, tall
    for step in steps:
        for _ in range(TURNS):
            farthest = 0.0
            for axis in range(3):
                ux, uy, uh = ax, ay, 0.0
                if axis == 1:
                    ux, uy = -ay, ax
                elif axis == 2:
                    ux, uy, uh = 0.0, 0.0, 0.5
                value, at_start = best, lam
                up, down, f, jump = 0.0, 0.0, 0.0, 0.0
                for trial in range(3):
                    f = step if trial == 0 else -step
                    if trial == 2:
                        bend, rise = up + down - 2 * value, up - down
                        if bend < 0:
                            f = max(-2 * step, min(2 * step, -0.5 * step * rise / bend))
                        else:
                            f = 2 * step if rise > 0 else -2 * step
                        if abs(f) < 0.1 * step:
                            break
                    new, lam_new = _posterior(x + f * ux, y + f * uy, max(low, min(high, h + f * uh)), prior, pixels)
                    if trial == 0:
                        up, bent[axis] = new, 2 * at_start - lam_new
                    elif trial == 1:
                        down, bent[axis] = new, (bent[axis] - lam_new) / (step * (0.5 if axis == 2 else 1.0)) ** 2
                    if new > best + 1e-6:
                        best, lam, jump = new, lam_new, f
                x, y, h = x + jump * ux, y + jump * uy, max(low, min(high, h + jump * uh))
                farthest = max(farthest, abs(jump))
            if farthest < 0.5 * step:
                break
    pose[0], pose[1], pose[2] = x, y, h
    return lam + believed(x, y, h, tall, tall_std, poses, sure, who, beliefs)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def visible(  # type: ignore[no-untyped-def]
    pose: F64, values: F32, marks: U8, n: int, cover: F32, front: F32, beliefs: Sequence[Beliefs], layers: F32,
    count: I64, scratch: F32, which: I64,
):  # fmt: skip
    """Patches of a body that it explains better than all else, and those in view."""
    b = beliefs[0]
    mine = total = 0.0
    for q in range(_covered(pose[0], pose[1], pose[2], values, n, cover, b, scratch, which)):
        i = which[q]
        angle, iu, iw, kind = marks[ANGLE, i], int(scratch[0, i]), int(scratch[1, i]), marks[KIND, i]
        pi = cover[angle, iu, iw]
        if pi < 0.02:
            continue
        total += pi * values[WEIGHT, i]
        if kind == 0:
            continue
        range_m = scratch[2, i] - front[angle, iu, iw] * pose[2] / b.body_m
        like = _body_likelihood(kind, values[RANGE, i], range_m, values[STD, i], values[MATCHED, i], 1.0, b)
        ray, j = layers[i], 0
        while j < count[i] and ray[AT, j] < range_m:
            j += 1
        own = ray[THROUGH, j] * pi * like
        floor = b.unknown / b.range_m if kind == 1 else 0.0
        if own > ray[BEFORE, j] + ray[THROUGH, j] * (1 - pi) * ray[REST, j] + floor:
            mine += pi * values[WEIGHT, i]
    return mine, total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def share_out(
    poses: F64, sure: F64, ratios: F32, boxes: I64, centre: F64, direction: F32, level: F32, stretch: F32,
    std_per_m2: float, per_patch: float, range_m: F32, cover: F32, front: F32, beliefs: Sequence[Beliefs],
    pixels: I64, colour: U8, owner: I64, share: F32, height: F32, patches: F32, points: F32,
) -> None:  # fmt: skip
    """Who owns each pixel of surface, see ``Owned``; ``per_patch``: patches that a pixel is at unit depth.

    Fills ``points`` (5, M): x, y, z, how much better a body's surface there would explain the pixel, as an expected
    logarithm times its patches, about 0 for what is explained; and its colour.
    """
    b = beliefs[0]
    cols = range_m.shape[1]
    t = np.empty(LAYERS)
    p = np.empty(LAYERS)
    like = np.empty(LAYERS)
    zs = np.empty(LAYERS)
    ks = np.empty(LAYERS, np.int64)
    for i in range(len(pixels)):
        r, c = pixels[i] // cols, pixels[i] % cols
        far, widened = range_m[r, c], stretch[r, c]
        dx, dy, dz = direction[r, c, 0], direction[r, c, 1], direction[r, c, 2]
        ex, ey, m, near = level[r, c, 0], level[r, c, 1], 0, False
        x, y = centre[0] + dx * far, centre[1] + dy * far
        points[0, i], points[1, i], points[2, i] = x, y, centre[2] + dz * far
        patches[i] = (far / widened) ** 2 * per_patch
        angle = min(max(int((level[r, c, 2] - b.angle_min) / b.angle_step + 0.5), 0), 24)
        for k in range(len(poses)):
            ox, oy = x - poses[k, 0], y - poses[k, 1]
            near = near or (sure[k] > 0.5 and ox * ox + oy * oy < b.reach_m * b.reach_m)
            if c < boxes[k, 0] or c > boxes[k, 2] or r < boxes[k, 1] or r > boxes[k, 3] or m >= LAYERS:
                continue
            pi, at, z = _look(
                poses[k, 0], poses[k, 1], poses[k, 2], centre[0], centre[1], centre[2], ex, ey,
                dx * ex + dy * ey, -dz, angle, cover, front, b,
            )  # fmt: skip
            pi *= sure[k]
            if pi < 0.01:
                continue
            ratio = 1.0 - b.colour + b.colour * ratios[k, _part(z), colour[i]]
            value = _body_likelihood(1, far, at, std_per_m2 / widened, 0.0, ratio, b)
            j = m
            while j > 0 and t[j - 1] > at:
                t[j], p[j], like[j], ks[j], zs[j] = t[j - 1], p[j - 1], like[j - 1], ks[j - 1], zs[j - 1]
                j -= 1
            t[j], p[j], like[j], ks[j], zs[j] = at, pi, value, k, z
            m += 1
        passing, total, best, who, at_z = 1.0, 0.0, 0.0, -1, 0.0
        for j in range(m):
            value = passing * p[j] * like[j]
            passing *= 1.0 - p[j]
            total += value
            if value > best:
                best, who, at_z = value, ks[j], zs[j]
        other = passing * 0.5 * (b.near_people / (2 * b.reach_m) if near else b.background / b.range_m)
        other += b.unknown / b.range_m
        owner[i] = who if best > other else -1
        share[i], height[i] = best / (total + other), at_z
        surface = b.surface_var + (std_per_m2 / widened * far * far) ** 2
        typical = b.body * (1.0 - b.no_depth) * (1.0 - b.outliers) / math.sqrt(2.0 * math.pi * math.e * surface)
        points[3, i], points[4, i] = patches[i] * math.log(typical / (total + other)), colour[i]


@njit(cache=True, nogil=True, error_model="numpy")
def map_lacking(points: F32, low_m: F64, cell_m: float, out: F32) -> None:
    """Add what points lack of an explanation, as of ``share_out``, to the cells of a map of the floor."""
    for i in range(points.shape[1]):
        row, col = int((points[0, i] - low_m[0]) / cell_m), int((points[1, i] - low_m[1]) / cell_m)
        out[row, col] += points[3, i]
