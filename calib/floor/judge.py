"""Which of several planes is the floor: what speaks for and against each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.floor.params import FloorParams
from calib.floor.plane_fit import Plane, Rays
from calib.types import F64, I64, Bool

PARALLEL_DEG = 10.0
"""Normals closer than this are one direction: a small plane's own is known to a few degrees only."""
MIN_MOVED = 500
"""Points that must have moved before they speak against a plane: a fifth of a person in a few frames."""
LEANING_DEG = -5.0
"""Below this tilt a camera leans backwards; an overhead mount is off by a few degrees."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A plane and what speaks for and against it.

    Attributes:
        plane: fitted plane.
        inlier_fraction: share of the points on it.
        below_fraction: share of the points beneath it.
        refused: why it cannot be the floor; empty when it can.
    """

    plane: Plane
    inlier_fraction: float
    below_fraction: float
    refused: str


def _sharpness(plane: Plane, points: Rays, params: FloorParams) -> float:
    """How points crowd on a plane before any median: share of those near it that are within half that distance."""
    gate = params.frame_noise * params.inlier_sigmas
    distance = np.abs(points.residuals(plane.q))
    return float((distance < gate / 2).sum() / max((distance < gate).sum(), 1))


def judge(plane: Plane, view: Rays, counts: I64, points: Rays, moved: F64, params: FloorParams) -> Candidate:
    """What speaks for and against a plane as the floor.

    Args:
        plane: fitted plane.
        view, counts: cells of the view and how many points are in each.
        points: the points themselves, before any median.
        moved: (M, 3) points of what moves, in the camera's frame [m].
        params: what counts as a floor.
    """
    residuals = view.residuals(plane.q)
    share = counts / counts.sum()
    on = float(share[np.abs(residuals) < params.inlier_sigmas].sum())
    below = float(share[_beneath(plane, view, params)].sum())
    above = float(share[(residuals > params.inlier_sigmas) & (residuals < 2 * params.inlier_sigmas)].sum())
    tilt, roll = math.degrees(plane.tilt_rad), math.degrees(plane.roll_rad)
    height = plane.distance_m
    refused = ""
    if not params.min_tilt_deg <= tilt <= params.max_tilt_deg or abs(roll) > params.max_roll_deg:
        refused = f"a wall or ceiling (tilt {tilt:.0f}, roll {roll:.0f} degrees)"
    elif not params.min_height_m <= height <= params.max_height_m:
        refused = f"{height:.2f} m from the camera (floors: {params.min_height_m:g}-{params.max_height_m:g} m)"
    elif on < params.min_inlier_fraction:
        refused = f"{on:.1%} of the depth lies on it (at least {params.min_inlier_fraction:.0%} needed)"
    elif below > params.max_below_fraction * (on + below):
        refused = f"{below:.0%} of the depth lies beneath it"
    elif above > params.max_blur_fraction * on or _sharpness(plane, points, params) < params.min_sharpness:
        refused = "it only cuts through a surface that is not flat"
    elif (high := _above_people(plane, moved, params)) > params.max_high_fraction:
        refused = f"{high:.0%} of what moves is higher than people above it"
    return Candidate(plane, on, below, refused)


def _above_people(plane: Plane, moved: F64, params: FloorParams) -> float:
    """Share of what moves that is higher above a plane than people are, 0 where hardly anything moves.

    A wall seen straight on looks like a floor from above, but people walk metres in front of it.
    """
    if len(moved) < MIN_MOVED:
        return 0.0
    return float(np.mean(moved @ plane.normal + plane.distance_m > params.people_m))


def _beneath(plane: Plane, view: Rays, params: FloorParams) -> Bool:
    """(N,) whether points are further beneath the plane than noise and a warped calibration explain."""
    depth_m = np.where(view.inverse > 0, (view.rays @ plane.q) / np.maximum(view.inverse, 1e-6) - 1.0, 0.0)
    far = depth_m * plane.distance_m > params.below_margin_m
    return np.asarray(far & (view.residuals(plane.q) < -params.inlier_sigmas))


def choose_floor(candidates: Sequence[Candidate], params: FloorParams) -> Candidate | None:
    """The floor among planes: the largest that a camera can stand above, and of parallel ones the lowest.

    A camera near the horizontal sees the wall in front as a camera leaning backwards sees its floor. Where both
    readings are open the upright camera is the likelier, so a plane that asks for leaning back gives way.
    """
    possible = [c for c in candidates if not c.refused]
    upright = [c for c in possible if c.plane.tilt_rad > math.radians(LEANING_DEG)]
    possible = upright or possible
    if not possible:
        return None
    largest = max(possible, key=lambda c: c.inlier_fraction)
    enough = largest.inlier_fraction * params.max_below_fraction / (1.0 - params.max_below_fraction)
    parallel = [
        c
        for c in possible
        if c.inlier_fraction >= enough
        and float(c.plane.normal @ largest.plane.normal) > math.cos(math.radians(PARALLEL_DEG))
    ]
    return max(parallel, key=lambda c: c.plane.distance_m)


def nothing_found(candidates: Sequence[Candidate], n_frames: int, params: FloorParams) -> str:
    """Why none of the planes is the floor, in a sentence."""
    if not candidates:
        return (
            f"no floor found in {n_frames} frames: no plane holds even "
            f"{0.5 * params.min_inlier_fraction:.1%} of the valid depth"
        )
    largest = "; ".join(
        f"plane with {c.inlier_fraction:.0%} of the depth: {c.refused}"
        for c in sorted(candidates, key=lambda c: -c.inlier_fraction)[:3]
    )
    return f"no floor found in {n_frames} frames ({largest})"
