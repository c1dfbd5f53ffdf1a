"""Ellipses fitted to foreground: expectation-maximisation refined by Levenberg-Marquardt, one ellipse per object.

del-Blanco, Jaureguizar, Garcia 2012, section II: their fitting is adapted from hierarchical silhouette fitting (their
reference [11]) with one ellipse per object and with sizes and orientations held near what objects have. The paper gives
no equations for it; the steps below are our choice. Each frame is fitted from nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from calib.types import F32, F64, I32, U8, Bool
from planview.tracking.ellipse_particle.size import Size

BACKGROUND_WEIGHT = 0.4
"""Cost of covering a background cell, against 1 gained per foreground cell. Our choice: less than 1, because a
silhouette fills only two thirds of its ellipse, and detection leaves holes in people."""
MIN_GAIN = 0.2
"""Smallest gain that an ellipse must add on its own, as a share of its area. Our choice: a silhouette that fills
two thirds gains 0.53, so a person hidden by half is measured, and a bag or a shadow of a third of a person is not.
"""
CELL_DEVIATION = 0.7
"""Deviation of a cell's residual, correlation of neighbouring cells included. Our choice: a residual of 0.35 per
cell (holes, limbs), the same over patches of 2 x 2 cells: 0.35 sqrt(4)."""
FIT_STEPS = 3
"""Steps of expectation-maximisation, which starts within a third of a width, and rounds of Levenberg-Marquardt."""
SOFT_EDGE = 0.7
"""Width of an ellipse's logistic edge in the refinement [cells]. Our choice: a cell is covered within about two."""
SOFT_CELLS = 3.0 * SOFT_EDGE
"""Beyond this from its edge an ellipse counts as over [cells]; 5 % are left there."""

Window = tuple[slice, slice]
"""Rows and columns of the grid."""


def fit_ellipses(mask: F32, size: Size) -> F64:
    """Fit one ellipse to each object in a foreground mask; their number is estimated.

    Args:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        size: expected [cells].
    Returns:
        (N, 5) float64: x, y, half length, half width [cells], angle of the length axis from the +row direction [rad].
    """
    # Where directions are not known yet, a circle of the same area.
    round_off = 1.0 if size.upright else math.sqrt(size.aspect)
    half = round_off * size.half_lengths(np.arange(mask.shape[0], dtype=np.float64))
    aspect = size.aspect / round_off**2
    # 1. A greedy cover with ellipses of the expected size proposes objects.
    ellipses = cover(mask, half, aspect)
    if not len(ellipses):
        return ellipses
    # 2. Expectation-maximisation of a mixture of ellipses moves them, with a prior on their covariance.
    expect_and_maximise(mask, ellipses, half, aspect, size.upright)
    # 3. The soft union of all ellipses is matched to the mask: who is hidden in part keeps a full size, so that a
    # merged region is explained by several.
    for ellipse in ellipses:
        ellipse[2:] = bound(ellipse, size)
    refine(mask, ellipses, size)
    # 4. The ellipse that adds least is dropped while that is too little: a split region keeps one.
    n_before = len(ellipses)
    while len(ellipses):
        gains = own_gains(mask, ellipses)
        if gains.min() >= MIN_GAIN:
            break
        ellipses = np.delete(ellipses, int(np.argmin(gains)), axis=0)
    if 0 < len(ellipses) < n_before:
        refine(mask, ellipses, size)
    return ellipses


def cover(mask: F32, half: F64, aspect: float) -> F64:
    """(N, 5) upright ellipses of the size expected in each row, (R,), where foreground less background is most.

    The sum is that of a box of an ellipse's area, as a share of its area in the grid, or of half of it where less is
    inside: what lies outside speaks for nothing.
    """
    n_rows, n_cols = mask.shape
    stride = max(1, round(0.4 * aspect * float(np.median(half))))
    y = np.arange(0, n_rows, stride)[:, None]
    x = np.arange(0, n_cols, stride)
    a = half[y]
    box_a = 0.5 * math.sqrt(math.pi) * a
    box_b = aspect * box_a
    top = nearest_edge(y + 0.5 - box_a, n_rows)
    bottom = nearest_edge(y + 0.5 + box_a, n_rows)
    left = nearest_edge(x + 0.5 - box_b, n_cols)
    right = nearest_edge(x + 0.5 + box_b, n_cols)
    area = np.maximum((bottom - top) * (right - left), 0.5 * math.pi * aspect * a * a)
    score = gain_of(mask)
    ellipses = np.zeros((0, 5))
    while True:
        total = cv2.integral(score, sdepth=cv2.CV_64F)
        share = (total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]) / area
        i, j = divmod(int(np.argmax(share)), len(x))
        if share[i, j] < MIN_GAIN / 2:
            return ellipses
        ellipses = np.vstack([ellipses, [x[j], y[i, 0], a[i, 0], aspect * a[i, 0], 0.0]])
        score[top[i, 0] : bottom[i, 0], left[i, j] : right[i, j]] = 0.0


def nearest_edge(at: F64 | F32, n: int) -> I32:
    """Nearest edge of the n cells of an axis."""
    return np.clip(np.rint(at), 0, n).astype(np.int32)


class Sums(NamedTuple):
    """Weighted sums over the cells that each of N ellipses accounts for."""

    mass: F64
    x: F64
    y: F64
    xx: F64
    xy: F64
    yy: F64


def expect_and_maximise(mask: F32, ellipses: F64, half: F64, aspect: float, upright: bool) -> None:
    """Maximum posterior of a mixture of ellipses, each the two-sigma contour of a Gaussian, and uniform clutter.

    The prior of a covariance is that of the ellipse expected in a row, (R,), and weighs as much as one object.
    """
    rows, cols = np.nonzero(mask)
    weight = mask[rows, cols].astype(np.float64)
    x = cols.astype(np.float64)
    y = rows.astype(np.float64)
    powers = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    clutter = 0.02 / (math.pi * float(half.mean()) ** 2 * aspect)
    for _ in range(FIT_STEPS):
        density = _densities(powers, ellipses)
        share = density * (weight / (density.sum(axis=1) + clutter))[:, None]
        _maximise(ellipses, Sums(*(powers.T @ share)), half, aspect, upright)


def _densities(powers: F64, ellipses: F64) -> F64:
    """(K, N) densities of N Gaussians at K cells, whose products of coordinates are (K, 6)."""
    x, y, a, b, angle = ellipses.T
    s = np.sin(angle)
    c = np.cos(angle)
    qxx = (s / a) ** 2 + (c / b) ** 2
    qxy = s * c * (a**-2 - b**-2)
    qyy = (c / a) ** 2 + (s / b) ** 2
    constant = qxx * x * x + 2 * qxy * x * y + qyy * y * y
    by_x = -2 * (qxx * x + qxy * y)
    by_y = -2 * (qxy * x + qyy * y)
    form = np.stack([constant, by_x, by_y, qxx, 2 * qxy, qyy])
    peak = 2.0 / (math.pi * a * b)
    return np.asarray(peak * np.exp(-2.0 * (powers @ form)))


def _maximise(ellipses: F64, sums: Sums, half: F64, aspect: float, upright: bool) -> None:
    """Move ellipses to the mean and the posterior covariance of their cells."""
    mass = np.maximum(sums.mass, 1e-9)
    x = sums.x / mass
    y = sums.y / mass
    a0 = half[np.clip(np.round(y), 0, len(half) - 1).astype(np.int64)]
    b0 = a0 * aspect
    prior = math.pi * a0 * b0
    vxx = (4 * (sums.xx - mass * x * x) + prior * b0 * b0) / (mass + prior)
    vyy = (4 * (sums.yy - mass * y * y) + prior * a0 * a0) / (mass + prior)
    vxy = 4 * (sums.xy - mass * x * y) / (mass + prior)
    mean = (vxx + vyy) / 2
    spread = np.hypot((vyy - vxx) / 2, vxy)
    lies = upright & (vyy < vxx)
    along = np.where(lies, vyy, mean + spread)
    across = np.where(lies, vxx, mean - spread)
    ellipses[:, 0] = x
    ellipses[:, 1] = y
    ellipses[:, 2] = np.sqrt(np.maximum(along, 0.25))
    ellipses[:, 3] = np.sqrt(np.maximum(across, 0.25))
    ellipses[:, 4] = np.where(lies, 0.0, np.arctan2(2 * vxy, vyy - vxx) / 2)


def refine(mask: F32, ellipses: F64, size: Size) -> None:
    """Levenberg-Marquardt of the union of (N, 5) soft ellipses against the mask, one at a time; in place.

    Residual of a cell: mask - (1 - prod_k (1 - inside_k)), weight 1 for foreground and BACKGROUND_WEIGHT for the rest.
    Size and angle have Gaussian priors around what is expected.
    """
    weight = np.asarray((mask + BACKGROUND_WEIGHT * (1.0 - mask)) / CELL_DEVIATION**2)
    outside = np.ones((len(ellipses), *mask.shape), np.float32)
    for free, ellipse in zip(outside, ellipses, strict=True):
        window = around(ellipse, mask.shape, SOFT_CELLS)
        free[window] = 1.0 - inside(ellipse, window)
    for k in [*range(len(ellipses))] * FIT_STEPS:
        window = around(ellipses[k], mask.shape, SOFT_CELLS)  # a step beyond it is judged by what is inside it
        others = np.delete(outside[:, *window], k, axis=0).prod(axis=0)
        cells = Surroundings(window, mask[window], weight[window], others)
        own = 1.0 - outside[k][window]
        moved = step(ellipses[k], own, cells, size)
        own_moved = inside(moved, window)
        if cost(moved, own_moved, cells, size) <= cost(ellipses[k], own, cells, size):
            ellipses[k] = moved
            outside[k] = 1.0
            outside[k][window] -= own_moved


class Surroundings(NamedTuple):
    """The cells that an ellipse reaches: their window, mask, weight, and what the other ellipses leave of them."""

    window: Window
    mask: F32
    weight: F64
    others: F32

    def residual(self, own: F64) -> F64:
        """Mask less the union with an ellipse that covers ``own`` of each cell."""
        return self.mask - 1.0 + self.others * (1.0 - own)


def cost(ellipse: F64, own: F64, cells: Surroundings, size: Size) -> float:
    """Sum of the squared residuals, and of the squared deviations of the ellipse from what is expected."""
    off = deviations(ellipse, size) / size.spread
    return float((cells.weight * cells.residual(own) ** 2).sum() + off @ off)


def step(ellipse: F64, own: F64, cells: Surroundings, size: Size) -> F64:
    """One step of Levenberg-Marquardt over x, y (at most 3 cells), ln a, ln b and the angle."""
    rows = (cells.others * slopes(ellipse, own, cells.window)).reshape(5, -1)
    gradient = rows @ (cells.weight * cells.residual(own)).ravel()
    curvature = (rows * cells.weight.ravel()) @ rows.T
    gradient[2:] -= deviations(ellipse, size) / size.spread**2
    curvature[2:, 2:] += np.diag(size.spread**-2)
    damping = np.diag(0.01 * curvature.diagonal() + 1e-3)
    change = np.linalg.solve(curvature + damping, gradient)
    moved = ellipse + np.clip(change, -3.0, 3.0)
    moved[2:4] = ellipse[2:4] * np.exp(change[2:4])
    moved[2:] = bound(moved, size)
    return np.asarray(moved)


def deviations(ellipse: F64, size: Size) -> F64:
    """(3,) of ln half length, ln half width and angle from what is expected."""
    half = float(size.half_lengths(ellipse[1]))
    return np.array([math.log(ellipse[2] / half), math.log(ellipse[3] / (half * size.aspect)), ellipse[4]])


def bound(ellipse: F64, size: Size) -> F64:
    """(3,) half length, half width and angle within three deviations of what is expected."""
    limits = 3.0 * size.spread
    length, width, angle = np.clip(deviations(ellipse, size), -limits, limits)
    half = float(size.half_lengths(ellipse[1]))
    return np.array([half * math.exp(length), half * size.aspect * math.exp(width), angle])


def slopes(ellipse: F64, own: F64, window: Window) -> F64:
    """(5, r, c) derivatives of ``inside``, which is ``own``, by x, y, ln a, ln b and the angle."""
    u, v = along_and_across(ellipse, window)
    _, _, a, b, angle = ellipse.tolist()
    s = math.sin(angle)
    c = math.cos(angle)
    steep = own * (1.0 - own) * b / SOFT_EDGE / np.maximum(np.hypot(u, v), 1e-6)
    by_x = u * s / a + v * c / b
    by_y = u * c / a - v * s / b
    by_angle = u * v * (a / b - b / a)
    return np.asarray(steep * np.stack([by_x, by_y, u * u, v * v, by_angle]))


def own_gains(mask: F32, ellipses: F64) -> F64:
    """(N,) gain of each ellipse over the union of the others, as a share of its area.

    Of an object that the border cuts only the part inside counts, or half of it all where less is inside.
    """
    masks = paint(ellipses, mask.shape).reshape(len(ellipses), -1)
    alone = masks & (masks.sum(axis=0, dtype=np.uint8) == 1)
    inside_area = masks.sum(axis=1, dtype=np.int64)
    area = np.maximum(inside_area, 0.5 * np.pi * ellipses[:, 2] * ellipses[:, 3])
    return np.asarray(alone.astype(np.float32) @ gain_of(mask).ravel() / area, dtype=np.float64)


def gain_of(mask: F32) -> F32:
    """Gain of covering each cell: foreground less background at its weight."""
    return mask - np.float32(BACKGROUND_WEIGHT) * (1 - mask)


def paint(ellipses: F64, shape: tuple[int, int]) -> U8:
    """(N, R, C) uint8, 1 in the cells whose centres lie inside each of (N, 5) ellipses."""
    masks = np.zeros((len(ellipses), *shape), dtype=np.uint8)
    for mask, ellipse in zip(masks, ellipses, strict=True):
        window = around(ellipse, shape)
        mask[window] = np.hypot(*along_and_across(ellipse, window)) < 1.0
    return masks


def find_uncovered(measured: U8, objects: U8, share: float) -> Bool:
    """(M,) measurements that have no object, of masks (M, R, C) and (N, R, C): objects cover less than a share of them,
    or leave as much next to them.

    One object that lies across two measurements covers enough of both, wherever it is. So each object is given the
    measurement that it covers most, and one that is left over has none when objects leave as much free of it and of
    those that they cover with it as they leave of an uncovered one. Our choice; the paper has no association.
    """
    from scipy.optimize import linear_sum_assignment  # half a second

    if not len(measured):
        return np.zeros(0, np.bool_)
    flat = measured.reshape(len(measured), -1)
    union = objects.any(axis=0).ravel()
    areas = np.maximum(flat.sum(axis=1), 1)
    uncovered = np.asarray((flat & union).sum(axis=1) < share * areas)
    if not 0 < len(objects) < len(measured):
        return uncovered
    covers = objects.reshape(len(objects), -1).astype(np.float32) @ flat.T.astype(np.float32)
    spare = ~uncovered
    _, given = linear_sum_assignment(covers, maximize=True)
    spare[given] = False
    for m in np.flatnonzero(spare):
        near = (covers[covers[:, m] > 0] > 0).any(axis=0)
        free = flat[near].any(axis=0) & ~union
        if np.count_nonzero(free) >= (1 - share) * areas[m]:
            uncovered[m] = True
            union = union | (flat[m] > 0)
    return uncovered


def inside(ellipse: F64, window: Window) -> F64:
    """Cover of cells by an ellipse: from 1 to 0 by a logistic edge ``SOFT_EDGE`` cells wide."""
    from scipy.special import expit  # a quarter of a second

    radius = np.hypot(*along_and_across(ellipse, window))
    return np.asarray(expit((1.0 - radius) * ellipse[3] / SOFT_EDGE))


def around(ellipse: F64, shape: tuple[int, int], margin: float = 0.0) -> Window:
    """Rows and columns of the grid that an ellipse, a margin wider [cells], reaches."""
    x, y, a, b, angle = ellipse.tolist()
    s = math.sin(angle)
    c = math.cos(angle)
    grow = 1.0 + margin / b
    rows = _cells_within(y, grow * math.hypot(a * c, b * s), shape[0])
    return rows, _cells_within(x, grow * math.hypot(a * s, b * c), shape[1])


def _cells_within(middle: float, reach: float, n: int) -> slice:
    """Cells of an axis of n within reach."""
    return slice(max(0, math.ceil(middle - reach)), max(0, min(n, math.floor(middle + reach) + 1)))


def along_and_across(ellipse: F64, window: Window) -> tuple[F64, F64]:
    """Places of cells along an ellipse's axes, in its half length and half width."""
    x, y, a, b, angle = ellipse.tolist()
    s = math.sin(angle)
    c = math.cos(angle)
    rows, cols = window
    dy = np.arange(rows.start, rows.stop)[:, None] - y
    dx = np.arange(cols.start, cols.stop) - x
    return (dx * s + dy * c) / a, (dx * c - dy * s) / b
