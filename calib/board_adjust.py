"""Bundle adjustment of board views: both cameras, the transform between them and one board pose per view.

Board poses are eliminated view by view (Schur complement), so the cost grows linearly with the views.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from calib.camera import Camera, LensModel
from calib.pose import SE3
from calib.types import F64, I64

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")

_MAX_ITERATIONS = 60
_CONVERGED = 1e-8
"""Relative fall of the cost below which the adjustment has converged."""
_SETTLED = 1e-3
_MAX_DAMPING = 1e10
_HUBER_SIGMAS = 3.0
"""Residuals beyond this many robust standard deviations pull linearly instead of squarely (our choice)."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of the board seen in one image: (n,) ids into the board's points and (n, 2) pixels."""

    ids: I64
    pixels: F64


@dataclass(frozen=True, eq=False)
class View:
    """One pair of images of the board; a side that did not show the board is None."""

    name: str
    left: Corners | None
    right: Corners | None

    def side(self, side: Side) -> Corners | None:
        """Corners of one camera."""
        return self.left if side == "left" else self.right


@dataclass(frozen=True, eq=False)
class Estimate:
    """Unknowns of the adjustment.

    Attributes:
        left, right: cameras; None when that side is not part of the adjustment.
        stereo: (6,) rotation vector and translation of right_SE3_left.
        poses: (n_views, 6) rotation vector and translation of left_SE3_board (right_SE3_board without a left camera).
    """

    left: Camera | None
    right: Camera | None
    stereo: F64
    poses: F64

    def camera(self, side: Side) -> Camera | None:
        """Camera of one side."""
        return self.left if side == "left" else self.right

    @property
    def right_SE3_left(self) -> SE3:
        """Transform between the cameras."""
        return SE3.from_rotvec(self.stereo[:3], self.stereo[3:])


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Outcome of an adjustment.

    Attributes:
        estimate: the unknowns.
        errors: per view, per side the (n, 2) reprojection errors [px], None for a side that is not there.
        covariance: (p, p) of ``names``, scaled by the residuals' variance.
        names: of the shared unknowns, e.g. "left fx", "rotation x", "translation z".
    """

    estimate: Estimate
    errors: tuple[dict[Side, F64], ...]
    covariance: F64
    names: tuple[str, ...]

    @property
    def rms_px(self) -> float:
        """Root mean square distance between corners and their reprojection, over all images [px]."""
        return rms(error for view in self.errors for error in view.values())

    def view_rms_px(self) -> F64:
        """(n_views,) the same per view [px]."""
        return np.array([rms(view.values()) for view in self.errors])


def rms(errors: object) -> float:
    """Root mean square length of 2-vectors in several (n, 2) arrays."""
    stacked = np.concatenate([np.empty((0, 2)), *errors])  # type: ignore[misc]
    return float(np.sqrt((stacked**2).sum(axis=1).mean())) if len(stacked) else math.nan


@dataclass(frozen=True)
class _Layout:
    """Places of the shared unknowns in the normal equations."""

    left: slice
    right: slice
    stereo: slice
    count: int

    def side(self, side: Side) -> slice:
        return self.left if side == "left" else self.right


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations at an estimate: shared block, and per view the mixed and the pose block."""

    shared: F64
    shared_gradient: F64
    mixed: F64
    pose: F64
    pose_gradient: F64
    cost: float
    errors: tuple[dict[Side, F64], ...]


def adjust(
    views: Sequence[View],
    points: F64,
    start: Estimate,
    *,
    fix_shared: bool = False,
    max_iterations: int = _MAX_ITERATIONS,
) -> Adjusted:
    """Levenberg-Marquardt on all reprojection errors, with Huber weights once it has settled.

    Args:
        views: what was seen.
        points: (m, 3) the board's points [m].
        start: first guess; the lens models and numbers of coefficients are kept.
        fix_shared: adjust the board poses only (to judge a rig on views it was not made from).
        max_iterations: steps to take at most.
    Returns:
        The adjusted estimate with its errors and covariance (empty with ``fix_shared``).
    """
    layout = _layout(start)
    estimate, damping, sigma = start, 1e-3, math.inf
    system = _linearise(views, points, estimate, layout, sigma)
    for _ in range(max_iterations):
        before = system.cost
        estimate, system, damping = _descend(views, points, estimate, system, damping, sigma, fix_shared)
        fallen = 1.0 - system.cost / before if before > 0 and math.isfinite(before) else 0.0
        if math.isinf(sigma) and fallen < _SETTLED:
            sigma, damping = _robust_sigma(system.errors), 1e-3
            system = _linearise(views, points, estimate, layout, sigma)
        elif fallen < _CONVERGED:
            break
    names = () if fix_shared else _names(estimate)
    return Adjusted(estimate, system.errors, _covariance(system, layout, fix_shared), names)


def _descend(
    views: Sequence[View],
    points: F64,
    estimate: Estimate,
    system: _System,
    damping: float,
    sigma: float,
    fix_shared: bool,
) -> tuple[Estimate, _System, float]:
    """One step downhill, damped until it is one; the same estimate when there is none."""
    layout = _layout(estimate)
    while damping < _MAX_DAMPING:
        trial = _moved(estimate, *_step(system, damping, fix_shared), layout)
        candidate = None if trial is None else _linearise(views, points, trial, layout, sigma)
        if trial is not None and candidate is not None and candidate.cost < system.cost:
            return trial, candidate, max(damping / 10, 1e-12)
        damping *= 10
    return estimate, system, 1e-3


def _layout(estimate: Estimate) -> _Layout:
    left = 0 if estimate.left is None else 4 + len(estimate.left.coefficients)
    right = 0 if estimate.right is None else 4 + len(estimate.right.coefficients)
    stereo = 6 if left and right else 0
    return _Layout(
        slice(0, left), slice(left, left + right), slice(left + right, left + right + stereo), left + right + stereo
    )


def _names(estimate: Estimate) -> tuple[str, ...]:
    names: list[str] = []
    for side in SIDES:
        camera = estimate.camera(side)
        if camera is not None:
            names += [f"{side} {name}" for name in ("fx", "fy", "cx", "cy", *coefficient_names(camera))]
    if estimate.left is not None and estimate.right is not None:
        names += [f"{what} {axis}" for what in ("rotation", "translation") for axis in "xyz"]
    return tuple(names)


def coefficient_names(camera: Camera) -> tuple[str, ...]:
    """Names of the distortion coefficients in their order."""
    if camera.model == "fisheye":
        return ("k1", "k2", "k3", "k4")
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
    return order[: len(camera.coefficients)]


def project_with_derivatives(camera: Camera, pose: F64, points: F64) -> tuple[F64, F64, F64] | None:
    """Pixels of board points and their derivatives.

    Args:
        pose: (6,) rotation vector and translation camera_SE3_board.
        points: (n, 3).
    Returns:
        (n, 2) pixels, (2n, 4 + k) by fx fy cx cy and the coefficients, (2n, 6) by the pose; None when a point lies
        behind the camera.
    """
    rotation, _ = cv2.Rodrigues(pose[:3])
    if not np.isfinite(pose).all() or ((points @ rotation.T + pose[3:])[:, 2] <= 1e-6).any():
        return None
    objects = np.ascontiguousarray(points).reshape(-1, 1, 3)
    if camera.model == "fisheye":
        pixels, jacobian = cv2.fisheye.projectPoints(objects, pose[:3], pose[3:], camera.matrix, camera.coefficients)
        by_camera, by_pose = jacobian[:, :8], jacobian[:, 8:14]
    else:
        pixels, jacobian = cv2.projectPoints(objects, pose[:3], pose[3:], camera.matrix, camera.coefficients)
        by_camera, by_pose = jacobian[:, 6 : 10 + len(camera.coefficients)], jacobian[:, :6]
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), np.asarray(by_camera), np.asarray(by_pose)


def _linearise(views: Sequence[View], points: F64, estimate: Estimate, layout: _Layout, sigma: float) -> _System:
    n = len(views)
    shared, gradient = np.zeros((layout.count, layout.count)), np.zeros(layout.count)
    mixed, pose = np.zeros((n, layout.count, 6)), np.zeros((n, 6, 6))
    pose_gradient, cost = np.zeros((n, 6)), 0.0
    errors: list[dict[Side, F64]] = []
    for index, view in enumerate(views):
        errors.append({})
        for side in SIDES:
            camera, corners = estimate.camera(side), view.side(side)
            if camera is None or corners is None:
                continue
            found = _side(estimate, side, camera, points[corners.ids], index, layout)
            if found is None:
                return _System(shared, gradient, mixed, pose, pose_gradient, math.inf, tuple(errors))
            pixels, by_shared, by_pose = found
            error = pixels - corners.pixels
            errors[index][side] = error
            weight, loss = _weights(error, sigma)
            rows = np.repeat(np.sqrt(weight), 2)[:, None]
            a, b, r = by_shared * rows, by_pose * rows, error.reshape(-1) * rows[:, 0]
            shared += a.T @ a
            gradient += a.T @ r
            mixed[index] += a.T @ b
            pose[index] += b.T @ b
            pose_gradient[index] += b.T @ r
            cost += loss
    cost = cost if math.isfinite(cost) else math.inf
    return _System(shared, gradient, mixed, pose, pose_gradient, cost, tuple(errors))


def _weights(error: F64, sigma: float) -> tuple[F64, float]:
    """Huber weights of the points and their loss."""
    length = np.linalg.norm(error, axis=1)
    if not math.isfinite(sigma):
        return np.ones(len(error)), float((length**2).sum())
    limit = _HUBER_SIGMAS * sigma
    far = length > limit
    weight = np.where(far, limit / np.maximum(length, 1e-12), 1.0)
    return weight, float(np.where(far, 2 * limit * length - limit**2, length**2).sum())


def _robust_sigma(errors: Sequence[dict[Side, F64]]) -> float:
    lengths = np.concatenate([np.linalg.norm(e, axis=1) for view in errors for e in view.values()])
    # The median of a Rayleigh distribution is 1.1774 sigma.
    return max(float(np.median(lengths)) / 1.1774, 1e-3)


def _side(
    estimate: Estimate, side: Side, camera: Camera, points: F64, index: int, layout: _Layout
) -> tuple[F64, F64, F64] | None:
    """Pixels and their derivatives by the shared unknowns and by the view's pose."""
    board = estimate.poses[index]
    chained = side == "right" and estimate.left is not None
    by_board = by_stereo = np.empty(0)
    here = board
    if chained:
        here, by_board, by_stereo = _composed(board, estimate.stereo)
    found = project_with_derivatives(camera, here, points)
    if found is None:
        return None
    pixels, by_camera, by_here = found
    by_shared = np.zeros((2 * len(points), layout.count))
    by_shared[:, layout.side(side)] = by_camera
    if chained:
        by_shared[:, layout.stereo] = by_here @ by_stereo
        return pixels, by_shared, by_here @ by_board
    return pixels, by_shared, by_here


def _composed(first: F64, second: F64) -> tuple[F64, F64, F64]:
    """Pose of second after first, with its (6, 6) derivatives by first and by second."""
    r, t, rr1, rt1, rr2, rt2, tr1, tt1, tr2, tt2 = cv2.composeRT(first[:3], first[3:], second[:3], second[3:])
    pose = np.concatenate([np.asarray(r).reshape(3), np.asarray(t).reshape(3)])
    return pose, np.block([[rr1, rt1], [tr1, tt1]]), np.block([[rr2, rt2], [tr2, tt2]])


def _step(system: _System, damping: float, fix_shared: bool) -> tuple[F64, F64]:
    """Damped Gauss-Newton step of the shared unknowns and of the poses."""
    pose = system.pose + damping * _diagonals(system.pose)
    eye = 1e-12 * np.eye(6)
    inverse = np.linalg.inv(pose + eye)
    if fix_shared or len(system.shared) == 0:
        return np.zeros(len(system.shared)), -np.einsum("vij,vj->vi", inverse, system.pose_gradient)
    carried = np.einsum("vsi,vij->vsj", system.mixed, inverse)
    shared = system.shared + damping * np.diag(np.diag(system.shared))
    reduced = shared - np.einsum("vsi,vti->st", carried, system.mixed)
    gradient = system.shared_gradient - np.einsum("vsi,vi->s", carried, system.pose_gradient)
    step = -_solve_scaled(reduced, gradient)
    back = system.pose_gradient + np.einsum("vsi,s->vi", system.mixed, step)
    return step, -np.einsum("vij,vj->vi", inverse, back)


def _diagonals(blocks: F64) -> F64:
    out = np.zeros_like(blocks)
    out[:, range(6), range(6)] = blocks[:, range(6), range(6)]
    return out


def _solve_scaled(matrix: F64, vector: F64) -> F64:
    """Solution with rows and columns scaled to a unit diagonal; least squares where it is singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scale = np.where(np.diag(matrix) > 0, scale, 0.0)
    solution, *_ = np.linalg.lstsq(matrix * np.outer(scale, scale), vector * scale, rcond=1e-14)
    return np.asarray(solution * scale, dtype=np.float64)


def _moved(estimate: Estimate, shared: F64, poses: F64, layout: _Layout) -> Estimate | None:
    """The estimate after a step; None where it leaves the domain of a camera."""
    if not (np.isfinite(shared).all() and np.isfinite(poses).all()):
        return None
    try:
        left = None if estimate.left is None else with_parameters(estimate.left, shared[layout.left])
        right = None if estimate.right is None else with_parameters(estimate.right, shared[layout.right])
    except ValueError:
        return None
    stereo = estimate.stereo + shared[layout.stereo] if layout.stereo.stop > layout.stereo.start else estimate.stereo
    return Estimate(left, right, stereo, estimate.poses + poses)


def with_parameters(camera: Camera, change: F64) -> Camera:
    """The camera after adding to fx fy cx cy and the coefficients."""
    fx, fy, cx, cy = np.array([camera.fx, camera.fy, camera.cx, camera.cy]) + change[:4]
    distortion = tuple(float(k) for k in camera.coefficients + change[4:])
    return replace(camera, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy), distortion=distortion)


def _covariance(system: _System, layout: _Layout, fix_shared: bool) -> F64:
    if fix_shared or layout.count == 0:
        return np.empty((0, 0))
    inverse = np.linalg.inv(system.pose + 1e-12 * np.eye(6))
    carried = np.einsum("vsi,vij->vsj", system.mixed, inverse)
    reduced = system.shared - np.einsum("vsi,vti->st", carried, system.mixed)
    values = 2 * sum(len(error) for view in system.errors for error in view.values())
    freedom = max(values - layout.count - 6 * len(system.errors), 1)
    squares = sum(float((error**2).sum()) for view in system.errors for error in view.values())
    scale = 1.0 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    scaled = np.linalg.pinv(reduced * np.outer(scale, scale), rcond=1e-15, hermitian=True)
    return np.asarray(scaled * np.outer(scale, scale) * squares / freedom, dtype=np.float64)


def lens(camera: Camera, model: LensModel, count: int) -> Camera:
    """The camera with another lens model; coefficients that both models share are kept."""
    same_family = (camera.model == "fisheye") == (model == "fisheye")
    kept = camera.distortion[:count] if same_family else ()
    return replace(camera, model=model, distortion=(*kept, *[0.0] * (count - len(kept))))
