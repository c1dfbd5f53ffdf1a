"""Compiled kernels of the joint explanation of a mask; ``tests/reference/human_model.py`` defines them in plain numpy.

A sample is one pixel near a person: its ray, kind, colour and weight. ``pose`` is (x, y, height). The camera is at
(0, 0, ``camera_m``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from calib.types import F32, F64, I32, I64, U8, Bool

EX, EY, COS, SIN, WEIGHT, THROUGH, BEFORE, REST = range(8)
SAMPLE_FIELDS = 8
SEEN, SHADOW, SURFACE = 0, 1, 2
"""Kinds of pixels: background, foreground that looks like a shadow and says nothing, foreground."""
LEGS_TO, TORSO_TO = 0.45, 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
AROUND_M = 0.25
"""Margin of samples beside the body's axis and reach [m]."""


class OutlineBeliefs(NamedTuple):
    """``HumanModelParams`` and the body's table as kernels take them."""

    body: float
    background: float
    near_people: float
    hidden: float
    hidden_sitting: float
    hidden_to: float
    sitting_from: float
    colour: float
    sits: float
    sitting: float
    reach_m: float
    apart_m: float
    camera_m: float
    focal_px: float
    patch_m: float
    patch_px: float
    body_m: float
    angle_min: float
    angle_step: float
    cell_m: float
    w_min: float


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _look(  # type: ignore[no-untyped-def]
    x: float,
    y: float,
    h: float,
    ex: float,
    ey: float,
    cos: float,
    sin: float,
    angle: int,
    cover: F32,
    b: OutlineBeliefs,
):
    """Cover of a body on a ray, and the relative height of the point of its axis that the ray passes."""
    dz = 0.5 * h - b.camera_m
    along = x * ex + y * ey
    scale = b.body_m / h
    iu = int(abs(y * ex - x * ey) * scale / b.cell_m)
    iw = int((-(along * sin + dz * cos) * scale - b.w_min) / b.cell_m)
    if iu >= cover.shape[1] or iw < 0 or iw >= cover.shape[2]:
        return 0.0, 0.0
    return cover[angle, iu, iw], (b.camera_m - sin * (along * cos - dz * sin)) / h


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _likelihood(kind: int, z: float, hidden: float, colour: float, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """Of a pixel on a body; its lower part may be hidden by furniture."""
    if kind == SHADOW:
        return 0.5
    o = hidden if z < b.hidden_to else 0.0
    if kind == SEEN:
        return (1.0 - o) * (1.0 - b.body) + o * (1.0 - b.background)
    return ((1.0 - o) * b.body + o * b.background) * colour


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _ground(kind: int, near: bool, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on which nobody is."""
    if kind == SHADOW:
        return 0.5
    return 1.0 - b.background if kind == SEEN else (b.near_people if near else b.background)


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _hidden(h: float, tall: float, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """How probably furniture hides a lower pixel of a person as tall as this when standing."""
    return b.hidden_sitting if h < b.sitting_from * tall else b.hidden


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _colour(z: float, code: int, ratio: F32, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    part = 0 if z < LEGS_TO else (1 if z < TORSO_TO else 2)
    return 1.0 - b.colour + b.colour * ratio[part, code]


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _share(  # type: ignore[no-untyped-def]
    pose: F64, sure: float, tall: float, ratio: F32, s: F32, kind: int, code: int, angle: int, cover: F32,
    b: OutlineBeliefs,
):  # fmt: skip
    """How probably somebody covers a sample, and the likelihood of the sample then."""
    pi, z = _look(pose[0], pose[1], pose[2], s[EX], s[EY], s[COS], s[SIN], angle, cover, b)
    pi *= sure
    if pi <= 0.01:
        return 0.0, 0.0
    return pi, _likelihood(kind, z, _hidden(pose[2], tall, b), _colour(z, code, ratio, b), b)


@njit(cache=True, nogil=True)
def gather(
    pose: F64, half_m: float, spacing_m: float, box: I64, rays: F32, angle: I32, kind: U8, code: U8, samples: F32,
    kinds: U8, codes: U8, angles: I64, b: OutlineBeliefs,
) -> int:  # fmt: skip
    """Fill the samples within ``half_m`` of a body in its box; their number."""
    rows, cols = kind.shape
    c0, c1 = max(0, box[0]), min(cols - 1, box[2])
    r0, r1 = max(0, box[1]), min(rows - 1, box[3])
    if c0 > c1 or r0 > r1:
        return 0
    dz = 0.5 * pose[2] - b.camera_m
    away = math.sqrt(pose[0] ** 2 + pose[1] ** 2 + dz * dz)
    step = max(1, int(spacing_m * b.focal_px / away + 0.5))
    while ((c1 - c0) // step + 1) * ((r1 - r0) // step + 1) > len(samples):
        step += 1
    n = 0
    for r in range(r0 + (-r0) % step, r1 + 1, step):
        for c in range(c0 + (-c0) % step, c1 + 1, step):
            ray = rays[r, c]
            across = pose[1] * ray[0] - pose[0] * ray[1]
            ahead = (pose[0] * ray[0] + pose[1] * ray[1]) * ray[2] - dz * ray[3]
            if abs(across) > half_m or ahead < 0.15:
                continue
            depth = ahead / ray[4]
            s = samples[n]
            s[EX], s[EY], s[COS], s[SIN] = ray[0], ray[1], ray[2], ray[3]
            s[WEIGHT] = (step / max(b.focal_px * b.patch_m / depth, b.patch_px)) ** 2
            kinds[n], codes[n], angles[n] = kind[r, c], code[r, c], angle[r, c]
            n += 1
    return n


@njit(cache=True, nogil=True, fastmath=True)
def layer(
    samples: F32, kinds: U8, codes: U8, angles: I64, n: int, poses: F64, sure: F64, tall: F64, ratios: F32,
    order: I64, before: int, cover: F32, b: OutlineBeliefs,
) -> None:  # fmt: skip
    """Lay other people over the samples, each covering as surely as it exists.

    ``order`` lists them, the nearest first; the first ``before`` of them are nearer than the person in question. Fills
    the share of the ray that passes these, the likelihood that they explain, and what all behind explain.
    """
    for i in range(n):
        s = samples[i]
        kind, code = kinds[i], codes[i]
        near = False
        for a in range(len(order)):
            k = order[a]
            x, y, h = poses[k, 0], poses[k, 1], poses[k, 2]
            if kind == SURFACE and sure[k] > 0.5 and abs(y * s[EX] - x * s[EY]) < b.reach_m:
                along = x * s[EX] + y * s[EY]
                z = b.camera_m - s[SIN] * (along * s[COS] - (0.5 * h - b.camera_m) * s[SIN])
                near = near or -0.1 < z < h + 0.2
        rest = _ground(kind, near, b)
        through, explained = 1.0, 0.0
        for a in range(before):
            k = order[a]
            pi, like = _share(poses[k], sure[k], tall[k, 0], ratios[k], s, kind, code, angles[i], cover, b)
            explained += through * pi * like
            through *= 1.0 - pi
        for a in range(len(order) - 1, before - 1, -1):
            k = order[a]
            pi, like = _share(poses[k], sure[k], tall[k, 0], ratios[k], s, kind, code, angles[i], cover, b)
            rest = pi * like + (1.0 - pi) * rest
        s[THROUGH], s[BEFORE], s[REST] = through, explained, rest


@njit(cache=True, nogil=True, fastmath=True)
def evaluate(
    x: float, y: float, h: float, tall: float, samples: F32, kinds: U8, codes: U8, angles: I64, n: int, ratio: F32,
    cover: F32, b: OutlineBeliefs,
) -> float:  # fmt: skip
    """Lam of all samples with one person at a pose among the others, less Lam without that person."""
    total = 0.0
    hidden = _hidden(h, tall, b)
    for i in range(n):
        s = samples[i]
        pi, z = _look(x, y, h, s[EX], s[EY], s[COS], s[SIN], angles[i], cover, b)
        if pi < 0.005 or kinds[i] == SHADOW:
            continue
        like = _likelihood(kinds[i], z, hidden, _colour(z, codes[i], ratio, b), b)
        change = s[THROUGH] * pi * (like - s[REST])
        total += s[WEIGHT] * math.log1p(change / (s[BEFORE] + s[THROUGH] * s[REST]))
    return total


@njit(cache=True, nogil=True, fastmath=True)
def believed(x: float, y: float, h: float, tall: float, tall_std: float, apart: F64, b: OutlineBeliefs) -> float:
    """Logarithm of what is believed of a pose: upright, seldom sitting, and no body inside another.

    ``tall``, ``tall_std``: the person's height when upright. Relative to standing so with nobody near.
    """
    upright, low = (h - tall) / tall_std, (h - b.sitting * tall) / (2.0 * tall_std)
    sits = b.sits / (1.0 - b.sits) * 0.5
    value = math.log((math.exp(-0.5 * upright * upright) + sits * math.exp(-0.5 * low * low) + 1e-9) / (1.0 + sits))
    for k in range(len(apart)):
        gap = math.sqrt((x - apart[k, 0]) ** 2 + (y - apart[k, 1]) ** 2)
        if gap < b.apart_m:
            value -= 0.5 * apart[k, 2] * ((b.apart_m - gap) / 0.07) ** 2
    return value


@njit(cache=True, nogil=True, fastmath=True)
def ascend(
    pose: F64, predicted: F64, information: F64, tall: float, tall_std: float, apart: F64, steps: F64, low: float,
    high: float, samples: F32, kinds: U8, codes: U8, angles: I64, n: int, ratio: F32, cover: F32, b: OutlineBeliefs,
) -> float:  # fmt: skip
    """Pattern search on Lam - Mahalanobis / 2; moves ``pose``. Lam at the end plus what is believed of such a pose.

    Moves go along and across the camera's ray, up and down, and along the ray of the head with the height that keeps
    it; two of these stand up and sit down. ``information`` (4,): xx, xy, yy of the place's and of the height's inverse
    covariance. ``apart`` (K, 3): places of other bodies and how surely they exist.
    """
    best, worth = -1e300, 0.0
    for step in steps:
        came = -1
        for _ in range(4):
            x, y, h = pose[0], pose[1], pose[2]
            away = max(math.sqrt(x * x + y * y), 1e-3)
            ax, ay = x / away, y / away
            # One step in the image, whatever the slope of the ray.
            slope = math.sqrt(away * away + b.camera_m * b.camera_m) / b.camera_m
            far = step * min(slope, 4.0)
            moved, back = False, came
            for move in range(11):
                if move == back:
                    continue
                nx, ny, nh = x, y, h
                if move == 0:
                    if best > -1e299:
                        continue
                elif move <= 2:
                    f = far if move == 1 else -far
                    nx, ny = x + f * ax, y + f * ay
                elif move <= 4:
                    f = step if move == 3 else -step
                    nx, ny = x - f * ay, y + f * ax
                elif move <= 6:
                    nh = h + (0.5 * step if move == 5 else -0.5 * step)
                else:
                    if move <= 8:
                        nh = h + (0.5 * step if move == 7 else -0.5 * step)
                    elif step < steps[0]:
                        continue
                    else:
                        nh = tall if move == 9 else b.sitting * tall
                    if nh == h or b.camera_m - max(h, nh) < 0.3:
                        continue
                    f = (b.camera_m - nh) / (b.camera_m - h)
                    nx, ny = x * f, y * f
                if nh < low or nh > high:
                    continue
                ox, oy, oh = nx - predicted[0], ny - predicted[1], nh - predicted[2]
                prior = -0.5 * (information[0] * ox * ox + 2 * information[1] * ox * oy + information[2] * oy * oy)
                prior -= 0.5 * information[3] * oh * oh
                mine = believed(nx, ny, nh, tall, tall_std, apart, b)
                lam = evaluate(nx, ny, nh, tall, samples, kinds, codes, angles, n, ratio, cover, b)
                if lam + mine + prior > best + 1e-6:
                    best, worth = lam + mine + prior, lam + mine
                    pose[0], pose[1], pose[2] = nx, ny, nh
                    # Moves 1 and 2, 3 and 4, 5 and 6, 7 and 8 undo each other.
                    moved, came = True, move + 2 * (move % 2) - 1
            if not moved:
                break
    return worth


@njit(cache=True, nogil=True, fastmath=True)
def visible(  # type: ignore[no-untyped-def]
    pose: F64, tall: float, samples: F32, kinds: U8, angles: I64, n: int, cover: F32, b: OutlineBeliefs
):
    """Patches of a body that it explains better than all else, those on foreground, and those in view."""
    mine = seen = total = 0.0
    hidden = _hidden(pose[2], tall, b)
    for i in range(n):
        s = samples[i]
        pi, z = _look(pose[0], pose[1], pose[2], s[EX], s[EY], s[COS], s[SIN], angles[i], cover, b)
        if pi < 0.02:
            continue
        total += pi * s[WEIGHT]
        if kinds[i] != SURFACE:
            continue
        seen += pi * s[WEIGHT]
        own = s[THROUGH] * pi * _likelihood(SURFACE, z, hidden, 1.0, b)
        if own > s[BEFORE] + s[THROUGH] * (1.0 - pi) * s[REST]:
            mine += pi * s[WEIGHT]
    return mine, seen, total


@njit(cache=True, nogil=True, fastmath=True)
def share_out(
    poses: F64, sure: F64, tall: F64, ratios: F32, order: I64, boxes: I64, rays: F32, angle: I32, kind: U8, code: U8,
    cover: F32, b: OutlineBeliefs, owner: I64, share: F32, height: F32, range_m: F32, residual: F32, near: Bool,
) -> None:  # fmt: skip
    """Who owns each pixel of foreground: -2 no foreground, -1 nobody, else a person, with the responsibility.

    ``height`` and ``range_m``: of the owner's pixels, relative to the owner and along the ray. ``residual``: what one
    more person, behind all others, would gain at each pixel. ``near``: whether a person may reach there.
    """
    rows, cols = kind.shape
    bare_seen = math.log((1.0 - b.body) / (1.0 - b.background))
    bare_surface = math.log(b.body / b.background)
    for r in range(rows):
        for c in range(cols):
            owner[r, c], near[r, c], residual[r, c] = -2, False, 0.0
            what = kind[r, c]
            if what == SHADOW:
                continue
            ray = rays[r, c]
            through, explained, best, who, at_z, reached = 1.0, 0.0, 0.0, -1, 0.0, False
            for a in range(len(order)):
                k = order[a]
                if c < boxes[k, 0] or c > boxes[k, 2] or r < boxes[k, 1] or r > boxes[k, 3]:
                    continue
                reached = reached or sure[k] > 0.5
                pi, z = _look(
                    poses[k, 0], poses[k, 1], poses[k, 2], ray[0], ray[1], ray[2], ray[3], angle[r, c], cover, b
                )  # fmt: skip
                pi *= sure[k]
                if pi < 0.01:
                    continue
                hidden = _hidden(poses[k, 2], tall[k, 0], b)
                value = through * pi * _likelihood(what, z, hidden, _colour(z, code[r, c], ratios[k], b), b)
                explained += value
                through *= 1.0 - pi
                if value > best:
                    best, who, at_z = value, k, z
            if not reached and through == 1.0:
                residual[r, c] = bare_seen if what == SEEN else bare_surface
                if what == SURFACE:
                    owner[r, c], share[r, c] = -1, 0.0
                continue
            ground = _ground(what, reached, b)
            one_more = explained + through * _likelihood(what, 1.0, 0.0, 1.0, b)
            residual[r, c] = math.log(one_more / (explained + through * ground))
            if what == SURFACE:
                other = through * ground
                near[r, c] = reached
                owner[r, c] = who if best > other else -1
                share[r, c] = best / (explained + other)
                height[r, c] = at_z
                if who >= 0:
                    ahead = poses[who, 0] * ray[0] + poses[who, 1] * ray[1]
                    range_m[r, c] = ahead * ray[2] - (0.5 * poses[who, 2] - b.camera_m) * ray[3]


@njit(cache=True, nogil=True)
def hull_scores(total: F64, bands: I32, scores: F32) -> None:
    """What people at (N,) places of the model map would gain: the residual's sum in the bands of their hulls.

    ``total`` (H + 1, W + 1): the residual's integral image; ``bands`` (N, K, 4) left, top, right, bottom, clipped.
    """
    for i in range(len(bands)):
        scores[i] = 0.0
        for k in range(bands.shape[1]):
            left, top, right, down = bands[i, k]
            if right > left and down > top:
                scores[i] += total[down, right] - total[top, right] - total[down, left] + total[top, left]
