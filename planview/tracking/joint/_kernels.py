"""Compiled kernels of the joint explanation; ``tests/reference/explain.py`` defines them in plain numpy.

A sample is one pixel near a person: its camera, ray, kind, range and weight. ``pose`` is (x, y, height, facing, lean):
where the feet are [m], how high the head is and how far before the feet [m], and where the chest points [rad],
counterclockwise from x. Arrays that belong together are passed as one tuple: ``samples`` (``SampleArrays``), ``people``
(``People.arrays``), ``table`` (``BodyTable``) and ``model`` (an array of one ``Model``).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, Bool
from planview.maps.view import BACKGROUND_SEEN as SEEN
from planview.maps.view import NO_DEPTH, SHADOW, SURFACE, UNKNOWN
from planview.tracking.body import LEAN_M, TURNS, TURNS_PER_RAD
from planview.tracking.joint.samples import (
    ACROSS,
    AHEAD,
    AT,
    BEFORE,
    COS,
    CX,
    CY,
    CZ,
    EX,
    EY,
    LAYERS,
    LEGS_TO,
    REST,
    SIN,
    THROUGH,
    TINY,
    TORSO_TO,
    UP,
    WHO,
    SampleArrays,
)

MAX_TURNS = 3
"""Most rounds of the ascent with one step."""
ONE_LOG = 12
"""Ratios of likelihoods, each within 1e-12 and 1e12, whose product one logarithm is taken of."""
FURNITURE_TO = 0.72
"""Relative height up to which nearer background may hide a person."""
BODY_SOFTNESS_M = 0.07
"""Deviation of the least distance of two bodies' axes [m]."""
SLOPE_MAX = 4.0
"""Most that a step along a flat ray is lengthened."""
COVERS = 0.005
"""Bodies cover a ray that they cover less surely than this not at all."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _samples_of(samples, k):  # type: ignore[no-untyped-def]
    """Those of one person."""
    rays, pixels, layers = samples.rays[k], samples.pixels[k], samples.layers[k]
    return SampleArrays(rays, pixels, layers, samples.counts[k], samples.which[k], samples.size[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _covered(x: float, y: float, h: float, samples, table, m) -> int:  # type: ignore[no-untyped-def]
    """The samples within a body's table: their number, and which; fills the last three rows of ``rays``.

    Loops without branches in float32, which processors take eight at a time; three samples in five end here.
    """
    n, which, rays = samples.size[0], samples.which, samples.rays
    cx, cy, cz, ex, ey, cos, sin = rays[CX], rays[CY], rays[CZ], rays[EX], rays[EY], rays[COS], rays[SIN]
    across, up, ahead = rays[ACROSS], rays[UP], rays[AHEAD]
    per_m, lowest = np.float32(m.body_m / h / table.cell_m), np.float32(table.w_min_m / table.cell_m)
    zero, middle = np.float32(0.0), np.float32(table.cover.shape[2] // 2)
    x_m, y_m, z_m = np.float32(x), np.float32(y), np.float32(0.5 * h)
    for i in range(n):
        dx, dy, dz = x_m - cx[i], y_m - cy[i], z_m - cz[i]
        along = dx * ex[i] + dy * ey[i]
        across[i] = (dx * ey[i] - dy * ex[i]) * per_m + middle
        up[i] = -(along * sin[i] + dz * cos[i]) * per_m - lowest
        ahead[i] = along * cos[i] - dz * sin[i]
    widest, highest, k = np.float32(table.cover.shape[2]), np.float32(table.cover.shape[3]), 0
    for i in range(n):
        which[k] = i
        k += (across[i] >= zero) & (across[i] < widest) & (up[i] >= zero) & (up[i] < highest)
    return k


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _surface(i, pose, samples, table, m):  # type: ignore[no-untyped-def]
    """How surely a body covers the ray of a sample that is ``_covered``, where its surface is [m], and its relative
    height there."""
    rays, p, (_, _, h, facing, lean) = samples.rays, samples.pixels[i], pose
    posture = 0
    if len(table.cover) > 1:
        posture = int(facing * TURNS_PER_RAD + (4 * TURNS) - p.turn) & (TURNS - 1)
        posture += TURNS if lean > p.slant * LEAN_M else 0
    cell = posture, int(p.angle), int(rays[ACROSS, i]), int(rays[UP, i])
    at = rays[AHEAD, i] - table.front[cell] * h / m.body_m
    return table.cover[cell], at, (rays[CZ, i] - rays[SIN, i] * at) / h


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _on_body(p, at, z, upright, ratios, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on a body whose surface is at a range and at a relative height of a body, which is
    ``upright`` [of the height when upright]; the right camera sees nothing before ``matched_m``."""
    if p.kind >= UNKNOWN:
        return 0.5
    hidden = 0.0
    if z < m.hidden_to:
        hidden = m.hidden_sitting if upright < m.sitting_from else m.hidden
    if p.kind == SEEN:
        return (1.0 - hidden) * (1.0 - m.body) + hidden * (1.0 - m.background)
    shown = (1.0 - hidden) * m.body + hidden * m.background
    if p.kind == NO_DEPTH:
        return shown * (1.0 if at < p.matched_m else m.no_depth)
    shown *= 1.0 - m.colour + m.colour * ratios[0 if z < LEGS_TO else (1 if z < TORSO_TO else 2), p.code]
    if p.range_m <= 0.0:
        return shown
    off = (p.range_m - at) * p.sharp
    normal = math.exp(-0.5 * off * off) * p.sharp / math.sqrt(2.0 * math.pi)
    return shown * (1.0 - m.no_depth) * ((1.0 - m.outliers) * normal + m.outliers / m.range_m)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _on_ground(p, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on which nobody is; ``near`` people there are arms, shadows and what is carried."""
    if p.kind >= UNKNOWN:
        return 0.5
    if p.kind == SEEN:
        return 1.0 - m.background
    if p.kind == NO_DEPTH:
        return 0.5 * m.background
    if p.range_m <= 0.0:
        return m.near_people if p.near else m.background
    return 0.5 * (m.near_people / (2 * m.reach_m) if p.near else m.background / m.range_m)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _behind(p, at, z):  # type: ignore[no-untyped-def]
    """Whether background nearer than a body hides it."""
    return p.kind == SEEN and p.range_m > 0.0 and z < FURNITURE_TO and (at - p.range_m) * p.sharp > 3.0


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_near(x: float, y: float, h: float, samples, m) -> None:  # type: ignore[no-untyped-def]
    """Mark the samples within a person's reach: by where their surface is, in masks by where their ray passes."""
    rays = samples.rays
    for i in range(samples.size[0]):
        flat = rays[COS, i] * samples.pixels[i].range_m
        if m.masks > 0.0:
            along = (x - rays[CX, i]) * rays[EX, i] + (y - rays[CY, i]) * rays[EY, i]
            at = along * rays[COS, i] - (0.5 * h - rays[CZ, i]) * rays[SIN, i]
            flat, z = along, rays[CZ, i] - rays[SIN, i] * at
            if z < -0.1 or z > h + 0.2:
                continue
        ox, oy = rays[CX, i] + rays[EX, i] * flat - x, rays[CY, i] + rays[EY, i] * flat - y
        if ox * ox + oy * oy < m.reach_m * m.reach_m:
            samples.pixels[i].near = 1


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
def lay_others(samples, people, who: I64, reaching: I64, table, model) -> None:  # type: ignore[no-untyped-def]
    """The other people on every sample's ray, the nearest first, each covering as surely as it exists.

    ``reaching``: those whose arms and shadows may be on the ground.

    Fills ``layers`` (N, 5, LAYERS + 1): ranges, the share of the ray that passes the first k people, the likelihood
    that these explain, what all behind them explains of what passes, and who they are; ``counts`` (N,), how many.
    """
    m = model[0]
    layers, count = samples.layers, samples.counts
    poses, sure, tall, ratios = people
    n = samples.size[0]
    count[:n] = 0
    for i in range(n):
        samples.pixels[i].near = 0
    for k in reaching:
        if sure[k] > 0.5:
            _mark_near(poses[k, 0], poses[k, 1], poses[k, 2], samples, m)
    for k in who:
        pose = poses[k, 0], poses[k, 1], poses[k, 2], poses[k, 3], poses[k, 4]
        for q in range(_covered(pose[0], pose[1], pose[2], samples, table, m)):
            i = samples.which[q]
            p, k_on, (pi, at, z) = samples.pixels[i], count[i], _surface(i, pose, samples, table, m)
            if pi * sure[k] < 2 * COVERS or z < 0.0 or _behind(p, at, z):
                continue
            ray, j = layers[i], k_on
            while j > 0 and ray[AT, j - 1] > at:
                for row in (AT, THROUGH, BEFORE, WHO):
                    ray[row, j] = ray[row, j - 1]
                j -= 1
            like = _on_body(p, at, z, pose[2] / tall[k, 0], ratios[k], m)
            ray[AT, j], ray[THROUGH, j], ray[BEFORE, j], ray[WHO, j] = at, pi * sure[k], like, k
            count[i] = min(k_on + 1, LAYERS)
    for i in range(n):
        _sum_layers(layers[i], count[i], _on_ground(samples.pixels[i], m))


@njit(cache=True, nogil=True, error_model="numpy")
def share_out(samples, poses: F64, model, owner: I64, found: F32) -> None:  # type: ignore[no-untyped-def]
    """The owner of each of the samples that ``take_pixels`` took, among the people laid on them; see ``Owned``.

    Fills ``found`` (4, N): share, relative height, patches and what is lacking.
    """
    m = model[0]
    for i in range(samples.size[0]):
        p, ray, n, best, layer = samples.pixels[i], samples.layers[i], samples.counts[i], 0.0, -1
        for j in range(n):
            like = ray[BEFORE, j + 1] - ray[BEFORE, j]
            if like > best:
                best, layer = like, j
        other = ray[THROUGH, n] * ray[REST, n] + m.unknown / m.range_m
        total, at, z = ray[BEFORE, n] + other, p.range_m, 0.0
        if layer >= 0:
            at = at if at > 0.0 else ray[AT, layer]
            who = int(ray[WHO, layer])
            z = (samples.rays[CZ, i] - samples.rays[SIN, i] * ray[AT, layer]) / poses[who, 2]
        patches = p.weight * at * at
        owner[i] = who if best > other else -1
        found[0, i], found[1, i], found[2, i] = best / total, z, patches
        if p.range_m > 0.0:  # a body's surface there, as an expected logarithm
            surface = m.body * (1.0 - m.no_depth) * (1.0 - m.outliers) * p.sharp / math.sqrt(2.0 * math.pi * math.e)
            found[3, i] = patches * math.log(surface / total)
        else:  # one more person behind all others
            more = ray[THROUGH, n] * (m.body if p.kind == SURFACE else 1.0 - m.body)
            found[3, i] = math.log((total + more) / total)


@njit(cache=True, nogil=True, error_model="numpy")
def log_ratio(pose, tall_m: float, ratios: F32, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Lam of all samples with one person at a pose among the others, less Lam without that person."""
    m = model[0]
    total, product, factors, weight = 0.0, 1.0, 0, 0.0
    floor_seen = m.unknown / m.range_m / (1.0 - m.unknown)
    for q in range(_covered(pose[0], pose[1], pose[2], samples, table, m)):
        i = samples.which[q]
        p, (pi, at, z) = samples.pixels[i], _surface(i, pose, samples, table, m)
        if pi < COVERS or z < 0.0 or _behind(p, at, z):
            continue
        ray, j = samples.layers[i], 0
        while j < samples.counts[i] and ray[AT, j] < at:
            j += 1
        without = ray[BEFORE, j] + ray[THROUGH, j] * ray[REST, j] + (floor_seen if p.kind == SURFACE else TINY)
        if factors == ONE_LOG or p.weight != weight:
            total += weight * math.log(product)
            product, factors, weight = 1.0, 0, p.weight
        like = _on_body(p, at, z, pose[2] / tall_m, ratios, m)
        product *= 1.0 + ray[THROUGH, j] * pi * (like - ray[REST, j]) / without
        factors += 1
    return float(total + weight * math.log(product))


@njit(cache=True, nogil=True, error_model="numpy")
def visible(pose, me, samples, table, model, seen: F64) -> None:  # type: ignore[no-untyped-def]
    """Patches of a body that it explains better than all else, those that show something, and those in view, to
    ``seen`` (3,)."""
    m, (tall_m, _, ratios) = model[0], me
    seen[:] = 0.0
    for q in range(_covered(pose[0], pose[1], pose[2], samples, table, m)):
        i = samples.which[q]
        p, (pi, at, z) = samples.pixels[i], _surface(i, pose, samples, table, m)
        if pi < 0.02:
            continue
        seen[2] += pi * p.weight
        if p.kind == UNKNOWN:
            continue
        seen[1] += pi * p.weight
        if p.kind == SEEN or p.kind == SHADOW:
            continue
        ray, j = samples.layers[i], 0
        while j < samples.counts[i] and ray[AT, j] < at:
            j += 1
        rest = (1 - pi) * ray[REST, j] * ray[THROUGH, j] + (m.unknown / m.range_m if p.kind == SURFACE else 0.0)
        if ray[THROUGH, j] * pi * _on_body(p, at, z, pose[2] / tall_m, ratios, m) > ray[BEFORE, j] + rest:
            seen[0] += pi * p.weight


@njit(cache=True, nogil=True, error_model="numpy")
def log_prior(pose, me, others, model):  # type: ignore[no-untyped-def]
    """Logarithm of the prior of a pose: upright, rarely lower or with the head ahead, and no body inside another.

    ``me``: height when upright and its deviation; ``others``: people and which. Relative to standing so with nobody
    near.
    """
    m = model[0]
    (poses, sure, _, _), who = others
    (x, y, h, _, lean), tall_m, std = pose, me[0], me[1]
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
def log_known(pose, predicted: F64, known):  # type: ignore[no-untyped-def]
    """Logarithm of the density of a pose before the frame, relative to the predicted one; ``known``: of KNOWN."""
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
def _posterior(pose, task):  # type: ignore[no-untyped-def]
    """Lam plus what is known before plus the logarithm of the prior of a pose; Lam alone."""
    (predicted, known, _), me, others, samples, table, model = task
    lam = log_ratio(pose, me[0], me[2], samples, table, model)
    return lam + log_known(pose, predicted, known[0]) + log_prior(pose, me, others, model), lam


@njit(cache=True, nogil=True, error_model="numpy")
def _better(new, best, task):  # type: ignore[no-untyped-def]
    """The better of a pose and the best so far: pose, posterior, Lam."""
    value, lam = _posterior(new, task)
    return (new, value, lam) if value > best[1] else best


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


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(pose, way, far, axes, m):  # type: ignore[no-untyped-def]
    """A pose moved along (0) or across (1) the level direction of the camera's ray, up (2), turned (3), leant (4), or
    moved up along the head's ray (5)."""
    (x, y, h, facing, lean), (camera, ax, ay) = pose, axes
    height_m = max(m.height_min_m, min(m.height_max_m, h + far))
    if way == 0:
        return x + far * ax, y + far * ay, h, facing, lean
    if way == 1:
        return x - far * ay, y + far * ax, h, facing, lean
    if way == 2:
        return x, y, height_m, facing, lean
    if way == 3:
        return _postured(pose, facing + far, lean)
    if way == 4:
        return _postured(pose, facing, max(0.0, min(LEAN_M, lean + far)))
    return _along_head(pose, height_m, camera)


@njit(cache=True, nogil=True, error_model="numpy")
def _start(pose: F64, axes, task):  # type: ignore[no-untyped-def]
    """The best of a pose, the upright one and, in masks, the sitting one; then of the postures 45 degrees apart where
    nothing is known of them, else of this one and that back to front: pose, posterior, Lam. Upright, front and back
    look the same."""
    (_, known, _), me, _, _, table, model = task
    m, at = model[0], (pose[0], pose[1], pose[2], pose[3], pose[4])
    value, lam = _posterior(at, task)
    best = at, value, lam
    for posture in range(2 if m.masks > 0.0 else 1):
        tall_m = me[0] * (m.sitting if posture == 1 else 1.0)
        new = _along_head(best[0], tall_m, axes[0]) if m.masks > 0.0 else (at[0], at[1], tall_m, at[3], at[4])
        best = _better(new, best, task)
    if len(table.cover) == 1:
        return best
    start = best[0]
    if known[0].turn >= 1.0:
        return _better(_postured(start, start[3] + math.pi, start[4]), best, task)
    for lean in range(2):
        for way in range(4 << lean):
            best = _better(_postured(start, 0.25 * math.pi * way, lean * LEAN_M), best, task)
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _parabola(best, way, step, unit, axes, task, curvature, bend):  # type: ignore[no-untyped-def]
    """A step each way and one to the top of the parabola: the best of them, and how far it is [steps' unit].

    Fills ``curvature``, how sharply Lam curves there [1/m^2, 1/rad^2], and ``bend``, how the parabola does; where it is
    known to be negative, one step says where the top is.
    """
    m = task[5][0]
    start, value, lam = best
    up = down = value
    lam_up, far, jump = lam, step, 0.0
    for trial in range(3):
        if trial == 1 and bend[way] < 0.0:
            down = 2 * value + bend[way] - up
            continue
        if trial == 2:
            bend[way], rise = up + down - 2 * value, up - down
            far = 2 * step if rise > 0 else -2 * step
            if bend[way] < 0.0:
                far = max(-2 * step, min(2 * step, -0.5 * step * rise / bend[way]))
            if abs(far) < 0.1 * step:
                break
        new = _moved(start, way, far * unit, axes, m)
        reached, lam_new = (value, lam) if new == start else _posterior(new, task)
        if trial == 0:
            up, lam_up = reached, lam_new
        elif trial == 1:
            down, curvature[way] = reached, (2 * lam - lam_up - lam_new) / (step * unit) ** 2
        if reached > best[1] + 1e-6:
            best, jump = (new, reached, lam_new), far
        far = -step
    return best, abs(jump)


@njit(cache=True, nogil=True, error_model="numpy")
def ascend(pose: F64, curvature: F64, prior, me, others, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Ascent on Lam plus what is known before by parabolas along and across the first camera's ray, in height, facing
    and lean and, in masks, in height along the ray of the head.

    Moves ``pose``; fills ``curvature`` (6,), how sharply Lam curves there [1/m^2, 1/rad^2].

    Args:
        prior: (5,) predicted pose, what is known of it (one of KNOWN), and steps.
        me: height when upright and its deviation, (PARTS, CODES) ratios of colours.
        others: people and which of them: bodies that cannot be entered.

    Returns:
        Lam at the end plus the logarithm of the prior of such a pose.
    """
    m, task = model[0], (prior, me, others, samples, table, model)
    camera, ax, ay, slope = (pose[0] - 1.0, pose[1], 1e6), 1.0, 0.0, 1.0
    if samples.size[0] > 0:
        camera = float(samples.rays[CX, 0]), float(samples.rays[CY, 0]), float(samples.rays[CZ, 0])
        ax, ay = pose[0] - camera[0], pose[1] - camera[1]
        norm = math.sqrt(ax * ax + ay * ay)
        ax, ay = (ax / norm, ay / norm) if norm > 1e-6 else (1.0, 0.0)
        if m.masks > 0.0:  # one step in the image, whatever the slope of the ray
            slope = min(math.sqrt(norm * norm + camera[2] ** 2) / camera[2], SLOPE_MAX)
    units, axes = (slope, 1.0, 0.5, 1.0 / LEAN_M, 1.0, 0.5), (camera, ax, ay)
    best = _start(pose, axes, task)
    for step in prior[2]:
        bend = np.zeros(6)
        for again in range(MAX_TURNS):
            farthest = 0.0
            for way in (3, 4, 0, 1, 2, 5):
                if (way in (3, 4) and (again or len(table.cover) == 1)) or (way == 5 and m.masks == 0.0):
                    continue
                best, jump = _parabola(best, way, step, units[way], axes, task, curvature, bend)
                farthest = max(farthest, jump)
            if farthest < 0.5 * step:
                break
    for i in range(5):
        pose[i] = best[0][i]
    return float(best[2] + log_prior(best[0], me, others, model))


@njit(cache=True, nogil=True, error_model="numpy")
def explain(people, prior, order, touch: Bool, samples, table, model, found) -> None:  # type: ignore[no-untyped-def]
    """Coordinate ascent of everybody, in an order, in two sweeps of which the second is of those who touch somebody.

    Moves the poses; fills ``found``: (N,) evidence, (N, 6) curvature and (N, 3) of ``visible``, each with all others
    where they are at the end.

    Args:
        prior: (N, 5) predicted poses, (N,) of KNOWN, (K,) steps, and the first of these that each takes.
    """
    (poses, _, tall, ratios), (predicted, known, steps, first), (evidence, curvature, seen) = people, prior, found
    for sweep in range(3):
        for a in order:
            others, mine = np.flatnonzero(touch[a]), _samples_of(samples, a)
            if sweep == 0 or len(others):
                lay_others(mine, people, others, others, table, model)
            me, pose = (tall[a, 0], tall[a, 1], ratios[a]), poses[a]
            if sweep == 0 or (sweep == 1 and len(others)):
                mine_before = predicted[a], known[a : a + 1], steps[max(sweep, first[a]) :]
                evidence[a] = ascend(pose, curvature[a], mine_before, me, (people, others), mine, table, model)
            if sweep == 2:
                at = pose[0], pose[1], pose[2], pose[3], pose[4]
                evidence[a] = log_ratio(at, me[0], me[2], mine, table, model)
                evidence[a] += log_prior(at, me, (people, others), model)
                visible(at, me, mine, table, model, seen[a])
