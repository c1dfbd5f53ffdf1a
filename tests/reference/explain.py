"""Plain numpy twin of the likelihood (``planview/tracking/explain/_likelihood_kernels.py``)."""

import math
from collections.abc import Sequence

import numpy as np
from toy_people import seen_body, towards

from calib.types import F64
from planview.maps.view import SURFACE, UNKNOWN, PixelRays, View
from planview.tracking import body
from planview.tracking.human_model.explanation import MaskExplanation
from planview.tracking.joint import ranges as given
from planview.tracking.joint.ranges import JointParams

Poses = Sequence[tuple[float, ...]]


def log_likelihood(seen: View, people: Poses, p: JointParams, reaching: Poses) -> float:
    """Sum of log L_p over all pixels, without weights and colours; ``people`` are certain, ``reaching`` have arms."""
    bodies = [seen_body(seen.rays, person) for person in people]
    camera, direction = seen.rays.centre_m, towards(seen.rays)
    total = 0.0
    for row in range(seen.kind.shape[0]):
        for col in range(seen.kind.shape[1]):
            kind, z = int(seen.kind[row, col]), float(seen.range_m[row, col])
            if kind == UNKNOWN:
                continue
            stretch = float(seen.rays.stretch[row, col])
            std = p.disparity_std_px / seen.rays.disparity_metre / stretch
            point = camera + z * direction[row, col]
            near = any(math.dist(point[:2], person[:2]) < body.REACH_M for person in reaching) and kind == SURFACE
            layers = sorted((float(at[row, col]), float(cover[row, col])) for cover, at in bodies)
            passing, value = 1.0, 0.0
            for at, cover in layers:
                if cover < 0.01 or camera[2] + at * direction[row, col, 2] < 0.0:
                    continue
                value += passing * cover * _of_body(kind, z, at, std)
                passing *= 1.0 - cover
            value += passing * _of_background(kind, near, p, body.REACH_M)
            if kind == SURFACE:
                value = (1 - given.UNKNOWN_SHARE) * value + given.UNKNOWN_SHARE / given.RANGE_M
            total += math.log(value)
    return total


def _of_body(kind: int, z: float, at: float, std: float) -> float:
    if kind == 0:
        return 1.0 - given.SEEN_ON_BODY
    if kind == 2:
        return given.SEEN_ON_BODY * given.NO_DEPTH_SHARE
    var = body.SURFACE_STD_M**2 + (std * z * z) ** 2
    normal = math.exp(-0.5 * (z - at) ** 2 / var) / math.sqrt(2 * math.pi * var)
    density = (1 - given.OUTLIERS) * normal + given.OUTLIERS / given.RANGE_M
    return given.SEEN_ON_BODY * (1 - given.NO_DEPTH_SHARE) * density


def _of_background(kind: int, near: bool, p: JointParams, reach_m: float) -> float:
    if kind == 0:
        return 1.0 - given.SEEN_ON_BACKGROUND
    share = p.seen_near_people if near else given.SEEN_ON_BACKGROUND
    if kind == 2:
        return 0.5 * given.SEEN_ON_BACKGROUND
    return 0.5 * share / (2 * reach_m if near else given.RANGE_M)


def patches_of(seen: View, per_patch: float) -> F64:
    """(N,) patches that every pixel of surface is."""
    surface = seen.kind == SURFACE
    return (seen.range_m[surface] / seen.rays.stretch[surface]).astype(np.float64) ** 2 * per_patch


def log_likelihood_of_mask(frame: MaskExplanation, people: Poses, reaching: Poses, tall_m: float) -> float:
    """Sum of log L_p over all pixels of a mask; ``people`` are certain and ``tall_m`` when upright."""
    m, table, rays = frame.likelihood.model[0], frame.likelihood.table, frame.views[0].rays
    direction = towards(rays)
    bodies = [(*seen_body(rays, person, table), person[2]) for person in people]
    total = 0.0
    for row, col in np.argwhere(frame.kind < UNKNOWN).tolist():
        seen = frame.kind[row, col] == 1
        near = any(_reaches(rays, person, row, col, m["reach_m"]) for person in reaching)
        passing, value = 1.0, 0.0
        for at, cover, height in sorted((float(at[row, col]), float(cover[row, col]), h) for cover, at, h in bodies):
            z = (rays.centre_m[2] + at * float(direction[row, col, 2])) / height
            if cover < 0.005 or z < 0.0:
                continue
            sits = height < m["sitting_from"] * tall_m
            hidden = (m["hidden_sitting"] if sits else m["hidden"]) if z < m["hidden_to"] else 0.0
            shown = (1 - hidden) * m["body"] + hidden * m["background"]
            value += passing * cover * (shown if seen else 1 - shown)
            passing *= 1.0 - cover
        ground = m["near_people"] if near else m["background"]
        total += math.log(value + passing * (ground if seen else 1 - m["background"]))
    return total


def _reaches(rays: PixelRays, pose: tuple[float, ...], row: int, col: int, reach_m: float) -> bool:
    """Whether a ray passes a body's axis within reach, between the floor and the head."""
    ex, ey, flat, sin = rays.level[row, col, :4].tolist()
    dx, dy = pose[0] - rays.centre_m[0], pose[1] - rays.centre_m[1]
    at = (dx * ex + dy * ey) * flat - (0.5 * pose[2] - rays.centre_m[2]) * sin
    z = rays.centre_m[2] - at * sin
    return abs(dy * ex - dx * ey) < reach_m and -0.1 < z < pose[2] + 0.2
