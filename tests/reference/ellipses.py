"""Plain numpy twins of the ellipse kernels; they define what the compiled loops compute."""

import math

import numpy as np

from calib.types import F32, F64, U8, Bool


def raster(ellipse: F64, shape: tuple[int, int]) -> Bool:
    """Cells whose centres lie in an ellipse (x, y, a, b, angle)."""
    x, y, a, b, angle = ellipse
    rows, cols = np.indices(shape, dtype=np.float64)
    u = (cols - x) * math.sin(angle) + (rows - y) * math.cos(angle)
    v = (cols - x) * math.cos(angle) - (rows - y) * math.sin(angle)
    return (u / a) ** 2 + (v / b) ** 2 < 1.0


def paint(ellipses: F64, shape: tuple[int, int]) -> U8:
    mask = np.zeros(shape, dtype=np.uint8)
    for ellipse in ellipses:
        mask[raster(ellipse, shape)] = 1
    return mask


def row_spans(ellipse: F64, row: int) -> tuple[float, float] | None:
    """Columns between which a row's centre line lies in the ellipse."""
    x, y, a, b, angle = ellipse
    s, c = math.sin(angle), math.cos(angle)
    dy = row - y
    # (dx s + dy c)^2 / a^2 + (dx c - dy s)^2 / b^2 = 1 in dx.
    square, free = s * s / a**2 + c * c / b**2, dy * dy * (c * c / a**2 + s * s / b**2) - 1
    roots = np.roots([square, 2 * dy * s * c * (1 / a**2 - 1 / b**2), free])
    if np.iscomplexobj(roots) and abs(roots.imag).max() > 0:
        return None
    return x + float(roots.real.min()), x + float(roots.real.max())


def integral_between(values: F32, row: int, low: float, high: float) -> float:
    """Integral of a row of cells between two columns; a cell reaches half a cell to each side of its centre."""
    cols = np.arange(values.shape[1])
    overlap = np.clip(np.minimum(high, cols + 0.5) - np.maximum(low, cols - 0.5), 0, None)
    return float((overlap * values[row]).sum())


def overlap(ellipse: F64, left: F32, allowed: F32) -> tuple[float, float]:
    """What an ellipse covers of the cells that are left, and its area inside the grid outside the allowed cells."""
    n_rows, n_cols = left.shape
    covered = outside = 0.0
    for row in range(n_rows):
        ends = row_spans(ellipse, row)
        if ends is None:
            continue
        low, high = max(ends[0], -0.5), min(ends[1], n_cols - 0.5)
        if high > low:
            covered += integral_between(left, row, low, high)
            outside += high - low - integral_between(allowed, row, low, high)
    return covered, outside


def cover(score: F32, half: F64, aspect: float, stride: int, accept: float) -> list[tuple[int, int]]:
    """(row, column) of the ellipses chosen one after the other; each has gain in its middle row."""
    score, ones = score.copy(), np.ones_like(score)
    chosen: list[tuple[int, int]] = []
    while True:
        best, where = -math.inf, (0, 0)
        for r in range(0, score.shape[0], stride):
            a = half[r]
            for c in range(0, score.shape[1], stride):
                low, high = max(c - a * aspect, -0.5), min(c + a * aspect, score.shape[1] - 0.5)
                if (r, c) in chosen or integral_between(score, r, low, high) <= 0:
                    continue
                ellipse = np.array([c, r, a, a * aspect, 0.0])
                gain = overlap(ellipse, score, ones)[0]
                gain /= max(overlap(ellipse, ones, ones)[0], 0.5 * math.pi * a * a * aspect)
                if gain > best + 1e-9:
                    best, where = gain, (r, c)
        if best < accept:
            return chosen
        chosen.append(where)
        a = half[where[0]]
        score[raster(np.array([where[1], where[0], a, a * aspect, 0.0]), score.shape)] = 0.0


EDGE = 5.0
"""Widths of the soft edge beyond which an ellipse has nothing."""


def soft_inside(ellipse: F64, shape: tuple[int, int], soft: float) -> tuple[F64, F64, F64]:
    """Logistic inside of an ellipse, and (u, v) of each cell along and across its axis."""
    x, y, a, b, angle = ellipse
    rows, cols = np.indices(shape, dtype=np.float64)
    u = (cols - x) * math.sin(angle) + (rows - y) * math.cos(angle)
    v = (cols - x) * math.cos(angle) - (rows - y) * math.sin(angle)
    z = (np.maximum(1e-6, np.hypot(u / a, v / b)) - 1.0) * b / soft
    return np.where(z > EDGE, 0.0, 1.0 / (1.0 + np.exp(np.minimum(z, EDGE)))), u, v


def equations(
    mask: F32, ellipse: F64, others: F64, soft: float, background: float, box: tuple[slice, slice]
) -> tuple[float, F64, F64]:
    """Cost of the soft union against the mask in a box, and its Gauss-Newton gradient and Hessian."""
    a, b, s, c = ellipse[2], ellipse[3], math.sin(ellipse[4]), math.cos(ellipse[4])
    own, u, v = soft_inside(ellipse, mask.shape, soft)
    weight = mask + background * (1.0 - mask)
    residual = mask - (1.0 - (1.0 - own) * others)
    slope = others * own * (1.0 - own) * b / soft
    slope = np.where(slope < 1e-4, 0.0, slope) / np.maximum(1e-6, np.hypot(u / a, v / b))
    rows = slope * np.array([
        u * s / a**2 + v * c / b**2, u * c / a**2 - v * s / b**2, (u / a) ** 2, (v / b) ** 2, -u * v * (a**-2 - b**-2)
    ])  # fmt: skip
    weight, residual, rows = weight[box], residual[box], rows[:, box[0], box[1]]
    gradient = np.einsum("rc,irc->i", weight * residual, rows)
    return 0.5 * float((weight * residual**2).sum()), gradient, np.einsum("rc,irc,jrc->ij", weight, rows, rows)


def refine(
    mask: F32, ellipses: F64, law: tuple[float, float, float, float], spread: F64, limit: float,
    deviation: float, background: float, soft: float, sweeps: int,
) -> F64:  # fmt: skip
    """Levenberg-Marquardt on one ellipse at a time with Gaussian priors of length, width and angle."""
    level, slope, least, aspect = law
    out, damping, precision = ellipses.copy(), np.full(len(ellipses), 0.01), deviation**-2

    def expected(e: F64) -> F64:
        a0 = max(least, level + slope * e[1])
        return np.array([a0, a0 * aspect])

    def posterior(e: F64, others: F64, box: tuple[slice, slice]) -> tuple[float, F64, F64]:
        cost, gradient, hessian = equations(mask, e, others, soft, background, box)
        off = np.array([*np.log(e[2:4] / expected(e)), e[4]])
        gradient, hessian = gradient * precision, hessian * precision
        gradient[2:] -= off / spread**2
        hessian[2:, 2:] += np.diag(spread**-2)
        return cost * precision + 0.5 * float(((off / spread) ** 2).sum()), gradient, hessian

    for _ in range(sweeps):
        for k in range(len(out)):
            x, y, a, b, angle = out[k]
            grow = 1.0 + EDGE * soft / b
            reach_y = math.hypot(a * math.cos(angle), b * math.sin(angle)) * grow
            reach_x = math.hypot(a * math.sin(angle), b * math.cos(angle)) * grow
            box = (
                slice(max(0, math.ceil(y - reach_y)), math.floor(y + reach_y) + 1),
                slice(max(0, math.ceil(x - reach_x)), math.floor(x + reach_x) + 1),
            )
            insides = [soft_inside(e, mask.shape, soft)[0] for e in np.delete(out, k, axis=0)]
            others = np.prod([1.0 - i for i in insides], axis=0) if insides else np.ones(mask.shape)
            cost, gradient, hessian = posterior(out[k], others, box)
            hessian[np.diag_indices(5)] = hessian.diagonal() * (1.0 + damping[k]) + 1e-3
            step = np.linalg.solve(hessian, gradient)
            new = out[k].copy()
            new[:2] += np.clip(step[:2], -3.0, 3.0)
            ratio = math.exp(limit * spread[0])
            new[2:4] = np.clip(new[2:4] * np.exp(step[2:4]), expected(new) / ratio, expected(new) * ratio)
            new[4] = np.clip(new[4] + step[4], -limit * spread[2], limit * spread[2])
            if posterior(new, others, box)[0] <= cost:
                out[k], damping[k] = new, max(1e-4, damping[k] * 0.3)
            else:
                damping[k] = min(1e4, damping[k] * 10.0)
    return out
