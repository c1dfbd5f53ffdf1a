"""Checks of a stereo pair: rows, order of the cameras, pose, exposure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calib.images import as_grey
from calib.types import F64, U8
from planview.checks.check import Check, at_least, at_most
from stereo.recording import StereoFrame
from stereo.rectify import Rectifier
from stereo.rig_correction import RigCorrection, fit_correction

MIN_MATCHES = 60
"""Fewest corners found in both images on which the geometry is judged."""


def alignment_checks(plain: Rectifier, matches: F64, correction: RigCorrection) -> list[Check]:
    """Row offset and what turn of a camera explains it, left-right order and mirrored pose, from the rectifier of the
    calibration as it is, (N, 4) matches in its images (``match_corners``), whose rows may be far off, and the
    correction that a run makes."""
    enough = len(matches) >= MIN_MATCHES
    offset = float(np.median(np.abs(matches[:, 3]))) * 640.0 / plain.geometry.width if enough else math.nan
    positive = float(np.mean(matches[:, 0] - matches[:, 2] > -0.5)) if enough else math.nan
    turn = fit_correction(matches, plain.geometry)
    turned_deg = math.degrees(float(np.linalg.norm(turn.applied))) if enough else math.nan
    return [
        at_least("matched corners", float(len(matches)), MIN_MATCHES, "", "corners that both cameras show"),
        # Share of corners whose right place is to the left of the left one; far corners may err by calibration.
        at_least("left-right order", positive, 0.8, "", "share of corners nearer than infinity"),
        # Row offset of the calibration as it is [px of 640]: a factory calibration after some years has up to 0.5. A
        # run takes out the turn that explains it, but a rig that moved this far is better calibrated again.
        at_most("row offset", offset, 1.5, "px", "median, of 640 px, before the rig is corrected"),
        # Rotation of the right camera since calibration: half a degree of pan shifts disparities by 3.5 px of 640, or
        # 15 % of the depth at 2 m; a worn factory calibration has up to 0.2.
        at_most("camera turn", turned_deg, 0.5, "deg", f"right camera since calibration; {correction}"),
        # Row offset that is left [px]: block matching loses half of its matches beyond (our choice).
        at_most("row residual", correction.after_px, 0.5, "px", "median, after the rig is corrected"),
        # A good pose has a smaller error than its mirror images.
        at_most("mirrored pose", mirror_ratio(plain, matches), 1.5, "", "row error of the pose over its mirror image"),
    ]


def mirror_ratio(rectifier: Rectifier, matches: F64) -> float:
    """Epipolar error of the calibrated pose over that of its mirror images; NaN when the pose hardly turns.

    Planar targets allow two poses, and extrinsics written the wrong way round are the inverse of the right ones: both
    have the same translation axis and the inverse rotation, and pass for a calibration with a low reprojection error.
    """
    pose = rectifier.rig.right_SE3_left
    turn = math.degrees(pose.angle_rad)
    # Poses with less rotation look the same mirrored.
    if len(matches) < MIN_MATCHES or turn < 0.3:
        return math.nan
    # (N, 3) unit rays in the recorded cameras.
    u, v, right_u, offset = matches.T
    rays = [
        rectifier.geometry.rays(np.column_stack(place)) @ rotation
        for place, rotation in zip(((u, v), (right_u, v + offset)), rectifier.rig.rectifying_rotations(), strict=True)
    ]
    left, right = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    own = epipolar_error(left, right, pose.rotation, pose.translation)
    mirrored = [(pose.rotation.T, -pose.rotation.T @ pose.translation), (pose.rotation.T, pose.translation)]
    other = min(epipolar_error(left, right, rotation, translation) for rotation, translation in mirrored)
    return own / max(other, 1e-6)


def epipolar_error(left: F64, right: F64, rotation: F64, translation: F64) -> float:
    """Median angle [rad] between (N, 3) unit right rays and the planes through the baseline and the left rays."""
    normals = np.cross(translation, left @ rotation.T)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return float(np.median(np.abs(np.sum(normals * right, axis=1))))


SATURATED_LEVEL = 250
"""Grey levels from here on hold no texture (as in the matcher)."""
BLOCK_PX = 8
"""Side of the blocks that JPEG, MPEG and H.264 transform."""


def image_checks(frames: Sequence[StereoFrame]) -> list[Check]:
    """Over-exposure, under-exposure, brightness of left against right, and compression, of frames as recorded."""
    sides = [as_grey(f.left) for f in frames], [as_grey(f.right) for f in frames]
    levels = [float(np.median([np.mean(i[::4, ::4]) for i in side])) + 1.0 for side in sides]
    ratio = max(levels) / min(levels)
    blocks = max(float(np.median([blocking(i) for i in side])) for side in sides)
    return [
        *light_checks(*sides),
        # Ratio of the cameras' median brightness; block matching bears small differences only (our choice).
        at_most("brightness match", ratio, 2.0, "", "mean brightness of one camera over the other"),
        # Grey steps at the borders of blocks over those inside, which match at the same place in both cameras and
        # pull disparities there. Images as recorded have 0.7 to 1.3, JPEG of quality 10 has 5 and loses the floor
        # (our choice).
        at_most("compression", blocks, 2.0, "", "grey steps at the borders of 8x8 blocks over those inside"),
    ]


def light_checks(*cameras: Sequence[U8]) -> list[Check]:
    """Over-exposure and under-exposure, from images of each camera."""
    sides = [[as_grey(image) for image in images] for images in cameras]
    over = max(float(np.median([np.mean(i[::2, ::2] >= SATURATED_LEVEL) for i in side])) for side in sides)
    bright = min(float(np.median([np.percentile(i[::2, ::2], 90) for i in side])) for side in sides)
    return [
        # Share of saturated pixels that leaves enough to see people by; a sunny terrace has up to a quarter (our
        # choice).
        at_most("over-exposure", over, 0.35, "", "share of saturated pixels in the worse camera", warns=True),
        # The brightest tenth of a picture must reach this grey level: below, sensor noise is a good part of any
        # texture.
        at_least("under-exposure", bright, 40.0, "grey", "brightest tenth of the picture, darker camera"),
    ]


def blocking(image: U8) -> float:
    """Mean grey step along the rows of a (H, W) image across the borders of blocks, over that inside of them."""
    steps = np.abs(np.diff(image[::4].astype(np.int16), axis=1)).mean(axis=0)
    border = np.arange(len(steps)) % BLOCK_PX == BLOCK_PX - 1
    return float(steps[border].mean() / max(float(steps[~border].mean()), 1e-3)) if border.any() else np.nan
