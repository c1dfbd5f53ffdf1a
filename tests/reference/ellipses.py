"""Plain numpy twins of the ellipse kernels; they define what the compiled loops compute."""

import math

import numpy as np

from calib.types import F32, F64, I32, U8, Bool


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


def claim(values: F32, ellipses: F64, order: list[int]) -> F64:
    out = np.zeros((len(ellipses), 4))
    taken = np.zeros(values.shape, dtype=bool)
    for k in order:
        cells = raster(ellipses[k], values.shape)
        new = cells & ~taken
        out[k] = cells.sum(), values[cells].sum(), values[new].sum(), new.sum()
        taken |= cells
    return out


def exclusive(values: F32, ellipses: F64) -> F64:
    rasters = np.array([raster(e, values.shape) for e in ellipses])
    alone = rasters.sum(axis=0) == 1
    return np.array(
        [[r.sum(), values[r].sum(), values[r & alone].sum(), (r & alone).sum()] for r in rasters], dtype=np.float64
    )


def shown_rows(mask: F32, ellipses: F64, order: list[int], limb: F64, filled: float) -> F64:
    """Rows with a limb's breadth that no earlier ellipse has, filled where earlier ones have such too; rows."""
    out = np.zeros((len(ellipses), 2))
    taken = np.zeros(mask.shape, dtype=bool)
    for k in order:
        cells = raster(ellipses[k], mask.shape)
        width = cells.sum(axis=1)
        own = np.where(cells & ~taken, mask, 0.0).sum(axis=1)
        others = np.where(cells & taken, mask, 0.0).sum(axis=1)
        shows = (own >= limb[k]) & ((others < limb[k]) | (own >= filled * width))
        out[k] = ((width > 0) & shows).sum(), (width > 0).sum()
        taken |= cells
    return out


def row_spans(ellipse: F64, row: int) -> tuple[float, float] | None:
    """Columns between which a row's centre line lies in the ellipse."""
    x, y, a, b, angle = ellipse
    s, c = math.sin(angle), math.cos(angle)
    dy = row - y
    # (dx s + dy c)^2 / a^2 + (dx c - dy s)^2 / b^2 = 1 in dx.
    roots = np.roots(
        [
            s * s / a**2 + c * c / b**2,
            2 * dy * s * c * (1 / a**2 - 1 / b**2),
            dy * dy * (c * c / a**2 + s * s / b**2) - 1,
        ]
    )
    if np.iscomplexobj(roots) and abs(roots.imag).max() > 0:
        return None
    return x + float(roots.real.min()), x + float(roots.real.max())


def integral_between(values: F32, row: int, low: float, high: float) -> float:
    """Integral of a row of cells between two columns; a cell reaches half a cell to each side of its centre."""
    cols = np.arange(values.shape[1])
    overlap = np.clip(np.minimum(high, cols + 0.5) - np.maximum(low, cols - 0.5), 0, None)
    return float((overlap * values[row]).sum())


def union_overlap(ellipses: F64, measured: F32, allowed: F32) -> tuple[float, float]:
    """Measured area covered by the union of ellipses, and its area inside the grid outside the allowed cells."""
    n_rows, n_cols = measured.shape
    covered = outside = 0.0
    for row in range(n_rows):
        spans = sorted(s for e in ellipses if (s := row_spans(e, row)) is not None)
        merged: list[list[float]] = []
        for low, high in spans:
            low, high = max(low, -0.5), min(high, n_cols - 0.5)
            if high <= low:
                continue
            if merged and low <= merged[-1][1]:
                merged[-1][1] = max(merged[-1][1], high)
            else:
                merged.append([low, high])
        for low, high in merged:
            covered += integral_between(measured, row, low, high)
            outside += high - low - integral_between(allowed, row, low, high)
    return covered, outside


def cover(score: F32, half_length: F64, aspect: float, stride: int, accept: float, limit: int) -> list[tuple[int, int]]:
    """(row, column) of the ellipses chosen one after the other."""
    score = score.copy()
    chosen: list[tuple[int, int]] = []
    while len(chosen) < limit:
        best, where = -math.inf, (0, 0)
        for r in range(0, score.shape[0], stride):
            a = half_length[r]
            for c in range(0, score.shape[1], stride):
                if (r, c) in chosen:
                    continue
                ellipse = np.array([c, r, a, a * aspect, 0.0])
                total, _ = union_overlap(ellipse[None], score, np.ones_like(score))
                inside, _ = union_overlap(ellipse[None], np.ones_like(score), np.ones_like(score))
                gain = total / max(inside, 0.5 * math.pi * a * a * aspect)
                if gain > best + 1e-9:
                    best, where = gain, (r, c)
        if best < accept:
            break
        chosen.append(where)
        a = half_length[where[0]]
        score[raster(np.array([where[1], where[0], a, a * aspect, 0.0]), score.shape)] = 0.0
    return chosen


def em_step(points: F64, ellipses: F64, law: tuple[float, float, float, float], strength: float, outlier: float) -> F64:
    """One step of expectation-maximisation with upright priors; returns the new ellipses."""
    half_0, slope, half_min, aspect = law
    d = points[:, None, :2] - ellipses[None, :, :2]
    s, c = np.sin(ellipses[:, 4]), np.cos(ellipses[:, 4])
    u = (d[..., 0] * s + d[..., 1] * c) / ellipses[:, 2]
    v = (d[..., 0] * c - d[..., 1] * s) / ellipses[:, 3]
    m = u * u + v * v
    density = np.where(m > 6.0, 0.0, 2.0 / (np.pi * ellipses[:, 2] * ellipses[:, 3]) * np.exp(-2.0 * m))
    weight = points[:, 2:3] * density / (outlier + density.sum(axis=1, keepdims=True))
    out = ellipses.copy()
    for k in range(len(ellipses)):
        mass = weight[:, k].sum()
        if mass <= 1e-9:
            continue
        centre = (weight[:, k : k + 1] * points[:, :2]).sum(axis=0) / mass
        e = points[:, :2] - centre
        scatter = (weight[:, k, None, None] * e[:, :, None] * e[:, None, :]).sum(axis=0)
        a0 = max(half_min, half_0 + slope * centre[1])
        prior = strength * np.pi * a0 * a0 * aspect
        cov = (4 * scatter + prior * np.diag([(a0 * aspect) ** 2, a0**2])) / (mass + prior)
        values, vectors = np.linalg.eigh(cov)
        along = vectors[:, 1]
        if along[1] < 0:
            along = -along
        out[k] = [*centre, math.sqrt(values[1]), math.sqrt(values[0]), math.atan2(along[0], along[1])]
    return out


def soft_union(ellipses: F64, shape: tuple[int, int], soft: float, widths: F64) -> F64:
    """1 - prod (1 - inside), inside a logistic edge ``soft`` cells wide across ellipses of half ``widths``."""
    rows, cols = np.indices(shape, dtype=np.float64)
    free = np.ones(shape)
    for (x, y, a, b, angle), width in zip(ellipses, widths, strict=True):
        u = ((cols - x) * math.sin(angle) + (rows - y) * math.cos(angle)) / a
        v = ((cols - x) * math.cos(angle) - (rows - y) * math.sin(angle)) / b
        z = np.clip((np.hypot(u, v) - 1.0) * width / soft, -30, 30)
        free *= 1.0 - 1.0 / (1.0 + np.exp(z))
    return 1.0 - free


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


def explained(mask: F32, ellipses: F64, background: float, soft: float) -> float:
    """Half the weighted squared residual of a mask without ellipses, less that with their soft union."""
    outside = [1.0 - soft_inside(e, mask.shape, soft)[0] for e in ellipses]
    union = 1.0 - np.prod(outside, axis=0)
    weight = mask + background * (1.0 - mask)
    return float(0.5 * (weight * (mask**2 - (mask - union) ** 2)).sum())


def refine(
    mask: F32, ellipses: F64, law: tuple[float, float, float, float], spread: F64, limits: F64,
    background: float, soft: float, sweeps: int, members: list[int], looseness: float,
) -> F64:  # fmt: skip
    """Levenberg-Marquardt on one of the members at a time with Gaussian priors of size and angle.

    Length and width have a deviation each of their own, and a common one: together ``looseness`` times as large.
    """
    covariance = np.diag(spread[:3] ** 2)
    covariance[:2, :2] += spread[0] ** 2 * (looseness**2 - 1.0)
    information = np.linalg.inv(covariance)
    half_0, slope, half_min, aspect = law
    out, damping, precision = ellipses.copy(), np.full(len(ellipses), 0.01), spread[3] ** -2

    def expected(e: F64) -> F64:
        a0 = max(half_min, half_0 + slope * e[1])
        return np.array([a0, a0 * aspect])

    def posterior(e: F64, others: F64, box: tuple[slice, slice]) -> tuple[float, F64, F64]:
        cost, gradient, hessian = equations(mask, e, others, soft, background, box)
        off = np.array([*np.log(e[2:4] / expected(e)), e[4]])
        gradient, hessian = gradient * precision, hessian * precision
        gradient[2:] -= information @ off
        hessian[2:, 2:] += information
        return cost * precision + 0.5 * float(off @ information @ off), gradient, hessian

    for _ in range(sweeps):
        for k in members:
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
            hessian[np.diag_indices(5)] = hessian.diagonal() * (1.0 + damping[k]) + 1e-3 * precision
            step = np.linalg.solve(hessian, gradient)
            new = out[k].copy()
            new[:2] += np.clip(step[:2], -3.0, 3.0)
            ratio = np.log(new[2:4] / expected(new)) + step[2:4]
            new[2:4] = np.maximum(0.7, expected(new) * np.exp(np.clip(ratio, -limits[0], limits[0])))
            new[4] = np.clip(new[4] + step[4], -limits[1], limits[1])
            if posterior(new, others, box)[0] <= cost:
                out[k], damping[k] = new, max(1e-4, damping[k] * 0.3)
            else:
                damping[k] = min(1e4, damping[k] * 10.0)
    return out


def region_sums(labels: I32, moving: Bool, count: int) -> tuple[F64, F64]:
    """(count, 6) cells, x, y, x^2, x y, y^2 summed over each label's cells, and (count,) its cells that move."""
    rows, cols = np.indices(labels.shape).astype(np.float64)
    terms = np.ones(labels.shape), cols, rows, cols * cols, cols * rows, rows * rows
    sums = np.array([[term[labels == k].sum() for term in terms] for k in range(count)])
    return sums, np.array([float((moving & (labels == k)).sum()) for k in range(count)])
