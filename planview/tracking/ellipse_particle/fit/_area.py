"""Compiled kernels: areas of ellipses on a grid of cells; ``tests/reference/ellipses.py`` defines them in plain numpy.

Coordinates: cell (row r, column c) has its centre at (x, y) = (c, r) and reaches half a cell to each side.
An ellipse is (x, y, a, b, angle): centre, half length, half width [cells], and the angle of the length axis
from the +row direction towards +column [rad].
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8

AREA, VALUE, OWN_VALUE, OWN_AREA = range(4)
"""Columns of what ``claim`` and ``exclusive`` give per ellipse: cells in the grid, sum of the values inside, and of
both the part that belongs to no other ellipse: the sum of its values, its cells."""
SHOWN, ROWS = range(2)
"""Columns of what ``shown_rows`` gives per ellipse: rows in which it shows, its rows in the grid."""


@njit(cache=True, nogil=True, inline="always")
def half_length(law, y):  # type: ignore[no-untyped-def]
    """Half length expected of an ellipse centred in row y, by a ``SizeLaw``."""
    return max(law.half_min, law.half_0 + law.slope * y)


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


@njit(cache=True, nogil=True, inline="always")
def columns_of(x, form, dy, n_cols):  # type: ignore[no-untyped-def]
    """First and last column whose centres lie in an ellipse (centre column x, ``conic`` form) in the row dy below its
    centre, clipped to the grid; first > last when there are none."""
    qxx, qxy, qyy = form
    lo, hi = span(qxx, qxy, qyy, dy)
    return max(0, math.ceil(lo + x)), min(n_cols - 1, math.floor(hi + x))


@njit(cache=True, nogil=True)
def row_prefix(values: F32 | U8) -> F64:
    """(R, C + 1): sums of the columns left of each cell edge."""
    n_rows, n_cols = values.shape
    out = np.empty((n_rows, n_cols + 1))
    for r in range(n_rows):
        total = 0.0
        row, sums = values[r], out[r]
        sums[0] = 0.0
        for c in range(np.uintp(n_cols)):
            total += row[c]
            sums[c + np.uintp(1)] = total
    return out


@njit(cache=True, nogil=True, inline="always")
def between(sums, lo, hi):  # type: ignore[no-untyped-def]
    """Integral of a row between the columns lo and hi (fractional, already within the grid's edges), from its sums."""
    t0 = lo + 0.5
    t1 = hi + 0.5
    last = sums.shape[0] - 2
    j0 = np.uintp(min(np.int64(t0), last))
    j1 = np.uintp(min(np.int64(t1), last))
    low = sums[j0] + (t0 - np.float64(np.int64(j0))) * (sums[j0 + np.uintp(1)] - sums[j0])
    high = sums[j1] + (t1 - np.float64(np.int64(j1))) * (sums[j1 + np.uintp(1)] - sums[j1])
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
            total += between(prefix[r], lo, hi)
            area += hi - lo
    return total, area


@njit(cache=True, nogil=True)
def paint(mask: U8, ellipses: F64, value: int) -> None:
    """Set the cells whose centres lie in any of the (N, 5) ellipses."""
    n_rows, n_cols = mask.shape
    for k in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        for r in range(first, last + 1):
            c0, c1 = columns_of(x, form, r - y, n_cols)
            for c in range(c0, c1 + 1):
                mask[r, c] = value


@njit(cache=True, nogil=True)
def claim(prefix: F64, ellipses: F64, order: I64, out: F64) -> None:
    """What each ellipse covers of the values, and what of it no ellipse earlier in the order covers.

    out: (N, 4) float64, columns ``AREA``, ``VALUE``, ``OWN_VALUE``, ``OWN_AREA``.
    """
    n_rows = prefix.shape[0]
    n_cols = prefix.shape[1] - 1
    taken = np.zeros((n_rows, n_cols), dtype=np.uint8)
    for k in order:
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        out[k] = 0.0
        for r in range(first, last + 1):
            c0, c1 = columns_of(x, form, r - y, n_cols)
            for c in range(c0, c1 + 1):
                value = prefix[r, c + 1] - prefix[r, c]
                out[k, AREA] += 1.0
                out[k, VALUE] += value
                if taken[r, c] == 0:
                    taken[r, c] = 1
                    out[k, OWN_VALUE] += value
                    out[k, OWN_AREA] += 1.0


@njit(cache=True, nogil=True)
def exclusive(prefix: F64, ellipses: F64, out: F64) -> None:
    """What each ellipse covers of the values, and what of it no other ellipse covers; out as in ``claim``."""
    n_rows = prefix.shape[0]
    n_cols = prefix.shape[1] - 1
    count = np.zeros((n_rows, n_cols), dtype=np.int32)
    for k in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        for r in range(first, last + 1):
            c0, c1 = columns_of(x, form, r - y, n_cols)
            for c in range(c0, c1 + 1):
                count[r, c] += 1
    for k in range(ellipses.shape[0]):
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        out[k] = 0.0
        for r in range(first, last + 1):
            c0, c1 = columns_of(x, form, r - y, n_cols)
            for c in range(c0, c1 + 1):
                value = prefix[r, c + 1] - prefix[r, c]
                out[k, AREA] += 1.0
                out[k, VALUE] += value
                if count[r, c] == 1:
                    out[k, OWN_VALUE] += value
                    out[k, OWN_AREA] += 1.0


@njit(cache=True, nogil=True)
def shown_rows(mask: F32, ellipses: F64, order: I64, limb: F64, filled: float, out: F64) -> None:
    """Per ellipse: rows in which it shows, and its rows in the grid; out (N, 2), columns ``SHOWN``, ``ROWS``.

    It shows in a row when the values that are in no ellipse earlier in the order sum up to ``limb`` (N,) [cells], and
    to the share ``filled`` of the row's cells where earlier ellipses have as much as ``limb`` of what it covers.
    """
    n_rows, n_cols = mask.shape
    taken = np.zeros((n_rows, n_cols), dtype=np.uint8)
    for k in order:
        x, y, a, b, angle = ellipses[k]
        form = conic(a, b, angle)
        first, last = rows_of(y, a, b, angle, n_rows)
        out[k] = 0.0
        for r in range(first, last + 1):
            c0, c1 = columns_of(x, form, r - y, n_cols)
            own = 0.0
            others = 0.0
            for c in range(c0, c1 + 1):
                if taken[r, c] == 0:
                    taken[r, c] = 1
                    own += mask[r, c]
                else:
                    others += mask[r, c]
            if c1 >= c0:
                out[k, ROWS] += 1.0
                if own >= limb[k] and (others < limb[k] or own >= filled * (c1 + 1 - c0)):
                    out[k, SHOWN] += 1.0
