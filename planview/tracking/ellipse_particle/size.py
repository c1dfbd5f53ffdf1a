"""Size of people in the image: given by a calibrated camera, or learned from regions that move (section II)."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.types import F64, U8, Bool
from planview.tracking.body import HEIGHT_MEAN_M
from planview.tracking.detections import overlaps

BREADTH_M = 0.55
"""Breadth of a person in an image, arms and stride included [m], whatever the angle: from shoulders to a stride."""
ASPECT = BREADTH_M / HEIGHT_MEAN_M
"""Width over length of a person whose length is given."""
SPREAD = 0.12
"""Deviation of the logarithm of an object's length and width from what is expected. Our choice: the height of adults
varies by 7 %, a walker's silhouette by about 10 % over a step."""
ONE = 0.6
"""Share of regions that are one person; others are longer (a group in depth) or shorter (pieces). Our choice."""
FILLED = 0.75
"""Share of its ellipse that a silhouette fills: 0.7 to 0.8 of people who walk in all directions."""
UPRIGHT = 0.4
"""Mean cosine of twice the angle of regions below which people point anywhere, as seen from straight above; of upright
walkers, a quarter of them in pairs side by side, it is 0.5. Our choice."""
FIRST, KEPT = 15, 600
"""Regions from which a size is learned, and the most that are kept, evenly thinned."""
FOOT, LENGTH, WIDTH, AREA, MAJOR, MINOR, LEAN, CUT = range(8)


class Size(NamedTuple):
    """Size expected of an ellipse, linear in the row of its centre, which is where people on a floor are seen.

    Attributes:
        level, slope: half length in row 0, and its growth per row.
        least: smallest half length: a line must not run on to nothing at the horizon.
        aspect: width over length.
        upright: length axes are near the columns; seen from straight above they point anywhere.
    """

    level: float
    slope: float
    least: float
    aspect: float
    upright: bool = True

    @property
    def lean(self) -> float:
        """Deviation of the length axis from the columns [rad]: 6 degrees of walkers, anything from straight above."""
        return math.radians(6.0) if self.upright else math.pi / 4

    @property
    def spread(self) -> F64:
        """(3,) deviations of ln length, ln width and angle from what is expected."""
        return np.array([SPREAD, SPREAD, self.lean])

    def half_lengths(self, rows: F64) -> F64:
        """Half lengths expected in rows, float64 of their shape."""
        return np.asarray(np.maximum(self.least, self.level + self.slope * rows))

    def cells_per_m(self, rows: F64) -> F64:
        """Cells per metre where an object is centred in rows, float64 of their shape."""
        return np.asarray(2.0 * self.aspect / BREADTH_M * self.half_lengths(rows))

    def on(self, scale: float) -> Size:
        """This size, in pixels, on a grid of cells of ``scale`` pixels; pixel and cell 0 share their corner."""
        shift = self.level + self.slope * (scale - 1) / 2
        return self._replace(level=shift / scale, least=max(1.0, self.least / scale))


def size_of_camera(camera: GroundCamera) -> Size | None:
    """Size [px] of a standing adult in the middle column, by the nearest line; None where nobody is seen upright, from
    less than 35 degrees off the vertical, or so low that people at all distances are centred in nearly one row."""
    feet = np.linspace(0.0, 2.0 * camera.height, 50)
    floor = camera.back_project(np.column_stack([np.full(50, (camera.width - 1) / 2), feet]))
    heads = camera.project(np.column_stack([floor, np.full(50, HEIGHT_MEAN_M)]))[:, 1]
    middle, half = (feet + heads) / 2, (feet - heads) / 2
    seen = np.isfinite(half) & (middle >= 0) & (middle < camera.height) & (half > 0.5)
    if camera.tilt_rad < math.radians(35.0) or np.count_nonzero(seen) < 2:
        return None
    slope, level = np.polyfit(middle[seen], half[seen], 1)
    return Size(float(level), max(0.0, float(slope)), float(half[seen].min()), ASPECT) if slope < 1 else None


def height_of(camera: GroundCamera, floor: F64, top_row: float) -> float:
    """Height [m] above a floor position at which a vertical line meets an image row; NaN where there is none."""
    heights = np.linspace(0.3, 2.5, 45)
    if not np.isfinite(floor).all():
        return math.nan
    rows = camera.project(np.column_stack([np.broadcast_to(floor, (len(heights), 2)), heights]))[:, 1]
    seen = np.isfinite(rows)
    order = np.argsort(rows[seen])
    return float(np.interp(top_row, rows[seen][order], heights[seen][order])) if seen.sum() > 1 else math.nan


class SizeLearner(Carried):
    """Learns a line of length over the rows of the feet from regions that move and were there in the frame before.

    Lines through pairs of regions, and level ones, are judged by the density of all lengths: a whole region is one
    person, a group in depth (longer) or a piece (shorter); one that the border cuts is any part of somebody. Where
    regions lie in all directions, people are seen from straight above: they have the area of one, and one size.
    """

    def __init__(self) -> None:
        self._before: F64 = np.zeros((0, 4))
        self._regions: F64 = np.zeros((0, CUT + 1))
        self._frames, self._every, self._fitted_at = 0, 1, 0
        self._shape = 0, 0

    def add(self, foreground: U8, motion: U8 | None) -> None:
        """Take the largest regions of the next frame, (H, W), 255 where it is; no motion where that is not known."""
        self._shape = foreground.shape[0], foreground.shape[1]
        new, self._before = regions(foreground, motion, self._before)
        self._frames += 1
        if self._frames % self._every == 0:
            self._regions = np.concatenate([self._regions, new])
        if len(self._regions) > KEPT:
            self._regions, self._every = self._regions[::2], 2 * self._every

    @property
    def is_due(self) -> bool:
        """Whether enough has been added since the last ``size`` that it may have changed."""
        return self._frames > 1.2 * self._fitted_at + 2

    def size(self, n_cols: int) -> tuple[Size, float] | None:
        """The size by all regions so far, in pixels of an image of so many columns, and the share of their area that
        has it; None while they are few."""
        self._fitted_at = self._frames
        if len(self._regions) < FIRST:
            return None
        size, share = self._from_above() or _fitted(self._regions)
        return size.on(self._shape[1] / n_cols), share

    def _from_above(self) -> tuple[Size, float] | None:
        """Of large people whose regions lie in all directions; None for upright or small ones."""
        whole = self._regions[self._regions[:, CUT] == 0]
        if len(whole) < FIRST:
            return None
        slim = whole[:, MINOR] / whole[:, MAJOR]
        if np.average(whole[:, LEAN], weights=np.sqrt(whole[:, AREA]) * (1.0 - slim) + 1e-9) >= UPRIGHT:
            return None
        discs = self._regions.copy()
        discs[:, [LENGTH, WIDTH]] = 2 * np.sqrt(discs[:, AREA, None] / (FILLED * math.pi))
        size, share = _fitted(discs, level_only=True)
        aspect = float(np.median(slim))
        k = 1 / math.sqrt(aspect)
        above = Size(k * size.level, 0.0, k * size.least, aspect, upright=False)
        return (above, share) if size.level > self._shape[0] / 10 else None


def _fitted(found: F64, level_only: bool = False) -> tuple[Size, float]:
    """The likeliest line of regions, and the share of their area that is one person."""
    # Two side by side are wider for their length than most.
    ratio = found[:, WIDTH] / found[:, LENGTH]
    found = found[(found[:, CUT] > 0) | (ratio <= 1.6 * np.percentile(ratio, 30))]
    foot, length, cut = found[:, FOOT], found[:, LENGTH], found[:, CUT] > 0
    # The same place and length again adds less than another one.
    _, which, count = np.unique(found[:, [FOOT, LENGTH]] // 4, axis=0, return_inverse=True, return_counts=True)
    weight = np.sqrt(found[:, AREA] / count[which.ravel()])
    chosen = np.argsort(foot, kind="stable")[np.linspace(0, len(foot) - 1, min(len(foot), 40)).astype(np.int64)]
    levels, rise = length[chosen], np.zeros(len(chosen))
    if not level_only:
        i, j = (chosen[k] for k in np.triu_indices(len(chosen), 1))
        i, j = (k[(np.abs(foot[i] - foot[j]) > 20) & ~cut[i] & ~cut[j]] for k in (i, j))
        steep = (length[i] - length[j]) / (foot[i] - foot[j])
        i, steep = i[(steep > 0) & (steep < 1.5)], steep[(steep > 0) & (steep < 1.5)]
        levels, rise = np.concatenate([levels, length[i] - steep * foot[i]]), np.concatenate([rise, steep])
    expected = np.maximum(levels[:, None] + rise[:, None] * foot, 1.0)
    best = int(np.argmax(log_density(length / expected, cut) @ weight))
    level, slope = float(levels[best]), float(rise[best])
    for _ in range(3):
        away = np.log(length / np.maximum(level + slope * foot, 1.0)) / (math.sqrt(2) * SPREAD)
        one = np.abs(away) < 1.5
        own = weight * one * np.exp(-0.5 * away**2) + 1e-9
        x, y = np.average(foot, weights=own), np.average(length, weights=own)
        if slope > 0:
            spread = np.average((foot - x) ** 2, weights=own)
            slope = float(np.average((foot - x) * (length - y), weights=own) / max(float(spread), 1e-9))
            slope = min(max(slope, 0.0), 1.5)
        level = float(y - slope * x)
    # foot = centre + length / 2
    k = 1 / (1 - slope / 2)
    whole = one & ~cut if (one & ~cut).any() else one
    aspect = float(np.median(found[whole, AREA] / (FILLED * math.pi / 4 * length[whole] ** 2)))
    share = float(weight[one | (cut & (away < 0))].sum() / weight.sum())
    least = 0.4 * float(np.percentile(length[one], 5))
    return Size(k * level / 2, k * slope / 2, least, min(max(aspect, 0.2), 1.0)), share


def log_density(ratio: F64, cut: Bool) -> F64:
    """(..., N) logarithm of the density of the logarithms of lengths over one person's, (..., N); any part of somebody
    may show of a region that the border cuts, (N,)."""
    away, std = np.log(ratio), math.sqrt(2) * SPREAD
    bell = np.exp(-0.5 * (away / std) ** 2)
    one = np.where(cut, np.where(ratio < 1, ratio, bell), bell / (math.sqrt(2 * math.pi) * std))
    return np.asarray(np.log(ONE * one + (1 - ONE) * 0.5 * np.exp(-np.abs(away))))


def regions(foreground: U8, motion: U8 | None, before: F64) -> tuple[F64, F64]:
    """Regions (N, 8) that move and continue one of the boxes (M, 4) before, and the boxes (K, 4) of all regions."""
    n_rows, n_cols = foreground.shape
    # A belt that looks like the wall parts nobody: gaps of a fortieth of the image are closed.
    closed = cv2.morphologyEx(foreground, cv2.MORPH_CLOSE, np.ones((max(1, n_rows // 40), 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    order = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")[:12]
    order = order[stats[order, cv2.CC_STAT_AREA] >= 24]
    boxes = stats[order, :4].astype(np.float64)
    if not len(boxes) or not len(before):
        return np.zeros((0, CUT + 1)), boxes
    alike = np.abs(np.log(boxes[:, None, 3] / before[None, :, 3])) < np.log(1.25)
    stays = ((overlaps(boxes, before) > 0.3) & alike).any(axis=1)
    rows = []
    for label, (left, top, width, height) in zip(order[stays], boxes[stays], strict=True):
        inside = (slice(int(top), int(top + height)), slice(int(left), int(left + width)))
        own = ((labels[inside] == label) & (foreground[inside] > 0)).astype(np.uint8)
        m = cv2.moments(own, binaryImage=True)
        still = motion is not None and np.count_nonzero(own & motion[inside]) < 0.05 * m["m00"]
        if still or m["m00"] < max(24, 0.12 * height**2) or width >= n_cols:  # a pole, a change of light
            continue
        across, down, mixed = (m[name] / m["m00"] for name in ("mu20", "mu02", "mu11"))
        half = math.hypot((down - across) / 2, mixed)
        mean = (down + across) / 2 + 1 / 12
        cut = left <= 0 or top <= 0 or left + width >= n_cols or top + height >= n_rows
        axes = 4 * math.sqrt(mean + half), 4 * math.sqrt(max(mean - half, 1 / 12))
        rows.append((top + height, height, width, m["m00"], *axes, (down - across) / 2 / max(half, 1e-9), cut))
    return np.array(rows, dtype=np.float64).reshape(-1, CUT + 1), boxes
