"""Compiled kernels of ellipses on a grid of cells; ``tests/reference/ellipses.py`` defines them in plain numpy.

Coordinates: cell (row r, column c) has its centre at (x, y) = (c, r) and reaches half a cell to each side.
An ellipse is (x, y, a, b, angle): centre, half length, half width [cells], and the angle of the length axis
from the +row direction towards +column [rad].
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, U8
from planview.tracking.ellipse_particle.size import Size

EDGE = 5.0
"""Widths of the soft edge beyond which nothing is left of an ellipse (0.7 %)."""
X, Y, VX, VY, LN_A, LN_B, ANGLE = range(7)
"""Columns of an object's state: position and velocity in cells (per second), logarithms of half length and half width
over the expected ones, angle of the length axis [rad]."""


class Match(NamedTuple):
    """How the union of ellipses is compared with the mask, and what is expected of each.

    Attributes:
        deviation: of a cell's residual.
        background: weight of a background cell against 1 of a foreground cell.
        soft: width of the logistic edge of an ellipse [cells].
        size_spread: deviation of ln half length and ln half width from the size.
        angle_spread: deviation of the angle [rad].
        limit: largest deviation of size and angle, in these.
    """

    deviation: float
    background: float
    soft: float
    size_spread: float
    angle_spread: float
    limit: float


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def half_length(size, y):  # type: ignore[no-untyped-def]
    """Half length expected of an ellipse centred in row y."""
    return max(size.least, size.level + size.slope * y)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def conic(a, b, angle):  # type: ignore[no-untyped-def]
    """(qxx, qxy, qyy) of qxx dx^2 + 2 qxy dx dy + qyy dy^2 = 1."""
    s = math.sin(angle)
    c = math.cos(angle)
    ia = 1.0 / (a * a)
    ib = 1.0 / (b * b)
    return s * s * ia + c * c * ib, s * c * (ia - ib), c * c * ia + s * s * ib


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def span(form, dy):  # type: ignore[no-untyped-def]
    """Offsets (lo, hi) from the centre column that a conic covers in the row dy below the centre; lo > hi for none."""
    qxx, qxy, qyy = form
    root = qxy * qxy * dy * dy - qxx * (qyy * dy * dy - 1.0)
    if root <= 0.0:
        return 1.0, -1.0
    root = math.sqrt(root)
    return (-qxy * dy - root) / qxx, (-qxy * dy + root) / qxx


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def reach(a, b, angle):  # type: ignore[no-untyped-def]
    """How far an ellipse reaches along columns and rows."""
    s = math.sin(angle)
    c = math.cos(angle)
    return math.sqrt(a * a * s * s + b * b * c * c), math.sqrt(a * a * c * c + b * b * s * s)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def between(sums, lo, hi):  # type: ignore[no-untyped-def]
    """Integral of a row between the columns lo and hi (fractional, within the grid's edges), from its sums."""
    t0 = lo + 0.5
    t1 = hi + 0.5
    last = sums.shape[0] - 2
    j0 = min(int(t0), last)
    j1 = min(int(t1), last)
    low = sums[j0] + (t0 - j0) * (sums[j0 + 1] - sums[j0])
    return sums[j1] + (t1 - j1) * (sums[j1 + 1] - sums[j1]) - low


@njit(cache=True, nogil=True, error_model="numpy")
def row_sums(values: F32 | U8) -> F64:
    """(R, C + 1): sums of the columns left of each cell edge."""
    out = np.zeros((values.shape[0], values.shape[1] + 1))
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            out[r, c + 1] = out[r, c] + values[r, c]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def paint(ellipses: F64, masks: U8) -> None:
    """Set the cells whose centres lie in each of (N, 5) ellipses, in its own one of the masks (N, R, C)."""
    _, n_rows, n_cols = masks.shape
    for k in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        _, down = reach(a, b, angle)
        for r in range(max(0, math.ceil(y - down)), min(n_rows - 1, math.floor(y + down)) + 1):
            lo, hi = span(form, r - y)
            for c in range(max(0, math.ceil(lo + x)), min(n_cols - 1, math.floor(hi + x)) + 1):
                masks[k, r, c] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def cover(score: F32, half: F64, aspect: float, stride: int, accept: float) -> F64:
    """Greedy cover: place upright ellipses of the expected size where the sum of ``score`` inside is largest.

    score: (R, C) gain of covering each cell; set to 0 where covered (overwritten).
    half: (R,) half length expected of an object centred in each row [cells].
    accept: smallest gain of an ellipse as a share of its area in the grid (at least half its area): what lies outside
    speaks for nothing.
    Returns (N, 5), in order of gain share.
    """
    n_rows, n_cols = score.shape
    sums = row_sums(score)
    n_i, n_j = (n_rows + stride - 1) // stride, (n_cols + stride - 1) // stride
    gain = np.empty((n_i, n_j))
    for i in range(n_i):
        for j in range(n_j):
            gain[i, j] = gain_share(sums, j * stride, i * stride, half[i * stride], aspect)
    found = np.empty((n_i * n_j, 5))
    most = half.max()
    n = 0
    while n < found.shape[0]:
        best = np.argmax(gain)
        i, j = best // n_j, best % n_j
        if not gain[i, j] >= accept:
            break
        x, y, a = float(j * stride), float(i * stride), half[i * stride]
        b = a * aspect
        found[n] = np.array([x, y, a, b, 0.0])
        n += 1
        for r in range(max(0, math.ceil(y - a)), min(n_rows - 1, math.floor(y + a)) + 1):
            wide = b * math.sqrt(max(0.0, 1.0 - ((r - y) / a) ** 2))
            for c in range(max(0, math.ceil(x - wide)), min(n_cols - 1, math.floor(x + wide)) + 1):
                score[r, c] = 0.0
            for c in range(n_cols):
                sums[r, c + 1] = sums[r, c] + score[r, c]
        for i2 in range(max(0, int((y - a - most) / stride)), min(n_i, int((y + a + most) / stride) + 2)):
            across = b + half[i2 * stride] * aspect
            for j2 in range(max(0, int((x - across) / stride)), min(n_j, int((x + across) / stride) + 2)):
                gain[i2, j2] = gain_share(sums, j2 * stride, i2 * stride, half[i2 * stride], aspect)
        gain[i, j] = -1.0
    return found[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def gain_share(sums: F64, x: float, y: int, a: float, aspect: float) -> float:
    """Gain of an upright ellipse over its area in the grid, or half its area where less is inside; -1 for little.

    A body fills its own middle: where nothing is to be gained in the middle row, nothing is summed.
    """
    b = a * aspect
    edge = sums.shape[1] - 1.5
    if between(sums[y], max(x - b, -0.5), min(x + b, edge)) <= 0.0:
        return -1.0
    total = 0.0
    inside = 0.0
    for r in range(max(0, math.ceil(y - a)), min(sums.shape[0] - 1, math.floor(y + a)) + 1):
        wide = b * math.sqrt(max(0.0, 1.0 - ((r - y) / a) ** 2))
        lo, hi = max(x - wide, -0.5), min(x + wide, edge)
        if hi > lo:
            total += between(sums[r], lo, hi)
            inside += hi - lo
    return total / max(inside, 0.5 * math.pi * a * b)


@njit(cache=True, nogil=True, error_model="numpy")
def refine(mask: F32, ellipses: F64, size: Size, match: Match, sweeps: int) -> None:
    """Levenberg-Marquardt of the union of (N, 5) soft ellipses against the mask, one at a time; in place.

    Residual of a cell: mask - (1 - prod_k (1 - inside_k)), weight 1 for foreground and ``match.background`` for the
    rest; inside_k is 1 within ellipse k and falls to 0 by a logistic edge ``match.soft`` cells wide across it.
    Size and angle are held near what is expected (``match``).
    """
    n_rows, n_cols = mask.shape
    grad, hess = np.empty(5), np.empty((5, 5))
    damping = np.full(ellipses.shape[0], 0.01)
    free = np.empty((n_rows, n_cols))
    for _ in range(sweeps):
        for k in range(ellipses.shape[0]):
            x, y, a, b, angle = ellipses[k]
            grow = 1.0 + EDGE * match.soft / b
            across, down = reach(a * grow, b * grow, angle)
            # A step beyond this window is judged by what is inside it.
            r0, r1 = max(0, math.ceil(y - down)), min(n_rows - 1, math.floor(y + down))
            c0, c1 = max(0, math.ceil(x - across)), min(n_cols - 1, math.floor(x + across))
            if r1 < r0 or c1 < c0:
                continue
            window = (r0, r1, c0, c1)
            free_of_others(ellipses, k, match.soft, window, free)
            cost = normal_equations(mask, ellipses[k], window, free, size, match, grad, hess, True)
            for i in range(5):
                hess[i, i] = hess[i, i] * (1.0 + damping[k]) + 1e-3
            step = np.linalg.solve(hess, grad)
            old = ellipses[k].copy()
            ellipses[k, 0] += min(max(step[0], -3.0), 3.0)
            ellipses[k, 1] += min(max(step[1], -3.0), 3.0)
            half = half_length(size, ellipses[k, 1])
            ratio = math.exp(match.limit * match.size_spread)
            ellipses[k, 2] = min(max(a * math.exp(step[2]), half / ratio), half * ratio)
            ellipses[k, 3] = min(max(b * math.exp(step[3]), half * size.aspect / ratio), half * size.aspect * ratio)
            turn = match.limit * match.angle_spread
            ellipses[k, 4] = min(max(angle + step[4], -turn), turn)
            if normal_equations(mask, ellipses[k], window, free, size, match, grad, hess, False) <= cost:
                damping[k] = max(1e-4, damping[k] * 0.3)
            else:
                ellipses[k] = old
                damping[k] = min(1e4, damping[k] * 10.0)


@njit(cache=True, nogil=True, error_model="numpy")
def free_of_others(ellipses: F64, k: int, soft: float, window: tuple[int, int, int, int], free: F64) -> None:
    """prod_j (1 - inside_j) over the other ellipses, in the rows r0 to r1 and columns c0 to c1 of the window."""
    r0, r1, c0, c1 = window
    free[: r1 - r0 + 1, : c1 - c0 + 1] = 1.0
    for j in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[j]
        grow = 1.0 + EDGE * soft / b
        across, down = reach(a * grow, b * grow, angle)
        if j == k or x + across < c0 or x - across > c1:
            continue
        qxx, qxy, qyy = conic(a, b, angle)
        end = conic(a * grow, b * grow, angle)
        for r in range(max(r0, math.ceil(y - down)), min(r1, math.floor(y + down)) + 1):
            dy = r - y
            lo, hi = span(end, dy)
            for c in range(max(c0, math.ceil(lo + x)), min(c1, math.floor(hi + x)) + 1):
                dx = c - x
                rho = math.sqrt(max(0.0, qxx * dx * dx + 2.0 * qxy * dx * dy + qyy * dy * dy))
                free[r - r0, c - c0] *= 1.0 - 1.0 / (1.0 + math.exp((rho - 1.0) * b / soft))


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    mask: F32,
    ellipse: F64,
    window: tuple[int, int, int, int],
    free: F64,
    size: Size,
    match: Match,
    grad: F64,
    hess: F64,
    derive: bool,
) -> float:
    """Half the weighted squared residual in a window over its variance, and half the squared deviations of the prior.

    grad (5,) and hess (5, 5) receive the Gauss-Newton terms for (x, y, ln a, ln b, angle) of the ellipse, where
    ``derive`` asks for them.
    """
    x0, y0, a, b, angle = ellipse
    s, c = math.sin(angle), math.cos(angle)
    ia, ib = 1.0 / (a * a), 1.0 / (b * b)
    r0, r1, c0, c1 = window
    grad[:] = 0.0
    hess[:, :] = 0.0
    far = (1.0 + EDGE * match.soft / b) ** 2
    precision = 1.0 / (match.deviation * match.deviation)
    cost = 0.0
    for r in range(r0, r1 + 1):
        dy = r - y0
        for col in range(c0, c1 + 1):
            dx = col - x0
            u = dx * s + dy * c
            v = dx * c - dy * s
            rho = u * u * ia + v * v * ib
            own = 0.0
            if rho < far:
                rho = max(1e-6, math.sqrt(rho))
                own = 1.0 / (1.0 + math.exp((rho - 1.0) * b / match.soft))
            others = free[r - r0, col - c0]
            f = mask[r, col]
            weight = precision * (f + match.background * (1.0 - f))
            residual = f - (1.0 - (1.0 - own) * others)
            cost += 0.5 * weight * residual * residual
            slope = others * own * (1.0 - own) * b / match.soft
            if not derive or slope < 1e-4:
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
            for i in range(5):
                grad[i] += weight * residual * row[i]
                for j in range(i + 1):
                    hess[i, j] += weight * row[i] * row[j]
    for i in range(5):
        for j in range(i):
            hess[j, i] = hess[i, j]
    half = half_length(size, y0)
    off = (math.log(a / half), math.log(b / (half * size.aspect)), angle)
    for i in range(3):
        spread = match.size_spread if i < 2 else match.angle_spread
        grad[2 + i] -= off[i] / (spread * spread)
        hess[2 + i, 2 + i] += 1.0 / (spread * spread)
        cost += 0.5 * (off[i] / spread) ** 2
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
def overlaps(states: F64, left: F64, allowed: F64, size: Size, out: F64) -> None:
    """What the ellipse of each state covers of the cells that are left, and of the grid outside the allowed cells.

    states: (P, 7), columns ``X`` to ``ANGLE``; left, allowed: (R, C + 1) ``row_sums``; out: (P, 2) [cells].
    """
    n_rows, edge = left.shape[0], left.shape[1] - 1.5
    # Every row of a small ellipse, every second or third of a tall one: a dozen rows give its area to 3 %.
    step = max(1, int(half_length(size, states[0, Y]) / 6.0))
    for p in range(states.shape[0]):
        x, y = states[p, X], states[p, Y]
        half = half_length(size, y)
        a, b = half * math.exp(states[p, LN_A]), half * size.aspect * math.exp(states[p, LN_B])
        qxx, qxy, _ = conic(a, b, states[p, ANGLE])
        # In the row dy below its centre it covers x + lean dy +- sqrt(wide - thin dy^2).
        wide, lean = 1.0 / qxx, -qxy / qxx
        thin = wide * wide / (a * a * b * b)
        down = math.sqrt(wide / thin)
        first, last = max(0, math.ceil(y - down)), min(n_rows - 1, math.floor(y + down))
        covered = 0.0
        outside = 0.0
        for r in range(first + (-first) % step, last + 1, step):
            dy = r - y
            reach_x = math.sqrt(max(0.0, wide - thin * dy * dy))
            lo, hi = max(x + lean * dy - reach_x, -0.5), min(x + lean * dy + reach_x, edge)
            if hi > lo:
                covered += between(left[r], lo, hi)
                outside += hi - lo - between(allowed[r], lo, hi)
        out[p, 0] = covered * step
        out[p, 1] = outside * step
