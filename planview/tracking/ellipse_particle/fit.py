"""Ellipses fitted to foreground: expectation-maximisation refined by Levenberg-Marquardt, one ellipse per object.

del-Blanco, Jaureguizar, Garcia 2012, section II: their fitting is adapted from hierarchical silhouette fitting (their
reference [11]) with one ellipse per object and with sizes and orientations held near what objects have. The paper gives
no equations for it; the steps below are our choice. Each frame is fitted from nothing.
"""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64, U8
from planview.tracking.ellipse_particle import _kernels as kernels
from planview.tracking.ellipse_particle.size import Size

SIZE_SPREAD = 0.12
"""Deviation of the logarithm of an object's length and width from what is expected; at most three are measured. Our
choice: the height of adults varies by 7 %, a walker's silhouette by about 10 % over a step."""
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
STEPS = 3
"""Steps of expectation-maximisation, which starts within a third of a width, and rounds of Levenberg-Marquardt."""
SOFT_EDGE = 0.7
"""Width of an ellipse's logistic edge in the refinement [cells]. Our choice: a cell is covered within about two."""


def fit_ellipses(mask: F32, size: Size) -> F64:
    """Fit one ellipse to each object in a foreground mask; their number is estimated.

    Args:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        size: expected [cells].
    Returns:
        (N, 5) float64: x, y, half length, half width [cells], angle of the length axis from the +row direction [rad].
    """
    match = kernels.Match(CELL_DEVIATION, BACKGROUND_WEIGHT, SOFT_EDGE, SIZE_SPREAD, size.lean, 3.0)
    # Where directions are not known yet, a circle of the same area.
    round_off = 1.0 if size.upright else math.sqrt(size.aspect)
    half = round_off * size.half_lengths(np.arange(mask.shape[0], dtype=np.float64))
    aspect = size.aspect / round_off**2
    # 1. A greedy cover with ellipses of the expected size proposes objects.
    score = mask - np.float32(BACKGROUND_WEIGHT) * (1 - mask)
    stride = max(1, round(0.4 * aspect * float(np.median(half))))
    ellipses = kernels.cover(score, half, aspect, stride, MIN_GAIN / 2)
    if not len(ellipses):
        return np.asarray(ellipses)
    # 2. Expectation-maximisation of a mixture of ellipses moves them, with a prior on their covariance.
    expect_and_maximise(mask, ellipses, half, aspect, size.upright)
    expected = size.half_lengths(ellipses[:, 1])[:, None] * np.array([1.0, size.aspect])
    ratio = math.exp(match.limit * match.size_spread)
    ellipses[:, 2:4] = np.clip(ellipses[:, 2:4], expected / ratio, expected * ratio)
    # 3. The soft union of all ellipses is matched to the mask: who is hidden in part keeps a full size, so that a
    # merged region is explained by several.
    kernels.refine(mask, ellipses, size, match, STEPS)
    # 4. The ellipse that adds least is dropped while that is too little: a split region keeps one.
    n_before = len(ellipses)
    while len(ellipses):
        gains = own_gains(mask, ellipses, BACKGROUND_WEIGHT)
        if gains.min() >= MIN_GAIN:
            break
        ellipses = np.delete(ellipses, int(np.argmin(gains)), axis=0)
    if 0 < len(ellipses) < n_before:
        kernels.refine(mask, ellipses, size, match, STEPS)
    return np.asarray(ellipses)


def expect_and_maximise(mask: F32, ellipses: F64, half: F64, aspect: float, upright: bool) -> None:
    """Maximum posterior of a mixture of ellipses, each the two-sigma contour of a Gaussian, and uniform clutter.

    The prior of a covariance is that of the expected ellipse, and weighs as much as one object.

    Args:
        half: (R,) half length expected in each row.
        aspect: width over length expected.
        upright: length axes stay nearer the columns than the rows.
    """
    rows, cols = np.nonzero(mask)
    weight, x, y = mask[rows, cols].astype(np.float64), cols.astype(np.float64), rows.astype(np.float64)
    powers = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    for _ in range(STEPS):
        x, y, a, b, angle = ellipses.T
        s, c = np.sin(angle), np.cos(angle)
        qxx, qxy, qyy = (s / a) ** 2 + (c / b) ** 2, s * c * (a**-2 - b**-2), (c / a) ** 2 + (s / b) ** 2
        constant = qxx * x * x + 2 * qxy * x * y + qyy * y * y
        form = np.stack([constant, -2 * (qxx * x + qxy * y), -2 * (qxy * x + qyy * y), qxx, 2 * qxy, qyy])
        density = 2.0 / (math.pi * a * b) * np.exp(-2.0 * (powers @ form))
        clutter = 0.02 / (math.pi * float(half.mean()) ** 2 * aspect)
        share = density * (weight / (density.sum(axis=1) + clutter))[:, None]
        mass, sx, sy, sxx, sxy, syy = powers.T @ share
        mass = np.maximum(mass, 1e-9)
        ellipses[:, 0], ellipses[:, 1] = mx, my = sx / mass, sy / mass
        a0 = half[np.clip(np.round(my), 0, len(half) - 1).astype(np.int64)]
        b0 = a0 * aspect
        prior = math.pi * a0 * b0
        vxx = (4 * (sxx - mass * mx * mx) + prior * b0 * b0) / (mass + prior)
        vyy = (4 * (syy - mass * my * my) + prior * a0 * a0) / (mass + prior)
        vxy = 4 * (sxy - mass * mx * my) / (mass + prior)
        mean, spread = (vxx + vyy) / 2, np.hypot((vyy - vxx) / 2, vxy)
        lies = upright & (vyy < vxx)
        ellipses[:, 2] = np.sqrt(np.maximum(np.where(lies, vyy, mean + spread), 0.25))
        ellipses[:, 3] = np.sqrt(np.maximum(np.where(lies, vxx, mean - spread), 0.25))
        ellipses[:, 4] = np.where(lies, 0.0, np.arctan2(2 * vxy, vyy - vxx) / 2)


def own_gains(mask: F32, ellipses: F64, background_weight: float) -> F64:
    """(N,) gain of each ellipse over the union of the others, as a share of its area.

    Of an object that the border cuts only the part inside counts, or half of it all where less is inside.
    """
    inside = painted(ellipses, mask.shape).reshape(len(ellipses), -1)
    own = inside & (inside.sum(axis=0, dtype=np.uint8) == 1)
    gain = mask - np.float32(background_weight) * (1 - mask)
    area = np.maximum(inside.sum(axis=1, dtype=np.int64), 0.5 * np.pi * ellipses[:, 2] * ellipses[:, 3])
    return np.asarray(own.astype(np.float32) @ gain.ravel() / area, dtype=np.float64)


def painted(ellipses: F64, shape: tuple[int, int]) -> U8:
    """(N, R, C) uint8, 1 inside each of (N, 5) ellipses."""
    masks = np.zeros((len(ellipses), *shape), dtype=np.uint8)
    kernels.paint(ellipses, masks)
    return masks
