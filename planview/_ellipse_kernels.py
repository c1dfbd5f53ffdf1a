"""Compiled kernels of ellipses on a grid of cells; ``tests/reference/ellipses.py`` defines them in plain numpy.

Coordinates: cell (row r, column c) has its centre at (x, y) = (c, r) and reaches half a cell to each side.
An ellipse is (x, y, a, b, angle): centre, half length, half width [cells], and the angle of the length axis
from the +row direction towards +column [rad].
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8


@njit(cache=True, nogil=True, inline="always")
def conic(a, b, angle):  # type: ignore[no-untyped-def]
    """(qxx, qxy, qyy) of qxx dx^2 + 2 qxy dx dy + qyy dy^2 = 1."""
    s = math.sin(angle)
    c = math.cos(angle)
    ia = 1.0 / (a * a)
    ib = 1.0 / (b * b)
    return s * s * ia + c * c * ib, s * c * (ia - ib), c * c * ia + s * s * ib


@njit(cache=True, nogil=True, inline="always")
def span(qxx, qxy, qyy, dy):  # type: ignore[no-untyped-def]
    """Offsets (lo, hi) from the centre column covered in the row dy below the centre; lo > hi when none."""
    root = qxy * qxy * dy * dy - qxx * (qyy * dy * dy - 1.0)
    if root <= 0.0:
        return 1.0, -1.0
    root = math.sqrt(root)
    return (-qxy * dy - root) / qxx, (-qxy * dy + root) / qxx


@njit(cache=True, nogil=True, inline="always")
def rows_of(y, a, b, angle, n_rows):  # type: ignore[no-untyped-def]
    """First and last row (inclusive) whose centre line can cross the ellipse, clipped to the grid."""
    s = math.sin(angle)
    c = math.cos(angle)
    reach = math.sqrt(a * a * c * c + b * b * s * s)
    return max(0, math.ceil(y - reach)), min(n_rows - 1, math.floor(y + reach))


@njit(cache=True, nogil=True)
def row_prefix(values: F32) -> F64:
    """(R, C + 1): sums of the columns left of each cell edge."""
    n_rows, n_cols = values.shape
    out = np.zeros((n_rows, n_cols + 1))
    for r in range(n_rows):
        total = 0.0
        for c in range(n_cols):
            total += values[r, c]
            out[r, c + 1] = total
    return out


@njit(cache=True, nogil=True)
def integral(values: F32) -> F64:
    """(R + 1, C + 1): sums of the positive values above and left of each corner."""
    n_rows, n_cols = values.shape
    out = np.zeros((n_rows + 1, n_cols + 1))
    for r in range(n_rows):
        total = 0.0
        for c in range(n_cols):
            total += max(values[r, c], 0.0)
            out[r + 1, c + 1] = out[r, c + 1] + total
    return out


@njit(cache=True, nogil=True, inline="always")
def between(prefix, r, lo, hi, n_cols):  # type: ignore[no-untyped-def]
    """Integral of row r between the columns lo and hi (fractional, already within the grid's edges)."""
    t0 = lo + 0.5
    j0 = min(int(t0), n_cols - 1)
    t1 = hi + 0.5
    j1 = min(int(t1), n_cols - 1)
    low = prefix[r, j0] + (t0 - j0) * (prefix[r, j0 + 1] - prefix[r, j0])
    high = prefix[r, j1] + (t1 - j1) * (prefix[r, j1 + 1] - prefix[r, j1])
    return high - low


@njit(cache=True, nogil=True)
def ellipse_sum(prefix: F64, x: float, y: float, a: float, b: float, angle: float) -> tuple[float, float]:
    """(integral of the values inside the ellipse, area of the ellipse inside the grid)."""
    n_rows = prefix.shape[0]
    n_cols = prefix.shape[1] - 1
    qxx, qxy, qyy = conic(a, b, angle)
    first, last = rows_of(y, a, b, angle, n_rows)
    total = 0.0
    area = 0.0
    for r in range(first, last + 1):
        lo, hi = span(qxx, qxy, qyy, r - y)
        lo = max(lo + x, -0.5)
        hi = min(hi + x, n_cols - 0.5)
        if hi > lo:
            total += between(prefix, r, lo, hi, n_cols)
            area += hi - lo
    return total, area


@njit(cache=True, nogil=True)
def paint(mask: U8, ellipses: F64, value: int) -> None:
    """Set the cells whose centres lie in any of the (N, 5) ellipses."""
    n_rows, n_cols = mask.shape
    for k in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[k]
        qxx, qxy, qyy = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        for r in range(first, last + 1):
            lo, hi = span(qxx, qxy, qyy, r - y)
            c0 = max(0, math.ceil(lo + x))
            c1 = min(n_cols - 1, math.floor(hi + x))
            for c in range(c0, c1 + 1):
                mask[r, c] = value


@njit(cache=True, nogil=True)
def claim(prefix: F64, ellipses: F64, order: I64, out: F64) -> None:
    """Per ellipse: area in the grid, values inside, values not inside an ellipse earlier in the order, area likewise.

    out: (N, 4) float64.
    """
    n_rows = prefix.shape[0]
    n_cols = prefix.shape[1] - 1
    taken = np.zeros((n_rows, n_cols), dtype=np.uint8)
    for i in range(order.shape[0]):
        k = order[i]
        x, y, a, b, angle = ellipses[k]
        qxx, qxy, qyy = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        for j in range(4):
            out[k, j] = 0.0
        for r in range(first, last + 1):
            lo, hi = span(qxx, qxy, qyy, r - y)
            c0 = max(0, math.ceil(lo + x))
            c1 = min(n_cols - 1, math.floor(hi + x))
            for c in range(c0, c1 + 1):
                value = prefix[r, c + 1] - prefix[r, c]
                out[k, 0] += 1.0
                out[k, 1] += value
                if taken[r, c] == 0:
                    taken[r, c] = 1
                    out[k, 2] += value
                    out[k, 3] += 1.0


@njit(cache=True, nogil=True)
def shown_rows(mask: F32, ellipses: F64, order: I64, shared: bool, least: float, out: F64) -> None:
    """Per ellipse: rows in which it shows, and its rows in the grid; out (N, 2).

    It shows in a row when the values that are in no ellipse earlier in the order, or all of them when ``shared``, make
    up the share ``least`` of the row's cells.
    """
    n_rows, n_cols = mask.shape
    taken = np.zeros((n_rows, n_cols), dtype=np.uint8)
    for k in order:
        x, y, a, b, angle = ellipses[k]
        qxx, qxy, qyy = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        out[k] = 0.0
        for r in range(first, last + 1):
            lo, hi = span(qxx, qxy, qyy, r - y)
            c0 = max(0, math.ceil(lo + x))
            c1 = min(n_cols - 1, math.floor(hi + x))
            total = 0.0
            for c in range(c0, c1 + 1):
                if shared or taken[r, c] == 0:
                    taken[r, c] = 1
                    total += mask[r, c]
            if c1 >= c0:
                out[k, 1] += 1.0
                if total >= least * (c1 + 1 - c0):
                    out[k, 0] += 1.0


@njit(cache=True, nogil=True)
def cover(score: F32, half_length: F64, aspect: float, stride: int, accept: float, limit: int) -> F64:
    """Greedy cover: place prior-sized upright ellipses where the sum of ``score`` inside is largest.

    score: (R, C) gain of covering each cell; set to 0 where covered (overwritten).
    half_length: (R,) half length expected of an object centred in each row [cells].
    accept: least gain of an ellipse as a share of its area.
    Returns (N, 5), N <= limit, in order of gain share.
    """
    n_rows, n_cols = score.shape
    prefix = row_prefix(score)
    bound = integral(score)
    n_r = (n_rows + stride - 1) // stride
    n_c = (n_cols + stride - 1) // stride
    gain = np.zeros((n_r, n_c))
    for i in range(n_r):
        r = i * stride
        a = half_length[r]
        area = math.pi * a * a * aspect
        r0 = max(0, r - int(a) - 1)
        r1 = min(n_rows, r + int(a) + 2)
        for j in range(n_c):
            reach = int(a * aspect) + 1
            c0 = max(0, j * stride - reach)
            c1 = min(n_cols, j * stride + reach + 1)
            most = bound[r1, c1] - bound[r0, c1] - bound[r1, c0] + bound[r0, c0]
            if most < accept * area:
                # Not even all gains in the box around the ellipse would do.
                gain[i, j] = -1.0
                continue
            total, _ = ellipse_sum(prefix, float(j * stride), float(r), a, a * aspect, 0.0)
            gain[i, j] = total / area
    found = np.empty((limit, 5))
    n = 0
    while n < limit:
        best = np.argmax(gain)
        i = best // n_c
        j = best % n_c
        if not gain[i, j] >= accept:
            break
        y = float(i * stride)
        x = float(j * stride)
        a = half_length[i * stride]
        b = a * aspect
        found[n, 0] = x
        found[n, 1] = y
        found[n, 2] = a
        found[n, 3] = b
        found[n, 4] = 0.0
        n += 1
        _take(score, prefix, x, y, a, b)
        _refresh(gain, prefix, half_length, aspect, stride, x, y, a, b)
        # A cell on the far side of rounding may keep its gain: never choose the same place twice.
        gain[i, j] = -1.0
    return found[:n]


@njit(cache=True, nogil=True)
def _take(score: F32, prefix: F64, x: float, y: float, a: float, b: float) -> None:
    n_rows, n_cols = score.shape
    qxx, qxy, qyy = conic(a, b, 0.0)
    first, last = rows_of(y, a, b, 0.0, n_rows)
    for r in range(first, last + 1):
        lo, hi = span(qxx, qxy, qyy, r - y)
        for c in range(max(0, math.ceil(lo + x)), min(n_cols - 1, math.floor(hi + x)) + 1):
            score[r, c] = 0.0
        total = 0.0
        for c in range(n_cols):
            total += score[r, c]
            prefix[r, c + 1] = total


@njit(cache=True, nogil=True)
def _refresh(
    gain: F64, prefix: F64, half_length: F64, aspect: float, stride: int, x: float, y: float, a: float, b: float
) -> None:
    n_r, n_c = gain.shape
    n_rows = half_length.shape[0]
    reach = 0.0
    for r in range(n_rows):
        reach = max(reach, half_length[r])
    i0 = max(0, int((y - a - reach) / stride))
    i1 = min(n_r - 1, int((y + a + reach) / stride) + 1)
    j0 = max(0, int((x - b - reach * aspect) / stride))
    j1 = min(n_c - 1, int((x + b + reach * aspect) / stride) + 1)
    for i in range(i0, i1 + 1):
        r = i * stride
        h = half_length[r]
        area = math.pi * h * h * aspect
        for j in range(j0, j1 + 1):
            if gain[i, j] >= 0.0:
                total, _ = ellipse_sum(prefix, float(j * stride), float(r), h, h * aspect, 0.0)
                gain[i, j] = total / area


@njit(cache=True, nogil=True)
def em_step(
    points: F64,
    ellipses: F64,
    half0: float,
    half1: float,
    least: float,
    aspect: float,
    strength: float,
    outlier: float,
    upright: bool,
) -> None:
    """One step of expectation-maximisation of a mixture of ellipses, updated in place.

    points: (P, 3) x, y, weight of the foreground cells. Each ellipse is the two-sigma contour of a Gaussian
    (the Gaussian with the second moments of a uniform ellipse), next to a uniform density of outliers.
    max(least, half0 + half1 * y): half length expected in row y;
    strength: mass of the prior in units of the ellipse's area (the inverse-Wishart prior of a covariance, so the
    step maximises the posterior);
    upright: the length axis stays nearer the rows' direction than the columns'.
    """
    n = ellipses.shape[0]
    sums = np.zeros((n, 6))
    density = np.empty(n)
    forms = np.empty((n, 4))
    for k in range(n):
        qxx, qxy, qyy = conic(ellipses[k, 2], ellipses[k, 3], ellipses[k, 4])
        forms[k, 0] = qxx
        forms[k, 1] = qxy
        forms[k, 2] = qyy
        forms[k, 3] = 2.0 / (math.pi * ellipses[k, 2] * ellipses[k, 3])
    for i in range(points.shape[0]):
        total = outlier
        for k in range(n):
            dx = points[i, 0] - ellipses[k, 0]
            dy = points[i, 1] - ellipses[k, 1]
            m = forms[k, 0] * dx * dx + 2.0 * forms[k, 1] * dx * dy + forms[k, 2] * dy * dy
            density[k] = 0.0 if m > 6.0 else forms[k, 3] * math.exp(-2.0 * m)
            total += density[k]
        for k in range(n):
            if density[k] > 0.0:
                w = points[i, 2] * density[k] / total
                dx = points[i, 0] - ellipses[k, 0]
                dy = points[i, 1] - ellipses[k, 1]
                sums[k, 0] += w
                sums[k, 1] += w * dx
                sums[k, 2] += w * dy
                sums[k, 3] += w * dx * dx
                sums[k, 4] += w * dx * dy
                sums[k, 5] += w * dy * dy
    for k in range(n):
        mass = sums[k, 0]
        if mass <= 1e-9:
            continue
        mx = sums[k, 1] / mass
        my = sums[k, 2] / mass
        ellipses[k, 0] += mx
        ellipses[k, 1] += my
        a0 = max(least, half0 + half1 * ellipses[k, 1])
        b0 = a0 * aspect
        weight = strength * math.pi * a0 * b0
        vxx = (4.0 * (sums[k, 3] - mass * mx * mx) + weight * b0 * b0) / (mass + weight)
        vyy = (4.0 * (sums[k, 5] - mass * my * my) + weight * a0 * a0) / (mass + weight)
        vxy = 4.0 * (sums[k, 4] - mass * mx * my) / (mass + weight)
        mean = 0.5 * (vxx + vyy)
        diff = math.sqrt(0.25 * (vyy - vxx) ** 2 + vxy * vxy)
        if vyy >= vxx or not upright:
            ellipses[k, 2] = math.sqrt(max(mean + diff, 0.25))
            ellipses[k, 3] = math.sqrt(max(mean - diff, 0.25))
            ellipses[k, 4] = 0.5 * math.atan2(2.0 * vxy, vyy - vxx)
        else:
            ellipses[k, 2] = math.sqrt(max(vyy, 0.25))
            ellipses[k, 3] = math.sqrt(max(vxx, 0.25))
            ellipses[k, 4] = 0.0


EDGE = 5.0
"""Widths of the soft edge beyond which nothing is left of an ellipse (0.7 %)."""


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
def normal_equations(
    mask: F32, ellipse: F64, window: I64, free: F64, background: float, soft: float, grad: F64, hess: F64
) -> float:
    """Half the weighted squared residual of the union of ellipses against the mask in a window.

    Residual of a cell: mask - (1 - (1 - inside) free), weight 1 for foreground and ``background`` for the rest.
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
            z = (rho - 1.0) * b / soft
            own = 0.0 if z > EDGE else 1.0 / (1.0 + math.exp(z))
            others = free[r - r0, col - c0]
            f = mask[r, col]
            weight = f + background * (1.0 - f)
            residual = f - (1.0 - (1.0 - own) * others)
            cost += 0.5 * weight * residual * residual
            slope = others * own * (1.0 - own) * b / soft
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
def refine(
    mask: F32, ellipses: F64, half0: float, half1: float, least: float, aspect: float, spread: F64, limits: F64,
    background: float, soft: float, sweeps: int,
) -> None:  # fmt: skip
    """Levenberg-Marquardt on one ellipse at a time, the others held, ``sweeps`` times round; in place.

    max(least, half0 + half1 * y): half length expected in row y; aspect: width / length;
    spread: (4,) deviations of ln a, ln b, angle from the prior, and the deviation of a cell's residual;
    limits: (2,) largest |ln size ratio| and |angle|.
    """
    n_rows, n_cols = mask.shape
    grad = np.empty(5)
    hess = np.empty((5, 5))
    damping = np.full(ellipses.shape[0], 0.01)
    precision = 1.0 / (spread[3] * spread[3])
    free = np.empty((n_rows, n_cols))
    window = np.empty(4, dtype=np.int64)
    for _ in range(sweeps):
        for k in range(ellipses.shape[0]):
            a0 = max(least, half0 + half1 * ellipses[k, 1])
            window[0], window[1], window[2], window[3] = window_of(ellipses, k, soft, n_rows, n_cols)
            free_of(ellipses, k, soft, window, free)
            cost = normal_equations(mask, ellipses[k], window, free, background, soft, grad, hess) * precision
            cost += _prior(ellipses, k, a0, aspect, spread, grad, hess, precision)
            old = ellipses[k].copy()
            for i in range(5):
                hess[i, i] = hess[i, i] * (1.0 + damping[k]) + 1e-3 * precision
            step = np.linalg.solve(hess, grad)
            ellipses[k, 0] += min(max(step[0], -3.0), 3.0)
            ellipses[k, 1] += min(max(step[1], -3.0), 3.0)
            a0 = max(least, half0 + half1 * ellipses[k, 1])
            la = math.log(ellipses[k, 2] / a0) + step[2]
            lb = math.log(ellipses[k, 3] / (a0 * aspect)) + step[3]
            ellipses[k, 2] = max(0.7, a0 * math.exp(min(max(la, -limits[0]), limits[0])))
            ellipses[k, 3] = max(0.7, a0 * aspect * math.exp(min(max(lb, -limits[0]), limits[0])))
            ellipses[k, 4] = min(max(ellipses[k, 4] + step[4], -limits[1]), limits[1])
            after = normal_equations(mask, ellipses[k], window, free, background, soft, grad, hess) * precision
            after += _prior(ellipses, k, a0, aspect, spread, grad, hess, precision)
            if after <= cost:
                damping[k] = max(1e-4, damping[k] * 0.3)
            else:
                ellipses[k] = old
                damping[k] = min(1e4, damping[k] * 10.0)


@njit(cache=True, nogil=True)
def _prior(
    ellipses: F64, k: int, a0: float, aspect: float, spread: F64, grad: F64, hess: F64, precision: float
) -> float:
    """Scale the data terms by the precision and add the prior's; returns the prior's cost."""
    cost = 0.0
    for i in range(5):
        grad[i] *= precision
        for j in range(5):
            hess[i, j] *= precision
    for i in range(3):
        if i == 0:
            off = math.log(ellipses[k, 2] / a0)
        elif i == 1:
            off = math.log(ellipses[k, 3] / (a0 * aspect))
        else:
            off = ellipses[k, 4]
        w = 1.0 / (spread[i] * spread[i])
        grad[2 + i] -= w * off
        hess[2 + i, 2 + i] += w
        cost += 0.5 * w * off * off
    return cost


@njit(cache=True, nogil=True)
def exclusive(prefix: F64, ellipses: F64, out: F64) -> None:
    """Per ellipse: cells, values inside, values in no other ellipse, cells in no other ellipse; out (N, 4)."""
    n_rows = prefix.shape[0]
    n_cols = prefix.shape[1] - 1
    count = np.zeros((n_rows, n_cols), dtype=np.int32)
    for turn in range(2):
        for k in range(ellipses.shape[0]):
            x, y, a, b, angle = ellipses[k]
            qxx, qxy, qyy = conic(a, b, angle)
            first, last = rows_of(y, a, b, angle, n_rows)
            if turn == 1:
                out[k, :] = 0.0
            for r in range(first, last + 1):
                lo, hi = span(qxx, qxy, qyy, r - y)
                for c in range(max(0, math.ceil(lo + x)), min(n_cols - 1, math.floor(hi + x)) + 1):
                    if turn == 0:
                        count[r, c] += 1
                    else:
                        value = prefix[r, c + 1] - prefix[r, c]
                        out[k, 0] += 1.0
                        out[k, 1] += value
                        if count[r, c] == 1:
                            out[k, 2] += value
                            out[k, 3] += 1.0
