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
from scipy.spatial.transform import Rotation

from calib.camera import Camera
from calib.pose import SE3
from calib.types import F64, I64

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")

_MAX_ITERATIONS = 60
_CONVERGED = 1e-8
"""Relative fall of the cost below which the adjustment has converged."""
_SETTLED = 1e-3
_MAX_DAMPING = 1e10
_NEAREST_M = 1e-6
"""A corner nearer to the image plane than this is behind the camera."""
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
        poses: (n_views, 6) rotation vector and translation of left_SE3_board.
        frozen: names of distortion coefficients that stay as they are.
    """

    left: Camera | None
    right: Camera | None
    stereo: F64
    poses: F64
    frozen: frozenset[str] = frozenset()

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
    """Places of the shared unknowns in the normal equations, and those among them that are frozen."""

    left: slice
    right: slice
    stereo: slice
    count: int
    frozen: tuple[int, ...]

    def side(self, side: Side) -> slice:
        return self.left if side == "left" else self.right


@dataclass(frozen=True, eq=False)
class _Seen:
    """All corners of one camera in a row: board points, pixels, the view of each, and each view's slice."""

    points: F64
    pixels: F64
    view: I64
    slices: tuple[tuple[int, slice], ...]


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
    seen = {side: _gather(views, points, side) for side in SIDES if start.camera(side) is not None}
    layout = _layout(start)
    estimate, damping, sigma = start, 1e-3, math.inf
    system = _linearise(seen, estimate, layout, sigma)
    for _ in range(max_iterations):
        if not math.isfinite(system.cost):
            break
        before = system.cost
        estimate, system, damping = _descend(seen, estimate, system, damping, sigma, fix_shared)
        fallen = 1.0 - system.cost / before if before > 0 else 0.0
        if math.isinf(sigma) and fallen < _SETTLED:
            sigma, damping = _robust_sigma(system.errors), 1e-3
            system = _linearise(seen, estimate, layout, sigma)
        elif fallen < _CONVERGED:
            break
    names = () if fix_shared else _names(estimate)
    return Adjusted(estimate, system.errors, _covariance(system, layout, fix_shared), names)


def _descend(
    seen: dict[Side, _Seen],
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
        candidate = None if trial is None else _linearise(seen, trial, layout, sigma)
        if trial is not None and candidate is not None and candidate.cost < system.cost:
            return trial, candidate, max(damping / 10, 1e-12)
        damping *= 10
    return estimate, system, 1e-3


def _gather(views: Sequence[View], points: F64, side: Side) -> _Seen:
    found = [(i, corners) for i, view in enumerate(views) if (corners := view.side(side)) is not None]
    counts = [len(corners.ids) for _, corners in found]
    ends = np.cumsum([0, *counts])
    slices = tuple((i, slice(int(a), int(b))) for (i, _), a, b in zip(found, ends[:-1], ends[1:], strict=True))
    empty = np.empty((0, 2))
    return _Seen(
        points[np.concatenate([np.empty(0, dtype=np.int64), *(corners.ids for _, corners in found)])],
        np.concatenate([empty, *(corners.pixels for _, corners in found)]),
        np.repeat(np.array([i for i, _ in found], dtype=np.int64), counts),
        slices,
    )


def _layout(estimate: Estimate) -> _Layout:
    left = 0 if estimate.left is None else 4 + len(estimate.left.coefficients)
    right = 0 if estimate.right is None else 4 + len(estimate.right.coefficients)
    stereo = 6 if left and right else 0
    frozen = tuple(i for i, name in enumerate(_names(estimate)) if name.split()[-1] in estimate.frozen)
    return _Layout(
        slice(0, left),
        slice(left, left + right),
        slice(left + right, left + right + stereo),
        left + right + stereo,
        frozen,
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


def _projected(camera: Camera, points: F64) -> tuple[F64, F64, F64]:
    """Pixels of (n, 3) points before the camera, (n, 2, 4 + k) by its parameters and (n, 2, 3) by the points."""
    objects, zero = np.ascontiguousarray(points).reshape(-1, 1, 3), np.zeros(3)
    if camera.model == "fisheye":
        pixels, jacobian = cv2.fisheye.projectPoints(objects, zero, zero, camera.matrix, camera.coefficients)
        by_camera, by_point = jacobian[:, :8], jacobian[:, 11:14]
    else:
        pixels, jacobian = cv2.projectPoints(objects, zero, zero, camera.matrix, camera.coefficients)
        by_camera, by_point = jacobian[:, 6 : 10 + len(camera.coefficients)], jacobian[:, 3:6]
    n = len(points)
    return (
        np.asarray(pixels, dtype=np.float64).reshape(n, 2),
        np.asarray(by_camera, dtype=np.float64).reshape(n, 2, -1),
        np.asarray(by_point, dtype=np.float64).reshape(n, 2, 3),
    )


def _linearise(seen: dict[Side, _Seen], estimate: Estimate, layout: _Layout, sigma: float) -> _System:
    """Normal equations; an infinite cost where a corner would lie behind a camera."""
    n = len(estimate.poses)
    errors: tuple[dict[Side, F64], ...] = tuple({} for _ in range(n))
    system = _System(
        np.zeros((layout.count, layout.count)),
        np.zeros(layout.count),
        np.zeros((n, layout.count, 6)),
        np.zeros((n, 6, 6)),
        np.zeros((n, 6)),
        0.0,
        errors,
    )
    cost = 0.0
    for side, corners in seen.items():
        found = _side(estimate, side, corners, layout)
        if found is None:
            return replace(system, cost=math.inf)
        pixels, by_shared, by_pose = found
        error = pixels - corners.pixels
        weight, loss = _weights(error, sigma)
        root = np.sqrt(weight)[:, None, None]
        by_shared, by_pose, weighted = by_shared * root, by_pose * root, error * root[..., 0]
        flat = by_shared.reshape(-1, layout.count)
        system.shared[:] += flat.T @ flat
        system.shared_gradient[:] += flat.T @ weighted.ravel()
        for index, rows in corners.slices:
            a, b, r = by_shared[rows].reshape(-1, layout.count), by_pose[rows].reshape(-1, 6), weighted[rows].ravel()
            system.mixed[index] += a.T @ b
            system.pose[index] += b.T @ b
            system.pose_gradient[index] += b.T @ r
            errors[index][side] = error[rows]
        cost += loss
    return replace(system, cost=cost if math.isfinite(cost) else math.inf)


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


def _side(estimate: Estimate, side: Side, corners: _Seen, layout: _Layout) -> tuple[F64, F64, F64] | None:
    """Pixels, their (n, 2, p) derivatives by the shared unknowns and (n, 2, 6) by the pose of each corner's view.

    Rotations are varied from the left: R becomes exp(w) R, so that d(R p)/dw = -[R p]x.
    """
    camera = estimate.camera(side)
    if camera is None:
        raise ValueError(f"expected a {side} camera")
    turned = np.einsum("nij,nj->ni", _matrices(estimate.poses[:, :3])[corners.view], corners.points)
    here = turned + estimate.poses[corners.view, 3:]
    by_pose_point = np.concatenate([-_cross(turned), np.broadcast_to(np.eye(3), (len(turned), 3, 3))], axis=2)
    chained = side == "right" and estimate.left is not None
    if chained:
        rotation = _matrices(estimate.stereo[None, :3])[0]
        here = here @ rotation.T
        by_stereo_point = np.concatenate([-_cross(here), np.broadcast_to(np.eye(3), (len(here), 3, 3))], axis=2)
        here = here + estimate.stereo[3:]
        by_pose_point = rotation @ by_pose_point
    if not (here[:, 2] > _NEAREST_M).all():
        return None
    pixels, by_camera, by_point = _projected(camera, here)
    by_shared = np.zeros((len(here), 2, layout.count))
    by_shared[:, :, layout.side(side)] = by_camera
    if chained:
        by_shared[:, :, layout.stereo] = by_point @ by_stereo_point
    by_shared[:, :, layout.frozen] = 0.0
    return pixels, by_shared, by_point @ by_pose_point


def _matrices(rotvecs: F64) -> F64:
    return np.asarray(Rotation.from_rotvec(rotvecs).as_matrix(), dtype=np.float64)


def _cross(vectors: F64) -> F64:
    """(n, 3, 3) matrices [v]x."""
    out = np.zeros((len(vectors), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = vectors[:, 2], -vectors[:, 1], vectors[:, 0]
    return out


def _turned(vectors: F64, steps: F64) -> F64:
    """(n, 6) poses after (n, 6) steps: rotations from the left, translations added."""
    rotations = Rotation.from_rotvec(steps[:, :3]) * Rotation.from_rotvec(vectors[:, :3])
    return np.column_stack([rotations.as_rotvec(), vectors[:, 3:] + steps[:, 3:]])


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
    scale = _inverse_root(np.diag(matrix))
    solution, *_ = np.linalg.lstsq(matrix * np.outer(scale, scale), vector * scale, rcond=1e-14)
    return np.asarray(solution * scale, dtype=np.float64)


def _inverse_root(diagonal: F64) -> F64:
    """1 / sqrt, and 0 for what nothing depends on (frozen unknowns)."""
    known = diagonal > 0
    return np.asarray(np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0), dtype=np.float64)


def _moved(estimate: Estimate, shared: F64, poses: F64, layout: _Layout) -> Estimate | None:
    """The estimate after a step; None where it leaves the domain of a camera."""
    if not (np.isfinite(shared).all() and np.isfinite(poses).all()):
        return None
    try:
        left = None if estimate.left is None else with_parameters(estimate.left, shared[layout.left])
        right = None if estimate.right is None else with_parameters(estimate.right, shared[layout.right])
    except ValueError:
        return None
    stereo = estimate.stereo
    if layout.stereo.stop > layout.stereo.start:
        stereo = _turned(stereo[None], shared[None, layout.stereo])[0]
    return replace(estimate, left=left, right=right, stereo=stereo, poses=_turned(estimate.poses, poses))


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
    scale = _inverse_root(np.diag(reduced))
    scaled = np.linalg.pinv(reduced * np.outer(scale, scale), rcond=1e-15, hermitian=True)
    return np.asarray(scaled * np.outer(scale, scale) * squares / freedom, dtype=np.float64)
