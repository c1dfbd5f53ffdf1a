"""Plain numpy twin of the joint tracker's likelihood (``planview/tracking/joint/_kernels.py``)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from toy_people import seen_body

from calib.types import F64
from planview.maps.pixels import SURFACE, SeenPixels
from planview.tracking import body
from planview.tracking.joint import explanation as given
from planview.tracking.joint.params import JointParams

Poses = Sequence[tuple[float, float, float]]


def log_likelihood(seen: SeenPixels, people: Poses, p: JointParams, reaching: Poses) -> float:
    """Sum of log L_p over all pixels, without weights and colours; ``people`` are certain, ``reaching`` have arms."""
    bodies = [seen_body(seen.rays, person) for person in people]
    camera = seen.rays.centre_m
    total = 0.0
    for row in range(seen.kind.shape[0]):
        for col in range(seen.kind.shape[1]):
            kind, z = int(seen.kind[row, col]), float(seen.range_m[row, col])
            stretch = float(seen.rays.stretch[row, col])
            std = p.disparity_std_px / seen.rays.disparity_metre / stretch
            point = camera + z * seen.rays.direction[row, col]
            near = any(math.dist(point[:2], person[:2]) < body.REACH_M for person in reaching) and kind == SURFACE
            layers = sorted((float(at[row, col]), float(cover[row, col])) for cover, at in bodies)
            passing, value = 1.0, 0.0
            for at, cover in layers:
                if cover < 0.01:
                    continue
                value += passing * cover * _of_body(kind, z, at, std)
                passing *= 1.0 - cover
            value += passing * _of_background(kind, near, p, body.REACH_M)
            if kind == SURFACE:
                value = (1 - given.UNKNOWN) * value + given.UNKNOWN / given.RANGE_M
            total += math.log(value)
    return total


def _of_body(kind: int, z: float, at: float, std: float) -> float:
    if kind == 0:
        return 1.0 - given.SEEN_ON_BODY
    if kind == 2:
        return given.SEEN_ON_BODY * given.NO_DEPTH
    var = given.SURFACE_STD_M**2 + (std * at * at) ** 2
    normal = math.exp(-0.5 * (z - at) ** 2 / var) / math.sqrt(2 * math.pi * var)
    return given.SEEN_ON_BODY * (1 - given.NO_DEPTH) * ((1 - given.OUTLIERS) * normal + given.OUTLIERS / given.RANGE_M)


def _of_background(kind: int, near: bool, p: JointParams, reach_m: float) -> float:
    if kind == 0:
        return 1.0 - given.SEEN_ON_BACKGROUND
    share = p.seen_near_people if near else given.SEEN_ON_BACKGROUND
    if kind == 2:
        return 0.5 * given.SEEN_ON_BACKGROUND
    return 0.5 * share / (2 * reach_m if near else given.RANGE_M)


def surface_points(seen: SeenPixels, per_patch: float) -> tuple[F64, F64]:
    """(3, N) places of every pixel of surface and (N,) patches that they are."""
    row, col = np.nonzero(seen.kind == SURFACE)
    far = seen.range_m[row, col].astype(np.float64)
    xyz = seen.rays.centre_m + far[:, None] * seen.rays.direction[row, col]
    return xyz.T, (far / seen.rays.stretch[row, col]) ** 2 * per_patch
