"""Compiled Levenberg-Marquardt refinement; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64
from planview.tracking.ellipse_particle.fit._area import conic, half_length, span
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
        common: rho of the prior (la^2 + lb^2 - rho (la + lb)^2) / (2 size_spread^2) of the ln size ratios la of length
            and lb of width: 0 where they differ independently, nearly 1/2 where they hardly differ but together.
    """

    size_spread: float
    angle_spread: float
    size_limit: float
    angle_limit: float
    common: float


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


class SoftEdges(NamedTuple):
    """Where soft ellipses end, one row per ellipse: forms of their outlines and of the ends of their edges (``conic``),
    and how far they reach along the rows and columns [cells]."""

    outline: F64
    end: F64
    reach: F64


@njit(cache=True, nogil=True)
def set_edge(edges: SoftEdges, ellipses: F64, k: int, soft: float) -> None:
    """Row k."""
    _, _, a, b, angle = ellipses[k]
    grow = 1.0 + EDGE * soft / b
    edges.outline[k, 0], edges.outline[k, 1], edges.outline[k, 2] = conic(a, b, angle)
    a, b = a * grow, b * grow
    edges.end[k, 0], edges.end[k, 1], edges.end[k, 2] = conic(a, b, angle)
    s = math.sin(angle)
    c = math.cos(angle)
    edges.reach[k, 0] = math.sqrt(a * a * s * s + b * b * c * c)
    edges.reach[k, 1] = math.sqrt(a * a * c * c + b * b * s * s)


@njit(cache=True, nogil=True)
def soft_edges(ellipses: F64, soft: float) -> SoftEdges:
    """Of (N, 5) ellipses."""
    n = ellipses.shape[0]
    edges = SoftEdges(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 2)))
    for k in range(n):
        set_edge(edges, ellipses, k, soft)
    return edges


@njit(cache=True, nogil=True)
def free_of(ellipses: F64, edges: SoftEdges, k: int, soft: float, window: I64, free: F64) -> None:
    """prod_j (1 - inside_j) over the other ellipses, in the rows r0..r1 and columns c0..c1 of the window.

    inside_j is 1 within ellipse j and falls to 0 by a logistic edge ``soft`` cells wide across the ellipse.
    free: at least (r1 - r0 + 1, c1 - c0 + 1).
    """
    r0, r1, c0, c1 = window
    free[: r1 - r0 + 1, : c1 - c0 + 1] = 1.0
    for j in range(ellipses.shape[0]):
        x, y, b = ellipses[j, 0], ellipses[j, 1], ellipses[j, 3]
        reach_x, reach_y = edges.reach[j]
        if j == k or x + reach_x < c0 - 1 or x - reach_x > c1 + 1:
            continue
        qxx, qxy, qyy = edges.outline[j]
        gxx, gxy, gyy = edges.end[j]
        for r in range(max(r0, math.ceil(y - reach_y)), min(r1, math.floor(y + reach_y)) + 1):
            dy = r - y
            lo, hi = span(gxx, gxy, gyy, dy)
            row = free[r - r0]
            for col in range(max(c0, math.ceil(lo + x)), min(c1, math.floor(hi + x)) + 1):
                dx = col - x
                rho = math.sqrt(max(0.0, qxx * dx * dx + 2.0 * qxy * dx * dy + qyy * dy * dy))
                z = (rho - 1.0) * b / soft
                row[np.uintp(col - c0)] *= 1.0 - 1.0 / (1.0 + math.exp(z))


@njit(cache=True, nogil=True, inline="always")
def inside_of(rho2, b, soft, far2):  # type: ignore[no-untyped-def]
    """(share of a cell inside an ellipse, rho): the cell is at rho times its outline, and rho^2 is given.

    far2: rho^2 a little beyond the end of the edge, where no root is needed.
    """
    if rho2 > far2:
        return 0.0, 1.0
    rho = max(1e-6, math.sqrt(rho2))
    z = (rho - 1.0) * b / soft
    return 0.0 if z > EDGE else 1.0 / (1.0 + math.exp(z)), rho


@njit(cache=True, nogil=True, inline="always")
def add_cell(row, weight, residual, grad, hess):  # type: ignore[no-untyped-def]
    """Add a cell's terms, of its five slopes, to the gradient and to the lower triangle of the Hessian."""
    for i in range(5):
        grad[i] += weight * residual * row[i]
        for j in range(i + 1):
            hess[i, j] += weight * row[i] * row[j]


@njit(cache=True, nogil=True)
def normal_equations(
    mask: F32, ellipse: F64, window: I64, free: F64, match: Match, grad: F64, hess: F64, derive: bool
) -> float:
    """Half the weighted squared residual of the union of ellipses against the mask in a window.

    Residual of a cell: mask - (1 - (1 - inside) free), weight 1 for foreground and ``match.background`` for the rest.
    grad (5,) and hess (5, 5) receive the Gauss-Newton terms for (x, y, ln a, ln b, angle) of the ellipse, where
    they are asked for by ``derive``.
    """
    x0, y0, a, b, angle = ellipse
    s, c = math.sin(angle), math.cos(angle)
    ia, ib = 1.0 / (a * a), 1.0 / (b * b)
    r0, r1, c0, c1 = window
    if derive:
        grad[:] = 0.0
        hess[:, :] = 0.0
    end, far2 = max(c0, c1 + 1), 1.000001 * (1.0 + EDGE * match.soft / b) ** 2
    cost = 0.0
    for r in range(r0, r1 + 1):
        dy = r - y0
        values, rest = mask[r, c0:end], free[r - r0, : end - c0]
        for k in range(np.uintp(len(values))):
            dx = np.float64(np.int64(k) + c0) - x0
            u = dx * s + dy * c
            v = dx * c - dy * s
            own, rho = inside_of(u * u * ia + v * v * ib, b, match.soft, far2)
            others = rest[k]
            f = values[k]
            weight = f + match.background * (1.0 - f)
            residual = f - (1.0 - (1.0 - own) * others)
            cost += 0.5 * weight * residual * residual
            if not derive:
                continue
            slope = others * own * (1.0 - own) * b / match.soft
            if slope < 1e-4:
                continue
            # d union / d p = -slope * d rho / d p; the residual falls as the union grows.
            slope /= rho
            row = (
                slope * (u * s * ia + v * c * ib),
                slope * (u * c * ia - v * s * ib),
                slope * u * u * ia,
                slope * v * v * ib,
                -slope * u * v * (ia - ib),
            )
            add_cell(row, weight, residual, grad, hess)
    for i in range(5):
        for j in range(i):
            hess[j, i] = hess[i, j]
    return cost


@njit(cache=True, nogil=True)
def refine(mask: F32, ellipses: F64, members: I64, law: SizeLaw, prior: Prior, match: Match, sweeps: int) -> None:
    """Levenberg-Marquardt on one of the members (K,) at a time, all others held, ``sweeps`` times round; in place."""
    n_rows, n_cols = mask.shape
    grad = np.empty(5)
    hess = np.empty((5, 5))
    step = np.empty(5)
    damping = np.full(ellipses.shape[0], 0.01)
    precision = 1.0 / (match.deviation * match.deviation)
    free = np.empty((n_rows, n_cols))
    window = np.empty(4, dtype=np.int64)
    edges = soft_edges(ellipses, match.soft)
    for _ in range(sweeps):
        for k in members:
            window[0], window[1], window[2], window[3] = window_of(ellipses, k, match.soft, n_rows, n_cols)
            free_of(ellipses, edges, k, match.soft, window, free)
            cost = normal_equations(mask, ellipses[k], window, free, match, grad, hess, True) * precision
            cost += add_prior(ellipses[k], law, prior, precision, grad, hess)
            old = ellipses[k].copy()
            for i in range(5):
                hess[i, i] = hess[i, i] * (1.0 + damping[k]) + 1e-3 * precision
            step[:] = np.linalg.solve(hess, grad)
            move(ellipses[k], step, law, prior)
            after = normal_equations(mask, ellipses[k], window, free, match, grad, hess, False) * precision
            after += add_prior(ellipses[k], law, prior, precision, grad, hess)
            if after <= cost:
                damping[k] = max(1e-4, damping[k] * 0.3)
                set_edge(edges, ellipses, k, match.soft)
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
    la, lb = math.log(ellipse[2] / a0), math.log(ellipse[3] / (a0 * law.aspect))
    both = prior.common * (la + lb)
    w, turn = 1.0 / (prior.size_spread * prior.size_spread), 1.0 / (prior.angle_spread * prior.angle_spread)
    grad[2] -= w * (la - both)
    grad[3] -= w * (lb - both)
    grad[4] -= turn * ellipse[4]
    for i in range(2, 4):
        hess[i, i] += w
        for j in range(2, 4):
            hess[i, j] -= w * prior.common
    hess[4, 4] += turn
    cost: float = 0.5 * (w * (la * la + lb * lb - both * (la + lb)) + turn * ellipse[4] * ellipse[4])
    return cost
