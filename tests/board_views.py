"""Views of a board by random rigs, whose calibration is known."""

import math

import numpy as np

from calib.board.detect import Board, BoardView
from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.rig import StereoRig

BOARD_SIZE = 1280, 800
LENSES: dict[str, tuple[float, LensModel, tuple[float, ...]]] = {
    "plain": (900.0, "brown", ()),
    "brown": (900.0, "brown", (-0.3, 0.1, 5e-4, -3e-4)),
    "tele": (2000.0, "brown", (-0.1, 0.05, 0.0, 0.0)),
    "fisheye": (420.0, "fisheye", (0.05, -0.02, 0.005, -0.001)),
    "rational": (600.0, "rational", (0.3, 0.05, 2e-4, -1e-4, 0.001, 0.65, 0.1, 0.01)),
}
"""Focal length [px], model and coefficients."""


def random_rig(lens: str, rng: np.random.Generator) -> StereoRig:
    """A rig such as is built: lenses (of LENSES) and mounts of one kind scatter by a per cent and a degree."""
    focal, model, coefficients = LENSES[lens]

    def camera():
        fx, fy = focal * (1 + 0.01 * rng.normal(size=2))
        cx, cy = np.array(BOARD_SIZE) / 2 + 8 * rng.normal(size=2)
        distortion = tuple(float(k * (1 + 0.02 * rng.normal())) for k in coefficients)
        return Camera(*BOARD_SIZE, float(fx), float(fy), float(cx), float(cy), model, distortion)

    shift = np.array([-rng.uniform(0.06, 0.25), 0.0, 0.0]) + 0.002 * rng.normal(size=3)
    return StereoRig(camera(), camera(), SE3.from_rotvec(0.02 * rng.normal(size=3), shift), f"random {lens} rig")


def board_views(rig: StereoRig, board: Board, n: int, noise_px: float, rng: np.random.Generator) -> list[BoardView]:
    """Pairs in which both images show the whole board, at places and tilts all over the left image.

    Args:
        noise_px: standard deviation of each corner coordinate.
    """
    points, extent = board.points, float(board.points.max())
    near = 1.5 * extent * rig.left.fx / rig.left.width
    ids = np.arange(len(points))
    views = []
    while len(views) < n:
        turn = SE3.from_rotvec(rng.normal(size=3) * [0.45, 0.45, 0.3])
        middle = rig.left.unproject([rng.uniform(0.12, 0.88, 2) * rig.left.size])[0] * rng.uniform(near, 2.5 * near)
        left_SE3_board = SE3(turn.rotation, middle - turn.rotation @ points.mean(axis=0))
        left = rig.left.project(left_SE3_board @ points)
        right = rig.right.project(rig.right_SE3_left @ (left_SE3_board @ points))
        if all(((p > 0) & (p < np.array(rig.left.size) - 1)).all() for p in (left, right)):
            noise = noise_px * rng.normal(size=(2, *left.shape))
            views.append(BoardView(f"view {len(views):02d}", ids, left + noise[0], right + noise[1]))
    return views


def calibration_errors(truth: StereoRig, found: StereoRig) -> tuple[float, float, float]:
    """Worst focal length error [%], baseline error [%] and rotation error [deg]."""
    (left, right), (true_left, true_right) = ((rig.left, rig.right) for rig in (found, truth))
    ratios = (left.fx / true_left.fx, left.fy / true_left.fy, right.fx / true_right.fx, right.fy / true_right.fy)
    baseline = abs(found.baseline_m / truth.baseline_m - 1)
    turn = (found.right_SE3_left @ truth.right_SE3_left.inverse()).rotvec
    focal = max(abs(ratio - 1) for ratio in ratios)
    return 100 * focal, 100 * baseline, math.degrees(float(np.linalg.norm(turn)))
