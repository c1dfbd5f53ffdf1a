"""Compiled kernels of the likelihood of all pixels; ``tests/reference/explain.py`` defines them in plain numpy.

A sample is one pixel near a person: its camera, ray, kind, range and weight. ``pose`` is (x, y, height, facing, lean):
where the feet are [m], how high the head is and how far before the feet [m], and where the chest points [rad],
counterclockwise from x. Arrays that belong together are passed as one tuple: ``samples`` (``SampleArrays``), ``people``
(``People``), ``table`` (``BodyTable``) and ``model`` (an array of one ``Model``).
"""

from __future__ import annotations

import math

import numpy as np

from calib.kernels import inlined, kernel
from calib.types import F32, F64, I64
from planview.maps.view import BACKGROUND_SEEN as SEEN
from planview.maps.view import NO_DEPTH, SHADED, SURFACE, UNKNOWN
from planview.tracking.body import FACINGS, FACINGS_PER_RAD, LEAN_M, TORSO
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
    pose_tuple,
)

TORSO_HEIGHT_M = TORSO.height_m
"""Height of the table's body [m]."""
ONE_LOG = 12
"""Ratios of likelihoods, each within 1e-12 and 1e12, whose product one logarithm is taken of."""
FURNITURE_TO = 0.72
"""Relative height up to which nearer background may hide a person."""
COVERS = 0.005
"""Bodies cover a ray that they cover less surely than this not at all."""


@kernel
def _find_covered(x: float, y: float, h: float, samples, table) -> int:  # type: ignore[no-untyped-def]
    """Find the samples within a body's table; return their number.

    Fills ``which`` and the last three rows of ``rays``. Loops without branches in float32, which processors take eight
    at a time; three samples in five end here.
    """
    n = samples.size[0]
    which = samples.which
    rays = samples.rays
    cx = rays[CX]
    cy = rays[CY]
    cz = rays[CZ]
    ex = rays[EX]
    ey = rays[EY]
    cos = rays[COS]
    sin = rays[SIN]
    across = rays[ACROSS]
    up = rays[UP]
    ahead = rays[AHEAD]
    per_m = np.float32(TORSO_HEIGHT_M / h / table.cell_m)
    lowest = np.float32(table.w_min_m / table.cell_m)
    zero = np.float32(0.0)
    middle = np.float32(table.cover.shape[2] // 2)
    widest = np.float32(table.cover.shape[2])
    highest = np.float32(table.cover.shape[3])
    x_m = np.float32(x)
    y_m = np.float32(y)
    z_m = np.float32(0.5 * h)
    for i in range(n):
        dx = x_m - cx[i]
        dy = y_m - cy[i]
        dz = z_m - cz[i]
        along = dx * ex[i] + dy * ey[i]
        across[i] = (dx * ey[i] - dy * ex[i]) * per_m + middle
        up[i] = -(along * sin[i] + dz * cos[i]) * per_m - lowest
        ahead[i] = along * cos[i] - dz * sin[i]
    k = 0
    for i in range(n):
        which[k] = i
        k += (across[i] >= zero) & (across[i] < widest) & (up[i] >= zero) & (up[i] < highest)
    return k


@inlined
def _surface(i, pose, samples, table):  # type: ignore[no-untyped-def]
    """Surface of a body at a covered sample: how surely it covers the ray, its range [m] and its relative height."""
    rays = samples.rays
    pixel = samples.pixels[i]
    _, _, h, facing, lean = pose
    posture = int(facing * FACINGS_PER_RAD + (4 * FACINGS) - pixel.turn) & (FACINGS - 1)
    posture += FACINGS if lean > pixel.slant * LEAN_M else 0
    cell = posture & (len(table.cover) - 1), int(pixel.angle), int(rays[ACROSS, i]), int(rays[UP, i])
    at = rays[AHEAD, i] - table.front[cell] * h / TORSO_HEIGHT_M
    return table.cover[cell], at, (rays[CZ, i] - rays[SIN, i] * at) / h


@inlined
def _on_body(pixel, at, z, upright, ratios, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on a body whose surface is at a range and at a relative height of a body, which is
    ``upright`` [of the height when upright]; the right camera sees nothing before ``matched_m``."""
    if pixel.kind >= UNKNOWN:
        return 0.5
    hidden = 0.0
    if z < m.hidden_to:
        hidden = m.hidden_sitting if upright < m.sitting_from else m.hidden
    if pixel.kind == SEEN:
        return (1.0 - hidden) * (1.0 - m.body) + hidden * (1.0 - m.background)
    shown = (1.0 - hidden) * m.body + hidden * m.background
    if pixel.kind == NO_DEPTH:
        return shown * (1.0 if at < pixel.matched_m else m.no_depth)
    part = 0 if z < LEGS_TO else (1 if z < TORSO_TO else 2)
    shown *= 1.0 - m.colour + m.colour * ratios[part, pixel.code]
    if pixel.range_m <= 0.0:
        return shown
    off = (pixel.range_m - at) * pixel.sharp
    normal = math.exp(-0.5 * off * off) * pixel.sharp / math.sqrt(2.0 * math.pi)
    return shown * (1.0 - m.no_depth) * ((1.0 - m.outliers) * normal + m.outliers / m.range_m)


@inlined
def _on_ground(pixel, m):  # type: ignore[no-untyped-def]
    """Likelihood of a pixel on which nobody is; ``near`` people there are arms, shadows and what is carried."""
    if pixel.kind >= UNKNOWN:
        return 0.5
    if pixel.kind == SEEN:
        return 1.0 - m.background
    if pixel.kind == NO_DEPTH:
        return 0.5 * m.background
    if pixel.range_m <= 0.0:
        return m.near_people if pixel.near else m.background
    return 0.5 * (m.near_people / (2 * m.reach_m) if pixel.near else m.background / m.range_m)


@inlined
def _hides(pixel, at, z):  # type: ignore[no-untyped-def]
    """True where background nearer than a body hides it."""
    seen = pixel.kind == SEEN and pixel.range_m > 0.0
    return seen and z < FURNITURE_TO and (at - pixel.range_m) * pixel.sharp > 3.0


@inlined
def _count_before(i, at, samples):  # type: ignore[no-untyped-def]
    """Number of others on a sample's ray before a range."""
    j = 0
    while j < samples.counts[i] and samples.layers[i, AT, j] < at:
        j += 1
    return j


@kernel
def _mark_near(x: float, y: float, h: float, samples, m) -> None:  # type: ignore[no-untyped-def]
    """Mark the samples within a person's reach: by where their surface is, in masks by where their ray passes."""
    rays = samples.rays
    for i in range(samples.size[0]):
        flat = rays[COS, i] * samples.pixels[i].range_m
        if m.masks > 0.0:
            flat = (x - rays[CX, i]) * rays[EX, i] + (y - rays[CY, i]) * rays[EY, i]
            at = flat * rays[COS, i] - (0.5 * h - rays[CZ, i]) * rays[SIN, i]
            z = rays[CZ, i] - rays[SIN, i] * at
            if z < -0.1 or z > h + 0.2:
                continue
        ox = rays[CX, i] + rays[EX, i] * flat - x
        oy = rays[CY, i] + rays[EY, i] * flat - y
        if ox * ox + oy * oy < m.reach_m * m.reach_m:
            samples.pixels[i].near = 1


@kernel
def _sum_layers(ray: F32, n: int, ground: float) -> None:
    """Turn cover and likelihood of each of n people on a ray into what passes them and what they explain
    (``lay_others``)."""
    ray[REST, n] = ground
    for j in range(n - 1, -1, -1):
        ray[REST, j] = ray[THROUGH, j] * ray[BEFORE, j] + (1.0 - ray[THROUGH, j]) * ray[REST, j + 1]
    passing = 1.0
    explained = 0.0
    for j in range(n):
        pi = ray[THROUGH, j]
        like = ray[BEFORE, j]
        ray[THROUGH, j] = passing
        ray[BEFORE, j] = explained
        explained += passing * pi * like
        passing *= 1.0 - pi
    ray[THROUGH, n] = passing
    ray[BEFORE, n] = explained


@kernel
def lay_others(samples, people, who: I64, reaching: I64, table, model) -> None:  # type: ignore[no-untyped-def]
    """Lay the other people on every sample's ray, the nearest first, each covering as surely as it exists.

    Fills ``layers`` (N, 5, LAYERS + 1): ranges, the share of the ray that passes the first k people, the likelihood
    that these explain, what all behind them explains of what passes, and who they are; ``counts`` (N,), how many.

    Args:
        reaching: those whose arms and shadows may be on the ground.
    """
    m = model[0]
    layers = samples.layers
    count = samples.counts
    poses = people.poses
    n = samples.size[0]
    count[:n] = 0
    for i in range(n):
        samples.pixels[i].near = 0
    for k in reaching:
        if people.existence[k] > 0.5:
            _mark_near(poses[k, 0], poses[k, 1], poses[k, 2], samples, m)
    for k in who:
        pose = pose_tuple(poses[k])
        for q in range(_find_covered(pose[0], pose[1], pose[2], samples, table)):
            i = samples.which[q]
            pixel = samples.pixels[i]
            pi, at, z = _surface(i, pose, samples, table)
            sure = pi * people.existence[k]
            if sure < 2 * COVERS or z < 0.0 or _hides(pixel, at, z):
                continue
            ray = layers[i]
            j = count[i]
            while j > 0 and ray[AT, j - 1] > at:
                for row in (AT, THROUGH, BEFORE, WHO):
                    ray[row, j] = ray[row, j - 1]
                j -= 1
            ray[AT, j] = at
            ray[THROUGH, j] = sure
            ray[BEFORE, j] = _on_body(pixel, at, z, pose[2] / people.statures[k, 0], people.ratios[k], m)
            ray[WHO, j] = k
            count[i] = min(count[i] + 1, LAYERS)
    for i in range(n):
        _sum_layers(layers[i], count[i], _on_ground(samples.pixels[i], m))


@kernel
def assign_pixels(samples, poses: F64, model, owner: I64, out: F32) -> None:  # type: ignore[no-untyped-def]
    """The owner of each of the samples that ``take_pixels`` took, among the people laid on them; see ``Owners``.

    Fills ``out`` (4, N): share, relative height, patches and what is lacking.
    """
    m = model[0]
    for i in range(samples.size[0]):
        pixel = samples.pixels[i]
        ray = samples.layers[i]
        n = samples.counts[i]
        best = 0.0
        layer = -1
        for j in range(n):
            like = ray[BEFORE, j + 1] - ray[BEFORE, j]
            if like > best:
                best = like
                layer = j
        other = ray[THROUGH, n] * ray[REST, n] + m.unknown / m.range_m
        total = ray[BEFORE, n] + other
        at = pixel.range_m
        z = 0.0
        if layer >= 0:
            at = at if at > 0.0 else ray[AT, layer]
            who = int(ray[WHO, layer])
            z = (samples.rays[CZ, i] - samples.rays[SIN, i] * ray[AT, layer]) / poses[who, 2]
        patches = pixel.weight * at * at
        owner[i] = who if best > other else -1
        out[0, i] = best / total
        out[1, i] = z
        out[2, i] = patches
        if pixel.range_m > 0.0:  # a body's surface there, as an expected logarithm
            surface = m.body * (1.0 - m.no_depth) * (1.0 - m.outliers) * pixel.sharp / math.sqrt(2.0 * math.pi * math.e)
            out[3, i] = patches * math.log(surface / total)
        else:  # one more person behind all others
            more = ray[THROUGH, n] * (m.body if pixel.kind == SURFACE else 1.0 - m.body)
            out[3, i] = math.log((ray[BEFORE, n] + more) / total)


@kernel
def log_ratio(pose, stature_m: float, ratios: F32, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """The log-likelihood ratio of all samples: with one person at a pose among the others, to without that person."""
    m = model[0]
    total = 0.0
    product = 1.0
    factors = 0
    weight = 0.0
    floor_seen = m.unknown / m.range_m / (1.0 - m.unknown)
    for q in range(_find_covered(pose[0], pose[1], pose[2], samples, table)):
        i = samples.which[q]
        pixel = samples.pixels[i]
        pi, at, z = _surface(i, pose, samples, table)
        if pi < COVERS or z < 0.0 or _hides(pixel, at, z):
            continue
        ray = samples.layers[i]
        j = _count_before(i, at, samples)
        without = ray[BEFORE, j] + ray[THROUGH, j] * ray[REST, j] + (floor_seen if pixel.kind == SURFACE else TINY)
        if factors == ONE_LOG or pixel.weight != weight:
            total += weight * math.log(product)
            product = 1.0
            factors = 0
            weight = pixel.weight
        like = _on_body(pixel, at, z, pose[2] / stature_m, ratios, m)
        product *= 1.0 + ray[THROUGH, j] * pi * (like - ray[REST, j]) / without
        factors += 1
    return float(total + weight * math.log(product))


@kernel
def visible_patches(pose, stature_m: float, ratios: F32, samples, table, model, out: F64) -> None:  # type: ignore[no-untyped-def]
    """Patches of a body that it explains better than all else, those that show something, and those in view, to
    ``out`` (3,)."""
    m = model[0]
    out[:] = 0.0
    for q in range(_find_covered(pose[0], pose[1], pose[2], samples, table)):
        i = samples.which[q]
        pixel = samples.pixels[i]
        pi, at, z = _surface(i, pose, samples, table)
        if pi < 0.02:
            continue
        out[2] += pi * pixel.weight
        if pixel.kind == UNKNOWN:
            continue
        out[1] += pi * pixel.weight
        if pixel.kind == SEEN or pixel.kind == SHADED:
            continue
        ray = samples.layers[i]
        j = _count_before(i, at, samples)
        rest = (1 - pi) * ray[REST, j] * ray[THROUGH, j] + (m.unknown / m.range_m if pixel.kind == SURFACE else 0.0)
        like = _on_body(pixel, at, z, pose[2] / stature_m, ratios, m)
        if ray[THROUGH, j] * pi * like > ray[BEFORE, j] + rest:
            out[0] += pi * pixel.weight
