"""The floor where it cannot be found by itself: from points given by hand, or from tracked people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError, WorkError
from calib.rig import Floor, world_from_plane
from calib.types import F64, I64, Bool

ADULT_HEIGHT_M = 1.72
ADULT_HEIGHT_STD_M = 0.09
"""Mean and deviation of adults' heights with shoes, women and men together (NCD-RisC 2016, rounded)."""
MIN_FEET = 8
"""Fewer observations of people say too little (our choice)."""


def floor_from_points(points: ArrayLike, name: str = "points") -> Floor:
    """The plane through points on the floor, by least squares; the camera is on its upper side.

    Args:
        points: (N, 3) [m], rectified left camera frame, N >= 3, not on one line.
        name: of their source, for messages.
    Returns:
        Floor with its residual; inlier fraction unknown.
    Raises:
        InputError: too few points, not finite, on a line, or a plane no camera stands above.
    """
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1:] != (3,) or len(p) < 3:
        raise InputError(f"{name}: expected three or more floor points, found {len(p)}")
    if not np.isfinite(p).all():
        raise InputError(f"{name}: expected finite floor points in metres, found NaN or infinity")
    centre = p.mean(axis=0)
    _, spread, axes = np.linalg.svd(p - centre)
    if spread[1] < 0.05 * max(spread[0], 1e-9) or spread[0] < 0.1:
        raise InputError(f"{name}: expected floor points that span a triangle, found them on one line or in one place")
    normal = axes[2] if axes[2] @ centre < 0 else -axes[2]
    height = float(-normal @ centre)
    if height < 0.1:
        raise InputError(f"{name}: expected a camera above the floor, found one {height:.2f} m above the points' plane")
    if abs(normal[0]) > math.sin(math.radians(60.0)):
        raise InputError(
            f"{name}: expected a floor, found a wall (the camera's x axis points "
            f"{math.degrees(math.asin(normal[0])):.0f} degrees out of the plane)"
        )
    residual = float(np.sqrt(np.mean(((p - centre) @ normal) ** 2)))
    return Floor(world_from_plane(normal, height), residual_m=residual)


@dataclass(frozen=True, eq=False)
class PeopleSeen:
    """Tracked people in the rectified left camera frame; a row without one of the points has NaN there.

    Attributes:
        track_id: (n,) int64.
        head_m: (n, 3) float64, top of the head [m].
        foot_m: (n, 3) float64, where a foot meets the floor [m].
    """

    track_id: I64
    head_m: F64
    foot_m: F64


def floor_from_people(people: PeopleSeen, start: Floor, name: str = "tracks") -> Floor:
    """Refine a floor that is hidden from where people's feet and heads are.

    Feet lie on the floor. Each person's head is at one height above it all along, that of an adult where no foot of
    theirs is ever seen (1.72 +- 0.09 m). Robust least squares over tilt, roll, height and every person's height.

    Args:
        people: observations spread over the floor.
        start: a first guess, e.g. by hand.
        name: of the observations' source, for messages.
    Raises:
        WorkError: too few observations, or in one place only.
    """
    heads: Bool = np.asarray(np.isfinite(people.head_m).all(axis=1))
    feet_seen: Bool = np.asarray(np.isfinite(people.foot_m).all(axis=1))
    used: Bool = np.asarray(heads | feet_seen)
    anywhere = np.where(feet_seen[:, None], people.foot_m, people.head_m)[used]
    if used.sum() < MIN_FEET:
        raise WorkError(f"{name}: expected at least {MIN_FEET} observations of people, found {int(used.sum())}")
    on_floor = (start.world_SE3_left @ anywhere)[:, :2]
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(on_floor.T)))
    if spread[0] < 0.15:
        raise WorkError(
            f"{name}: expected people all over the floor, found them within {2 * spread[0]:.2f} m of one line: "
            "tilt or roll cannot be told"
        )
    from scipy.optimize import least_squares  # half a second, and only people need it

    ids, person = np.unique(people.track_id, return_inverse=True)

    def residuals(values: F64) -> F64:
        normal = _normal(values[0], values[1])
        foot = (people.foot_m[feet_seen] @ normal + values[2]) / FOOT_STD_M
        head = (people.head_m[heads] @ normal + values[2] - values[3:][person[heads]]) / HEAD_STD_M
        return np.concatenate([foot, head, (values[3:] - ADULT_HEIGHT_M) / ADULT_HEIGHT_STD_M])

    up = start.world_SE3_left.rotation[2]
    first = [math.atan2(-up[1], -up[2]), math.asin(up[0]), start.height_m]
    found = least_squares(residuals, [*first, *[ADULT_HEIGHT_M] * len(ids)], loss="soft_l1")
    pose = world_from_plane(_normal(found.x[0], found.x[1]), float(found.x[2]))
    feet = (pose @ people.foot_m[feet_seen])[:, 2]
    covariance = np.linalg.pinv(found.jac.T @ found.jac)[:3, :3]
    order = [2, 0, 1]
    return Floor(
        pose,
        residual_m=float(np.sqrt(np.mean(np.minimum(np.abs(feet), 0.3) ** 2))) if len(feet) else math.nan,
        covariance=covariance[np.ix_(order, order)],
    )


FOOT_STD_M = 0.08
"""A foot's observed point is off by half a shoe and the noise of depth [m] (our choice)."""
HEAD_STD_M = 0.06
"""A head bobs by 2-3 cm when walking, plus the noise of depth [m] (our choice)."""


def _normal(tilt: float, roll: float) -> F64:
    return np.array(
        [math.sin(roll), -math.sin(tilt) * math.cos(roll), -math.cos(tilt) * math.cos(roll)],
    )


def parse_points(texts: Sequence[str]) -> tuple[F64, bool]:
    """Points as typed: ``u,v`` in pixels of the rectified left image or ``x,y,z`` in metres.

    Returns:
        (N, 2) or (N, 3) float64, and whether they are pixels.
    Raises:
        InputError: not numbers, or of both kinds.
    """
    rows = []
    for text in texts:
        try:
            row = [float(part) for part in text.replace(";", ",").split(",")]
        except ValueError:
            raise InputError(f"--points: expected u,v in pixels or x,y,z in metres, found {text!r}") from None
        if len(row) not in (2, 3) or not all(math.isfinite(v) for v in row):
            raise InputError(f"--points: expected u,v in pixels or x,y,z in metres, found {text!r}")
        rows.append(row)
    if len({len(row) for row in rows}) != 1:
        raise InputError("--points: expected all points in pixels or all in metres, found both")
    if len(rows) < 3:
        raise InputError(f"--points: expected three or more, found {len(rows)}")
    return np.array(rows), len(rows[0]) == 2
