"""Heights of people, which check baseline, focal length and units."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.pose import SE3
from calib.rig import Floor
from calib.types import F32, F64, Bool
from planview.checks.check import Check, limit_check
from planview.foreground.ghosts import find_blobs
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.floor import DepthFrames, PairFrames

HEIGHT_TOLERANCE = 0.08
"""A known height must be met within this share: 5 cm of noise and shoes, and some error of the floor."""
POSSIBLE_M = (0.4, 2.3)
"""Heights of moving things when no person's height is known: a pushed chair or box to a tall man in a hat [m]."""
LIKELY_M = (1.5, 1.95)
"""Heights of standing adults, whom a usual recording shows [m]."""
PERSON_SHARE = (0.001, 0.25)
"""Share of the picture that a person takes: at 8 m some 0.2 %. Not an area in metres, which would hide wrong units."""
STANDS_OUT_M = 0.25


def height_check(heights_m: F64, person_height_m: float | None = None) -> Check:
    """Measured (N,) heights [m] of people against the known one, or against what people can be."""
    # Cut by the image's edge or half hidden, people look smaller, never taller.
    height_m = float(np.percentile(heights_m, 75)) if len(heights_m) >= 3 else math.nan
    if person_height_m is not None:
        note = f"known to be {person_height_m:g} m" if math.isfinite(height_m) else "no person was found to measure"
        least = person_height_m * (1 - HEIGHT_TOLERANCE)
        most = person_height_m * (1 + HEIGHT_TOLERANCE)
        note += ": baseline and units"
        return limit_check("person height", height_m, "m", note, least=least, most=most, needed=True)
    note = "of moving people; no known height was given"
    if not POSSIBLE_M[0] <= height_m <= POSSIBLE_M[1]:
        return limit_check("person height", height_m, "m", note, least=POSSIBLE_M[0], most=POSSIBLE_M[1])
    if not LIKELY_M[0] <= height_m <= LIKELY_M[1]:
        note = "likely a wrong focal length, baseline or unit of length in the calibration, or no standing adults"
    return limit_check("person height", height_m, "m", note, least=LIKELY_M[0], most=LIKELY_M[1], warns=True)


def person_heights(seen: PairFrames | DepthFrames, floor: Floor | None) -> F64:
    """(N,) heights [m] of things that stand out of the background, one per thing and frame."""
    if floor is None:
        return np.empty(0)
    background = median_image(seen.disparities)
    things = []
    for disparity in seen.disparities:
        # Nearer than the background by four deviations of disparity.
        moved = disparity - background > 1.0
        things.append(standing_things(disparity, moved, seen.rectifier.geometry, floor))
    return large_heights(np.concatenate(things))


def large_heights(things: F64) -> F64:
    """Heights [m] of those (N, 2) ``standing_things`` that are no shreds."""
    if len(things) == 0:
        return np.empty(0)
    # Things with less than this part of the surface of the largest ones are shreds, not people.
    is_large = things[:, 1] >= 0.4 * np.percentile(things[:, 1], 90)
    return np.asarray(things[is_large, 0], dtype=np.float64)


def heights_above_floor(points: F32, world_SE3_left: SE3) -> F32:
    """(H, W) heights [m] of (H, W, 3) points of the rectified left camera."""
    z = world_SE3_left.rotation[2].astype(np.float32)
    return np.asarray(points @ z + np.float32(world_SE3_left.translation[2]), dtype=np.float32)


def standing_things(disparity: F32, moved: Bool, geometry: RectifiedGeometry, floor: Floor, step: int = 1) -> F64:
    """(N, 2) height [m] and surface (in units that all things share) of what stands out of the background, from the
    (H, W) disparity of samples of step x step pixels, NaN where unknown, and whether a sample moved."""
    depth = geometry.depth(disparity)
    above = heights_above_floor(back_project(depth, geometry, step), floor.world_SE3_left)
    stands_out = (moved & (above > STANDS_OUT_M)).astype(np.uint8)
    mask = np.asarray(cv2.morphologyEx(stands_out, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    blobs = find_blobs(mask)
    share = blobs.area_px / mask.size
    # At the upper edge of the image the top of a person may be outside.
    are_people = (blobs.box_px[:, 1] > 2) & (share >= PERSON_SHARE[0]) & (share <= PERSON_SHARE[1])
    surface = depth * depth
    things = []
    for label in np.flatnonzero(are_people):
        if label > 0:  # the background
            shows = (blobs.labels == label) & np.isfinite(above)
            # The percentile of a person's points that is their top: single points above it are wrong matches.
            things.append((float(np.percentile(above[shows], 98.0)), float(surface[shows].sum())))
    return np.array(things, dtype=np.float64).reshape(-1, 2)
