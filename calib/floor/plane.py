"""Planes in clouds of points: fitted in inverse depth, and judged whether they are the floor.

A plane ``n . p + h = 0`` (n its unit normal towards the camera, h the camera's distance from it) divided by z reads
``1/z = q . (x/z, y/z, 1)`` with ``q = -n / h``. Disparity is proportional to 1/z, so least squares on this form
weighs every pixel by its disparity noise (1/sigma_z^2 in depth) and has no bias from the noise of z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.rig import world_from_plane
from calib.types import F64, I64, Bool

FLOOR_DISPARITY_STD_PX = 0.15
"""Deviation of the background's disparity after medians [px]: what sub-pixel bias leaves."""
FLOOR_BIAS_PX = 0.03
"""Deviation of the error that the disparities of a whole floor have in common [px]: of its middle and, one deviation
away from there, of its slopes. Lenses and a matcher's steps leave it (rendered pairs calibrated by boards: 0.03)."""
INLIER_SIGMAS = 3.0
"""Points within this many deviations lie on a plane: 99.7 % of Gaussian noise."""
FRAME_GATE_PX = 3.0 * INLIER_SIGMAS
"""The same in a single frame, whose disparity deviates three times as much as the medians (0.45 px)."""
MIN_INLIER_FRACTION = 0.025
"""Least share of the valid depth a floor covers (less is a shelf or a step)."""
SEEN_QUANTILE = 0.98
"""Share of the depth within which a floor is expected to be seen (the rest is a window, or wrong)."""
BELOW_MARGIN_M = 0.25
"""Points count as beneath a plane from here on [m]: lower than a seat, more than calibration warps."""
MAX_BLUR_FRACTION = 0.5
"""Points just above the plane's layer of noise, in as thick a layer, against points on it: a flat surface ends
sharply, a plane laid through clutter or a corner does not."""
MIN_SHARPNESS = 0.56
"""Least share, of the points near a plane, within half that distance: 0.5 where points fill a volume, whose
medians make a plane too; above 0.8 on a surface."""
PEOPLE_M = 2.4
"""People reach no higher [m] (Harville 2002, section 4: H_max)."""
MAX_HIGH_FRACTION = 0.25
"""Share of what moves that may be higher: errors of matching."""
CELLS_ACROSS = 64
"""Cells across the view whose medians are fitted (10 px wide at 640 px)."""


class FloorParams(Params):
    """Limits of what counts as a floor."""

    min_height_m: float = Field(default=0.8, gt=0, le=100)
    """Lowest camera: below it people are taller than the view."""
    max_height_m: float = Field(default=12.0, gt=0, le=100)
    """Highest camera: beyond it a person covers a few disparities at most."""
    max_tilt_deg: float = Field(default=105.0, gt=0, lt=120)
    """Flattest view of a floor: 90 degrees for a level camera, more for one that looks up."""
    min_tilt_deg: float = Field(default=-12.0, gt=-90, le=0)
    """An overhead camera may lean backwards by this much; beyond it the plane is a wall in front of a camera
    that hardly sees its floor."""
    max_roll_deg: float = Field(default=30.0, gt=0, lt=90)
    """Cameras are mounted roughly upright (Zhang 2008, section 2, assumption 3: no significant roll)."""
    max_below_fraction: float = Field(default=0.2, gt=0, le=0.5)
    """Points beneath the plane, against points on and beneath it: nothing is seen below a floor but errors of
    matching; below a table top or a plane through clutter much is. A parallel plane beneath that holds this share
    is the floor instead."""


TUKEY_C = 3.0
"""Cut of Tukey's biweight in deviations. The textbook's 4.685 lets the foot of a wall in; 3 costs a fifth of the
efficiency, which thousands of cells can afford."""
MAD_TO_SIGMA = 1.4826
MIN_WIDTH = 0.3
"""Residuals below this many predicted deviations always count, however clean the data."""
MAX_ASPECT = 16.0
"""Greatest height of a view over its width: points in a line would need cells without end."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Points as (N, 3) float64 rays (x/z, y/z, 1), (N,) inverse depths [1/m] and their predicted deviation [1/m]."""

    rays: F64
    inverse: F64
    sigma: F64

    def __len__(self) -> int:
        return len(self.inverse)

    def where(self, keep: Bool) -> Rays:
        return Rays(self.rays[keep], self.inverse[keep], self.sigma[keep])

    def residuals(self, q: F64) -> F64:
        """(N,) inverse-depth residuals of plane q in predicted deviations; positive is nearer than the plane."""
        return np.asarray((self.inverse - self.rays @ q) / self.sigma)


@dataclass(frozen=True, eq=False)
class Plane:
    """A fitted plane: (3,) q = -normal / distance [1/m], robust deviation of its inliers' residuals in predicted
    deviations, and (3, 3) covariance of q from the scatter between parts of the view."""

    q: F64
    scale: float
    covariance: F64

    @property
    def distance_m(self) -> float:
        """Distance of the camera centre from the plane [m]."""
        return float(1.0 / np.linalg.norm(self.q))

    @property
    def normal(self) -> F64:
        """(3,) unit normal towards the camera."""
        return np.asarray(-self.q * self.distance_m)

    @property
    def tilt_rad(self) -> float:
        """Angle of the optical axis from straight onto the plane, negative when the camera leans backwards."""
        n = self.normal
        return float(np.arctan2(-n[1], -n[2]))

    @property
    def roll_rad(self) -> float:
        """Angle of the camera's x axis above the plane."""
        return float(np.arcsin(np.clip(self.normal[0], -1.0, 1.0)))


class Cells:
    """Points of all frames in square cells of the view; cells with less than a tenth of the mean count are left out.

    Attributes:
        points: those in the cells.
        counts: (N,) of the points in each cell.
        places: (N, 2) row and column of each cell.
    """

    def __init__(self, points: Rays) -> None:
        xy = points.rays[:, :2]
        low, high = np.quantile(xy, (0.0005, 0.9995), axis=0)
        width, height = (high - low).tolist()
        step = max(width, height / MAX_ASPECT, 1e-9) / CELLS_ACROSS
        last = np.maximum(1, np.ceil((high - low) / step)).astype(np.int64) - 1
        column, row = np.clip(np.floor((xy - low) / step).astype(np.int64), 0, last).T
        number = row * CELLS_ACROSS + column
        counts = np.bincount(number)
        is_full = counts >= max(1.0, 0.1 * counts[counts > 0].mean())
        in_full = is_full[number]
        self.points = points.where(in_full)
        self.counts = counts[is_full]
        self.places = np.stack(np.divmod(np.flatnonzero(is_full), CELLS_ACROSS), axis=1)
        full_number = np.cumsum(is_full) - 1
        self._index: I64 = full_number[number[in_full]]
        # A row of a table for the points of each cell, and the place in it of each point.
        longest = self.counts.max()
        self._rows = np.full((len(self.counts), longest), np.inf)
        order = np.argsort(self._index, kind="stable")
        first = np.cumsum(self.counts) - self.counts
        before = np.arange(len(order)) - np.repeat(first, self.counts)
        self._place: I64 = np.empty(len(order), dtype=np.int64)
        self._place[order] = self._index[order] * longest + before
        self._rays = np.stack([self._mean(column) for column in self.points.rays.T], axis=1)
        self._sigma = self._mean(self.points.sigma)

    def _mean(self, value: F64) -> F64:
        """(N,) mean of a value of the points of each cell."""
        return np.asarray(np.bincount(self._index, value) / self.counts)

    def medians(self, q: F64 | None = None) -> Rays:
        """The median inverse depth of each cell.

        The median forgets people who pass and most matching errors, and leaves so little noise that a wall is distinct
        from the floor it stands on close to their corner. Where a plane q (3,) is known already, the medians are taken
        against it, so that a slope within a cell does no harm, and points beyond the gate are left out of cells that
        mostly show it: what passes is always nearer and would pull the median.
        """
        if q is None:
            return Rays(self._rays, self._medians(self.points.inverse), self._sigma)
        value = self.points.inverse - self.points.rays @ q
        is_near = np.abs(value) < FRAME_GATE_PX * self.points.sigma
        n_near = np.bincount(self._index[is_near], minlength=len(self.counts))
        shows_plane = n_near > 0.5 * self.counts
        is_used = is_near | ~shows_plane[self._index]
        medians = self._medians(np.where(is_used, value, np.inf))
        return Rays(self._rays, medians + self._rays @ q, self._sigma)

    def _medians(self, value: F64) -> F64:
        """(N,) upper median of the finite values of each cell."""
        table = self._rows.copy()
        table.ravel()[self._place] = value
        table.sort(axis=1)
        middle = np.isfinite(table).sum(axis=1) // 2
        return np.asarray(table[np.arange(len(table)), middle])


def fit_plane(points: Rays, q: F64) -> Plane | None:
    """Robust least squares from a first guess q (3,) (iteratively reweighted, Tukey's biweight); None when fewer than 3
    points support the plane or they lie on one line."""
    width = INLIER_SIGMAS
    weights = np.zeros(len(points))
    scale = np.nan
    for _ in range(25):
        residuals = points.residuals(q)
        distances = np.abs(residuals)
        is_near = distances < width
        if is_near.sum() < 3:
            return None
        # Feet, furniture and walls are all nearer than the floor: only the far side shows the noise.
        far = np.sort(distances[is_near & (residuals <= 0)])
        middle = far[(len(far) - 1) // 2 : len(far) // 2 + 1]
        scale = float(MAD_TO_SIGMA * middle.sum() / max(len(middle), 1))
        width = min(INLIER_SIGMAS, max(TUKEY_C * scale, MIN_WIDTH))
        weights = np.where(distances < width, (1.0 - (residuals / width) ** 2) ** 2, 0.0)
        weighted = points.rays * (weights / points.sigma**2)[:, None]
        normal_matrix = weighted.T @ points.rays
        if not np.isfinite(normal_matrix).all():
            return None
        if np.linalg.eigvalsh(normal_matrix)[0] <= 1e-12 * np.trace(normal_matrix):
            return None
        previous = q
        q = np.asarray(np.linalg.solve(normal_matrix, weighted.T @ points.inverse))
        changes = points.rays[is_near] @ (q - previous) / points.sigma[is_near]
        if np.abs(changes).max() < 1e-4:
            break
    is_used = weights > 0
    rays = points.rays[is_used]
    weights = weights[is_used] / points.sigma[is_used] ** 2
    scores = rays * (weights * (points.inverse[is_used] - rays @ q))[:, None]
    inverse_information = np.asarray(np.linalg.pinv((rays * weights[:, None]).T @ rays))
    return Plane(q, scale, sandwich(inverse_information, scores, rays[:, :2]))


def sandwich(inverse_information: F64, scores: F64, places: F64, parts: int = 6) -> F64:
    """(k, k) covariance of an estimate whose errors are alike within parts of the view, from (N, k)
    gradients of the points' halved squared residuals at (N, 2) places.

    The view is cut into parts x parts clusters: neighbouring disparities share a matching window and sub-pixel bias,
    clusters large compared with the window do not (Liang and Zeger 1986).
    """
    low = places.min(axis=0)
    extent = np.maximum(places.max(axis=0) - low, 1e-9)
    cell = np.clip((places - low) * (parts / extent), 0, parts - 1).astype(np.int64)
    index = cell[:, 0] * parts + cell[:, 1]
    sums = np.stack([np.bincount(index, column, parts * parts) for column in scores.T], axis=1)
    n = max(len(np.unique(index)), 2)
    return np.asarray(inverse_information @ (sums.T @ sums) @ inverse_information * n / (n - 1))


PARALLEL_DEG = 10.0
"""Normals closer than this are one direction: a small plane's own is known to a few degrees only."""
LEAST_COS = math.cos(math.radians(PARALLEL_DEG))
MIN_PATCH = 60
MIN_PATCHES = 3
"""Fewest points of a patch that moved, and fewest patches, that show where the vertical is."""
ELONGATED = 2.0
"""Least ratio of length to breadth of a patch that shows how a body stands: a standing person is three times as tall as
broad."""
PERSON_LENGTH_M = (0.5, PEOPLE_M)
PERSON_BREADTH_M = 0.15
"""Length and least breadth of what is seen of a person [m]: from head and chest behind a desk to the whole body. Longer
patches are several people, narrower ones edges of things that flicker."""
UPRIGHT_COS = math.cos(math.radians(45.0))
"""A patch stands along a vertical where the angle between them is less than 45 degrees."""
STANDING_ODDS = 9.0
"""Odds that a long patch of a person's size stands. One of ten lies: two people side by side, or a thing that is
carried."""
MIDDLES_STD_M = 0.25
"""Deviation of the heights of what is seen of people, in the middle: children, and legs behind desks [m]."""
DECISIVE = 0.3
"""Log-likelihood ratio by which a plane is a wall: people of whom half the points lie along it, or what varies twice as
much in height as people do."""
MIN_MOVED = 500
"""Points that must have moved before they speak against a plane: a fifth of a person in a few frames."""
MOUNT_M = (3.0, 1.4)
MOUNT_SPREAD = (0.35, 0.5)
"""Median height over floors of cameras that look straight down, from ceilings, and of level ones, on robots, shelves
and tripods [m], and the deviation of its logarithm; in between by the tilt."""
CEILING_M = (2.2, 3.5)
CEILING_ODDS = 3.0
"""Heights of rooms [m], and by how much a ceiling at one of them makes a floor likelier than two walls as far apart are
in the view of a camera that looks straight down."""
LEANING_DEG = -5.0
"""Below this tilt a camera leans backwards (an overhead mount is off by a few degrees)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted plane and what speaks for and against it: shares of the points on and beneath it, the share on it of
    those where it would be seen, with each point counted by how near it is (MSAC), and why it cannot be the floor;
    empty when it can."""

    plane: Plane
    inlier_fraction: float
    below_fraction: float
    closeness: float
    refused: str


@dataclass(frozen=True, eq=False)
class Moved:
    """Evidence of what moves between the frames, mostly people.

    Attributes:
        points: (M, 3) of the patches that are large enough [m]: smaller ones are mostly errors of matching.
        middles: (K, 3) of each patch that is large enough [m].
        axes: (K, 3) unit vectors along them; NaN where they are not much longer than broad, or not of a person's size.
        weights: (K,) shares of their points.
    """

    points: F64
    middles: F64
    axes: F64
    weights: F64

    @classmethod
    def of(cls, patches: Sequence[F64]) -> Moved:
        """Gather (N, 3) points [m] of patches, one for each thing in each frame."""
        large = [patch for patch in patches if len(patch) >= MIN_PATCH]
        middles = np.array([patch.mean(axis=0) for patch in large]).reshape(-1, 3)
        axes = np.array([long_axis(patch) for patch in large]).reshape(-1, 3)
        counts = np.array([len(patch) for patch in large])
        return cls(np.concatenate([np.empty((0, 3)), *large]), middles, axes, counts / max(counts.sum(), 1))

    def objection(self, plane: Plane, params: FloorParams) -> str:
        """Objection to a plane as the floor from what moves; empty without one."""
        if len(self.points) >= MIN_MOVED:
            heights_m = self.points @ plane.normal + plane.distance_m
            high = float(np.mean(heights_m > PEOPLE_M))
            if high > MAX_HIGH_FRACTION:
                return f"{high:.0%} of what moves is higher than people above it"
        if self.floor_to_wall(plane, params) < -DECISIVE:
            return "what moves does not stand on it but lies along it"
        return ""

    def floor_to_wall(self, plane: Plane, params: FloorParams) -> float:
        """Log-likelihood ratio of a plane as the floor to the plane as a wall, from what moves, taken as one
        observation.

        A wall seen straight on looks like a floor from above, but people stand along it, and walk towards it and away.
        Each reading has its own vertical. People are long along the true one and stay at one height along it; each
        patch counts by its points. Long things that lie along neither, as carried boards do, favour none.
        """
        vertical = vertical_of_wall(plane, params)
        if vertical is None:
            return math.inf
        if len(self.weights) < MIN_PATCHES:
            return 0.0
        is_standing = np.abs(self.axes @ plane.normal) > UPRIGHT_COS
        is_lying = np.abs(self.axes @ vertical) > UPRIGHT_COS
        standing_share = float(self.weights @ is_standing - self.weights @ is_lying)
        excess_m2 = self._variance_m2(vertical) - self._variance_m2(plane.normal)
        return math.log(STANDING_ODDS) * standing_share + excess_m2 / (2.0 * MIDDLES_STD_M**2)

    def _variance_m2(self, direction: F64) -> float:
        """Variance of the middles of the patches along a direction [m^2]."""
        along_m = self.middles @ direction
        return float(self.weights @ (along_m - self.weights @ along_m) ** 2)


def long_axis(points: F64) -> F64:
    """(3,) unit vector along the longest extent of (N, 3) points [m]; NaN where they are not much longer than broad, or
    not of a person's size."""
    variances, axes = np.linalg.eigh(np.cov(points.T))
    # Extents of an even spread with these variances.
    breadth_m, length_m = np.sqrt(12.0 * np.maximum(variances[1:], 0.0))
    is_person = PERSON_LENGTH_M[0] < length_m < PERSON_LENGTH_M[1] and breadth_m > PERSON_BREADTH_M
    if not is_person or length_m <= ELONGATED * breadth_m:
        return np.full(3, np.nan)
    return np.asarray(axes[:, 2])


def vertical_of_wall(plane: Plane, params: FloorParams) -> F64 | None:
    """(3,) unit vector of the vertical if a plane is a wall and no floor; None where no camera would be upright then.

    A level camera sees the wall ahead as one that looks straight down sees the floor, and the other way round.
    """
    tilt_deg = math.degrees(plane.tilt_rad)
    if params.max_tilt_deg - 90.0 < tilt_deg < params.min_tilt_deg + 90.0:
        return None
    return np.array([0.0, -math.cos(plane.tilt_rad), math.sin(plane.tilt_rad)])


def judge(plane: Plane, view: Rays, cells: Cells, moved: Moved, params: FloorParams) -> Candidate:
    """Judge a plane as the floor by the cells of the view, their medians against the plane, and what moves."""
    residuals = view.residuals(plane.q)
    share = cells.counts / cells.counts.sum()
    on = float(share[np.abs(residuals) < INLIER_SIGMAS].sum())
    # Further beneath the plane than noise and a warped calibration explain.
    plane_inverse = view.rays @ plane.q
    depth = np.where(view.inverse > 0, plane_inverse / np.maximum(view.inverse, 1e-6) - 1.0, 0.0)
    is_beneath = (depth * plane.distance_m > BELOW_MARGIN_M) & (residuals < -INLIER_SIGMAS)
    below = float(share[is_beneath].sum())
    is_above = (residuals > INLIER_SIGMAS) & (residuals < 2 * INLIER_SIGMAS)
    above = float(share[is_above].sum())
    # Where the plane is near enough to be seen: what a level camera sees of its floor is below the horizon.
    far = float(np.quantile(view.inverse, 1 - SEEN_QUANTILE))
    within = max(float(share[plane_inverse > far].sum()), on)
    # How points crowd on the plane before any median: share of those near it that are within half that distance.
    distance = np.abs(cells.points.residuals(plane.q))
    n_near = (distance < FRAME_GATE_PX).sum()
    n_close = (distance < FRAME_GATE_PX / 2).sum()
    sharpness = float(n_close / max(n_near, 1))
    refused = out_of_place(plane, params)
    if not refused and on < MIN_INLIER_FRACTION:
        refused = f"{on:.1%} of the depth lies on it (at least {MIN_INLIER_FRACTION:.0%} needed)"
    if not refused and below > params.max_below_fraction * (on + below):
        refused = f"{below:.0%} of the depth lies beneath it"
    if not refused and (above > MAX_BLUR_FRACTION * on or sharpness < MIN_SHARPNESS):
        refused = "it only cuts through a surface that is not flat"
    if not refused:
        refused = moved.objection(plane, params)
    nearness = np.maximum(1.0 - (residuals / INLIER_SIGMAS) ** 2, 0.0)
    closeness = float(share @ nearness) / max(within, 1e-9)
    return Candidate(plane, on, below, closeness, refused)


def in_place(q: F64, params: FloorParams) -> Bool:
    """(N,) mask of the planes of (N, 3) q that a camera can be above."""
    height = 1.0 / np.linalg.norm(q, axis=1)
    x, y, z = (-q * height[:, None]).T
    tilt = np.degrees(np.arctan2(-y, -z))
    roll = np.degrees(np.arcsin(np.clip(x, -1.0, 1.0)))
    is_tilt = (params.min_tilt_deg <= tilt) & (tilt <= params.max_tilt_deg)
    is_roll = np.abs(roll) <= params.max_roll_deg
    is_height = (params.min_height_m <= height) & (height <= params.max_height_m)
    return np.asarray(is_tilt & is_roll & is_height)


def out_of_place(plane: Plane, params: FloorParams) -> str:
    """Reason for which a camera cannot be above a plane; empty where it can."""
    height = plane.distance_m
    tilt = math.degrees(plane.tilt_rad)
    roll = math.degrees(plane.roll_rad)
    if not params.min_tilt_deg <= tilt <= params.max_tilt_deg or abs(roll) > params.max_roll_deg:
        is_turned = -88 < tilt < 0 and abs(roll) < params.max_roll_deg
        turned = ", or the floor of an upside-down camera" if is_turned else ""
        return f"a wall or ceiling{turned} (tilt {tilt:.0f}, roll {roll:.0f} degrees)"
    if not params.min_height_m <= height <= params.max_height_m:
        return f"{height:.2f} m from the camera (floors: {params.min_height_m:g}-{params.max_height_m:g} m)"
    return ""


def choose_floor(candidates: Sequence[Candidate], params: FloorParams) -> Candidate | None:
    """The floor among planes: the likeliest that a camera can stand above, and of parallel ones the lowest.

    Planes that fill the view where they would be seen are likely, those with something beneath less so. A camera that
    looks straight down hangs at the height of a ceiling rather than at twice that, a level one is low, and a room is
    2.2 to 3.5 m high, which distinguishes a wall seen straight on from the floor below an overhead camera.

    A camera near the horizontal sees the wall in front as a camera leaning backwards sees its floor. Where both
    readings are open the upright camera is the likelier, so a plane that asks for leaning back gives way.
    """
    possible = [candidate for candidate in candidates if not candidate.refused]
    if not possible:
        return None
    upright = [candidate for candidate in possible if math.degrees(candidate.plane.tilt_rad) > LEANING_DEG]
    upright = upright or possible
    likeliest = max(upright, key=lambda candidate: _log_likelihood(candidate, candidates))
    enough = likeliest.inlier_fraction * params.max_below_fraction / (1.0 - params.max_below_fraction)
    lowest = likeliest
    for candidate in upright:
        is_parallel = float(candidate.plane.normal @ likeliest.plane.normal) > LEAST_COS
        is_lower = candidate.plane.distance_m > lowest.plane.distance_m
        if is_parallel and is_lower and candidate.inlier_fraction >= enough:
            lowest = candidate
    return lowest


def doubt(chosen: Candidate, candidates: Sequence[Candidate], moved: Moved, params: FloorParams) -> str:
    """Doubt whether a plane seen straight on is a wall in front of a level camera, or the floor of a level camera a
    wall next to an overhead one; empty where that is settled.

    From straight above and straight ahead alone both readings are alike; what moves in front of the plane decides.
    """
    if moved.floor_to_wall(chosen.plane, params) > 0.0:
        return ""
    is_level = _is_level(chosen.plane)
    rivals_m = []
    for other in candidates:
        is_ambiguous = vertical_of_wall(other.plane, params) is not None
        if is_ambiguous and not other.refused and _is_level(other.plane) != is_level:
            rivals_m.append(other.plane.distance_m)
    if is_level and not rivals_m:
        return ""
    wall = "a wall next to a camera that looks straight down" if is_level else "a wall in front of a level camera"
    text = f"{wall} would look the same, and nothing moved that shows which it is"
    if not rivals_m:
        return text
    return f"{text}: another plane would be the floor {min(rivals_m):.2f} m below such a camera"


def _is_level(plane: Plane) -> bool:
    """True if a camera above a plane looks ahead rather than down."""
    return plane.tilt_rad > math.radians(45.0)


def _log_likelihood(candidate: Candidate, candidates: Sequence[Candidate]) -> float:
    plane = candidate.plane
    level = min(max(math.sin(plane.tilt_rad), 0.0), 1.0)
    down_m, level_m = MOUNT_M
    down_spread, level_spread = MOUNT_SPREAD
    spread = down_spread + level * (level_spread - down_spread)
    off = (math.log(plane.distance_m / down_m) - level * math.log(level_m / down_m)) / spread
    ceiling = math.log(CEILING_ODDS) if _has_ceiling(plane, candidates) else 0.0
    prior = ceiling - math.log(spread) - 0.5 * off * off
    return math.log(candidate.closeness) - candidate.below_fraction / candidate.inlier_fraction + prior


def _has_ceiling(plane: Plane, candidates: Sequence[Candidate]) -> bool:
    """True if another plane would be the ceiling of a room with this floor."""
    for other in candidates:
        is_opposite = float(other.plane.normal @ plane.normal) < -LEAST_COS
        height_m = plane.distance_m + other.plane.distance_m
        if is_opposite and CEILING_M[0] <= height_m <= CEILING_M[1]:
            return True
    return False


def refusal(candidates: Sequence[Candidate], n_frames: int) -> str:
    """Refusal of all planes as the floor: the plane most like one, what spoke against it, and how to accept it."""
    if not candidates:
        least = f"{0.5 * MIN_INLIER_FRACTION:.1%} of the valid depth"
        return f"no floor found in {n_frames} frames: no plane holds even {least}"

    def likeness(candidate: Candidate) -> tuple[bool, bool, float]:
        # What a camera could stand above comes first, whatever else speaks against it.
        is_wall = candidate.refused.startswith("a wall")
        return not is_wall, "moves" not in candidate.refused, candidate.inlier_fraction

    best = max(candidates, key=likeness)
    plane = best.plane
    tilt = math.degrees(plane.tilt_rad)
    roll = math.degrees(plane.roll_rad)
    reasons = [
        f"best plane, {plane.distance_m:.2f} m from the camera at tilt {tilt:.1f} and roll {roll:.1f} degrees with "
        f"{best.inlier_fraction:.0%} of the depth, refused: {best.refused}"
    ]
    for other in sorted(candidates, key=lambda candidate: -candidate.inlier_fraction)[:3]:
        if other is not best:
            reasons.append(f"plane with {other.inlier_fraction:.0%} of the depth: {other.refused}")
    text = f"no floor found in {n_frames} frames ({'; '.join(reasons)})"
    if abs(roll) > 60 or not -30 < tilt < 120:
        return text
    pose = ", ".join(world_from_plane(plane.normal, plane.distance_m).toml(digits=7))
    return f"{text}. If it is the floor, a world.toml with this line accepts it: world_SE3_left = {{ {pose} }}"
