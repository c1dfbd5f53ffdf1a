"""Size of objects learned from isolated regions: a line of length against row, without any calibration."""

from __future__ import annotations

import cv2
import numpy as np

from calib.types import F32, F64
from planview.ellipses import SizePrior
from planview.tracking.ellipse_particle.params import SizeParams

PER_FRAME = 12
"""Largest regions kept of a frame; a frame full of specks must not outvote the others."""
KEPT = 600
"""Samples kept, evenly thinned; bounds time and memory."""
PAIRED = 40
"""Samples, evenly spread over the rows, between which lines are tried."""
WIDEST = 1.6
"""Two people side by side are at least so much wider for their length than one."""
TOLERANCE = 0.15
"""Relative error of a length that still agrees with a line: a step, and a mask with ragged edges."""


class SizeLearner:
    """Collects isolated regions for the first minute and fits the size prior of the paper's section II.

    Each region of a foreground mask that touches no border gives one sample: row of its box's centre, length, width
    and area. Lines through pairs of samples, and horizontal lines, are scored by the area of the regions whose length
    agrees within 15 %: specks are small, wide groups are left out, pieces scattered; so the consensus is a person. The
    width is a low percentile of width/length among those, since nothing as long as a person is narrower.
    """

    def __init__(self, params: SizeParams) -> None:
        self._params = params
        self._samples: F64 = np.zeros((0, 4))
        self._taken = 0
        self._next_fit = params.least_samples
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
        new = regions(mask)
        self._taken += len(new)
        self._samples = np.concatenate([self._samples, new])
        if len(self._samples) > KEPT:
            self._samples = self._samples[::2]
        if self._taken >= self._next_fit:
            # Fits grow rarer as the samples grow: each costs time, and changes less.
            self._next_fit = self._taken + max(4, self._taken // 6)
            self.prior = self._fit(mask.shape[0]) or self.prior
        return self.prior

    def _fit(self, n_rows: int) -> SizePrior | None:
        row, length, width, area = alone(self._samples).T
        chosen = np.argsort(row, kind="stable")[np.linspace(0, len(row) - 1, min(len(row), PAIRED)).astype(np.int64)]
        i, j = (chosen[k] for k in np.triu_indices(len(chosen), 1))
        apart = np.abs(row[i] - row[j]) > 0.1 * n_rows
        i, j = i[apart], j[apart]
        slope = np.maximum((length[i] - length[j]) / (row[i] - row[j]), 0.0)
        flat = chosen
        slopes = np.concatenate([np.zeros(len(flat)), slope])
        heights = np.concatenate([length[flat], length[i] - slope * row[i]])
        fitted = heights[:, None] + slopes[:, None] * row
        agree = np.abs(fitted - length) < TOLERANCE * np.maximum(fitted, 1.0)
        # A line has one more freedom than a constant: it must explain a tenth more.
        score = (agree @ area) * np.where(slopes > 0, 1.0, 1.1)
        inliers = agree[int(np.argmax(score))]
        if inliers.sum() < self._params.least_samples / 2:
            return None
        level, slope_of = line(row[inliers], length[inliers], area[inliers], tilted=bool(slopes[np.argmax(score)] > 0))
        aspect = np.percentile((width / length)[inliers], 30)
        least = max(1.0, 0.4 * float(np.percentile(length[inliers], 5)))
        return SizePrior(level / 2, slope_of / 2, float(np.clip(aspect, 0.15, 1.0)), least)


def regions(mask: F32) -> F64:
    """(N, 4) float64 row of the centre, length, width, area of the isolated regions of a mask [cells]."""
    n_rows, n_cols = mask.shape
    binary = (mask >= 0.5).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(binary, connectivity=8)
    left, top, width, height, area = stats[1:].T
    inner = (left > 0) & (top > 0) & (left + width < n_cols) & (top + height < n_rows)
    fits = (area >= 12) & (height <= n_rows / 2) & (width <= n_cols / 2)
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
