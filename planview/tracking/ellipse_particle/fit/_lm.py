"""Compiled Levenberg-Marquardt refinement; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64
from planview.tracking.ellipse_particle.fit._area import conic, half_length, rows_of, span
from planview.tracking.ellipse_particle.fit.prior import SizeLaw

EDGE = 5.0
"""Widths of the soft edge beyond which nothing is left of an ellipse (0.7 %)."""


class Prior(NamedTuple):
    """Deviations from the prior and how far an ellipse may go from it.

    Attributes:
        size_spread: deviation of ln half length and ln half width from the size law.
        angle_spread: deviation of the angle [rad].
        size_limit: largest |ln size ratio|.
        angle_limit: largest |angle| [rad].
    """

    size_spread: float
    angle_spread: float
    size_limit: float
    angle_limit: float


class Match(NamedTuple):
    """How the union of ellipses is compared with the mask.

    Attributes:
        deviation: of a cell's residual.
        background: weight of a background cell against 1 of a foreground cell.
        soft: width of the logistic edge of an ellipse [cells].
    """

    deviation: float
    background: float
    soft: float


@njit(cache=True, nogil=True, inline="always")
def window_of(ellipses, k, soft, n_rows, n_cols):  # type: ignore[no-untyped-def]
    """First and last row and column that the soft ellipse reaches, clipped to the grid."""
    x, y, a, b, angle = ellipses[k]
    grow = 1.0 + EDGE * soft / b
    s = math.sin(angle)
    c = math.cos(angle)
    reach_y = math.sqrt(a * a * c * c + b * b * s * s) * grow
    reach_x = math.sqrt(a * a * s * s + b * b * c * c) * grow
    r0 = max(0, math.ceil(y - reach_y))
    r1 = min(n_rows - 1, math.floor(y + reach_y))
    c0 = max(0, math.ceil(x - reach_x))
    c1 = min(n_cols - 1, math.floor(x + reach_x))
    return r0, r1, c0, c1


@njit(cache=True, nogil=True)
def free_of(ellipses: F64, k: int, soft: float, window: I64, free: F64) -> None:
    """prod_j (1 - inside_j) over the other ellipses, in the rows r0..r1 and columns c0..c1 of the window.

    inside_j is 1 within ellipse j and falls to 0 by a logistic edge ``soft`` cells wide across the ellipse.
    free: at least (r1 - r0 + 1, c1 - c0 + 1).
    """
    r0, r1, c0, c1 = window
    free[: r1 - r0 + 1, : c1 - c0 + 1] = 1.0
    for j in range(ellipses.shape[0]):
        if j == k:
            continue
        x, y, a, b, angle = ellipses[j]
        grow = 1.0 + EDGE * soft / b
        qxx, qxy, qyy = conic(a, b, angle)
        gxx, gxy, gyy = conic(a * grow, b * grow, angle)
        first, last = rows_of(y, a * grow, b * grow, angle, r1 + 1)
        for r in range(max(first, r0), last + 1):
            dy = r - y
            lo, hi = span(gxx, gxy, gyy, dy)
            for col in range(max(c0, math.ceil(lo + x)), min(c1, math.floor(hi + x)) + 1):
                dx = col - x
                rho = math.sqrt(max(0.0, qxx * dx * dx + 2.0 * qxy * dx * dy + qyy * dy * dy))
                z = (rho - 1.0) * b / soft
                free[r - r0, col - c0] *= 1.0 - 1.0 / (1.0 + math.exp(z))


@njit(cache=True, nogil=True)
def normal_equations(mask: F32, ellipse: F64, window: I64, free: F64, match: Match, grad: F64, hess: F64) -> float:
    """Half the weighted squared residual of the union of ellipses against the mask in a window.

    Residual of a cell: mask - (1 - (1 - inside) free), weight 1 for foreground and ``match.background`` for the rest.
    grad (5,) and hess (5, 5) receive the Gauss-Newton terms for (x, y, ln a, ln b, angle) of the ellipse.
    """
    x0, y0, a, b, angle = ellipse
    s = math.sin(angle)
    c = math.cos(angle)
    ia = 1.0 / (a * a)
    ib = 1.0 / (b * b)
    r0, r1, c0, c1 = window
    grad[:] = 0.0
    hess[:, :] = 0.0
    row = np.empty(5)
    cost = 0.0
    for r in range(r0, r1 + 1):
        dy = r - y0
        for col in range(c0, c1 + 1):
            dx = col - x0
            u = dx * s + dy * c
            v = dx * c - dy * s
            rho = max(1e-6, math.sqrt(u * u * ia + v * v * ib))
            z = (rho - 1.0) * b / match.soft
            own = 0.0 if z > EDGE else 1.0 / (1.0 + math.exp(z))
            others = free[r - r0, col - c0]
            f = mask[r, col]
            weight = f + match.background * (1.0 - f)
            residual = f - (1.0 - (1.0 - own) * others)
            cost += 0.5 * weight * residual * residual
            slope = others * own * (1.0 - own) * b / match.soft
            if slope < 1e-4:
                continue
            # d union / d p = -slope * d rho / d p; the residual falls as the union grows.
            slope /= rho
            row[0] = slope * (u * s * ia + v * c * ib)
            row[1] = slope * (u * c * ia - v * s * ib)
            row[2] = slope * u * u * ia
            row[3] = slope * v * v * ib
            row[4] = -slope * u * v * (ia - ib)
            for i in range(5):
                grad[i] += weight * residual * row[i]
                for j in range(i + 1):
                    hess[i, j] += weight * row[i] * row[j]
    for i in range(5):
        for j in range(i):
            hess[j, i] = hess[i, j]
    return cost


@njit(cache=True, nogil=True)
def refine(mask: F32, ellipses: F64, law: SizeLaw, prior: Prior, match: Match, sweeps: int) -> None:
    """Levenberg-Marquardt on one ellipse at a time, the others held, ``sweeps`` times round; in place."""
    n_rows, n_cols = mask.shape
    grad = np.empty(5)
    hess = np.empty((5, 5))
    step = np.empty(5)
    damping = np.full(ellipses.shape[0], 0.01)
    precision = 1.0 / (match.deviation * match.deviation)
    free = np.empty((n_rows, n_cols))
    window = np.empty(4, dtype=np.int64)
    for _ in range(sweeps):
        for k in range(ellipses.shape[0]):
            window[0], window[1], window[2], window[3] = window_of(ellipses, k, match.soft, n_rows, n_cols)
            free_of(ellipses, k, match.soft, window, free)
            cost = normal_equations(mask, ellipses[k], window, free, match, grad, hess) * precision
            cost += add_prior(ellipses[k], law, prior, precision, grad, hess)
            old = ellipses[k].copy()
            for i in range(5):
                hess[i, i] = hess[i, i] * (1.0 + damping[k]) + 1e-3 * precision
            step[:] = np.linalg.solve(hess, grad)
            move(ellipses[k], step, law, prior)
            after = normal_equations(mask, ellipses[k], window, free, match, grad, hess) * precision
            after += add_prior(ellipses[k], law, prior, precision, grad, hess)
            if after <= cost:
                damping[k] = max(1e-4, damping[k] * 0.3)
            else:
                ellipses[k] = old
                damping[k] = min(1e4, damping[k] * 10.0)


@njit(cache=True, nogil=True)
def move(ellipse: F64, step: F64, law: SizeLaw, prior: Prior) -> None:
    """Take a step in (x, y, ln a, ln b, angle), at most 3 cells, within the limits about the size at the new place."""
    ellipse[0] += min(max(step[0], -3.0), 3.0)
    ellipse[1] += min(max(step[1], -3.0), 3.0)
    a0 = half_length(law, ellipse[1])
    la = math.log(ellipse[2] / a0) + step[2]
    lb = math.log(ellipse[3] / (a0 * law.aspect)) + step[3]
    limit = prior.size_limit
    ellipse[2] = max(0.7, a0 * math.exp(min(max(la, -limit), limit)))
    ellipse[3] = max(0.7, a0 * law.aspect * math.exp(min(max(lb, -limit), limit)))
    ellipse[4] = min(max(ellipse[4] + step[4], -prior.angle_limit), prior.angle_limit)


@njit(cache=True, nogil=True)
def add_prior(ellipse: F64, law: SizeLaw, prior: Prior, precision: float, grad: F64, hess: F64) -> float:
    """Scale the data terms by the precision and add the prior's; returns the prior's cost."""
    for i in range(5):
        grad[i] *= precision
        for j in range(5):
            hess[i, j] *= precision
    a0 = half_length(law, ellipse[1])
    offsets = (math.log(ellipse[2] / a0), math.log(ellipse[3] / (a0 * law.aspect)), ellipse[4])
    spreads = (prior.size_spread, prior.size_spread, prior.angle_spread)
    cost = 0.0
    for i in range(3):
        w = 1.0 / (spreads[i] * spreads[i])
        grad[2 + i] -= w * offsets[i]
        hess[2 + i, 2 + i] += w
        cost += 0.5 * w * offsets[i] * offsets[i]
    return cost
