"""Compiled kernels that move people to where they explain best; arguments are as in ``_likelihood_kernels.py``."""

from __future__ import annotations

import math

import numpy as np

from calib.kernels import kernel
from calib.types import F64, Bool
from planview.tracking.body import APART_M, FACINGS_PER_RAD, HEIGHT_MAX_M, HEIGHT_MIN_M, LEAN_M, LEAN_STD_M
from planview.tracking.explain._likelihood_kernels import lay_others, log_ratio, visible_patches
from planview.tracking.explain.samples import (
    CX,
    CY,
    CZ,
    TINY,
    Appearance,
    Others,
    Search,
    pose_tuple,
    samples_of_person,
)

MAX_TURNS = 3
"""Most rounds of the ascent with one step."""
BODY_SOFTNESS_M = 0.07
"""Deviation of the least distance of two bodies' axes [m]."""
SLOPE_MAX = 4.0
"""Most that a step along a flat ray is lengthened."""
FORWARD, SIDEWARD, UPWARD, TURN, LEAN, ALONG_HEAD = range(6)
"""Ways of moving a pose, see ``_move``."""


@kernel
def log_prior(pose, person, others, model):  # type: ignore[no-untyped-def]
    """Logarithm of the prior of a pose: upright, rarely lower or with the head ahead, and no body inside another.

    Relative to standing so with nobody near.
    """
    m = model[0]
    x, y, h, _, lean = pose
    stature_m = person.stature_m
    std_m = person.stature_std_m
    up = (h - stature_m) / std_m
    sits = 0.5 * m.sits / (1.0 - m.sits)
    down = (h - m.sitting * stature_m) / (2.0 * std_m)
    lower = m.low_share / (1.0 - m.low_share) * std_m * math.sqrt(2 * math.pi) / stature_m
    density = math.exp(-0.5 * up * up) + lower + sits * math.exp(-0.5 * down * down)
    value = math.log(density / (1.0 + lower + sits)) - 0.5 * (lean / LEAN_STD_M) ** 2
    poses = others.people.poses
    for k in others.which:
        gap = math.sqrt((x - poses[k, 0]) ** 2 + (y - poses[k, 1]) ** 2)
        if gap < APART_M:
            value -= 0.5 * others.people.existence[k] * ((APART_M - gap) / BODY_SOFTNESS_M) ** 2
    return value


@kernel
def log_prediction(pose, predicted: F64, prior):  # type: ignore[no-untyped-def]
    """Logarithm of the density of a pose before the frame, relative to the predicted one; ``prior``: of POSE_PRIOR."""
    x, y, h, facing, _ = pose
    ox = x - predicted[0]
    oy = y - predicted[1]
    oh = h - predicted[2]
    away = prior.xx * ox * ox + 2 * prior.xy * ox * oy + prior.yy * oy * oy + prior.height * oh * oh
    if prior.facing > 0.0:
        turned = math.sin(0.5 * (facing - predicted[3])) ** 2
        ahead = (1.0 - prior.back) * math.exp(-2.0 * prior.facing * turned)
        back = prior.back * math.exp(-2.0 * prior.facing * (1.0 - turned))
        away -= 2.0 * math.log(ahead + back + TINY)
    if prior.walk > 0.0:
        away += 4.0 * prior.walk * math.sin(0.5 * (facing - prior.heading)) ** 2
    return float(-0.5 * away)


@kernel
def _posterior(pose, task):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of a pose plus the logarithms of its prediction and prior; the ratio alone."""
    search, person, others, samples, table, model = task
    ratio = log_ratio(pose, person.stature_m, person.ratios, samples, table, model)
    predicted = log_prediction(pose, search.predicted, search.prior[0])
    return ratio + predicted + log_prior(pose, person, others, model), ratio


@kernel
def _choose_better(new, best, task):  # type: ignore[no-untyped-def]
    """The better of a pose and the best so far: pose, posterior, log-likelihood ratio."""
    value, ratio = _posterior(new, task)
    return (new, value, ratio) if value > best[1] else best


@kernel
def _move_along_head(pose, height_m: float, camera):  # type: ignore[no-untyped-def]
    """A pose of another height whose head is on the same ray."""
    x, y, h, facing, lean = pose
    cx, cy, cz = camera
    if cz - max(h, height_m) < 0.3:
        return x, y, height_m, facing, lean
    f = (cz - height_m) / (cz - h)
    return cx + (x - cx) * f, cy + (y - cy) * f, height_m, facing, lean


@kernel
def _turn_and_lean(pose, facing, lean):  # type: ignore[no-untyped-def]
    """A pose that faces and leans otherwise, with the shoulders where they were: half as far ahead as the head."""
    x, y, h, old_facing, old_lean = pose
    ox = 0.5 * (old_lean * math.cos(old_facing) - lean * math.cos(facing))
    oy = 0.5 * (old_lean * math.sin(old_facing) - lean * math.sin(facing))
    return x + ox, y + oy, h, facing, lean


@kernel
def _move(pose, way, far, axes):  # type: ignore[no-untyped-def]
    """A pose moved along or across the level direction of the camera's ray, up, turned, leant, or moved up along the
    head's ray."""
    x, y, h, facing, lean = pose
    camera, ax, ay = axes
    height_m = max(HEIGHT_MIN_M, min(HEIGHT_MAX_M, h + far))
    if way == FORWARD:
        return x + far * ax, y + far * ay, h, facing, lean
    if way == SIDEWARD:
        return x - far * ay, y + far * ax, h, facing, lean
    if way == UPWARD:
        return x, y, height_m, facing, lean
    if way == TURN:
        return _turn_and_lean(pose, facing + far, lean)
    if way == LEAN:
        return _turn_and_lean(pose, facing, max(0.0, min(LEAN_M, lean + far)))
    return _move_along_head(pose, height_m, camera)


@kernel
def _choose_start(pose: F64, axes, task):  # type: ignore[no-untyped-def]
    """The best of a pose, the upright one and, in masks, the sitting one; then of the postures 45 degrees apart where
    nothing is known of them, else of this one and that back to front: pose, posterior, log-likelihood ratio. Upright,
    front and back look the same."""
    search, person, _, _, table, model = task
    m = model[0]
    at = pose_tuple(pose)
    value, ratio = _posterior(at, task)
    best = at, value, ratio
    for posture in range(2 if m.masks > 0.0 else 1):
        height_m = person.stature_m * (m.sitting if posture == 1 else 1.0)
        new = at[0], at[1], height_m, at[3], at[4]
        if m.masks > 0.0:
            new = _move_along_head(best[0], height_m, axes[0])
        best = _choose_better(new, best, task)
    if len(table.cover) == 1:
        return best
    start = best[0]
    if search.prior[0].facing >= 1.0:
        return _choose_better(_turn_and_lean(start, start[3] + math.pi, start[4]), best, task)
    for lean in range(2):
        for way in range(4 << lean):
            best = _choose_better(_turn_and_lean(start, 0.25 * math.pi * way, lean * LEAN_M), best, task)
    return best


@kernel
def _climb_parabola(best, way, step, unit, axes, task, curvature):  # type: ignore[no-untyped-def]
    """A step each way and one to the top of the parabola: the best of them, and how far it is [steps' unit].

    Fills ``curvature``, that of the log-likelihood ratio there [1/m^2, 1/rad^2].
    """
    start, value, ratio = best
    up = value
    down = value
    ratio_up = ratio
    ratio_down = ratio
    far = step
    jump = 0.0
    for trial in range(3):
        if trial == 2:
            curve = up + down - 2 * value
            rise = up - down
            far = 2 * step if rise > 0 else -2 * step
            if curve < 0:
                far = max(-2 * step, min(2 * step, -0.5 * step * rise / curve))
            if abs(far) < 0.1 * step:
                break
        new = _move(start, way, far * unit, axes)
        reached, ratio_new = (value, ratio) if new == start else _posterior(new, task)
        if trial == 0:
            up = reached
            ratio_up = ratio_new
        elif trial == 1:
            down = reached
            ratio_down = ratio_new
        if reached > best[1] + 1e-6:
            best = new, reached, ratio_new
            jump = far
        far = -step
    curvature[way] = (2 * ratio - ratio_up - ratio_down) / (step * unit) ** 2
    return best, abs(jump)


@kernel
def ascend(pose: F64, curvature: F64, search, person, others, samples, table, model) -> float:  # type: ignore[no-untyped-def]
    """Ascent on the log-likelihood ratio plus the logarithms of prediction and prior, by parabolas along and across the
    ray of the main camera, in height, facing and lean and, in masks, in height along the ray of the head.

    Moves ``pose``; fills ``curvature`` (6,), that of the log-likelihood ratio there [1/m^2, 1/rad^2].

    Returns:
        The log-likelihood ratio at the end plus the logarithm of the prior of such a pose.
    """
    masks = model[0].masks > 0.0
    task = search, person, others, samples, table, model
    camera = pose[0] - 1.0, pose[1], 1e6
    ax = 1.0
    ay = 0.0
    slope = 1.0
    if samples.size[0] > 0:
        main = samples.size[1]
        camera = float(samples.rays[CX, main]), float(samples.rays[CY, main]), float(samples.rays[CZ, main])
        ax = pose[0] - camera[0]
        ay = pose[1] - camera[1]
        norm = math.sqrt(ax * ax + ay * ay)
        ax, ay = (ax / norm, ay / norm) if norm > 1e-6 else (1.0, 0.0)
        if masks:  # one step in the image, whatever the slope of the ray
            slope = min(math.sqrt(norm * norm + camera[2] ** 2) / camera[2], SLOPE_MAX)
    units = slope, 1.0, 0.5, 1.0 / LEAN_M, 1.0, 0.5
    axes = camera, ax, ay
    best = _choose_start(pose, axes, task)
    for step in search.steps:
        for again in range(MAX_TURNS):
            farthest = 0.0
            for way in (TURN, LEAN, FORWARD, SIDEWARD, UPWARD, ALONG_HEAD):
                turns = way in (TURN, LEAN)
                if (turns and (again or len(table.cover) == 1)) or (way == ALONG_HEAD and not masks):
                    continue
                best, jump = _climb_parabola(best, way, step, units[way], axes, task, curvature)
                farthest = max(farthest, jump)
            if farthest < 0.5 * step:
                break
    for i in range(5):
        pose[i] = best[0][i]
    return float(best[2] + log_prior(best[0], person, others, model))


@kernel
def explain(people, searches, order, shared: Bool, samples, table, model, fits) -> None:  # type: ignore[no-untyped-def]
    """Coordinate ascent of everybody, in an order, in two sweeps of which the second is of those who share rays; the
    third only looks.

    Moves the poses; fills ``fits`` (``Fits``), each with all others where they are at the end.

    Args:
        searches: of everybody (``Searches``).
        shared: (N, N) who may be on a ray of whom.
    """
    for sweep in range(3):
        for a in order:
            neighbours = shared[a].nonzero()[0]  # numba's flatnonzero imports scipy
            own = samples_of_person(samples, a)
            if sweep == 0 or len(neighbours):
                lay_others(own, people, neighbours, neighbours, table, model)
            person = Appearance(people.statures[a, 0], people.statures[a, 1], people.ratios[a])
            others = Others(people, neighbours)
            pose = people.poses[a]
            if sweep == 0 or (sweep == 1 and len(neighbours)):
                steps = searches.steps[max(sweep, searches.first_step[a]) :]
                search = Search(searches.predicted[a], searches.priors[a : a + 1], steps)
                fits.evidence[a] = ascend(pose, fits.curvature[a], search, person, others, own, table, model)
            if sweep == 2:
                at = pose_tuple(pose)
                fits.evidence[a] = log_ratio(at, person.stature_m, person.ratios, own, table, model)
                fits.evidence[a] += log_prior(at, person, others, model)
                any_clothes = np.ones_like(person.ratios)
                visible_patches(at, person.stature_m, any_clothes, own, table, model, fits.patches[a])
                for way in range(fits.by_facing.shape[1] if len(table.cover) > 1 else 0):
                    turned = _turn_and_lean(at, way / FACINGS_PER_RAD, 0.0)
                    ratio = log_ratio(turned, person.stature_m, person.ratios, own, table, model)
                    fits.by_facing[a, way] = ratio
