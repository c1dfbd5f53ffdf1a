"""The floor in clouds of points, from points given by hand, or from tracked people."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError, WorkError
from calib.floor import plane as planes
from calib.floor.plane import INLIER_SIGMAS, Candidate, Cells, FloorParams, Moved, Plane, Rays
from calib.people.model import ADULT_HEIGHT_M, ADULT_HEIGHT_STD_M
from calib.pose import SE3
from calib.rig import Floor, world_from_plane
from calib.types import F32, F64, I64, Bool

N_CANDIDATES = 8
"""Planes searched; a room has a floor, three walls and some furniture."""
RANSAC_ITERATIONS = 2000
"""Triples tried per candidate: one of 2000 hits a plane of 12 % of the remaining points with 97 %."""
FIT_POINTS = 400_000
"""Points used over all frames, evenly thinned (for speed)."""
EDGE_CELLS = (np.hypot(*np.mgrid[-2:3, -2:3]) <= 2.5).astype(np.uint8)
"""Floor this close to something on it is left out of the last fits: within 2.5 cells (25 px at 640 px, what
semi-global matching smooths over)."""
MIN_POINTS = 1000
"""Fewer points than this are not reported."""
SCORED = 1500
"""Points that each plane tried is compared with (for speed)."""


def find_floor(
    clouds: Sequence[F32],
    *,
    focal_px: float,
    baseline_m: float,
    sigma_z: Sequence[F32] | None = None,
    moved: Sequence[F64] = (),
    align: Callable[[Plane], Plane] | None = None,
    near: SE3 | None = None,
    params: FloorParams | None = None,
) -> Floor:
    """The floor plane common to many frames.

    Candidates come from RANSAC; the floor is the likeliest plane that a camera looking down with little roll could
    stand above, with next to nothing seen beneath it (``choose_floor``). It is refined by robust least squares in
    inverse depth. Medians over all frames in cells of the view are fitted: people who walk through do not count. Raises
    InputError: clouds of another shape. WorkError: no floor is visible; the message names what was seen instead.

    Args:
        clouds: one (N, 3) array of points per frame [m], rectified left camera frame; rows with NaN are skipped.
        focal_px, baseline_m: of the rectified pair, for the depth noise.
        sigma_z: one (N,) array of depth deviations [m] per cloud; replaces the noise model.
        moved: (M, 3) points of each patch that moves between the frames, mostly people [m].
        align: improves the plane that was chosen, e.g. by the images (see ``stereo.floor``).
        near: a floor that was there before; only planes about it are looked at.
        params: what counts as a floor.
    """
    shapes = [np.shape(cloud) for cloud in clouds]
    if {shape[1:] for shape in shapes} != {(3,)}:
        raise InputError(f"expected an (N, 3) array of points per frame, found {shapes[:3]}", argument="clouds")
    params = params or FloorParams()
    inverse_per_px = 1.0 / (focal_px * baseline_m)
    points = _thin_points(clouds, sigma_z, planes.FLOOR_DISPARITY_STD_PX * inverse_per_px)
    if len(points) < MIN_POINTS:
        raise WorkError(f"no floor found: only {len(points)} points with valid depth in {len(clouds)} frames")
    movement = Moved.of(moved)
    cells = Cells(points)
    guesses = _guesses(cells.medians(), params) if near is None else [-near.rotation[2] / near.translation[2]]
    candidates = floor_candidates(cells, guesses, params, movement)
    best = planes.choose_floor(candidates, params)
    if best is None:
        raise WorkError(planes.refusal(candidates, len(clouds)))
    if align is not None:
        best = replace(best, plane=align(best.plane))
    floor = _floor(best, cells, planes.FLOOR_BIAS_PX * inverse_per_px)
    return replace(floor, doubt=planes.doubt(best, candidates, movement, params))


def floor_candidates(cells: Cells, guesses: Iterable[F64], params: FloorParams, moved: Moved) -> list[Candidate]:
    """Planes in the points about guessed ones, (3,) q, each judged."""
    view = cells.medians()
    candidates: list[Candidate] = []
    for guess in guesses:
        rough = planes.fit_plane(view, guess)
        if rough is None or any(_same(rough, other.plane, view) for other in candidates):
            continue
        plane, against_plane = _refine(rough, cells)
        candidates.append(planes.judge(plane, against_plane, cells, moved, params))
    return candidates


def _guesses(view: Rays, params: FloorParams) -> Iterator[F64]:
    """Planes in points, (3,) q, about the likeliest first."""
    rest = view
    least = 0.5 * planes.MIN_INLIER_FRACTION * len(view)
    for number in range(2 * N_CANDIDATES):
        if len(rest) < max(3, least):
            break
        # Of what the largest planes leave, walls for the most part, only what may be a floor.
        allowed = None if number < N_CANDIDATES else params
        guess = _ransac(rest, allowed)
        distances = np.abs(rest.residuals(guess))
        if (distances < INLIER_SIGMAS).sum() < least:
            break
        yield guess
        # Planes cross: a third of the layer taken out leaves enough of a floor that this one cuts through.
        rest = rest.where(distances >= INLIER_SIGMAS / 3)


def _refine(plane: Plane, cells: Cells) -> tuple[Plane, Rays]:
    """Fit again to cells without the points that the plane shows to be of something else."""
    view = cells.medians(plane.q)
    for _ in range(2):
        inside = view.where(_away_from_edges(plane, cells, view))
        plane = planes.fit_plane(inside, plane.q) or plane
        view = cells.medians(plane.q)
    return plane, view


def _away_from_edges(plane: Plane, cells: Cells, view: Rays) -> Bool:
    """(N,) mask of cells with nothing but floor around them: matching smooths what meets the floor into it."""
    residuals = view.residuals(plane.q)
    is_on = np.abs(residuals) < INLIER_SIGMAS
    rows, columns = cells.places.T
    above = np.zeros((rows.max() + 1, planes.CELLS_ACROSS), np.uint8)
    above[rows, columns] = residuals >= INLIER_SIGMAS
    is_free: Bool = np.asarray(cv2.dilate(above, EDGE_CELLS)[rows, columns] == 0)
    # A floor in small pieces is all edge: better fitted with them than not at all.
    if (is_on & is_free).sum() <= 0.3 * is_on.sum():
        return np.ones(len(view), dtype=np.bool_)
    return is_free


def _floor(best: Candidate, cells: Cells, bias: float) -> Floor:
    """The floor that a plane is; ``bias`` of its inverse depth, which no number of points shows [1/m]."""
    plane = best.plane
    columns = []
    # Covariance of (height, tilt, roll) by central differences over q.
    step = 1e-6 * float(np.linalg.norm(plane.q))
    for change in step * np.eye(3):
        ahead = _height_and_angles(replace(plane, q=plane.q + change))
        behind = _height_and_angles(replace(plane, q=plane.q - change))
        columns.append((ahead - behind) / (2 * step))
    jacobian = np.stack(columns, axis=1)
    pose = world_from_plane(plane.normal, plane.distance_m)
    view = cells.medians(plane.q)
    inliers = view.where(np.abs(view.residuals(plane.q)) < INLIER_SIGMAS)
    # A bias of the middle of what is seen, and two slopes of it: narrow floors are known less well.
    biases = bias**2 * np.linalg.pinv(inliers.rays.T @ inliers.rays / len(inliers))
    world = pose @ (inliers.rays / inliers.inverse[:, None])
    low, high = np.quantile(world[:, :2], (0.01, 0.99), axis=0)
    return Floor(
        pose,
        inlier_fraction=best.inlier_fraction,
        residual_m=float(np.sqrt(np.mean(world[:, 2] ** 2))),
        covariance=np.asarray(jacobian @ (plane.covariance + biases) @ jacobian.T),
        extent_m=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
    )


def _height_and_angles(plane: Plane) -> F64:
    """(3,) height [m], tilt and roll [rad] of a camera above a plane."""
    return np.array([plane.distance_m, plane.tilt_rad, plane.roll_rad])


def _thin_points(clouds: Sequence[F32], sigma_z: Sequence[F32] | None, noise: float) -> Rays:
    """Valid points of all clouds, thinned evenly to what the fit looks at; ``noise`` is that of inverse depth without
    deviations."""
    stride = 1 + sum(map(len, clouds)) // FIT_POINTS
    points = _thin(clouds, stride)
    z = points[:, 2]
    is_valid = np.isfinite(points).all(axis=1) & (z > 1e-3)
    points = points[is_valid]
    z = z[is_valid]
    sigma = np.full(len(z), noise)
    if sigma_z is not None:
        sigma = np.maximum(_thin(sigma_z, stride)[is_valid] / z**2, 1e-9)
    return Rays(points / z[:, None], 1.0 / z, sigma)


def _thin(arrays: Sequence[F32], stride: int) -> F64:
    """Every so manieth row of all arrays."""
    # Another offset per frame, so that every pixel is used in some frame.
    parts = [array[number % stride :: stride] for number, array in enumerate(arrays)]
    return np.concatenate(parts).astype(np.float64)


def _ransac(points: Rays, floors: FloorParams | None) -> F64:
    """(3,) q of the likeliest plane, of those that may be ``floors``, in (x/z, y/z, 1/z), where planes stay planes.

    A point counts by how near it is (MSAC, Torr and Zisserman 2000): a plane that cuts through a floor and what stands
    on it is near to more points, but not as near. Not open3d's, whose threads give another floor from run to run.
    """
    rng = np.random.default_rng(0)
    triples = rng.integers(0, len(points), (RANSAC_ITERATIONS, 3))
    corners = points.rays[triples]
    is_sound = np.abs(np.linalg.det(corners)) > 1e-9
    inverses = points.inverse[triples][is_sound]
    guesses = np.linalg.solve(corners[is_sound], inverses[..., None])[..., 0]
    if floors is not None:
        guesses = guesses[planes.in_place(guesses, floors)]
    if not len(guesses):
        return np.zeros(3)
    few = np.linspace(0, len(points) - 1, min(len(points), SCORED)).astype(np.int64)
    equations = np.column_stack([points.rays, points.inverse])[few]
    equations /= INLIER_SIGMAS * points.sigma[few, None]
    unknowns = np.column_stack([guesses, np.full(len(guesses), -1.0)])
    # In single precision and in place: the largest array of the search.
    scores = unknowns.astype(np.float32) @ equations.T.astype(np.float32)
    scores *= scores
    np.subtract(np.float32(1.0), scores, out=scores)
    np.maximum(scores, np.float32(0.0), out=scores)
    return np.asarray(guesses[int(np.argmax(scores.sum(axis=1)))])


def _same(a: Plane, b: Plane, points: Rays) -> bool:
    """True if two fits ran into the same plane: they differ by less than a deviation where they were seen."""
    is_near = np.abs(points.residuals(a.q)) < 3.0
    if not is_near.any():
        return True
    shift = points.rays[is_near] @ (a.q - b.q) / points.sigma[is_near]
    return bool(np.abs(shift).mean() < 1.0)


MIN_FEET = 8
"""Fewer observations of people are too few."""


def floor_from_points(points: ArrayLike, name: str = "points", depth_std_m: ArrayLike | None = None) -> Floor:
    """The plane through (N, 3) points on the floor [m] in the rectified left camera frame, not on one line, by least
    squares; the camera is on its upper side. With a residual, and with a covariance where the (N,) standard deviation
    of each point's depth [m] is given; ``name`` is that of their source, for messages. Raises InputError: too few
    points, not finite, on a line, or a plane no camera stands above."""
    p = np.asarray(points, dtype=np.float64)
    if p.shape[1:] != (3,) or len(p) < 3:
        raise InputError(f"{name}: expected three or more floor points, found {len(p)}")
    if not np.isfinite(p).all():
        raise InputError(f"{name}: expected finite floor points in metres, found NaN or infinity")
    centre = p.mean(axis=0)
    _, spread, axes = np.linalg.svd(p - centre)
    normal = axes[2]
    if normal @ centre >= 0:
        normal = -normal
    height = float(-normal @ centre)
    out_deg = math.degrees(math.asin(normal[0]))
    problem = ""
    if spread[1] < 0.05 * max(spread[0], 1e-9) or spread[0] < 0.1:
        problem = "floor points that span a triangle, found them on one line or in one place"
    elif height < 0.1:
        problem = f"a camera above the floor, found one {height:.2f} m above the points' plane"
    elif abs(out_deg) > 60.0:
        problem = f"a floor, found a wall (the camera's x axis points {out_deg:.0f} degrees out of the plane)"
    if problem:
        raise InputError(f"{name}: expected {problem}")
    residual = float(np.sqrt(np.mean(((p - centre) @ normal) ** 2)))
    pose = world_from_plane(normal, height)
    covariance = None
    if depth_std_m is not None:
        # Height of the floor at (x, y): height + y tilt + x roll, to first order.
        world = pose @ p
        design = np.column_stack([np.ones(len(p)), world[:, 1], world[:, 0]])
        estimate = np.linalg.pinv(design)
        height_std = np.asarray(depth_std_m) * np.abs(p @ normal) / p[:, 2]
        scatter = residual * math.sqrt(len(p) / max(len(p) - 3, 1))
        covariance = (estimate * np.maximum(height_std, scatter) ** 2) @ estimate.T
    return Floor(pose, residual_m=residual, covariance=covariance)


class PeopleSeen(NamedTuple):
    """Tracked people in the rectified left camera frame: (n,) ids, and (n, 3) tops of heads and places where a foot
    meets the floor [m], NaN where unknown."""

    track_id: I64
    head_m: F64
    foot_m: F64


def floor_from_people(people: PeopleSeen, start: Floor, name: str = "tracks") -> Floor:
    """Refine a floor that is hidden from where people's feet and heads are.

    Feet lie on the floor. Each person's head is at one height above it all along, that of an adult where no foot of
    theirs is ever seen. Robust least squares over tilt, roll, height and every person's height.
    """
    has_head: Bool = np.asarray(np.isfinite(people.head_m).all(axis=1))
    has_foot: Bool = np.asarray(np.isfinite(people.foot_m).all(axis=1))
    is_used: Bool = np.asarray(has_head | has_foot)
    n_used = int(is_used.sum())
    if n_used < MIN_FEET:
        raise WorkError(f"{name}: expected at least {MIN_FEET} observations of people, found {n_used}")
    points = np.where(has_foot[:, None], people.foot_m, people.head_m)[is_used]
    places = (start.world_SE3_left @ points)[:, :2]
    width_m = 2 * math.sqrt(np.linalg.eigvalsh(np.cov(places.T))[0])
    if width_m < 0.3:
        actual = f"them within {width_m:.2f} m of one line: tilt or roll cannot be determined"
        raise WorkError(f"{name}: expected people all over the floor, found {actual}")
    from scipy.optimize import least_squares  # half a second, and only people need it

    ids, numbers = np.unique(people.track_id, return_inverse=True)
    feet_m = people.foot_m[has_foot]
    heads_m = people.head_m[has_head]
    head_numbers = numbers[has_head]

    def residuals(values: F64) -> F64:
        tilt, roll, height = values[:3]
        heights = values[3:]
        normal = _normal(tilt, roll)
        foot = (feet_m @ normal + height) / FOOT_STD_M
        head = (heads_m @ normal + height - heights[head_numbers]) / HEAD_STD_M
        adult = (heights - ADULT_HEIGHT_M) / ADULT_HEIGHT_STD_M
        return np.concatenate([foot, head, adult])

    up = start.world_SE3_left.rotation[2]
    pose_values = [math.atan2(-up[1], -up[2]), math.asin(up[0]), start.height_m]
    result = least_squares(residuals, [*pose_values, *[ADULT_HEIGHT_M] * len(ids)], loss="soft_l1")
    pose = world_from_plane(_normal(result.x[0], result.x[1]), float(result.x[2]))
    foot_heights_m = (pose @ feet_m)[:, 2]
    residual_m = math.nan
    if len(foot_heights_m):
        residual_m = float(np.sqrt(np.mean(np.minimum(np.abs(foot_heights_m), 0.3) ** 2)))
    covariance = np.linalg.pinv(result.jac.T @ result.jac)
    height_tilt_roll = np.ix_([2, 0, 1], [2, 0, 1])
    return Floor(pose, residual_m=residual_m, covariance=covariance[height_tilt_roll])


FOOT_STD_M = 0.08
"""A foot's observed point is off by half a shoe and the noise of depth [m]."""
HEAD_STD_M = 0.06
"""A head bobs by 2-3 cm when walking, plus the noise of depth [m]."""


def _normal(tilt: float, roll: float) -> F64:
    return np.array([math.sin(roll), -math.sin(tilt) * math.cos(roll), -math.cos(tilt) * math.cos(roll)])
