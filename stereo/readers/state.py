"""The state of the images of two cameras: which is the left one, and whether they are rectified already."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from calib.camera import Camera
from calib.images import as_grey
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8
from stereo.rig_correction import match_corners

NEARER_SHARE = 0.8
"""Share of corners nearer than infinity of views in their right order; of swapped ones nearly none is."""
ROWS_PX = 1.5
"""Median row offset [px of 640] up to which rows count as aligned (a worn factory calibration has 0.6)."""


class Order(NamedTuple):
    """What the corners show: whether the first view is the right camera's, whether the views are rectified already, and
    the share of corners nearer than infinity then."""

    swapped: bool
    rectified: bool
    nearer: float


def find_order(matches: F64, rig: StereoRig, rectified: StereoRig) -> Order | None:
    """The order and the calibration under which corners lie nearer than infinity and on their rows.

    The one that fits best, what is usual first; None when there are too few corners, or none fits.

    Args:
        matches: (N, 4) float64 [px], u, v in the first view and u, v in the second.
        rig: of the views as the cameras took them; ``rectified``: when they are rectified.
    """
    if len(matches) < 40:
        return None
    fits = []
    for is_rectified, swapped in product((False, True), repeat=2):
        nearer, rows_px = _fit(matches, rectified if is_rectified else rig, swapped)
        if nearer >= NEARER_SHARE and rows_px <= ROWS_PX:
            # What is usual counts unless the rows agree twice as well.
            fits.append((rows_px * (2.0 if is_rectified else 1.0), Order(swapped, is_rectified, nearer)))
    return min(fits, key=lambda fit: fit[0])[1] if fits else None


def _fit(matches: F64, rig: StereoRig, swapped: bool = False) -> tuple[float, float]:
    """Share of corners nearer than infinity, and median row offset [px of 640]; 0 and infinite where none is seen."""
    pixels = (matches[:, 2:], matches[:, :2]) if swapped else (matches[:, :2], matches[:, 2:])
    cameras = zip((rig.left, rig.right), pixels, rig.rectifying_rotations(), strict=True)
    first, second = (camera.unproject(own) @ rotation.T for camera, own, rotation in cameras)
    offsets = (first[:, :2] / first[:, 2:] - second[:, :2] / second[:, 2:]) * rig.left.fx * 640.0 / rig.left.width
    across, down = offsets[np.isfinite(offsets).all(axis=1)].T
    return (float(np.mean(across > -0.5)), float(np.median(np.abs(down)))) if len(across) else (0.0, np.inf)


def rectified_rig(load: Callable[[], StereoRig], rig: StereoRig) -> tuple[StereoRig, str]:
    """The calibration of rectified images: from the file (``load`` gives that, or its other one when it holds none),
    else as OpenCV computes it; and what was assumed, empty when the file gives it."""
    held = rig if is_ideal(rig) else load()
    if is_ideal(held):
        return held, ""
    pose, size = rig.right_SE3_left, rig.left.size
    (k1, d1), (k2, d2) = ((one.matrix, one.coefficients) for one in (rig.left, rig.right))
    turn, shift_column = pose.rotation, pose.translation.reshape(3, 1)
    if "fisheye" in (rig.left.model, rig.right.model):
        _, _, *projections, _ = cv2.fisheye.stereoRectify(k1, d1, k2, d2, size, turn, shift_column, 0)
    else:
        _, _, *projections, _, _, _ = cv2.stereoRectify(k1, d1, k2, d2, size, turn, shift_column, alpha=0.0)
    left, right = (Camera(*size, float(p[0, 0]), float(p[1, 1]), float(p[0, 2]), float(p[1, 2])) for p in projections)
    shift = np.array([-rig.baseline_m, 0.0, 0.0])
    ideal = StereoRig(left, right, SE3(np.eye(3), shift), f"{rig.source} [rectified images]")
    return ideal, f"their focal length is taken as {left.fx:.1f} px, as OpenCV's stereoRectify gives it for alpha 0"


def is_ideal(rig: StereoRig) -> bool:
    """Whether a rig is that of rectified images: no distortion, no rotation."""
    turned = float(np.abs(rig.right_SE3_left.rotation - np.eye(3)).max())
    return turned < 1e-9 and not any(np.any(one.coefficients) for one in (rig.left, rig.right))


def settled(pairs: Iterable[tuple[U8, U8]], rig: StereoRig, other: StereoRig, how: str) -> tuple[StereoRig, str]:
    """The rig of the images' own state, and a note where that is not the one that was expected.

    Args:
        pairs: some of the recording.
        rig: as expected, of raw images, or of rectified ones (``is_ideal``).
        other: of the other state, if the calibration gives it, else the same; ``how``: what it assumes, for the note.
    """
    matches = common(pairs).matches
    if len(matches) < 40:
        return rig, ""
    (_, own_px), (nearer, other_px) = _fit(matches, rig), _fit(matches, other)
    if nearer >= NEARER_SHARE and other_px <= ROWS_PX and other_px < 0.5 * own_px:
        state = "rectified already" if is_ideal(other) else "not rectified, whatever their topics are called"
        rows = f"rows differ by {other_px:.1f} px, else by {own_px:.1f}"
        return other, f"the images are {state} ({rows})" + (f"; {how}" if how else "")
    if is_ideal(rig) and own_px > ROWS_PX:
        rows = f"rows differ by {own_px:.1f} px under a calibration of rectified images"
        return rig, f"{rows}: raw images need the raw calibration"
    return rig, ""


class Common(NamedTuple):
    """What the two views of some pairs have in common: the number of corners, and (N, 4) float64 matches of them [px of
    the view as it is given], u, v in the first view, u, v in the second."""

    corners: int = 0
    matches: F64 = np.empty((0, 4))


def common(pairs: Iterable[tuple[U8, U8]]) -> Common:
    """Match corners between the two views of each pair."""
    corners, found = 0, [np.empty((0, 4))]
    # Rows of unrectified cameras may be 24 of 320 px apart.
    features, search_px = 150, 24
    for pair in pairs:
        first, second = map(as_grey, pair)
        height, width = first.shape
        scale = width / min(width, 320)
        size = round(width / scale), round(height / scale)
        a, b = (np.asarray(cv2.resize(v, size, interpolation=cv2.INTER_AREA), np.uint8) for v in (first, second))
        points = cv2.goodFeaturesToTrack(a, features, 0.01, 14.0)
        corners += 0 if points is None else len(points)
        reach = 0.3 * a.shape[1]  # largest disparity, each way
        matches = match_corners(a, b, reach, -reach, features=features, search_px=search_px)
        if len(matches):
            # Matches of one pair of cameras lie about on one row offset [px of 320].
            near = np.abs(matches[:, 3] - np.median(matches[:, 3])) <= 4.0
            u, v, u_second, offset = matches[near].T
            found.append(np.column_stack([u, v, u_second, v + offset]) * scale)
    return Common(corners, np.concatenate(found))
