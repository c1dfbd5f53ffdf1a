"""A first guess of a rig from board views, good enough for the joint adjustment to start from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.board.adjust import adjust
from calib.board.lens import BASES, Lens
from calib.board.model import SIDES, Adjusted, Corners, Estimate, Side, View
from calib.camera import Camera
from calib.errors import InputError
from calib.pose import SE3
from calib.types import F64

_FOCALS = (0.35, 0.5, 0.7, 1.0, 1.5, 2.5)
_GUESS_VIEWS = 8
_GUESS_ROUNDS = 3


def first_guess(
    views: Sequence[View], points: F64, size: tuple[int, int], lenses: Sequence[Lens], source: str
) -> Estimate:
    """Both cameras on their own, then the median of the transforms that each pair gives."""
    bases = [base for base in BASES if any(base.model == one.model for one in lenses)]
    best: tuple[_Single, _Single] | None = None
    for base in bases:
        focals = _FOCALS if best is None else (best[0].camera.fx / size[0], _FOCALS[1])
        left, right = (_single(views, points, size, side, base, focals) for side in SIDES)
        # A model with more freedom always fits a little better.
        if best is None or left.rms_px + right.rms_px < 0.95 * (best[0].rms_px + best[1].rms_px):
            best = (left, right)
    if best is None or not math.isfinite(best[0].rms_px + best[1].rms_px):
        raise InputError(f"{source}: expected views of a flat board, found none that a camera could have taken")
    left, right = best
    pairs = [i for i in left.poses if i in right.poses]
    stereo = np.median([_vector(_pose(right.poses[i]) @ _pose(left.poses[i]).inverse()) for i in pairs], axis=0)
    back = _pose(stereo).inverse()
    poses = [left.poses[i] if i in left.poses else _vector(back @ _pose(right.poses[i])) for i in range(len(views))]
    return Estimate(left.camera, right.camera, stereo, np.array(poses), left.frozen)


@dataclass(frozen=True, eq=False)
class _Single:
    """One camera calibrated on its own, with the board's pose in each view it saw."""

    camera: Camera
    poses: dict[int, F64]
    rms_px: float
    frozen: frozenset[str]


def _single(
    views: Sequence[View], points: F64, size: tuple[int, int], side: Side, base: Lens, focals: Sequence[float]
) -> _Single:
    """One camera from its own images: the focal length that fits best of a few, then the adjustment."""
    index = [i for i, view in enumerate(views) if view.side(side) is not None]
    seen = [View(views[i].name, views[i].side(side), None) for i in index]
    some = seen[:: max(1, len(seen) // _GUESS_VIEWS)]
    guesses = [_guess(some, points, _plain_camera(size, focal, base), base) for focal in focals]
    camera, _ = min(guesses, key=lambda guess: guess[1].rms_px if math.isfinite(guess[1].rms_px) else math.inf)
    camera, fit = _guess(seen, points, camera, base)
    return _Single(camera, dict(zip(index, fit.estimate.poses, strict=True)), fit.rms_px, base.frozen)


def _plain_camera(size: tuple[int, int], focal_widths: float, base: Lens) -> Camera:
    focal = focal_widths * size[0]
    return Camera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2, base.model, (0.0,) * base.count)


def _guess(views: Sequence[View], points: F64, camera: Camera, base: Lens) -> tuple[Camera, Adjusted]:
    """Adjust one camera, putting boards right that started tilted the wrong way, while that helps."""
    fit = _adjusted_single(views, points, camera, _start_poses(views, points, camera), base)
    for _ in range(_GUESS_ROUNDS):
        camera = fit.estimate.left or camera
        poses, turned = _best_poses(views, points, fit)
        if not turned:
            break
        again = _adjusted_single(views, points, camera, poses, base)
        if not again.rms_px < fit.rms_px:
            break
        fit = again
    return fit.estimate.left or camera, fit


def _adjusted_single(views: Sequence[View], points: F64, camera: Camera, poses: F64, base: Lens) -> Adjusted:
    return adjust(views, points, Estimate(camera, None, np.zeros(6), poses, base.frozen), max_iterations=30)


def _start_poses(views: Sequence[View], points: F64, camera: Camera) -> F64:
    return np.array([board_poses(camera, view.left, points)[0] for view in views if view.left is not None])


def _best_poses(views: Sequence[View], points: F64, fit: Adjusted) -> tuple[F64, bool]:
    """Per view the best of the pose found and the two that a plane allows, and whether any changed."""
    camera = fit.estimate.left
    if camera is None:
        raise ValueError("expected a left camera")
    both = [board_poses(camera, view.left, points) for view in views if view.left is not None]
    best, poses, turned = fit.view_rms_px(), fit.estimate.poses.copy(), False
    for k in range(2):
        start = replace(fit.estimate, poses=np.array([pair[k] for pair in both]))
        judged = adjust(views, points, start, fix_shared=True, max_iterations=10)
        for i, value in enumerate(judged.view_rms_px()):
            if value < 0.9 * best[i] or (math.isfinite(value) and not math.isfinite(best[i])):
                best[i], poses[i], turned = value, judged.estimate.poses[i], True
    return poses, turned


def board_poses(camera: Camera, corners: Corners, points: F64) -> tuple[F64, F64]:
    """The two (6,) camera_SE3_board that a flat board allows, the better one first (infinitesimal plane-based pose).

    Where there is none (a wild first guess of the lens), the board is put a little ahead of the camera.
    """
    extent = float(np.ptp(points, axis=0).max())
    ahead = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0 * extent])
    rays = camera.unproject(corners.pixels)[:, :2]
    good = np.isfinite(rays).all(axis=1)
    if good.sum() < 4:
        return ahead, ahead
    plane, image = np.ascontiguousarray(points[corners.ids][good]), np.ascontiguousarray(rays[good])
    _, rotations, translations, _ = cv2.solvePnPGeneric(plane, image, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = [
        np.concatenate([np.asarray(r).reshape(3), np.asarray(t).reshape(3)])
        for r, t in zip(rotations, translations, strict=True)
    ]
    usable = [pose for pose in poses if np.isfinite(pose).all() and pose[5] > 0] or [ahead]
    return usable[0], usable[-1]


def _pose(vector: F64) -> SE3:
    return SE3.from_rotvec(vector[:3], vector[3:])


def _vector(pose: SE3) -> F64:
    return np.concatenate([pose.rotvec, pose.translation])
