"""Size of people in the image: given by a calibrated camera, or learned from regions that move (section II)."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from calib.carried import Carried
from calib.ground_camera import GroundCamera
from calib.types import F64, I32, I64, U8, Bool
from planview.tracking.body import HEIGHT_MEAN_M
from planview.tracking.matching import overlaps

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
REGIONS_MIN = 15
REGIONS_MAX = 600
"""Regions from which a size is learned, and the most that are kept, evenly thinned."""
FOOT, LENGTH, WIDTH, AREA, MAJOR, MINOR, LEAN, CUT = range(8)
"""Columns of regions: row of the feet, height, width and area in the image; lengths of both axes, cosine of twice the
angle of the longer one, and 1 where the border cuts the region."""


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
        return np.maximum(self.least, self.level + self.slope * rows)

    def cells_per_m(self, rows: F64) -> F64:
        """Cells per metre where an object is centred in rows, float64 of their shape."""
        return 2.0 * self.aspect / BREADTH_M * self.half_lengths(rows)

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
    middle = (feet + heads) / 2
    half = (feet - heads) / 2
    seen = np.isfinite(half) & (middle >= 0) & (middle < camera.height) & (half > 0.5)
    if camera.tilt_rad < math.radians(35.0) or np.count_nonzero(seen) < 2:
        return None
    slope, level = np.polyfit(middle[seen], half[seen], 1)
    if slope >= 1:
        return None
    return Size(float(level), max(0.0, float(slope)), float(half[seen].min()), ASPECT)


def height_of(camera: GroundCamera, floor: F64, top_row: float) -> float:
    """Height [m] above a floor position at which a vertical line meets an image row; NaN where there is none."""
    if not np.isfinite(floor).all():
        return math.nan
    heights = np.linspace(0.3, 2.5, 45)
    line = np.column_stack([np.broadcast_to(floor, (len(heights), 2)), heights])
    rows = camera.project(line)[:, 1]
    seen = np.isfinite(rows)
    if seen.sum() <= 1:
        return math.nan
    order = np.argsort(rows[seen])
    return float(np.interp(top_row, rows[seen][order], heights[seen][order]))


class SizeLearner(Carried):
    """Learns a line of length over the rows of the feet from regions that move and were there in the frame before.

    Lines through pairs of regions, and level ones, are judged by the density of all lengths: a whole region is one
    person, a group in depth (longer) or a piece (shorter); one that the border cuts is any part of somebody. Where
    regions lie in all directions, people are seen from straight above: they have the area of one, and one size.
    """

    def __init__(self) -> None:
        self._before: F64 = np.zeros((0, 4))
        self._regions: F64 = np.zeros((0, CUT + 1))
        self._frames = 0
        self._every = 1
        self._fitted_at = 0
        self._shape = (0, 0)

    def add(self, foreground: U8, motion: U8 | None) -> None:
        """Take the largest regions of the next frame, (H, W), 255 where it is; no motion where that is not known."""
        self._shape = foreground.shape[0], foreground.shape[1]
        new, self._before = find_regions(foreground, motion, self._before)
        self._frames += 1
        if self._frames % self._every == 0:
            self._regions = np.concatenate([self._regions, new])
        if len(self._regions) > REGIONS_MAX:
            self._regions = self._regions[::2]
            self._every *= 2

    @property
    def is_due(self) -> bool:
        """True if enough has been added since the last ``size`` that it may have changed."""
        return self._frames > 1.2 * self._fitted_at + 2

    def size(self, n_cols: int) -> tuple[Size, float] | None:
        """The size by all regions so far, in pixels of an image of so many columns, and the share of their area that
        has it; None while they are few."""
        self._fitted_at = self._frames
        if len(self._regions) < REGIONS_MIN:
            return None
        size, share = self._size_from_above() or fit_size(self._regions)
        return size.on(self._shape[1] / n_cols), share

    def _size_from_above(self) -> tuple[Size, float] | None:
        """Size of large people whose regions lie in all directions; None for upright or small ones."""
        whole = self._regions[self._regions[:, CUT] == 0]
        if len(whole) < REGIONS_MIN:
            return None
        slim = whole[:, MINOR] / whole[:, MAJOR]
        weights = np.sqrt(whole[:, AREA]) * (1.0 - slim) + 1e-9
        if np.average(whole[:, LEAN], weights=weights) >= UPRIGHT:
            return None
        discs = self._regions.copy()
        discs[:, [LENGTH, WIDTH]] = 2 * np.sqrt(discs[:, AREA, None] / (FILLED * math.pi))
        size, share = fit_size(discs, level_only=True)
        if size.level <= self._shape[0] / 10:
            return None
        aspect = float(np.median(slim))
        k = 1 / math.sqrt(aspect)
        return Size(k * size.level, 0.0, k * size.least, aspect, upright=False), share


class Line(NamedTuple):
    """A line of length over the row of the feet.

    Attributes:
        away: (N,) logarithms of the regions' lengths over those of the line, in deviations.
    """

    level: float
    slope: float
    away: F64

    @property
    def one(self) -> Bool:
        """(N,) true for the regions that are one person."""
        return np.abs(self.away) < 1.5


def fit_size(regions: F64, level_only: bool = False) -> tuple[Size, float]:
    """Fit the likeliest line of length over the row of the feet to regions; return the size, and the share of their
    area that is one person."""
    # Two side by side are wider for their length than most.
    ratio = regions[:, WIDTH] / regions[:, LENGTH]
    cut = regions[:, CUT] > 0
    regions = regions[cut | (ratio <= 1.6 * np.percentile(ratio, 30))]
    cut = regions[:, CUT] > 0
    length = regions[:, LENGTH]
    # The same place and length again adds less than another one.
    cells = regions[:, [FOOT, LENGTH]] // 4
    _, which, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    weight = np.sqrt(regions[:, AREA] / count[which.ravel()])
    line = _likeliest_line(regions, weight, level_only)
    one = line.one
    # foot = centre + length / 2
    k = 1 / (1 - line.slope / 2)
    whole = one & ~cut if (one & ~cut).any() else one
    filled = regions[whole, AREA] / (FILLED * math.pi / 4 * length[whole] ** 2)
    aspect = min(max(float(np.median(filled)), 0.2), 1.0)
    share = float(weight[one | (cut & (line.away < 0))].sum() / weight.sum())
    least = 0.4 * float(np.percentile(length[one], 5))
    return Size(k * line.level / 2, k * line.slope / 2, least, aspect), share


def _likeliest_line(regions: F64, weight: F64, level_only: bool) -> Line:
    """The candidate that explains all lengths best, refined by weighted regression."""
    foot = regions[:, FOOT]
    length = regions[:, LENGTH]
    cut = regions[:, CUT] > 0
    levels, rises = _candidate_lines(foot, length, cut, level_only)
    expected = np.maximum(levels[:, None] + rises[:, None] * foot, 1.0)
    best = int(np.argmax(log_density(length / expected, cut) @ weight))
    level = float(levels[best])
    slope = float(rises[best])
    for _ in range(3):
        line = Line(level, slope, np.log(length / np.maximum(level + slope * foot, 1.0)) / (math.sqrt(2) * SPREAD))
        near = weight * line.one * np.exp(-0.5 * line.away**2) + 1e-9
        x = np.average(foot, weights=near)
        y = np.average(length, weights=near)
        if slope > 0:
            spread = float(np.average((foot - x) ** 2, weights=near))
            slope = float(np.average((foot - x) * (length - y), weights=near) / max(spread, 1e-9))
            slope = min(max(slope, 0.0), 1.5)
        level = float(y - slope * x)
    return Line(level, slope, line.away)


def _candidate_lines(foot: F64, length: F64, cut: Bool, level_only: bool) -> tuple[F64, F64]:
    """Levels and slopes of lines: level ones through up to 40 regions, and those through pairs of these."""
    spread = np.linspace(0, len(foot) - 1, min(len(foot), 40)).astype(np.int64)
    chosen = np.argsort(foot, kind="stable")[spread]
    levels = length[chosen]
    rises = np.zeros(len(chosen))
    if level_only:
        return levels, rises
    i, j = (chosen[side] for side in np.triu_indices(len(chosen), 1))
    apart = (np.abs(foot[i] - foot[j]) > 20) & ~cut[i] & ~cut[j]
    i = i[apart]
    j = j[apart]
    steep = (length[i] - length[j]) / (foot[i] - foot[j])
    rising = (steep > 0) & (steep < 1.5)
    i = i[rising]
    steep = steep[rising]
    return np.concatenate([levels, length[i] - steep * foot[i]]), np.concatenate([rises, steep])


def log_density(ratio: F64, cut: Bool) -> F64:
    """(..., N) logarithm of the density of the logarithms of lengths over one person's, (..., N); any part of somebody
    may show of a region that the border cuts, (N,)."""
    away = np.log(ratio)
    std = math.sqrt(2) * SPREAD
    bell = np.exp(-0.5 * (away / std) ** 2)
    any_part = np.where(ratio < 1, ratio, bell)
    one = np.where(cut, any_part, bell / (math.sqrt(2 * math.pi) * std))
    return np.log(ONE * one + (1 - ONE) * 0.5 * np.exp(-np.abs(away)))


def find_regions(foreground: U8, motion: U8 | None, before: F64) -> tuple[F64, F64]:
    """Regions (N, 8) that move and continue one of the boxes (M, 4) before, and the boxes (K, 4) of all regions."""
    n_rows, n_cols = foreground.shape
    labels, numbers, boxes = _large_components(foreground)
    if not len(boxes) or not len(before):
        return np.zeros((0, CUT + 1)), boxes
    rows = []
    for number, box in zip(numbers, boxes, strict=True):
        left, top, width, height = map(int, box)
        window = slice(top, top + height), slice(left, left + width)
        own = ((labels[window] == number) & (foreground[window] > 0)).astype(np.uint8)
        area = np.count_nonzero(own)
        moves = motion is None or np.count_nonzero(own & motion[window]) >= 0.05 * area
        pole = area < max(24, 0.12 * height**2)
        change_of_light = width >= n_cols
        if moves and not pole and not change_of_light and _continues(box, before):
            cut = left <= 0 or top <= 0 or left + width >= n_cols or top + height >= n_rows
            rows.append((top + height, height, width, *_shape_of(own), float(cut)))
    return np.array(rows, dtype=np.float64).reshape(-1, CUT + 1), boxes


def _large_components(foreground: U8) -> tuple[I32, I64, F64]:
    """Labels (H, W) of connected regions, numbers of the largest ones, and their (K, 4) boxes left, top, width,
    height."""
    # A belt that looks like the wall parts nobody: gaps of a fortieth of the image are closed.
    gap = max(1, len(foreground) // 40)
    closed = cv2.morphologyEx(foreground, cv2.MORPH_CLOSE, np.ones((gap, 3), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    numbers = 1 + np.argsort(-areas, kind="stable")[:12]
    numbers = numbers[stats[numbers, cv2.CC_STAT_AREA] >= 24]
    return np.asarray(labels, np.int32), numbers, stats[numbers, :4].astype(np.float64)


def _continues(box: F64, before: F64) -> bool:
    """True if one of the boxes before was at the same place and of the same height."""
    alike = np.abs(np.log(box[3] / before[:, 3])) < np.log(1.25)
    same_place = overlaps(box[None], before)[0] > 0.3
    return bool((same_place & alike).any())


def _shape_of(mask: U8) -> tuple[float, float, float, float]:
    """Area of a mask, lengths of its axes, and cosine of twice the angle of the longer one."""
    moments = cv2.moments(mask, binaryImage=True)
    area = moments["m00"]
    across = moments["mu20"] / area
    down = moments["mu02"] / area
    half = math.hypot((down - across) / 2, moments["mu11"] / area)
    mean = (down + across) / 2 + 1 / 12
    major = 4 * math.sqrt(mean + half)
    minor = 4 * math.sqrt(max(mean - half, 1 / 12))
    return area, major, minor, (down - across) / 2 / max(half, 1e-9)
