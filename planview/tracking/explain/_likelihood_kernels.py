"""Compiled kernels of the likelihood of all pixels; ``tests/reference/explain.py`` defines them in plain numpy.

A sample is one pixel near a person: its camera, ray, kind, range and weight. ``pose`` is (x, y, height, facing, lean):
where the feet are [m], how high the head is and how far before the feet [m], and where the chest points [rad],
counterclockwise from x. Arrays that belong together are passed as one tuple: ``samples`` (``SampleArrays``), ``people``
(``People``), ``table`` (``BodyTable``) and ``model`` (an array of one ``Model``).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from calib.kernels import kernel
from calib.types import F32, F64, I64
from planview.maps.view import BACKGROUND_SEEN as SEEN
from planview.maps.view import NO_DEPTH, SHADED, SURFACE, UNKNOWN
from planview.tracking.body import FACINGS, FACINGS_PER_RAD, LEAN_M
from planview.tracking.explain.samples import (
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
)

ONE_LOG = 12
"""Ratios of likelihoods, each within 1e-12 and 1e12, whose product one logarithm is taken of."""
FURNITURE_TO = 0.72
"""Relative height up to which nearer background may hide a person."""
COVERS = 0.005
"""Bodies cover a ray that they cover less surely than this not at all."""


@kernel
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


@njit(inline="always")
def _surface(i, pose, samples, table, m):  # type: ignore[no-untyped-def]
    """How surely a body covers the ray of a sample that is ``_covered``, where its surface is [m], and its relative
    height there."""
    rays, p, (_, _, h, facing, lean) = samples.rays, samples.pixels[i], pose
    posture = 0
    if len(table.cover) > 1:
        posture = int(facing * FACINGS_PER_RAD + (4 * FACINGS) - p.turn) & (FACINGS - 1)
        posture += FACINGS if lean > p.slant * LEAN_M else 0
    cell = posture, int(p.angle), int(rays[ACROSS, i]), int(rays[UP, i])
    at = rays[AHEAD, i] - table.front[cell] * h / m.body_m
    return table.cover[cell], at, (rays[CZ, i] - rays[SIN, i] * at) / h


@njit(inline="always")
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


@njit(inline="always")
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


@njit(inline="always")
def _behind(p, at, z):  # type: ignore[no-untyped-def]
    """Whether background nearer than a body hides it."""
    return p.kind == SEEN and p.range_m > 0.0 and z < FURNITURE_TO and (at - p.range_m) * p.sharp > 3.0


@kernel
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


@kernel
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


@kernel
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


@kernel
def assign_pixels(samples, poses: F64, model, owner: I64, found: F32) -> None:  # type: ignore[no-untyped-def]
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
            found[3, i] = math.log((ray[BEFORE, n] + more) / total)


@kernel
def log_ratio(pose, tall_m: float, ratios: F32, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """The log-likelihood ratio of all samples: with one person at a pose among the others, to without that person."""
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


@kernel
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
        if p.kind == SEEN or p.kind == SHADED:
            continue
        ray, j = samples.layers[i], 0
        while j < samples.counts[i] and ray[AT, j] < at:
            j += 1
        rest = (1 - pi) * ray[REST, j] * ray[THROUGH, j] + (m.unknown / m.range_m if p.kind == SURFACE else 0.0)
        if ray[THROUGH, j] * pi * _on_body(p, at, z, pose[2] / tall_m, ratios, m) > ray[BEFORE, j] + rest:
            seen[0] += pi * p.weight
