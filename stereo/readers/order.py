"""Which of two views is the left camera's, and whether they are rectified already, told by matched corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, AnyArray

MIN_MATCHES = 40
"""Fewest matched corners by which the order is told (our choice)."""
NEARER = 0.8
"""Share of corners nearer than infinity of views in their right order; of swapped ones nearly none is (our choice)."""
ROWS_PX = 1.5
"""Median row offset [px of 640] up to which rows count as aligned (our choice; a worn factory calibration has 0.6)."""
GAIN = 3.0
"""How much better the rows of rectified images agree without rectifying them again (our choice)."""


@dataclass(frozen=True)
class Order:
    """What the corners say.

    Attributes:
        swapped: the first view is the right camera's.
        rectified: the views are rectified already.
        nearer: share of corners nearer than infinity, in this order.
        rows_px: median row offset [px of 640].
        matches: corners compared.
    """

    swapped: bool
    rectified: bool
    nearer: float
    rows_px: float
    matches: int


def tell_order(matches: F64, rig: StereoRig, rectified: StereoRig) -> Order | None:
    """The order and the calibration under which corners lie nearer than infinity and on their rows.

    Args:
        matches: (N, 4) float64 [px], u, v in the first view and u, v in the second.
        rig: of the views as the cameras took them.
        rectified: of the views when they are rectified.
    Returns:
        None when there are too few corners, or none of the four cases explains them better than the first.
    """
    if len(matches) < MIN_MATCHES:
        return None
    cases = [
        _case(matches, one, swapped, is_rectified)
        for is_rectified, one in ((False, rig), (True, rectified))
        for swapped in (False, True)
    ]
    usual = cases[0]
    if usual.nearer >= NEARER and usual.rows_px <= ROWS_PX:
        return usual
    good = [case for case in cases if case.nearer >= NEARER and case.rows_px <= min(ROWS_PX, usual.rows_px / GAIN)]
    if not good:
        good = [case for case in cases if case.nearer >= NEARER and case.rows_px <= ROWS_PX]
    return min(good, key=lambda case: (case.rows_px > ROWS_PX, case.rectified, case.swapped), default=None)


def rectified_rig(load: Callable[[], StereoRig], rig: StereoRig) -> tuple[StereoRig, str]:
    """The calibration of rectified images: from the file, else as OpenCV computes it.

    Args:
        load: reads the file's calibration of rectified images, or its other one when it holds none.
    Returns:
        The rig, and what was assumed; empty when the file says it.
    """
    held = load()
    if is_ideal(held):
        return held, ""
    pose, size = rig.right_SE3_left, rig.left.size
    (k1, d1), (k2, d2) = ((one.matrix, one.coefficients) for one in (rig.left, rig.right))
    turn, shift_column = pose.rotation, pose.translation.reshape(3, 1)
    if "fisheye" in (rig.left.model, rig.right.model):
        _, _, *projections, _ = cv2.fisheye.stereoRectify(k1, d1, k2, d2, size, turn, shift_column, 0)
    else:
        _, _, *projections, _, _, _ = cv2.stereoRectify(k1, d1, k2, d2, size, turn, shift_column, alpha=0.0)
    left, right = (_ideal(np.asarray(p, dtype=np.float64), rig.left) for p in projections)
    shift = np.array([-rig.baseline_m, 0.0, 0.0])
    ideal = StereoRig(left, right, SE3(np.eye(3), shift), f"{rig.source} [rectified images]")
    return ideal, f"their focal length is taken as {left.fx:.1f} px, as OpenCV's stereoRectify gives it for alpha 0"


def is_ideal(rig: StereoRig) -> bool:
    """Whether a rig is that of rectified images: no distortion, no rotation."""
    turned = float(np.abs(rig.right_SE3_left.rotation - np.eye(3)).max())
    return turned < 1e-9 and not any(np.any(one.coefficients) for one in (rig.left, rig.right))


def _ideal(p: AnyArray, one: Camera) -> Camera:
    return Camera(one.width, one.height, float(p[0, 0]), float(p[1, 1]), float(p[0, 2]), float(p[1, 2]))


def _case(matches: F64, rig: StereoRig, swapped: bool, rectified: bool) -> Order:
    first, second = matches[:, :2], matches[:, 2:]
    left, right = (second, first) if swapped else (first, second)
    left_rotation, right_rotation = rig.rectifying_rotations()
    rays = [
        camera.unproject(pixels) @ rotation.T
        for camera, pixels, rotation in ((rig.left, left, left_rotation), (rig.right, right, right_rotation))
    ]
    a, b = (r[:, :2] / r[:, 2:] for r in rays)
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if not known.any():
        return Order(swapped, rectified, 0.0, np.inf, 0)
    scale = rig.left.fx * 640.0 / rig.left.width
    across, down = ((a - b)[known] * scale).T
    return Order(swapped, rectified, float(np.mean(across > -0.5)), float(np.median(np.abs(down))), int(known.sum()))
