"""The normal equations of a bundle adjustment of board views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calib.board.model import SIDES, Estimate, Side, View, coefficient_names
from calib.camera import Camera
from calib.types import F64, I64

_NEAREST_M = 1e-6
"""A corner nearer to the image plane than this is behind the camera."""
_HUBER_SIGMAS = 3.0
"""Residuals beyond this many robust standard deviations pull linearly instead of squarely (our choice)."""


@dataclass(frozen=True)
class Layout:
    """Places of the shared unknowns in the normal equations, and those among them that are frozen."""

    left: slice
    right: slice
    stereo: slice
    count: int
    frozen: tuple[int, ...]

    def side(self, side: Side) -> slice:
        return self.left if side == "left" else self.right


@dataclass(frozen=True, eq=False)
class Seen:
    """All corners of one camera in a row: board points, pixels, the view of each, and each view's slice."""

    points: F64
    pixels: F64
    view: I64
    slices: tuple[tuple[int, slice], ...]


@dataclass(frozen=True, eq=False)
class System:
    """Normal equations at an estimate: shared block, and per view the mixed and the pose block."""

    shared: F64
    shared_gradient: F64
    mixed: F64
    pose: F64
    pose_gradient: F64
    cost: float
    errors: tuple[dict[Side, F64], ...]


def gather(views: Sequence[View], points: F64, side: Side) -> Seen:
    found = [(i, corners) for i, view in enumerate(views) if (corners := view.side(side)) is not None]
    counts = [len(corners.ids) for _, corners in found]
    ends = np.cumsum([0, *counts])
    slices = tuple((i, slice(int(a), int(b))) for (i, _), a, b in zip(found, ends[:-1], ends[1:], strict=True))
    empty = np.empty((0, 2))
    return Seen(
        points[np.concatenate([np.empty(0, dtype=np.int64), *(corners.ids for _, corners in found)])],
        np.concatenate([empty, *(corners.pixels for _, corners in found)]),
        np.repeat(np.array([i for i, _ in found], dtype=np.int64), counts),
        slices,
    )


def layout_of(estimate: Estimate) -> Layout:
    left = 0 if estimate.left is None else 4 + len(estimate.left.coefficients)
    right = 0 if estimate.right is None else 4 + len(estimate.right.coefficients)
    stereo = 6 if left and right else 0
    frozen = tuple(i for i, name in enumerate(parameter_names(estimate)) if name.split()[-1] in estimate.frozen)
    return Layout(
        slice(0, left),
        slice(left, left + right),
        slice(left + right, left + right + stereo),
        left + right + stereo,
        frozen,
    )


def parameter_names(estimate: Estimate) -> tuple[str, ...]:
    names: list[str] = []
    for side in SIDES:
        camera = estimate.camera(side)
        if camera is not None:
            names += [f"{side} {name}" for name in ("fx", "fy", "cx", "cy", *coefficient_names(camera))]
    if estimate.left is not None and estimate.right is not None:
        names += [f"{what} {axis}" for what in ("rotation", "translation") for axis in "xyz"]
    return tuple(names)


def linearise(seen: dict[Side, Seen], estimate: Estimate, layout: Layout, sigma: float) -> System:
    """Normal equations; an infinite cost where a corner would lie behind a camera."""
    n = len(estimate.poses)
    errors: tuple[dict[Side, F64], ...] = tuple({} for _ in range(n))
    system = System(
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


def _side(estimate: Estimate, side: Side, corners: Seen, layout: Layout) -> tuple[F64, F64, F64] | None:
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


def _weights(error: F64, sigma: float) -> tuple[F64, float]:
    """Huber weights of the points and their loss."""
    length = np.linalg.norm(error, axis=1)
    if not math.isfinite(sigma):
        return np.ones(len(error)), float((length**2).sum())
    limit = _HUBER_SIGMAS * sigma
    far = length > limit
    weight = np.where(far, limit / np.maximum(length, 1e-12), 1.0)
    return weight, float(np.where(far, 2 * limit * length - limit**2, length**2).sum())


def robust_sigma(errors: Sequence[dict[Side, F64]]) -> float:
    lengths = np.concatenate([np.linalg.norm(e, axis=1) for view in errors for e in view.values()])
    # The median of a Rayleigh distribution is 1.1774 sigma.
    return max(float(np.median(lengths)) / 1.1774, 1e-3)


def _matrices(rotvecs: F64) -> F64:
    return np.asarray(Rotation.from_rotvec(rotvecs).as_matrix(), dtype=np.float64)


def _cross(vectors: F64) -> F64:
    """(n, 3, 3) matrices [v]x."""
    out = np.zeros((len(vectors), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = vectors[:, 2], -vectors[:, 1], vectors[:, 0]
    return out


def turned(vectors: F64, steps: F64) -> F64:
    """(n, 6) poses after (n, 6) steps: rotations from the left, translations added."""
    rotations = Rotation.from_rotvec(steps[:, :3]) * Rotation.from_rotvec(vectors[:, :3])
    return np.column_stack([rotations.as_rotvec(), vectors[:, 3:] + steps[:, 3:]])
