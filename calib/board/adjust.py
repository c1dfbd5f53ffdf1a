"""Bundle adjustment of board views: both cameras, the transform between them and one board pose per view.

Board poses are eliminated view by view (Schur complement), so the cost grows linearly with the views.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.board.equations import (
    Layout,
    Seen,
    System,
    gather,
    layout_of,
    linearise,
    parameter_names,
    robust_sigma,
    turned,
)
from calib.board.model import SIDES, Adjusted, Estimate, Side, View
from calib.camera import Camera
from calib.types import F64

_MAX_ITERATIONS = 60
_CONVERGED = 1e-8
"""Relative fall of the cost below which the adjustment has converged."""
_SETTLED = 1e-3
_MAX_DAMPING = 1e10


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
    seen = {side: gather(views, points, side) for side in SIDES if start.camera(side) is not None}
    layout = layout_of(start)
    estimate, damping, sigma = start, 1e-3, math.inf
    system = linearise(seen, estimate, layout, sigma)
    for _ in range(max_iterations):
        if not math.isfinite(system.cost):
            break
        before = system.cost
        estimate, system, damping = _descend(seen, estimate, system, damping, sigma, fix_shared)
        fallen = 1.0 - system.cost / before if before > 0 else 0.0
        if math.isinf(sigma) and fallen < _SETTLED:
            sigma, damping = robust_sigma(system.errors), 1e-3
            system = linearise(seen, estimate, layout, sigma)
        elif fallen < _CONVERGED:
            break
    names = () if fix_shared else parameter_names(estimate)
    return Adjusted(estimate, system.errors, _covariance(system, layout, fix_shared), names)


def _descend(
    seen: dict[Side, Seen],
    estimate: Estimate,
    system: System,
    damping: float,
    sigma: float,
    fix_shared: bool,
) -> tuple[Estimate, System, float]:
    """One step downhill, damped until it is one; the same estimate when there is none."""
    layout = layout_of(estimate)
    while damping < _MAX_DAMPING:
        trial = _moved(estimate, *_step(system, damping, fix_shared), layout)
        candidate = None if trial is None else linearise(seen, trial, layout, sigma)
        if trial is not None and candidate is not None and candidate.cost < system.cost:
            return trial, candidate, max(damping / 10, 1e-12)
        damping *= 10
    return estimate, system, 1e-3


def _step(system: System, damping: float, fix_shared: bool) -> tuple[F64, F64]:
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


def _moved(estimate: Estimate, shared: F64, poses: F64, layout: Layout) -> Estimate | None:
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
        stereo = turned(stereo[None], shared[None, layout.stereo])[0]
    return replace(estimate, left=left, right=right, stereo=stereo, poses=turned(estimate.poses, poses))


def with_parameters(camera: Camera, change: F64) -> Camera:
    """The camera after adding to fx fy cx cy and the coefficients."""
    fx, fy, cx, cy = np.array([camera.fx, camera.fy, camera.cx, camera.cy]) + change[:4]
    distortion = tuple(float(k) for k in camera.coefficients + change[4:])
    return replace(camera, fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy), distortion=distortion)


def _covariance(system: System, layout: Layout, fix_shared: bool) -> F64:
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
