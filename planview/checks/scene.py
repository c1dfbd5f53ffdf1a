"""Checks of what is seen: floor, disparities and the height of people."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, F64, Bool
from planview.checks.check import Check, at_least, at_most, between
from planview.checks.recording import Evidence
from planview.foreground.blobs import find_blobs
from planview.maps.grid import GridParams
from stereo.depth import DepthFromDisparity, RectifiedGeometry, back_project, median_image

TOLERANCE = 0.08
"""A known height must be met within this share: 5 cm of noise and shoes, and some error of the floor."""
POSSIBLE_M, LIKELY_M = (0.4, 2.3), (1.4, 2.0)
"""Heights of moving things that can be people, and of standing adults, whom a usual recording shows [m]."""


def height_check(heights: F64, person_height_m: float | None = None) -> Check:
    """Measured (N,) heights [m] of people against the known one, or against what people can be."""
    # Cut by the image's edge or half hidden, people look smaller, never taller.
    value = float(np.percentile(heights, 75)) if len(heights) >= 3 else math.nan
    if person_height_m is None:
        # Heights of moving things when no person's height is known: a pushed chair or box to a tall man in a hat.
        if not math.isfinite(value) or not POSSIBLE_M[0] <= value <= POSSIBLE_M[1]:
            return between("person height", value, POSSIBLE_M, "m", "of moving people; no known height was given")
        causes = "a wrong focal length, baseline or unit of length in the calibration, or no standing adults"
        inside = LIKELY_M[0] <= value <= LIKELY_M[1]
        note = "of moving people; no known height was given" if inside else f"likely {causes}"
        return between("person height", value, LIKELY_M, "m", note, warns=True)
    limits = (person_height_m * (1 - TOLERANCE), person_height_m * (1 + TOLERANCE))
    note = f"known to be {person_height_m:g} m" if math.isfinite(value) else "no person was found to measure"
    return between("person height", value, limits, "m", f"{note}: baseline and units", needed=True)


def person_heights(evidence: Evidence) -> F64:
    """(N,) heights [m] of things that stand out of the background, one per thing and frame."""
    if evidence.floor is None:
        return np.empty(0)
    geometry = evidence.rectifier.geometry
    background = median_image(evidence.disparities)
    to_depth, found = DepthFromDisparity(geometry), []
    for disparity in evidence.disparities:
        depth = to_depth(disparity)
        above = heights_above_floor(back_project(depth, geometry), evidence.floor.world_SE3_left)
        # Disparity by which something must be nearer than the background to stand out of it: four deviations.
        found.append(standing_things(above, depth, disparity - background > 1.0))
    return large_heights(np.concatenate(found))


def large_heights(things: F64) -> F64:
    """Heights [m] of those (N, 2) ``standing_things`` that are no shreds."""
    if len(things) == 0:
        return np.empty(0)
    # Things with less than this part of the surface of the largest ones are shreds, not people.
    large = things[:, 1] >= 0.4 * np.percentile(things[:, 1], 90)
    return np.asarray(things[large, 0], dtype=np.float64)


def heights_above_floor(points: F32, world_SE3_left: SE3) -> F32:
    """(H, W) heights [m] of (H, W, 3) points of the rectified left camera."""
    z = world_SE3_left.rotation[2].astype(np.float32)
    return np.asarray(points @ z + np.float32(world_SE3_left.translation[2]), dtype=np.float32)


def standing_things(above: F32, depth: F32, moved: Bool) -> F64:
    """(N, 2) height [m] and surface (in units that all things share) of what stands out of the background, from (H, W)
    heights above the floor and depth [m], NaN where unknown, and (H, W) whether a pixel moved."""
    stands_out = moved & (above > 0.25)  # [m]
    mask = cv2.morphologyEx(stands_out.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    blobs = find_blobs(np.asarray(mask, dtype=np.uint8))
    surface = depth * depth
    # Share of the picture that a person takes: at 8 m some 0.2 %. Not an area in metres, which would hide wrong
    # units.
    min_px, max_px = (share * mask.size for share in (0.001, 0.25))
    found = []
    for label in range(1, len(blobs)):
        # At the upper edge of the image a head may be outside.
        if blobs.box_px[label, 1] > 2 and min_px <= blobs.area_px[label] <= max_px:
            of_it = (blobs.labels == label) & np.isfinite(above)
            # Percentile of a person's points used as the top of the head: single points above it are wrong matches.
            found.append((float(np.percentile(above[of_it], 98.0)), float(surface[of_it].sum())))
    return np.array(found, dtype=np.float64).reshape(-1, 2)


MIN_VALID = 0.35
"""Share of pixels with a disparity; bare walls and saturated floors have none, people must (our choice)."""
MAX_DEPTH = {2.0: 0.15, 4.0: 0.5, 8.0: math.inf}
"""Predicted depth deviation at a distance [m]: at 4 m half a metre is a person's width (our choice)."""
CAMERA_HEIGHTS_M = (1.2, 10.0)
"""Heights of a camera above the floor from which people are tracked [m]."""


def scene_checks(evidence: Evidence) -> list[Check]:
    """Share of valid disparity, floor share, flatness and height, depth and cell error at 2, 4 and 8 m."""
    inside = evidence.rectifier.mask > 0
    shares = [float(np.mean(np.isfinite(d[inside]))) for d in evidence.disparities]
    return [
        at_least("valid disparity", float(np.median(shares)), MIN_VALID, "", "share of the picture, median frame"),
        *floor_checks(evidence.floor, evidence.floor_refused),
        *depth_checks(evidence.rectifier.geometry),
    ]


def floor_checks(floor: Floor | None, refused: str = "") -> list[Check]:
    """Share, flatness and distance of the floor (None: ``refused`` gives the reason), and a warning where it may be a
    wall."""
    share, height_m = (floor.inlier_fraction, floor.height_m) if floor else (math.nan, math.nan)
    why = "share of valid depth that lies on it" if floor else refused
    checks = [
        # Share of valid depth on the floor (our choice: a hand's breadth of floor between furniture still shows it).
        at_least("floor share", share, 0.10, "", why, needed=floor is None),
        # Deviation of floor points from the plane [m]: with more, a foot looks like a shadow (our choice).
        at_most("floor flatness", floor.residual_m if floor else math.nan, 0.12, "m", "rms from the plane"),
        between("camera height", height_m, CAMERA_HEIGHTS_M, "m", "of the (left) camera above it"),
    ]
    if floor and floor.doubt:
        checks.append(Check("floor or wall", False, math.degrees(floor.tilt_rad), "deg", note=floor.doubt, warns=True))
    return checks


def depth_checks(geometry: RectifiedGeometry) -> list[Check]:
    """Predicted deviation of depth, and of a point's place in cells of the plan-view map, at 2, 4 and 8 m."""
    checks = []
    cell_m = GridParams().cell_m
    cells_of = f"cells of {cell_m * 100:g} cm"
    for distance, most in MAX_DEPTH.items():
        deviation = geometry.depth_std_m(distance)
        name, note = f"depth error at {distance:g} m", "predicted standard deviation"
        limited = at_most(name, deviation, most, "m", note)
        checks.append(limited if math.isfinite(most) else Check(name, True, deviation, "m", note=note))
        across = distance / geometry.focal_u_px * geometry.disparity_std_px
        cells = math.hypot(deviation, across) / cell_m
        checks.append(Check(f"cell error at {distance:g} m", True, cells, "cells", note=cells_of))
    return checks
