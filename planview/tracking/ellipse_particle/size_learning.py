"""Size of objects learned from isolated regions: a line of length against row, without any calibration."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64
from planview.foreground.blobs import find_blobs
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.params import ImagePlaneParams

MIN_SAMPLES = 4
"""Isolated regions needed before a learned size is used. Our choice: one person in four frames, or two in two."""
PER_FRAME = 12
"""Largest regions kept of a frame; a frame full of specks must not outvote the others."""
KEPT = 600
"""Samples kept, evenly thinned; bounds time and memory."""
PAIRED = 40
"""Samples, evenly spread over the rows, between which lines are tried."""
WIDEST = 1.6
"""Two people side by side are at least so much wider for their length than one."""
SPREAD = 0.1
"""Deviation of a person's length in the mask from the law, relative: a step, and ragged edges. Our choice."""
ROUNDING = 0.5
"""The same in cells: both ends are rounded. Our choice."""
GROUP, PIECE = 0.25, 0.15
"""Shares of regions that are several people behind one another, up to 2.5 times as long as one, and that are pieces of
one, shorter. Our choice; the rest is one person."""
CLUTTER = 1e-4
"""Density of lengths for everything else [1/cell]; bounds what one region can say against a line."""
STEEPEST = 1.5
"""Length gained per row, more than a camera 2 m above the floor sees: k / (1 - k/2), k = 1.7 m / 2 m."""
FILLED = 0.75
"""Share of its ellipse that a silhouette fills. Our choice: measured 0.7 to 0.8 on people walking in all directions."""
THINNEST = 0.2
"""Least width over length of a person from any side: 0.3 m of 1.7 m, and limbs. Thinner are poles and their shadows."""
AGREE = 1.5
"""Deviations within which a region is taken for one person."""


class SizeLearner:
    """Collects isolated regions for the first minute and fits the size prior of the paper's section II.

    Each region of a foreground mask that touches no border gives one sample: row of its box's centre, length, width
    and area. Lines through pairs of samples, and horizontal lines, are judged by the likelihood of all lengths: a
    region is one person (near the line), a group in depth (longer), a piece of a person (shorter) or something else;
    so people who cover one another do not raise the line, nor do split people lower it. Specks weigh less than people
    (square root of the area), and the same region seen again in the next frame less than a new one (square root of
    the number alike). The width comes from the area that single people fill, which varies less over a step than the
    width of their boxes.
    """

    def __init__(self, params: ImagePlaneParams) -> None:
        self._params = params
        self._samples: F64 = np.zeros((0, 4))
        self._frames = 0
        self._stride = 1
        self._taken = 0
        self._next_fit = MIN_SAMPLES
        self._closed = False
        self.prior: SizePrior | None = None

    def update(self, mask: F32, time_s: float) -> SizePrior | None:
        """Take the regions of one frame; returns the prior as learned so far, None while there is too little.

        Args:
            mask: (R, C) float32 foreground share of each cell.
            time_s: seconds since the first frame.
        """
        if self._closed:
            return self.prior
        self._closed = time_s > self._params.learn_s and self.prior is not None
        self._frames += 1
        if (self._frames - 1) % self._stride:
            return self.prior
        new = regions(mask)
        self._taken += len(new)
        self._samples = np.concatenate([self._samples, new])
        if len(self._samples) > KEPT:
            # From now on every second of the frames so far: old and new samples stay equally dense in time.
            self._samples, self._stride = self._samples[::2], 2 * self._stride
            self._taken, self._next_fit = self._taken // 2, self._next_fit // 2
        if self._taken >= self._next_fit:
            # Fits grow rarer as the samples grow: each costs time, and changes less.
            self._next_fit = self._taken + max(4, self._taken // 6)
            self.prior = self._fit(mask.shape[0]) or self.prior
        return self.prior

    def _fit(self, n_rows: int) -> SizePrior | None:
        samples = alone(self._samples)
        row, length, _, area = samples.T
        weight = weights(samples)
        levels, slopes = lines(row, length, n_rows)
        fitted = np.maximum(levels[:, None] + slopes[:, None] * row, 1.0)
        best = int(np.argmax(log_density(length, fitted) @ weight))
        inliers = np.abs(length - fitted[best]) < AGREE * deviation(fitted[best])
        if inliers.sum() < MIN_SAMPLES / 2:
            return None
        x, y, tilted = row[inliers], length[inliers], bool(slopes[best] > 0)
        nearness = np.exp(-0.5 * ((y - fitted[best][inliers]) / deviation(fitted[best][inliers])) ** 2)
        level, slope = line(x, y, weight[inliers] * nearness, tilted)
        aspect = np.median(area[inliers] / (FILLED * math.pi / 4 * y * y))
        least = max(1.0, 0.4 * float(np.percentile(y, 5)))
        return SizePrior(level / 2, slope / 2, float(np.clip(aspect, THINNEST, 1.0)), least)


def lines(row: F64, length: F64, n_rows: int) -> tuple[F64, F64]:
    """(level at row 0, slope) of the lines to be tried, (L,) each: horizontal ones, and rising ones through pairs."""
    chosen = np.argsort(row, kind="stable")[np.linspace(0, len(row) - 1, min(len(row), PAIRED)).astype(np.int64)]
    i, j = (chosen[k] for k in np.triu_indices(len(chosen), 1))
    apart = np.abs(row[i] - row[j]) > 0.1 * n_rows
    i, j = i[apart], j[apart]
    slope = (length[i] - length[j]) / (row[i] - row[j])
    rising = (slope > 0) & (slope < STEEPEST)
    i, slope = i[rising], slope[rising]
    levels = np.concatenate([length[chosen], length[i] - slope * row[i]])
    return levels, np.concatenate([np.zeros(len(chosen)), slope])


def deviation(fitted: F64) -> F64:
    """Standard deviation of one person's length [cells]."""
    return np.asarray(np.hypot(SPREAD * fitted, ROUNDING))


def log_density(length: F64, fitted: F64) -> F64:
    """Logarithm of the density of (N,) lengths where (..., N) are expected of one person."""
    sigma = deviation(fitted)
    one = np.exp(-0.5 * ((length - fitted) / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)
    group = ((length > fitted) & (length < 2.5 * fitted)) / (1.5 * fitted)
    piece = (length < fitted) / fitted
    return np.asarray(np.log((1 - GROUP - PIECE) * one + GROUP * group + PIECE * piece + CLUTTER))


def weights(samples: F64) -> F64:
    """(N,) what each sample counts: see ``SizeLearner``; alike are samples within 3 rows and 2 cells of length."""
    row, length, _, area = samples.T
    alike = np.stack([row // 3, length // 2])
    _, which, count = np.unique(alike, axis=1, return_inverse=True, return_counts=True)
    return np.asarray(np.sqrt(area / count[which.ravel()]))


def regions(mask: F32) -> F64:
    """(N, 4) float64 row of the centre, length, width, area of the isolated regions of a mask [cells]."""
    n_rows, n_cols = mask.shape
    blobs = find_blobs((mask >= 0.5).astype(np.uint8))
    left, top, width, height = blobs.box_px[1:].T
    area = blobs.area_px[1:]
    inner = (left > 0) & (top > 0) & (left + width < n_cols) & (top + height < n_rows)
    fits = (area >= 12) & (height <= n_rows / 2) & (width <= n_cols / 2)
    fits &= area >= THINNEST * FILLED * math.pi / 4 * height**2
    samples = np.column_stack([top + (height - 1) / 2, height, width, area])[inner & fits].astype(np.float64)
    return np.asarray(samples[np.argsort(-samples[:, 3], kind="stable")[:PER_FRAME]])


def alone(samples: F64) -> F64:
    """The samples that are not much wider for their length than most: groups side by side are left out."""
    ratio = samples[:, 2] / samples[:, 1]
    return np.asarray(samples[ratio <= WIDEST * np.percentile(ratio, 30)])


def line(x: F64, y: F64, weight: F64, tilted: bool) -> tuple[float, float]:
    """(level at x = 0, slope >= 0) of a weighted least-squares line; slope 0 unless tilted."""
    mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = np.average((x - mean_x) ** 2, weights=weight)
    slope = 0.0
    if tilted and spread > 1e-9:
        slope = max(0.0, float(np.average((x - mean_x) * (y - mean_y), weights=weight) / spread))
    return float(mean_y - slope * mean_x), slope
