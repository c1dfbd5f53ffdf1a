"""The floor in clouds of points: which plane it is, and exactly where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from calib.errors import WorkError
from calib.floor.plane_fit import Plane, Rays, cells, fit_plane
from calib.params import Params
from calib.rig import Floor, world_from_plane
from calib.types import F32, F64, I64, AnyArray, Bool

MIN_POINTS = 1000
"""With fewer points than this nothing is said."""

PARALLEL_DEG = 10.0
"""Normals closer than this are one direction: a small plane's own is known to a few degrees only."""
LEANING_DEG = -5.0
"""Below this tilt a camera leans backwards; an overhead mount is off by a few degrees."""

TRIPLES, SCORED = 250, 4000
"""Planes tried at a time and points that each is held against; bounds on time and memory."""


class FloorParams(Params):
    """What counts as a floor."""

    disparity_std_px: float = Field(default=0.15, gt=0, le=5)
    """Deviation of the background's disparity after medians [px]: what sub-pixel bias leaves (our choice)."""
    frame_noise: float = Field(default=3.0, ge=1, le=20)
    """Deviation of a single frame's disparity against that of the medians [1] (our choice: 0.45 px)."""
    inlier_sigmas: float = Field(default=3.0, gt=0.5, le=10)
    """Points within this many deviations lie on a plane: 99.7 % of Gaussian noise (our choice)."""
    min_height_m: float = Field(default=0.8, gt=0)
    """Lowest camera: below it people are taller than the view (our choice)."""
    max_height_m: float = Field(default=12.0, gt=0)
    """Highest camera: beyond it a person covers a few disparities at most (our choice)."""
    max_tilt_deg: float = Field(default=83.0, gt=0, lt=90)
    """Steepest view of a floor; beyond it the plane is a wall seen from above (our choice)."""
    min_tilt_deg: float = Field(default=-12.0, gt=-90, le=0)
    """An overhead camera may lean backwards by this much; beyond it the plane is a wall in front of a camera
    that hardly sees its floor (our choice)."""
    max_roll_deg: float = Field(default=30.0, gt=0, lt=90)
    """Cameras are mounted roughly upright (Zhang 2008, section 2, assumption 3: no significant roll)."""
    min_inlier_fraction: float = Field(default=0.05, gt=0, le=1)
    """Least share of the valid depth a floor covers (our choice: less is a shelf or a step)."""
    below_margin_m: float = Field(default=0.25, ge=0, le=2)
    """Points count as beneath a plane from here on [m]: lower than a seat, more than calibration warps (our choice)."""
    max_below_fraction: float = Field(default=0.2, gt=0, lt=1)
    """Points beneath the plane, against points on and beneath it: nothing is seen below a floor but errors of
    matching; below a table top or a plane through clutter much is. A parallel plane beneath that holds this share
    is the floor instead (our choice)."""
    max_blur_fraction: float = Field(default=0.5, gt=0, le=1)
    """Points just above the plane's layer of noise, in as thick a layer, against points on it: a flat surface ends
    sharply, a plane laid through clutter or a corner does not (our choice)."""
    min_sharpness: float = Field(default=0.56, ge=0, le=1)
    """Least share, of the points near a plane, within half that distance: 0.5 where points fill a volume, whose
    medians make a plane too; above 0.8 on a surface (our choice)."""
    n_candidates: int = Field(default=8, ge=1, le=50)
    """Planes looked for, largest first; a room has a floor, three walls and some furniture (our choice)."""
    ransac_iterations: int = Field(default=2000, ge=10)
    """Triples tried per candidate: one of 2000 hits a plane of 12 % of the remaining points with 97 % (our choice)."""
    fit_points: int = Field(default=400_000, ge=1000)
    """Points looked at over all frames, evenly thinned (our choice, for speed)."""
    edge_cells: float = Field(default=2.5, ge=0, le=20)
    """Floor this close to something on it is left out of the last fits, in cells (our choice: 25 px at 640 px, what
    semi-global matching smooths over)."""
    cells_across: int = Field(default=64, ge=8, le=512)
    """Cells across the view whose medians are fitted (our choice: 10 px wide at 640 px)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A plane and what speaks for and against it.

    Attributes:
        plane: fitted plane.
        inlier_fraction: share of the points on it.
        below_fraction: share of the points beneath it.
        refused: why it cannot be the floor; empty when it can.
    """

    plane: Plane
    inlier_fraction: float
    below_fraction: float
    refused: str


def find_floor(
    clouds: Sequence[F32],
    *,
    focal_px: float | None = None,
    baseline_m: float | None = None,
    sigma_z: Sequence[F32] | None = None,
    params: FloorParams | None = None,
) -> Floor:
    """The floor plane common to many frames.

    Candidates come from RANSAC; the floor is the lowest plane that a camera looking down with little roll
    could stand above, with next to nothing seen beneath it. It is refined by robust least squares in inverse depth.
    Medians over all frames in cells of the view are fitted, so that people who walk through do not count.

    Args:
        clouds: one (N, 3) array of points per frame [m], rectified left camera frame; rows with NaN are skipped.
        focal_px, baseline_m: of the rectified pair, for the depth noise; without them 1.5 % of the median.
        sigma_z: one (N,) array of depth deviations [m] per cloud; replaces the noise model.
        params: what counts as a floor.
    Returns:
        Floor with inlier fraction, residual, covariance and extent.
    Raises:
        WorkError: no floor is visible; the sentence says what was seen instead.
        ValueError: shapes do not fit.
    """
    params = params or FloorParams()
    points = _points(clouds, sigma_z, params)
    if len(points) < MIN_POINTS:
        raise WorkError(f"no floor found: only {len(points)} points with valid depth in {len(clouds)} frames")
    if sigma_z is None:
        noise = 0.01 * float(np.median(points.inverse))
        if focal_px is not None and baseline_m is not None:
            noise = params.disparity_std_px / (focal_px * baseline_m)
        points = Rays(points.rays, points.inverse, np.full(len(points), noise))
    candidates = floor_candidates(points, params)
    best = choose_floor(candidates, params)
    if best is None:
        raise WorkError(_nothing_found(candidates, len(clouds), params))
    return _floor(best, points, params)


def floor_candidates(points: Rays, params: FloorParams) -> list[Candidate]:
    """Planes in the points, largest first, each judged."""
    view, counts = cells(points, params.cells_across)
    rest = view
    found: list[Candidate] = []
    for _ in range(params.n_candidates):
        if len(rest) < max(3, 0.5 * params.min_inlier_fraction * len(view)):
            break
        guess = _ransac(rest, params)
        taken = np.abs(rest.residuals(guess)) < params.inlier_sigmas
        if taken.sum() < 0.5 * params.min_inlier_fraction * len(view):
            break
        rest = rest.where(~taken)
        rough = fit_plane(view, guess, params.inlier_sigmas)
        if rough is not None and not any(_same(rough, other.plane, view) for other in found):
            plane, view_on, counts = _refined(rough, points, params)
            found.append(_judge(plane, view_on, counts, _sharpness(plane, points, params), params))
    return found


def choose_floor(candidates: Sequence[Candidate], params: FloorParams) -> Candidate | None:
    """The floor among planes: the largest that a camera can stand above, and of parallel ones the lowest.

    A camera near the horizontal sees the wall in front as a camera leaning backwards sees its floor. Where both
    readings are open the upright camera is the likelier, so a plane that asks for leaning back gives way.
    """
    possible = [c for c in candidates if not c.refused]
    upright = [c for c in possible if c.plane.tilt_rad > math.radians(LEANING_DEG)]
    possible = upright or possible
    if not possible:
        return None
    largest = max(possible, key=lambda c: c.inlier_fraction)
    enough = largest.inlier_fraction * params.max_below_fraction / (1.0 - params.max_below_fraction)
    parallel = [
        c
        for c in possible
        if c.inlier_fraction >= enough
        and float(c.plane.normal @ largest.plane.normal) > math.cos(math.radians(PARALLEL_DEG))
    ]
    return max(parallel, key=lambda c: c.plane.distance_m)


def _refined(plane: Plane, points: Rays, params: FloorParams) -> tuple[Plane, Rays, I64]:
    """Fit again to cells without the points that the plane shows to be of something else."""
    gate = params.frame_noise * params.inlier_sigmas
    view, counts = cells(points, params.cells_across, plane.q, gate)
    for _ in range(2):
        inside = view.where(_away_from_edges(plane, view, params))
        plane = fit_plane(inside, plane.q, params.inlier_sigmas) or plane
        view, counts = cells(points, params.cells_across, plane.q, gate)
    return plane, view, counts


def _away_from_edges(plane: Plane, view: Rays, params: FloorParams) -> Bool:
    """(N,) which cells have nothing but floor around them: matching smooths what meets the floor into it."""
    residuals = view.residuals(plane.q)
    on, other = np.abs(residuals) < params.inlier_sigmas, residuals >= params.inlier_sigmas
    if not other.any():
        return np.ones(len(view), dtype=np.bool_)
    across = view.rays[:, 0].max() - view.rays[:, 0].min()
    distance, _ = cKDTree(view.rays[other, :2]).query(view.rays[:, :2])
    free = np.asarray(distance > params.edge_cells * across / params.cells_across)
    # A floor in small pieces is all edge: better fitted with them than not at all.
    return free if (on & free).sum() > 0.3 * on.sum() else np.ones(len(view), dtype=np.bool_)


def _sharpness(plane: Plane, points: Rays, params: FloorParams) -> float:
    """How points crowd on a plane before any median: share of those near it that are within half that distance."""
    gate = params.frame_noise * params.inlier_sigmas
    distance = np.abs(points.residuals(plane.q))
    return float((distance < gate / 2).sum() / max((distance < gate).sum(), 1))


def _judge(plane: Plane, view: Rays, counts: I64, sharpness: float, params: FloorParams) -> Candidate:
    residuals = view.residuals(plane.q)
    share = counts / counts.sum()
    on = float(share[np.abs(residuals) < params.inlier_sigmas].sum())
    below = float(share[_beneath(plane, view, params)].sum())
    above = float(share[(residuals > params.inlier_sigmas) & (residuals < 2 * params.inlier_sigmas)].sum())
    tilt, roll = math.degrees(plane.tilt_rad), math.degrees(plane.roll_rad)
    height = plane.distance_m
    refused = ""
    if not params.min_tilt_deg <= tilt <= params.max_tilt_deg or abs(roll) > params.max_roll_deg:
        refused = f"a wall or ceiling (tilt {tilt:.0f}, roll {roll:.0f} degrees)"
    elif not params.min_height_m <= height <= params.max_height_m:
        refused = f"{height:.2f} m from the camera (floors: {params.min_height_m:g}-{params.max_height_m:g} m)"
    elif on < params.min_inlier_fraction:
        refused = f"{on:.1%} of the depth lies on it (at least {params.min_inlier_fraction:.0%} needed)"
    elif below > params.max_below_fraction * (on + below):
        refused = f"{below:.0%} of the depth lies beneath it"
    elif above > params.max_blur_fraction * on or sharpness < params.min_sharpness:
        refused = "it only cuts through a surface that is not flat"
    return Candidate(plane, on, below, refused)


def _beneath(plane: Plane, view: Rays, params: FloorParams) -> Bool:
    """(N,) whether points are further beneath the plane than noise and a warped calibration explain."""
    depth_m = np.where(view.inverse > 0, (view.rays @ plane.q) / np.maximum(view.inverse, 1e-6) - 1.0, 0.0)
    far = depth_m * plane.distance_m > params.below_margin_m
    return np.asarray(far & (view.residuals(plane.q) < -params.inlier_sigmas))


def _floor(best: Candidate, points: Rays, params: FloorParams) -> Floor:
    plane = best.plane
    pose = world_from_plane(plane.normal, plane.distance_m)
    view, _ = cells(points, params.cells_across, plane.q, params.frame_noise * params.inlier_sigmas)
    inliers = view.where(np.abs(view.residuals(plane.q)) < params.inlier_sigmas)
    world = pose @ (inliers.rays / inliers.inverse[:, None])
    low, high = np.quantile(world[:, :2], (0.01, 0.99), axis=0)
    return Floor(
        pose,
        inlier_fraction=best.inlier_fraction,
        residual_m=float(np.sqrt(np.mean(world[:, 2] ** 2))),
        covariance=_pose_covariance(plane),
        extent_m=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
    )


def _pose_covariance(plane: Plane) -> F64:
    """Covariance of (height, tilt, roll) by central differences over q."""

    def values(q: F64) -> F64:
        moved = Plane(q, plane.scale, plane.covariance)
        return np.array([moved.distance_m, moved.tilt_rad, moved.roll_rad])

    step = 1e-6 * float(np.linalg.norm(plane.q))
    columns = [(values(plane.q + d) - values(plane.q - d)) / (2 * step) for d in step * np.eye(3)]
    jacobian = np.stack(columns, axis=1)
    return np.asarray(jacobian @ plane.covariance @ jacobian.T)


def _points(clouds: Sequence[F32], sigma_z: Sequence[F32] | None, params: FloorParams) -> Rays:
    """Valid points of all clouds, thinned evenly to what the fit looks at."""
    for cloud in clouds:
        if np.ndim(cloud) != 2 or np.shape(cloud)[1] != 3:
            raise ValueError(f"expected clouds of (N, 3) points, got {np.shape(cloud)}")
    if sigma_z is not None and [len(s) for s in sigma_z] != [len(c) for c in clouds]:
        raise ValueError("expected one depth deviation per point")
    stride = max(1, math.ceil(sum(len(c) for c in clouds) / params.fit_points))
    parts = [
        # Another offset per frame, so that every pixel is looked at in some frame.
        _rays(np.asarray(c)[i % stride :: stride], None if sigma_z is None else sigma_z[i][i % stride :: stride])
        for i, c in enumerate(clouds)
    ]
    if not parts:
        return Rays(np.empty((0, 3)), np.empty(0), np.empty(0))
    return Rays(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("rays", "inverse", "sigma")))


def _rays(cloud: AnyArray, sigma_z: AnyArray | None) -> Rays:
    valid = np.isfinite(cloud).all(axis=1) & (np.nan_to_num(cloud[:, 2]) > 1e-3)
    p = cloud[valid].astype(np.float64)
    z = p[:, 2]
    sigma = np.ones(len(p)) if sigma_z is None else np.maximum(np.asarray(sigma_z)[valid] / z**2, 1e-9)
    return Rays(np.stack([p[:, 0] / z, p[:, 1] / z, np.ones(len(p))], axis=1), 1.0 / z, sigma.astype(np.float64))


def _ransac(points: Rays, params: FloorParams) -> F64:
    """(3,) q of the plane with most points, in (x/z, y/z, 1/z), where planes stay planes.

    Ours, since open3d's tries its triples on several threads: which it tries, and so the floor, differed from run to
    run.
    """
    rng = np.random.default_rng(0)
    few = np.linspace(0, len(points) - 1, min(len(points), SCORED)).astype(np.int64)
    rays, inverse, sigma = points.rays[few], points.inverse[few], points.sigma[few]
    best, most = np.zeros(3), -1
    for _ in range(-(-params.ransac_iterations // TRIPLES)):
        three = rng.integers(0, len(points), (TRIPLES, 3))
        corners = points.rays[three]
        sound = np.abs(np.linalg.det(corners)) > 1e-9
        planes = np.linalg.solve(corners[sound], points.inverse[three][sound][..., None])[..., 0]
        held = (np.abs(planes @ rays.T - inverse) < params.inlier_sigmas * sigma).sum(axis=1)
        if len(held) and held.max() > most:
            best, most = planes[int(np.argmax(held))], int(held.max())
    return np.asarray(best, dtype=np.float64)


def _same(a: Plane, b: Plane, points: Rays) -> bool:
    """Whether two fits ran into the same plane: they differ by less than a deviation where they were seen."""
    near = np.abs(points.residuals(a.q)) < 3.0
    if not near.any():
        return True
    shift = points.rays[near] @ (a.q - b.q) / points.sigma[near]
    return bool(np.abs(shift).mean() < 1.0)


def _nothing_found(candidates: Sequence[Candidate], n_frames: int, params: FloorParams) -> str:
    if not candidates:
        return (
            f"no floor found in {n_frames} frames: no plane holds even "
            f"{0.5 * params.min_inlier_fraction:.1%} of the valid depth"
        )
    seen = "; ".join(
        f"plane with {c.inlier_fraction:.0%} of the depth: {c.refused}"
        for c in sorted(candidates, key=lambda c: -c.inlier_fraction)[:3]
    )
    return f"no floor found in {n_frames} frames ({seen})"
