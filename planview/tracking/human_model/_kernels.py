"""Compiled kernels of the joint explanation of a mask; ``tests/reference/human_model.py`` defines them in plain numpy.

A sample is one pixel near a person: its ray, kind, colour and weight. ``pose`` is (x, y, height). The camera is at
(0, 0, ``camera_m``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, I64, U8, Bool

EX, EY, COS, SIN, WEIGHT, THROUGH, BEFORE, REST, GAINS = range(9)
"""Fields of a sample. From ``GAINS`` on six: what a body that surely covers it changes of its likelihood, over that, of
legs and hip of who stands and of who sits, torso and head."""
SEEN, SHADOW, SURFACE = 0, 1, 2
"""Kinds of pixels: background, foreground that looks like a shadow and says nothing, foreground."""
LEGS_TO, TORSO_TO = 0.45, 0.85
"""Relative heights at which the hip and the shoulders are (Zhang et al. 2008, table 1)."""
TILE_PX = 16
"""Side of the squares in which newcomers are looked for first [px]."""
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
    body_cells: float
    w_first: float


# Numba counts references to arrays that a function is given, which takes longer than a look: only numbers are given.
@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _look(  # type: ignore[no-untyped-def]
    x: float, y: float, h: float, ex: float, ey: float, cos: float, sin: float, cells_u: int, cells_w: int,
    b: OutlineBeliefs,
):  # fmt: skip
    """Where a ray passes a body: the cells of the table across and up, the latter -1 beside it, and the relative height
    of the point of the body's axis."""
    dz, per_h = 0.5 * h - b.camera_m, 1.0 / h
    along, scale = x * ex + y * ey, per_h * b.body_cells
    iu = np.uint32(abs(y * ex - x * ey) * scale)
    iw = np.int32(-(along * sin + dz * cos) * scale - b.w_first)
    if iu >= cells_u or iw >= cells_w:
        iw = np.int32(-1)
    return iu, iw, (b.camera_m - sin * (along * cos - dz * sin)) * per_h


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _likelihood(kind: int, z: float, hidden: float, colour: float, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """Of a pixel on a body; its lower part may be hidden by furniture."""
    if kind == SHADOW:
        return 0.5
    o = hidden if z < b.hidden_to else 0.0
    if kind == SEEN:
        return (1.0 - o) * (1.0 - b.body) + o * (1.0 - b.background)
    return ((1.0 - o) * b.body + o * b.background) * colour


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _ground(kind: int, near: bool, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on which nobody is."""
    if kind == SHADOW:
        return 0.5
    return 1.0 - b.background if kind == SEEN else (b.near_people if near else b.background)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _hidden(h: float, tall: float, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """How probably furniture hides a lower pixel of a person as tall as this when standing."""
    return b.hidden_sitting if h < b.sitting_from * tall else b.hidden


@njit(cache=True, nogil=True, error_model="numpy")
def boxes(poses: F64, reach_m: float, lens: F64, found: I64) -> None:
    """Fill (N, 4) left, top, right, bottom [px] of the corners of bodies' boxes, as ``GroundCamera.project`` has them.

    ``lens``: focal length, K, the camera's height, sine and cosine of tilt and roll, the image's middle.
    """
    focal, k, camera_m, s, c, sin, cos, u, v = lens
    for i in range(len(poses)):
        left, top, right, bottom = 1e4, 1e4, -1e4, -1e4
        for corner in range(8):
            x = poses[i, 0] + (reach_m if corner & 1 else -reach_m)
            y = poses[i, 1] + (reach_m if corner & 2 else -reach_m)
            drop = camera_m - min(1.05 * poses[i, 2] if corner & 4 else 0.0, camera_m - 0.05)
            depth = y * s + drop * c
            px, py = focal * x / max(depth, 1e-6), focal * (drop * s - y * c) / max(depth, 1e-6)
            r = math.sqrt(px * px + py * py)
            if depth <= 1e-6 or 1.0 + 2.0 * k * r <= 0.0:
                left, top, right, bottom = -1e4, -1e4, 1e4, 1e4
                break
            col, row = (cos * px - sin * py) * (1.0 + k * r) + u, (sin * px + cos * py) * (1.0 + k * r) + v
            left, top, right, bottom = min(left, col), min(top, row), max(right, col), max(bottom, row)
        found[i, 0], found[i, 1] = max(left, -1e4), max(top, -1e4)
        found[i, 2], found[i, 3] = min(right, 1e4), min(bottom, 1e4)


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    pose: F64, half_m: float, spacing_m: float, box: I64, rays: F32, angle: U8, kind: U8, code: U8, samples: F32,
    kinds: U8, codes: U8, angles: U8, b: OutlineBeliefs,
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
        first, nearest, weight = n, half_m, 0.0
        # Every other row half a step aside: edges of bodies are upright.
        shift = (r // step % 2) * (step // 2)
        for c in range(c0 + (shift - c0) % step, c1 + 1, step):
            ray = rays[r, c]
            across = pose[1] * ray[0] - pose[0] * ray[1]
            ahead = (pose[0] * ray[0] + pose[1] * ray[1]) * ray[2] - dz * ray[3]
            if abs(across) > half_m or ahead < 0.15:
                continue
            depth = ahead / ray[4]
            s = samples[n]
            s[EX], s[EY], s[COS], s[SIN] = ray[0], ray[1], ray[2], ray[3]
            if abs(across) <= nearest:
                nearest, weight = abs(across), (step / max(b.focal_px * b.patch_m / depth, b.patch_px)) ** 2
            kinds[n], codes[n], angles[n] = kind[r, c], code[r, c], angle[r, c]
            n += 1
        # One weight a row, that of its middle: one logarithm will do for the row.
        for i in range(first, n):
            samples[i, WEIGHT] = weight
    return n


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def layer(
    samples: F32, kinds: U8, codes: U8, angles: U8, n: int, poses: F64, sure: F64, tall: F64, ratios: F32,
    others: I64, i: int, pose: F64, cover: F32, b: OutlineBeliefs,
) -> None:  # fmt: skip
    """Lay other people over the samples, each covering as surely as it exists.

    Fills the share of the ray that passes those who are nearer than person ``i``, who is at ``pose``, the likelihood
    that they explain, what all behind explain, and what the person changes.
    """
    away = poses[others, 0] ** 2 + poses[others, 1] ** 2
    order = others[np.argsort(away)]
    before = (away < pose[0] ** 2 + pose[1] ** 2).sum()
    cells_u, cells_w = cover.shape[1:]
    for j in range(n):
        s, kind, code = samples[j], kinds[j], codes[j]
        ex, ey, cos, sin = s[EX], s[EY], s[COS], s[SIN]
        near, through, explained = False, 1.0, 0.0
        s[THROUGH], s[BEFORE] = 1.0, 0.0
        for a in range(len(order)):
            k = order[a]
            x, y, h = poses[k, 0], poses[k, 1], poses[k, 2]
            if a == before:
                s[THROUGH], s[BEFORE], through, explained = through, explained, 1.0, 0.0
            if kind == SURFACE and sure[k] > 0.5 and abs(y * ex - x * ey) < b.reach_m:
                z = b.camera_m - sin * ((x * ex + y * ey) * cos - (0.5 * h - b.camera_m) * sin)
                near = near or -0.1 < z < h + 0.2
            iu, iw, z = _look(x, y, h, ex, ey, cos, sin, cells_u, cells_w, b)
            pi = sure[k] * cover[angles[j], iu, np.uint32(iw)] if iw >= 0 else 0.0
            if pi > 0.01:
                colour = 1.0 - b.colour + b.colour * ratios[k, int(z >= LEGS_TO) + int(z >= TORSO_TO), code]
                explained += through * pi * _likelihood(kind, z, _hidden(h, tall[k, 0], b), colour, b)
                through *= 1.0 - pi
        if before == len(order):
            s[THROUGH], s[BEFORE], through, explained = through, explained, 1.0, 0.0
        rest = explained + through * _ground(kind, near, b)
        through = s[THROUGH]
        s[REST] = rest
        legs = 1.0 - b.colour + b.colour * ratios[i, 0, code]
        torso = 1.0 - b.colour + b.colour * ratios[i, 1, code]
        head = 1.0 - b.colour + b.colour * ratios[i, 2, code]
        change = 0.0 if kind == SHADOW else through / (s[BEFORE] + through * rest)
        for a, hidden in ((0, b.hidden), (2, b.hidden_sitting)):
            s[GAINS + a] = change * (_likelihood(kind, 0.0, hidden, legs, b) - rest)
            s[GAINS + a + 1] = change * (_likelihood(kind, 0.0, hidden, torso, b) - rest)
        s[GAINS + 4] = change * (_likelihood(kind, b.hidden_to, 0.0, torso, b) - rest)
        s[GAINS + 5] = change * (_likelihood(kind, b.hidden_to, 0.0, head, b) - rest)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def evaluate(
    x: float, y: float, h: float, tall: float, samples: F32, angles: U8, n: int, cover: F32, b: OutlineBeliefs
) -> float:
    """Lam of all samples with one person at a pose among the others, less Lam without that person."""
    total, product, weight = 0.0, 1.0, 0.0
    low = 2 if h < b.sitting_from * tall else 0
    cells_u, cells_w = cover.shape[1:]
    for i in range(n):
        s = samples[i]
        iu, iw, z = _look(x, y, h, s[EX], s[EY], s[COS], s[SIN], cells_u, cells_w, b)
        if iw < 0:
            continue
        pi = cover[angles[i], iu, np.uint32(iw)]
        if pi < 0.005:
            continue
        part = (low if z < LEGS_TO else low + 1) if z < b.hidden_to else (4 if z < TORSO_TO else 5)
        # Samples of a row have one weight, far away those of many rows: doubles hold the product of some 200.
        if s[WEIGHT] != weight or not 1e-200 < product < 1e200:
            total += weight * math.log(product)
            product, weight = 1.0, s[WEIGHT]
        product *= 1.0 + pi * s[GAINS + part]
    return total + weight * math.log(product)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def believed(
    x: float, y: float, h: float, tall: F64, poses: F64, sure: F64, others: I64, b: OutlineBeliefs
) -> float:  # fmt: skip
    """Logarithm of what is believed of a pose: upright, seldom sitting, and no body inside another.

    ``tall`` (2,): the person's height when upright and its deviation. Relative to standing so with nobody near.
    """
    upright, low = (h - tall[0]) / tall[1], (h - b.sitting * tall[0]) / (2.0 * tall[1])
    sits = b.sits / (1.0 - b.sits) * 0.5
    value = math.log((math.exp(-0.5 * upright * upright) + sits * math.exp(-0.5 * low * low) + 1e-9) / (1.0 + sits))
    for k in others:
        gap = math.sqrt((x - poses[k, 0]) ** 2 + (y - poses[k, 1]) ** 2)
        if gap < b.apart_m:
            value -= 0.5 * sure[k] * ((b.apart_m - gap) / 0.07) ** 2
    return value


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _moved(x: float, y: float, h: float, way: int, f: float, tall: float, b: OutlineBeliefs):  # type: ignore[no-untyped-def]
    """A pose moved by f along the camera's ray, across it, up, or up along the ray of the head; or the head's ray kept
    and stood up or sat down."""
    away = max(math.sqrt(x * x + y * y), 1e-3)
    if way == 0:
        # One step in the image, whatever the slope of the ray.
        f *= min(math.sqrt(away * away + b.camera_m * b.camera_m) / b.camera_m, 4.0) / away
        return x + f * x, y + f * y, h
    if way == 1:
        return x - f * y / away, y + f * x / away, h
    nh = h + 0.5 * f
    if way == 4:
        nh = tall if f < 0.0 else b.sitting * tall
    if way == 2 or b.camera_m - max(h, nh) < 0.3:
        return x, y, nh
    f = (b.camera_m - nh) / (b.camera_m - h)
    return x * f, y * f, nh


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def ascend(
    pose: F64, predicted: F64, information: F64, tall: F64, poses: F64, sure: F64, others: I64, steps: F64, low: float,
    high: float, samples: F32, angles: U8, n: int, cover: F32, b: OutlineBeliefs,
) -> float:  # fmt: skip
    """Ascent of Lam - Mahalanobis / 2; moves ``pose``. Lam at the end plus what is believed of such a pose.

    One way after the other (``_moved``), a step to both sides and then to the vertex of the parabola through the three.
    ``information`` (4,): xx, xy, yy of the place's and of the height's inverse covariance. ``others``: bodies that may
    be in the way.
    """
    best, worth = -1e300, 0.0
    for step in steps:
        for _ in range(4):
            moved = False
            for way in range(5 if step == steps[0] else 4):
                x, y, h = pose[0], pose[1], pose[2]
                values = best, best, best
                for trial in range(4):
                    t = (0.0, -1.0, 1.0, 0.0)[trial]
                    if trial == 0 and best > -1e299:
                        continue
                    if trial == 3:
                        here, before, after = values
                        bend = 2.0 * here - before - after
                        t = min(max(0.5 * (after - before) / bend, -2.0), 2.0) if bend > 1e-6 and way < 4 else 0.0
                        if abs(t) < 0.1 or abs(abs(t) - 1.0) < 0.1:
                            continue
                    nx, ny, nh = _moved(x, y, h, way, t * step, tall[0], b)
                    value = -1e300
                    if low <= nh <= high:
                        ox, oy, oh = nx - predicted[0], ny - predicted[1], nh - predicted[2]
                        value = information[0] * ox * ox + 2 * information[1] * ox * oy + information[2] * oy * oy
                        value = -0.5 * (value + information[3] * oh * oh)
                        mine = believed(nx, ny, nh, tall, poses, sure, others, b)
                        mine += evaluate(nx, ny, nh, tall[0], samples, angles, n, cover, b)
                        value += mine
                        if value > best + 1e-6:
                            best, worth = value, mine
                            pose[0], pose[1], pose[2] = nx, ny, nh
                            moved = moved or abs(t) > 0.5
                    # Where nothing was to be tried here, all three are the best so far.
                    values = (value, value, value) if trial == 0 else (values[0], values[2], value)
            if not moved:
                break
    return worth


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def visible(  # type: ignore[no-untyped-def]
    pose: F64, tall: float, samples: F32, kinds: U8, angles: U8, n: int, cover: F32, b: OutlineBeliefs
):
    """Patches of a body that it explains better than all else, those on foreground, and those in view."""
    mine = seen = total = 0.0
    hidden = _hidden(pose[2], tall, b)
    cells_u, cells_w = cover.shape[1:]
    for i in range(n):
        s = samples[i]
        iu, iw, z = _look(pose[0], pose[1], pose[2], s[EX], s[EY], s[COS], s[SIN], cells_u, cells_w, b)
        pi = cover[angles[i], iu, np.uint32(iw)] if iw >= 0 else np.float32(0.0)
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def share_out(
    kind: int, pixels: I64, poses: F64, sure: F64, tall: F64, ratios: F32, order: I64, boxes: I64, rays: F32,
    angle: U8, code: U8, cover: F32, b: OutlineBeliefs, owner: I64, share: F32, height: F32, range_m: F32,
    residual: F32, near: Bool, tiles: F64,
) -> None:  # fmt: skip
    """Who owns each of (K,) pixels of foreground: -1 nobody, else a person, with the responsibility.

    ``pixels`` are of one kind, SURFACE, or SEEN for what the residual alone still lacks. ``height`` and ``range_m``:
    of the owner's pixels, relative to the owner and along the ray. ``near``: whether a person may reach there.
    ``residual``: (H, W), what one more person, behind all others, would gain. ``tiles``: sum of the gains in squares of
    ``TILE_PX``, zeros before.
    """
    cols = code.shape[1]
    one_more = _likelihood(kind, 1.0, 0.0, 1.0, b)
    alone, beside = math.log(one_more / _ground(kind, False, b)), math.log(one_more / _ground(kind, True, b))
    here, n, last = np.empty(len(order), np.int64), 0, -1
    cells_u, cells_w = cover.shape[1:]
    for i in range(len(pixels)):
        r = pixels[i] // cols
        c = pixels[i] - r * cols
        if r != last:
            n, last = 0, r
            for a in range(len(order)):
                if boxes[order[a], 1] <= r <= boxes[order[a], 3]:
                    here[n], n = order[a], n + 1
        ex, ey, cos, sin = rays[r, c, EX], rays[r, c, EY], rays[r, c, COS], rays[r, c, SIN]
        through, explained, best, who, at_z, reached = 1.0, 0.0, 0.0, -1, 0.0, False
        for a in range(n):
            k = here[a]
            if c < boxes[k, 0] or c > boxes[k, 2]:
                continue
            reached = reached or sure[k] > 0.5
            h = poses[k, 2]
            iu, iw, z = _look(poses[k, 0], poses[k, 1], h, ex, ey, cos, sin, cells_u, cells_w, b)
            pi = sure[k] * cover[angle[r, c], iu, np.uint32(iw)] if iw >= 0 else 0.0
            if pi < 0.01:
                continue
            colour = 1.0 - b.colour + b.colour * ratios[k, int(z >= LEGS_TO) + int(z >= TORSO_TO), code[r, c]]
            value = through * pi * _likelihood(kind, z, _hidden(h, tall[k, 0], b), colour, b)
            explained += value
            through *= 1.0 - pi
            if value > best:
                best, who, at_z = value, k, z
        residual[r, c] = beside if reached else alone
        if through < 1.0:
            other = through * _ground(kind, reached, b)
            residual[r, c] = math.log((explained + through * one_more) / (explained + other))
        if kind == SEEN:
            continue
        owner[i], near[i] = -1, reached
        tiles[r // TILE_PX, c // TILE_PX] += residual[r, c]
        if through < 1.0 and best > other:
            owner[i], share[i], height[i] = who, best / (explained + other), at_z
            ahead = poses[who, 0] * ex + poses[who, 1] * ey
            range_m[i] = ahead * cos - (0.5 * poses[who, 2] - b.camera_m) * sin


@njit(cache=True, nogil=True, error_model="numpy")
def promising(total: F64, bands: I32, scale: F32, least: float, found: I32, wanted: Bool) -> int:
    """Fill the places whose hull may gain ``least``, and the tiles in which these are; the number of places.

    ``total``: integral image of the tiles' gains; ``bands``, ``scale``: see ``hull_scores``.
    """
    n = 0
    for i in range(len(bands)):
        left, top, right, down = bands[i, 0, 0], bands[i, 0, 1], bands[i, 0, 2], bands[i, -1, 3]
        for k in range(1, bands.shape[1]):
            left, right = min(left, bands[i, k, 0]), max(right, bands[i, k, 2])
        c0, r0, c1, r1 = left // TILE_PX, top // TILE_PX, (right - 1) // TILE_PX + 1, (down - 1) // TILE_PX + 1
        empty = right <= left or down <= top
        if not empty and scale[i] * (total[r1, c1] - total[r0, c1] - total[r1, c0] + total[r0, c0]) >= least:
            found[n], n = i, n + 1
            wanted[r0:r1, c0:c1] = True
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def hull_scores(total: F64, bands: I32, places: I32, scores: F32) -> None:
    """What people at some places of the model map would gain: the residual's sum in the bands of their hulls.

    ``total`` (H + 1, W + 1): the residual's integral image; ``bands`` (N, K, 4) left, top, right, bottom, clipped.
    """
    for j, i in enumerate(places):
        scores[j] = 0.0
        for k in range(bands.shape[1]):
            left, top, right, down = bands[i, k]
            if right > left and down > top:
                scores[j] += total[down, right] - total[top, right] - total[down, left] + total[top, left]
