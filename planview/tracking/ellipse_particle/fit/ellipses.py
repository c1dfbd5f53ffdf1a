"""Ellipses fitted to foreground: expectation-maximisation refined by Levenberg-Marquardt, one ellipse per object.

del-Blanco, Jaureguizar, Garcia 2012, section II. Their fitting is adapted from hierarchical silhouette fitting
(their reference [11]) with one ellipse per object and with sizes and orientations held near what objects have.
The paper gives no equations for it; the steps below are our choice:

1. a greedy cover of the foreground with ellipses of the expected size proposes how many objects there are;
2. expectation-maximisation of a mixture of ellipses moves them, with a prior on their covariance;
3. Levenberg-Marquardt matches the union of all soft ellipses to the mask, with priors on size and orientation,
   so that an object hidden in part keeps its full size (a merged region is explained by several ellipses);
4. an ellipse without which the others, refined again, explain as much is dropped (a split region keeps one ellipse).

Where people hide one another this is done twice, from nothing and from where known objects are expected, and in each
region the fit that explains more is kept: two who have merged stay two. On a floor, where bodies keep apart, an ellipse
that explains too little by itself is dropped.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64, U8
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit._cover import cover
from planview.tracking.ellipse_particle.fit._em import em_step
from planview.tracking.ellipse_particle.fit._lm import Match, Prior, refine
from planview.tracking.ellipse_particle.fit.explanation import SWEEPS, Judge, best_of, own_shares
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior

SIZE_LIMIT = 1.4
"""Largest ratio of a measured ellipse to the expected size, either way: three deviations of ``size_spread``, which are
``PlaneModel.looseness`` times as large."""
EM_STEPS = 4
"""Steps of expectation-maximisation. Our choice: the start is within a third of a width already."""
PRIOR_MASS = 0.5
"""Weight of the prior covariance in expectation-maximisation, in object areas. Our choice."""
SOFT_EDGE = 0.7
"""Width of an ellipse's logistic edge in the refinement [cells]. Our choice: a cell is covered within about two."""
STRAY = 0.02
"""Density of foreground that belongs to no ellipse, against that of an object of the middle row. Our choice."""
MAX_ELLIPSES = 64
"""Most ellipses per frame; a bound on time, not on what is expected."""


class EllipseFitParams(Params):
    """How foreground becomes ellipses, in the image and on the floor."""

    size_spread: float = Field(0.12, gt=0, le=1)
    """Standard deviation of the logarithm of an object's length and width from the prior. Our choice: the height of
    adults varies by 4 %, a walker's silhouette by about 10 % over a step."""
    background_weight: float = Field(0.4, ge=0, le=1)
    """Cost of covering a background cell, against 1 gained per foreground cell. Our choice: less than 1, because a
    silhouette fills only two thirds of its ellipse and detection leaves holes in people, seldom people in holes."""
    min_gain: float = Field(0.2, gt=0, lt=1)
    """Smallest gain that an ellipse must add on its own, as a share of its area. Our choice: a silhouette that fills
    two thirds gains 0.53, so a person hidden by half is still proposed, and a bag or a shadow of a third of a person
    is not."""
    known_gain: float = Field(0.05, ge=0, lt=1)
    """The same of a known object, where people hide one another: this frame alone need not prove that it is there. Our
    choice: a head beside another person."""
    cell_deviation: float = Field(0.7, gt=0, le=10)
    """Deviation of a cell's residual, correlation of neighbouring cells included. Our choice: a residual of 0.35 per
    cell (holes, limbs), the same over patches of 2 x 2 cells: 0.35 sqrt(4)."""


def fit_ellipses(
    mask: F32, prior: SizePrior, params: EllipseFitParams, plane: PlaneModel, known: F64 | None = None
) -> F64:
    """Fit one ellipse to each object in a foreground mask.

    Args:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        prior: size expected per row.
        params: weights.
        plane: directions and distances that are possible.
        known: (K, 5) where known objects are expected, as the result; none by default.
    Returns:
        (N, 5) float64: x, y, half length, half width [cells], angle of the length axis from the +row direction [rad].
    Raises:
        ValueError: mask is not (R, C) float32.
    """
    if mask.ndim != 2 or mask.dtype != np.float32:
        raise ValueError(f"expected a (R, C) float32 mask, got {mask.shape} {mask.dtype}")
    known = np.zeros((0, 5)) if known is None else known
    fresh = _fitted(mask, known[:0], prior, params, plane)
    if plane.separation > 0:
        return _needed(mask, _apart(mask, fresh, prior, params, plane), params)
    starts = [fresh, _fitted(mask, known, prior, params, plane)] if len(known) else [fresh]
    gains = params.min_gain, params.known_gain
    return best_of(
        Judge(mask, kernels.row_prefix(mask), prior, _about(params, plane), _match(params), *gains, known), starts
    )


def _fitted(mask: F32, known: F64, prior: SizePrior, params: EllipseFitParams, plane: PlaneModel) -> F64:
    """Known objects, and a greedy cover of what they leave, moved to the foreground."""
    score = mask - np.float32(params.background_weight) * (1 - mask)
    score[paint_union(known, mask.shape) > 0] = 0
    start = prior.rounded() if prior.any_direction else prior
    lengths = start.half_lengths(np.arange(mask.shape[0], dtype=np.float64))
    stride = max(1, round(0.4 * start.aspect * float(np.median(lengths))))
    accept = plane.proposal * params.min_gain
    found = np.concatenate([known, cover(score, lengths, start.aspect, stride, accept, MAX_ELLIPSES)])
    if len(found):
        _expect_and_maximise(mask, found, prior, params, plane)
        refine_ellipses(mask, found, prior, params, plane)
    return found


def refine_ellipses(mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams, plane: PlaneModel) -> None:
    """Levenberg-Marquardt refinement of (N, 5) ellipses against the mask, in place."""
    refine(mask, ellipses, np.arange(len(ellipses)), prior.law, _about(params, plane), _match(params), SWEEPS)


def _about(params: EllipseFitParams, plane: PlaneModel) -> Prior:
    # Length and width with a deviation of their own, and a common one that makes them so many times as loose.
    common = plane.looseness**2 - 1.0
    limit = plane.looseness * math.log(SIZE_LIMIT)
    return Prior(params.size_spread, plane.angle_spread, limit, plane.angle_limit, common / (1.0 + 2.0 * common))


def _match(params: EllipseFitParams) -> Match:
    return Match(params.cell_deviation, params.background_weight, SOFT_EDGE)


def _expect_and_maximise(
    mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams, plane: PlaneModel
) -> None:
    rows, cols = np.nonzero(mask)
    points = np.column_stack([cols, rows, mask[rows, cols]]).astype(np.float64)
    stray = STRAY / (math.pi * prior.half_length(mask.shape[0] / 2) ** 2 * prior.aspect)
    law = (prior.rounded() if prior.any_direction else prior).law
    for _ in range(EM_STEPS):
        em_step(points, ellipses, law, PRIOR_MASS, stray, plane.upright)
    a0 = prior.half_lengths(ellipses[:, 1])
    b0 = a0 * prior.aspect
    ratio = math.exp(_about(params, plane).size_limit)
    ellipses[:, 2] = np.clip(ellipses[:, 2], a0 / ratio, a0 * ratio)
    ellipses[:, 3] = np.clip(ellipses[:, 3], b0 / ratio, b0 * ratio)
    ellipses[:, 4] = np.clip(ellipses[:, 4], -plane.angle_limit, plane.angle_limit)


def _apart(mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams, plane: PlaneModel) -> F64:
    """Drop the one that covers less of any two ellipses that are too close to be two objects; the rest is refined."""
    if len(ellipses) < 2:
        return ellipses
    prefix = kernels.row_prefix(mask)
    covered = np.array([kernels.ellipse_sum(prefix, *ellipse)[0] for ellipse in ellipses])
    distance_min = plane.separation * prior.half_lengths(ellipses[:, 1])
    kept: list[int] = []
    for k in np.argsort(-covered, kind="stable"):
        distance = np.hypot(*(ellipses[kept, :2] - ellipses[k, :2]).T)
        if (distance >= distance_min[k]).all():
            kept.append(int(k))
    apart = ellipses[sorted(kept)]
    if len(apart) < len(ellipses):
        refine_ellipses(mask, apart, prior, params, plane)
    return apart


def _needed(mask: F32, ellipses: F64, params: EllipseFitParams) -> F64:
    """Drop, one at a time, the ellipse that adds least, while it adds less than ``min_gain``."""
    prefix = kernels.row_prefix(mask)
    while len(ellipses):
        shares = own_shares(prefix, ellipses, params.background_weight)
        worst = int(np.argmin(shares))
        if shares[worst] >= params.min_gain:
            break
        ellipses = np.delete(ellipses, worst, axis=0)
    return ellipses


def paint_union(ellipses: F64, shape: tuple[int, int]) -> U8:
    """(R, C) uint8 mask, 1 inside any of the (N, 5) ellipses (the union of equation 7)."""
    mask = np.zeros(shape, dtype=np.uint8)
    kernels.paint(mask, ellipses, 1)
    return mask


def extent(ellipse: F64) -> tuple[float, float]:
    """Half width and half height [cells] of the upright box around an ellipse."""
    _, _, a, b, angle = (float(v) for v in ellipse)
    s, c = math.sin(angle), math.cos(angle)
    return math.hypot(a * s, b * c), math.hypot(a * c, b * s)
