"""Ellipses fitted to foreground: expectation-maximisation refined by Levenberg-Marquardt, one ellipse per object.

del-Blanco, Jaureguizar, Garcia 2012, section II. Their fitting is adapted from hierarchical silhouette fitting
(their reference [11]) with one ellipse per object and with sizes and orientations held near what objects have.
The paper gives no equations for it; the steps below are our choice:

1. a greedy cover of the foreground with ellipses of the expected size proposes how many objects there are;
2. expectation-maximisation of a mixture of ellipses moves them, with a prior on their covariance;
3. Levenberg-Marquardt matches the union of all soft ellipses to the mask, with priors on size and orientation,
   so that an object hidden in part keeps its full size (a merged region is explained by several ellipses);
4. an ellipse that explains too little by itself is dropped (a split region keeps one ellipse).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64, U8
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit._cover import cover
from planview.tracking.ellipse_particle.fit._em import em_step
from planview.tracking.ellipse_particle.fit._lm import refine


class EllipseFitParams(Params):
    """How foreground becomes ellipses."""

    size_spread: float = Field(0.12, gt=0, le=1)
    """Standard deviation of the logarithm of an object's length and width from the prior. Our choice: the height of
    adults varies by 4 %, a walker's silhouette by about 10 % over a step."""
    angle_spread_deg: float = Field(6.0, gt=0, le=90)
    """Standard deviation of the length axis from the prior's direction [deg]. Our choice: lean of a walker."""
    size_limit: float = Field(1.4, gt=1, le=4)
    """Largest ratio to the expected size, either way (three deviations of size_spread)."""
    angle_limit_deg: float = Field(20.0, gt=0, le=90)
    """Largest angle from the prior's direction [deg] (three deviations of angle_spread_deg)."""
    background_weight: float = Field(0.4, ge=0, le=1)
    """Cost of covering a background cell, against 1 gained per foreground cell. Our choice: less than 1, because a
    silhouette fills only two thirds of its ellipse and detection leaves holes in people, seldom people in holes."""
    least_share: float = Field(0.2, gt=0, lt=1)
    """Least gain that an ellipse must add on its own, as a share of its area. Our choice: a silhouette that fills two
    thirds gains 0.53, so somebody hidden by half is still proposed, and a bag or a shadow of a third of a person is
    not."""
    proposed_share: float = Field(0.5, gt=0, le=1)
    """Part of ``least_share`` with which the cover proposes an ellipse: it is of the expected size on a coarse grid;
    fitted, it gains more of somebody who is smaller or strides. Our choice."""
    separation: float = Field(0.0, ge=0, le=4)
    """Least distance of two centres, in half lengths. 0 in an image, where people hide one another; on the floor two
    bodies cannot stand in each other."""
    em_steps: int = Field(4, ge=0, le=50)
    """Steps of expectation-maximisation. Our choice: the start is within a third of a width already."""
    lm_sweeps: int = Field(3, ge=0, le=50)
    """Rounds of Levenberg-Marquardt over all ellipses. Our choice."""
    prior_mass: float = Field(0.5, gt=0, le=10)
    """Weight of the prior covariance in expectation-maximisation, in object areas. Our choice."""
    cell_deviation: float = Field(0.7, gt=0, le=10)
    """Deviation of a cell's residual, correlation of neighbouring cells included. Our choice: a residual of 0.35 per
    cell (holes, limbs), the same over patches of 2 x 2 cells: 0.35 sqrt(4)."""
    max_ellipses: int = Field(64, ge=1, le=1000)
    """Most ellipses per frame; a bound on time, not on what is expected."""


@dataclass(frozen=True)
class SizePrior:
    """Size expected of an object, linear in the row of its centre, in cells of the grid it is fitted on.

    A linear law of the centre row is a linear law of the foot row too (foot = centre + half the length); it holds for
    objects on a plane seen by a camera without roll, so no calibration is asked for.

    Attributes:
        half_length_0: half length of an object centred in row 0 [cells].
        half_length_slope: its growth per row [cells/cell].
        aspect: width / length.
        least: half length below which nothing is expected, however far away [cells]; a line must not run on to
            objects of no size at the horizon.
    Raises:
        ValueError: aspect not positive.
    """

    half_length_0: float
    half_length_slope: float
    aspect: float
    least: float = 1.0

    def __post_init__(self) -> None:
        values = self.law
        if not all(math.isfinite(v) for v in values) or min(self.aspect, self.least) <= 0:
            raise ValueError(f"expected finite sizes and a positive aspect and least, got {values}")

    @property
    def law(self) -> tuple[float, float, float, float]:
        """(half_length_0, half_length_slope, least, aspect), the order in which kernels take them."""
        return self.half_length_0, self.half_length_slope, self.least, self.aspect

    def half_length(self, row: float) -> float:
        """Half length in cells of an object centred in a row."""
        return max(self.least, self.half_length_0 + self.half_length_slope * row)

    def half_lengths(self, rows: F64) -> F64:
        """``half_length`` of many rows, (N,) float64."""
        return np.asarray(np.maximum(self.least, self.half_length_0 + self.half_length_slope * rows))


def fit_ellipses(mask: F32, prior: SizePrior, params: EllipseFitParams) -> F64:
    """Fit one ellipse to each object in a foreground mask.

    Args:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        prior: size expected per row.
        params: weights and limits.
    Returns:
        (N, 5) float64: x, y, half length, half width [cells], angle of the length axis from the +row direction [rad].
    Raises:
        ValueError: mask is not (R, C) float32.
    """
    if mask.ndim != 2 or mask.dtype != np.float32:
        raise ValueError(f"expected a (R, C) float32 mask, got {mask.shape} {mask.dtype}")
    score = mask - np.float32(params.background_weight) * (1 - mask)
    lengths = prior.half_lengths(np.arange(mask.shape[0], dtype=np.float64))
    stride = max(1, round(0.4 * prior.aspect * float(np.median(lengths))))
    accept = params.proposed_share * params.least_share
    found = cover(score, lengths, prior.aspect, stride, accept, params.max_ellipses)
    if not len(found):
        return found
    _expect_and_maximise(mask, found, prior, params)
    refine_ellipses(mask, found, prior, params)
    apart = _apart(mask, found, prior, params)
    if len(apart) < len(found):
        refine_ellipses(mask, apart, prior, params)
    return _needed(mask, apart, params)


def refine_ellipses(mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams) -> None:
    """Levenberg-Marquardt refinement of (N, 5) ellipses against the mask, in place."""
    angle = math.radians(params.angle_spread_deg)
    spread = np.array([params.size_spread, params.size_spread, angle, params.cell_deviation])
    limits = np.array([math.log(params.size_limit), math.radians(params.angle_limit_deg)])
    refine(
        mask, ellipses, *prior.law, spread, limits,
        params.background_weight, 0.7, params.lm_sweeps,
    )  # fmt: skip


def _expect_and_maximise(mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams) -> None:
    rows, cols = np.nonzero(mask)
    points = np.column_stack([cols, rows, mask[rows, cols]]).astype(np.float64)
    outlier = 0.02 / (math.pi * prior.half_length(mask.shape[0] / 2) ** 2 * prior.aspect)
    for _ in range(params.em_steps):
        em_step(points, ellipses, *prior.law, params.prior_mass, outlier, params.angle_limit_deg < 45)
    for k, row in enumerate(ellipses[:, 1]):
        a0 = prior.half_length(row)
        ellipses[k, 2] = np.clip(ellipses[k, 2], a0 / params.size_limit, a0 * params.size_limit)
        b0 = a0 * prior.aspect
        ellipses[k, 3] = np.clip(ellipses[k, 3], b0 / params.size_limit, b0 * params.size_limit)
        limit = math.radians(params.angle_limit_deg)
        ellipses[k, 4] = np.clip(ellipses[k, 4], -limit, limit)


def _apart(mask: F32, ellipses: F64, prior: SizePrior, params: EllipseFitParams) -> F64:
    """Drop the one that covers less of any two ellipses that are too close to be two objects."""
    if params.separation == 0 or len(ellipses) < 2:
        return ellipses
    prefix = kernels.row_prefix(mask)
    covered = np.array([kernels.ellipse_sum(prefix, *ellipse)[0] for ellipse in ellipses])
    least = params.separation * prior.half_lengths(ellipses[:, 1])
    kept: list[int] = []
    for k in np.argsort(-covered, kind="stable"):
        distance = np.hypot(*(ellipses[kept, :2] - ellipses[k, :2]).T)
        if (distance >= least[k]).all():
            kept.append(int(k))
    return ellipses[sorted(kept)]


def _needed(mask: F32, ellipses: F64, params: EllipseFitParams) -> F64:
    """Drop, one at a time, the ellipse that adds least, while it adds less than the least share of its area."""
    prefix = kernels.row_prefix(mask)
    while len(ellipses):
        shares = own_shares(prefix, ellipses, params.background_weight)
        worst = int(np.argmin(shares))
        if shares[worst] >= params.least_share:
            break
        ellipses = np.delete(ellipses, worst, axis=0)
    return ellipses


def own_shares(prefix: F64, ellipses: F64, background_weight: float) -> F64:
    """Gain of each ellipse over the union of the others, as a share of its area, (N,) float64.

    Of somebody who is cut by the border only the part inside counts, or half where less is inside.
    """
    out = np.zeros((len(ellipses), 4))
    kernels.exclusive(prefix, ellipses, out)
    area = np.clip(out[:, 0], 0.5 * np.pi * ellipses[:, 2] * ellipses[:, 3], None)
    return np.asarray((out[:, 2] - background_weight * (out[:, 3] - out[:, 2])) / np.maximum(area, 1e-9))


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
