"""Planes in inverse depth, where stereo noise is the same at every distance.

A plane ``n . p + h = 0`` (n its unit normal towards the camera, h the camera's distance from it) divided by z reads
``1/z = q . (x/z, y/z, 1)`` with ``q = -n / h``. Disparity is proportional to 1/z, so least squares on this form
weighs every pixel by its disparity noise (1/sigma_z^2 in depth) and has no bias from the noise of z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64, I64, Bool

TUKEY_C = 3.0
"""Cut of Tukey's biweight in deviations. The textbook's 4.685 lets the foot of a wall in; 3 costs a fifth of the
efficiency, which thousands of cells can afford (our choice)."""
MAD_TO_SIGMA = 1.4826
MIN_WIDTH = 0.3
"""Residuals below this many predicted deviations always count, however clean the data."""
MAX_ASPECT = 16.0
"""Greatest height of a view over its width: points in a line would need cells without end."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Points as rays and inverse depths.

    Attributes:
        rays: (N, 3) float64 (x/z, y/z, 1).
        inverse: (N,) float64 1/z [1/m].
        sigma: (N,) float64 predicted deviation of ``inverse`` [1/m].
    """

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
    """A fitted plane.

    Attributes:
        q: (3,) float64, -normal / distance [1/m].
        scale: robust deviation of its inliers' residuals, in predicted deviations.
        covariance: (3, 3) float64 of q, from the scatter between parts of the view.
    """

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


def cells(points: Rays, columns: int, q: F64 | None = None, gate: float = np.inf) -> tuple[Rays, I64]:
    """Median inverse depth in square cells of the view, over all frames.

    The median forgets people who pass and most matching errors, and leaves so little noise that a wall can be told
    from the floor it stands on close to their corner. Where a plane is known already, points beyond the gate are left
    out of cells that mostly show it: what passes is always nearer and would pull the median.

    Args:
        points: of any number of frames.
        columns: cells across the width of the view.
        q: (3,) plane against which the medians are taken; a slope within a cell then does no harm.
        gate: residuals from q that a point of the plane can have, in predicted deviations.
    Returns:
        One row per cell that holds at least a tenth of the mean count of points, and those counts.
    """
    index = _cell_of(points, columns)
    value = points.inverse if q is None else points.inverse - points.rays @ q
    n = int(index.max()) + 1
    counts = np.bincount(index, minlength=n)
    full = counts >= max(1.0, 0.1 * counts[counts > 0].mean())
    medians = _medians(index, value, n)
    if q is not None and np.isfinite(gate):
        near = np.abs(value) < gate * points.sigma
        mostly = np.bincount(index[near], minlength=n) > 0.5 * counts
        medians = np.where(mostly, _medians(index[near], value[near], n), medians)
    safe = np.maximum(counts, 1)
    rays = np.stack([np.bincount(index, points.rays[:, k], n) / safe for k in range(3)], axis=1)
    inverse = medians if q is None else medians + rays @ q
    return Rays(rays, inverse, np.bincount(index, points.sigma, n) / safe).where(full), counts[full]


def _cell_of(points: Rays, columns: int) -> I64:
    low, high = np.quantile(points.rays[:, :2], (0.0005, 0.9995), axis=0)
    width, height = (float(v) for v in high - low)
    step = max(width, height / MAX_ASPECT, 1e-9) / columns
    last = np.maximum(1, np.ceil((high - low) / step)).astype(np.int64) - 1
    place = np.clip(np.floor((points.rays[:, :2] - low) / step).astype(np.int64), 0, last)
    return np.asarray(place[:, 1] * columns + place[:, 0])


def _medians(index: I64, value: F64, n: int) -> F64:
    """(n,) upper median of the values of each index; NaN where there is none."""
    medians = np.full(n, np.nan)
    # Small integers are sorted by radix, twenty times as fast as pairs of index and value.
    order = np.argsort(index.astype(np.uint16) if n <= 1 << 16 else index, kind="stable")
    grouped, counts = value[order], np.bincount(index, minlength=n)
    ends = np.cumsum(counts)
    for i in np.flatnonzero(counts):
        group = grouped[ends[i] - counts[i] : ends[i]]
        medians[i] = np.partition(group, counts[i] // 2)[counts[i] // 2]
    return medians


def fit_plane(points: Rays, q: F64, gate: float, iterations: int = 25) -> Plane | None:
    """Robust least squares from a first guess (iteratively reweighted, Tukey's biweight).

    Args:
        points: rays and inverse depths.
        q: (3,) first guess.
        gate: residuals up to this many predicted deviations take part in the first step.
    Returns:
        The plane, or None when fewer than 3 points support it or they lie on one line.
    """
    width = gate
    weights = np.zeros(len(points))
    scale = np.nan
    for _ in range(iterations):
        r = points.residuals(q)
        near = np.abs(r) < width
        if near.sum() < 3:
            return None
        # Feet, furniture and walls are all nearer than the floor: only the far side shows the noise.
        far = r[near & (r <= 0)]
        scale = float(MAD_TO_SIGMA * np.median(-far)) if len(far) else 0.0
        width = min(gate, max(TUKEY_C * scale, MIN_WIDTH))
        weights = np.where(np.abs(r) < width, (1.0 - (r / width) ** 2) ** 2, 0.0)
        solved = _solve(points, weights)
        if solved is None:
            return None
        done = np.abs(points.rays[near] @ (solved - q) / points.sigma[near]).max() < 1e-4
        q = solved
        if done:
            break
    return Plane(q, scale, _cluster_covariance(points, weights, q))


def _solve(points: Rays, weights: F64) -> F64 | None:
    w = weights / points.sigma**2
    normal_matrix = (points.rays * w[:, None]).T @ points.rays
    if not np.isfinite(normal_matrix).all() or np.linalg.cond(normal_matrix) > 1e12:
        return None
    return np.asarray(np.linalg.solve(normal_matrix, (points.rays * w[:, None]).T @ points.inverse))


def _cluster_covariance(points: Rays, weights: F64, q: F64, parts: int = 6) -> F64:
    """Sandwich estimate with the view cut into parts x parts clusters.

    Neighbouring disparities share a matching window and sub-pixel bias, so counting them as independent would
    promise far too much; clusters large against the window do not share them (Liang and Zeger 1986).
    """
    w = weights / points.sigma**2
    bread = np.linalg.pinv((points.rays * w[:, None]).T @ points.rays)
    used = weights > 0
    cells = np.zeros(len(points), dtype=np.int64)
    for axis in (0, 1):
        low, high = np.quantile(points.rays[used, axis], (0.0, 1.0))
        step = max(high - low, 1e-9) / parts
        cells = cells * parts + np.clip((points.rays[:, axis] - low) / step, 0, parts - 1).astype(np.int64)
    scores = points.rays * (w * (points.inverse - points.rays @ q))[:, None]
    sums = np.stack([np.bincount(cells, scores[:, k], parts * parts) for k in range(3)], axis=1)
    n = max(int((np.bincount(cells[used], minlength=parts * parts) > 0).sum()), 2)
    return np.asarray(bread @ (sums.T @ sums) @ bread * n / (n - 1))
