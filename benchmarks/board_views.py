"""Views of a board by a known rig, for measuring what calibration recovers."""

from __future__ import annotations

import numpy as np

from calib.board.detect import Board, BoardView
from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.rig import StereoRig

WIDTH, HEIGHT = 1280, 800


def random_rig(lens: str, rng: np.random.Generator) -> StereoRig:
    """A rig such as is built: lenses and mounts of one kind scatter by a per cent and a degree.

    Args:
        lens: "plain", "brown", "tele", "fisheye" or "rational".
    """
    focal, model, coefficients = _LENSES[lens]

    def camera() -> Camera:
        fx, fy = focal * (1 + 0.01 * rng.normal(size=2))
        cx, cy = np.array([WIDTH / 2, HEIGHT / 2]) + 8 * rng.normal(size=2)
        distortion = tuple(float(k * (1 + 0.02 * rng.normal())) for k in coefficients)
        return Camera(WIDTH, HEIGHT, float(fx), float(fy), float(cx), float(cy), model, distortion)

    shift = np.array([-rng.uniform(0.06, 0.25), 0.0, 0.0]) + 0.002 * rng.normal(size=3)
    return StereoRig(camera(), camera(), SE3.from_rotvec(0.02 * rng.normal(size=3), shift), f"random {lens} rig")


_LENSES: dict[str, tuple[float, LensModel, tuple[float, ...]]] = {
    "plain": (900.0, "brown", ()),
    "brown": (900.0, "brown", (-0.3, 0.1, 5e-4, -3e-4)),
    "tele": (2000.0, "brown", (-0.1, 0.05, 0.0, 0.0)),
    "fisheye": (420.0, "fisheye", (0.05, -0.02, 0.005, -0.001)),
    "rational": (600.0, "rational", (0.3, 0.05, 2e-4, -1e-4, 0.001, 0.65, 0.1, 0.01)),
}
LENS_NAMES = tuple(_LENSES)


def board_views(
    rig: StereoRig, board: Board, n: int, noise_px: float, rng: np.random.Generator, tilt_rad: float = 0.45
) -> list[BoardView]:
    """Pairs in which both images show the whole board, at places and tilts all over the left image.

    Args:
        noise_px: standard deviation of each corner coordinate.
        tilt_rad: standard deviation of the board's tilts.
    """
    points, extent = board.points, float(board.points.max())
    near = 1.5 * extent * rig.left.fx / rig.left.width
    ids = np.arange(len(points))
    views: list[BoardView] = []
    while len(views) < n:
        turn = SE3.from_rotvec(rng.normal(size=3) * [tilt_rad, tilt_rad, 0.3])
        middle = rig.left.unproject([rng.uniform(0.12, 0.88, 2) * rig.left.size])[0] * rng.uniform(near, 2.5 * near)
        left_SE3_board = SE3(turn.rotation, middle - turn.rotation @ points.mean(axis=0))
        left = rig.left.project(left_SE3_board @ points)
        right = rig.right.project(rig.right_SE3_left @ (left_SE3_board @ points))
        if all(((p > 0) & (p < np.array(rig.left.size) - 1)).all() for p in (left, right)):
            noise = noise_px * rng.normal(size=(2, *left.shape))
            views.append(BoardView(f"view {len(views):02d}", ids, left + noise[0], right + noise[1]))
    return views
