"""Compiled greedy cover of foreground by ellipses; ``tests/reference/ellipses.py`` defines it in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64
from planview.tracking.ellipse_particle.fit._area import between, conic, row_prefix, rows_of, span


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


@njit(cache=True, nogil=True)
def cover(score: F32, half_length: F64, aspect: float, stride: int, accept: float, limit: int) -> F64:
    """Greedy cover: place prior-sized upright ellipses where the sum of ``score`` inside is largest.

    score: (R, C) gain of covering each cell; set to 0 where covered (overwritten).
    half_length: (R,) half length expected of an object centred in each row [cells].
    accept: smallest gain of an ellipse as a share of its area in the grid (at least half its area): what lies outside
    speaks for nothing.
    Returns (N, 5), N <= limit, in order of gain share.
    """
    prefix = row_prefix(score)
    gain = _gains(score, prefix, half_length, aspect, stride, accept)
    n_c = gain.shape[1]
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
        found[n] = np.array([x, y, a, b, 0.0])
        n += 1
        _take(score, prefix, x, y, a, b)
        _refresh(gain, prefix, half_length, aspect, stride, x, y, a, b)
        # A cell on the far side of rounding may keep its gain: never choose the same place twice.
        gain[i, j] = -1.0
    return found[:n]


@njit(cache=True, nogil=True)
def _gains(score: F32, prefix: F64, half_length: F64, aspect: float, stride: int, accept: float) -> F64:
    """Gain of every place of the grid as a share of the ellipse's area; -1 where it cannot reach ``accept``."""
    n_rows, n_cols = score.shape
    bound = integral(score)
    gain = np.zeros(((n_rows + stride - 1) // stride, (n_cols + stride - 1) // stride))
    spans = np.empty((2, n_rows))
    for i in range(gain.shape[0]):
        r = i * stride
        a = half_length[r]
        area = math.pi * a * a * aspect
        reach = int(a * aspect) + 1
        r0 = max(0, r - int(a) - 1)
        r1 = min(n_rows, r + int(a) + 2)
        edge = r0 == 0 or r1 == n_rows
        first, last = _spans(float(r), a, a * aspect, spans)
        for j in range(gain.shape[1]):
            c0 = max(0, j * stride - reach)
            c1 = min(n_cols, j * stride + reach + 1)
            most = bound[r1, c1] - bound[r0, c1] - bound[r1, c0] + bound[r0, c0]
            if most < accept * area * (0.5 if edge or c0 == 0 or c1 == n_cols else 1.0):
                # Not even all gains in the box around the ellipse would do.
                gain[i, j] = -1.0
                continue
            gain[i, j] = _share(prefix, float(j * stride), a, a * aspect, spans, first, last)
    return gain


@njit(cache=True, nogil=True)
def _spans(y: float, a: float, b: float, spans: F64) -> tuple[int, int]:
    """Offsets from its centre column between which an upright ellipse covers each row; returns first and last row.

    They are the same for all ellipses of a row, which differ in their columns only.
    """
    qxx, qxy, qyy = conic(a, b, 0.0)
    first, last = rows_of(y, a, b, 0.0, spans.shape[1])
    for r in range(first, last + 1):
        spans[0, r], spans[1, r] = span(qxx, qxy, qyy, r - y)
    return first, last


@njit(cache=True, nogil=True)
def _share(prefix: F64, x: float, a: float, b: float, spans: F64, first: int, last: int) -> float:
    """Gain of an upright ellipse over its area inside the grid, or half its area when less is inside."""
    n_cols = prefix.shape[1] - 1
    lows, highs = spans[0], spans[1]
    total = 0.0
    inside = 0.0
    for r in range(np.uintp(first), np.uintp(last + 1)):
        lo = max(lows[r] + x, -0.5)
        hi = min(highs[r] + x, n_cols - 0.5)
        if hi > lo:
            total += between(prefix[r], lo, hi)
            inside += hi - lo
    return total / max(inside, 0.5 * math.pi * a * b)


@njit(cache=True, nogil=True)
def _take(score: F32, prefix: F64, x: float, y: float, a: float, b: float) -> None:
    """Nothing is left to gain in the cells of an upright ellipse."""
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
    """Gains of the places whose ellipses can overlap one just taken."""
    n_r, n_c = gain.shape
    n_rows = half_length.shape[0]
    reach = 0.0
    for r in range(n_rows):
        reach = max(reach, half_length[r])
    i0 = max(0, int((y - a - reach) / stride))
    i1 = min(n_r - 1, int((y + a + reach) / stride) + 1)
    j0 = max(0, int((x - b - reach * aspect) / stride))
    j1 = min(n_c - 1, int((x + b + reach * aspect) / stride) + 1)
    spans = np.empty((2, n_rows))
    for i in range(i0, i1 + 1):
        r = i * stride
        h = half_length[r]
        first, last = _spans(float(r), h, h * aspect, spans)
        for j in range(j0, j1 + 1):
            if gain[i, j] >= 0.0:
                gain[i, j] = _share(prefix, float(j * stride), h, h * aspect, spans, first, last)
