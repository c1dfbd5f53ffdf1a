"""Compiled kernels that move people to where they explain best; poses and tuples are as in ``_likelihood_kernels.py``.

Numba keeps them by the time of this file alone: after a change of other kernels, touch this one.
"""

from __future__ import annotations

import math

import numpy as np

from calib.kernels import kernel
from calib.types import F64, Bool
from planview.tracking.body import FACINGS_PER_RAD, LEAN_M
from planview.tracking.explain._likelihood_kernels import lay_others, log_ratio, visible
from planview.tracking.explain.samples import CX, CY, CZ, TINY, samples_of

MAX_TURNS = 3
"""Most rounds of the ascent with one step."""
BODY_SOFTNESS_M = 0.07
"""Deviation of the least distance of two bodies' axes [m]."""
SLOPE_MAX = 4.0
"""Most that a step along a flat ray is lengthened."""


@kernel
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


@kernel
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


@kernel
def _posterior(pose, task):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio plus what is known before plus the logarithm of the prior of a pose; the ratio alone."""
    (predicted, known, _), me, others, samples, table, model = task
    ratio = log_ratio(pose, me[0], me[2], samples, table, model)
    return ratio + log_known(pose, predicted, known[0]) + log_prior(pose, me, others, model), ratio


@kernel
def _better(new, best, task):  # type: ignore[no-untyped-def]
    """The better of a pose and the best so far: pose, posterior, log-likelihood ratio."""
    value, ratio = _posterior(new, task)
    return (new, value, ratio) if value > best[1] else best


@kernel
def _along_head(pose, height_m: float, camera):  # type: ignore[no-untyped-def]
    """A pose of another height whose head is on the same ray."""
    (x, y, h, facing, lean), (cx, cy, cz) = pose, camera
    if cz - max(h, height_m) < 0.3:
        return x, y, height_m, facing, lean
    f = (cz - height_m) / (cz - h)
    return cx + (x - cx) * f, cy + (y - cy) * f, height_m, facing, lean


@kernel
def _postured(pose, facing, lean):  # type: ignore[no-untyped-def]
    """A pose that faces and leans otherwise, with the shoulders where they were: half as far ahead as the head."""
    x, y, h, was, leant = pose
    ox = 0.5 * (leant * math.cos(was) - lean * math.cos(facing))
    oy = 0.5 * (leant * math.sin(was) - lean * math.sin(facing))
    return x + ox, y + oy, h, facing, lean


@kernel
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


@kernel
def _start(pose: F64, axes, task):  # type: ignore[no-untyped-def]
    """The best of a pose, the upright one and, in masks, the sitting one; then of the postures 45 degrees apart where
    nothing is known of them, else of this one and that back to front: pose, posterior, log-likelihood ratio. Upright,
    front and back look the same."""
    (_, known, _), me, _, _, table, model = task
    m, at = model[0], (pose[0], pose[1], pose[2], pose[3], pose[4])
    value, ratio = _posterior(at, task)
    best = at, value, ratio
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


@kernel
def _parabola(best, way, step, unit, axes, task, curvature):  # type: ignore[no-untyped-def]
    """A step each way and one to the top of the parabola: the best of them, and how far it is [steps' unit].

    Fills ``curvature``, that of the log-likelihood ratio there [1/m^2, 1/rad^2].
    """
    m = task[5][0]
    start, value, ratio = best
    up = down = value
    ratio_up = ratio_down = ratio
    far, jump = step, 0.0
    for trial in range(3):
        if trial == 2:
            curve, rise = up + down - 2 * value, up - down
            far = 2 * step if rise > 0 else -2 * step
            if curve < 0:
                far = max(-2 * step, min(2 * step, -0.5 * step * rise / curve))
            if abs(far) < 0.1 * step:
                break
        new = _moved(start, way, far * unit, axes, m)
        reached, ratio_new = (value, ratio) if new == start else _posterior(new, task)
        if trial == 0:
            up, ratio_up = reached, ratio_new
        elif trial == 1:
            down, ratio_down = reached, ratio_new
        if reached > best[1] + 1e-6:
            best, jump = (new, reached, ratio_new), far
        far = -step
    curvature[way] = (2 * ratio - ratio_up - ratio_down) / (step * unit) ** 2
    return best, abs(jump)


@kernel
def ascend(pose: F64, curvature: F64, prior, me, others, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Ascent on the log-likelihood ratio plus what is known before, by parabolas along and across the ray of the
    camera that gives most samples, in height, facing and lean and, in masks, in height along the ray of the head.

    Moves ``pose``; fills ``curvature`` (6,), that of the log-likelihood ratio there [1/m^2, 1/rad^2].

    Args:
        prior: (5,) predicted pose, what is known of it (one of KNOWN), and steps.
        me: height when upright and its deviation, (PARTS, CODES) ratios of colours.
        others: people and which of them: bodies that cannot be entered.

    Returns:
        The log-likelihood ratio at the end plus the logarithm of the prior of such a pose.
    """
    m, task = model[0], (prior, me, others, samples, table, model)
    camera, ax, ay, slope = (pose[0] - 1.0, pose[1], 1e6), 1.0, 0.0, 1.0
    if samples.size[0] > 0:
        main = samples.size[1]
        camera = float(samples.rays[CX, main]), float(samples.rays[CY, main]), float(samples.rays[CZ, main])
        ax, ay = pose[0] - camera[0], pose[1] - camera[1]
        norm = math.sqrt(ax * ax + ay * ay)
        ax, ay = (ax / norm, ay / norm) if norm > 1e-6 else (1.0, 0.0)
        if m.masks > 0.0:  # one step in the image, whatever the slope of the ray
            slope = min(math.sqrt(norm * norm + camera[2] ** 2) / camera[2], SLOPE_MAX)
    units, axes = (slope, 1.0, 0.5, 1.0 / LEAN_M, 1.0, 0.5), (camera, ax, ay)
    best = _start(pose, axes, task)
    for step in prior[2]:
        for again in range(MAX_TURNS):
            farthest = 0.0
            for way in (3, 4, 0, 1, 2, 5):
                if (way in (3, 4) and (again or len(table.cover) == 1)) or (way == 5 and m.masks == 0.0):
                    continue
                best, jump = _parabola(best, way, step, units[way], axes, task, curvature)
                farthest = max(farthest, jump)
            if farthest < 0.5 * step:
                break
    for i in range(5):
        pose[i] = best[0][i]
    return float(best[2] + log_prior(best[0], me, others, model))


@kernel
def explain(people, prior, order, touch: Bool, samples, table, model, found) -> None:  # type: ignore[no-untyped-def]
    """Coordinate ascent of everybody, in an order, in two sweeps of which the second is of those who touch somebody.

    Moves the poses; fills ``found``: (N,) evidence, (N, 6) curvature, (N, 3) of ``visible`` and (N, FACINGS / 2)
    log-likelihood ratios of the upright body there by its facing, each with all others where they are at the end.

    Args:
        prior: (N, 5) predicted poses, (N,) of KNOWN, (K,) steps, and the first of these that each takes.
    """
    (poses, _, tall, ratios), (predicted, known, steps, first) = people, prior
    evidence, curvature, seen, turned = found
    for sweep in range(3):
        for a in order:
            others, mine = np.flatnonzero(touch[a]), samples_of(samples, a)
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
                visible(at, (me[0], me[1], np.ones_like(me[2])), mine, table, model, seen[a])  # in any clothes
                for way in range(turned.shape[1] if len(table.cover) > 1 else 0):
                    facing = _postured(at, way / FACINGS_PER_RAD, 0.0)
                    turned[a, way] = log_ratio(facing, me[0], me[2], mine, table, model)
