"""Compiled choice of windows; its plain twin is in tests/reference/windows.py."""

import numpy as np
from numba import njit

from calib.types import F64, AnyArray


@njit(cache=True, nogil=True)
def _count(sums: AnyArray, top: int, left: int, bottom: int, right: int) -> int:
    """Marked tiles of a box, from the summed-area table."""
    return int(sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left])


@njit(cache=True, nogil=True)
def tight(sums: AnyArray, top: int, left: int, bottom: int, right: int) -> tuple[int, int, int, int]:
    """The smallest box around the marked tiles of a box; empty when there is none."""
    while top < bottom and _count(sums, top, left, top + 1, right) == 0:
        top += 1
    while bottom > top and _count(sums, bottom - 1, left, bottom, right) == 0:
        bottom -= 1
    while left < right and _count(sums, top, left, bottom, left + 1) == 0:
        left += 1
    while right > left and _count(sums, top, right - 1, bottom, right) == 0:
        right -= 1
    return top, left, bottom, right


@njit(cache=True, nogil=True)
def cost(box: tuple[int, int, int, int], per_pixel: F64, tile: int, rows: float, columns: float, fixed: float) -> float:
    """Of matching a box: its pixels and a margin times the work per pixel, and what a window costs besides."""
    top, left, bottom, right = box
    if top >= bottom or left >= right:
        return 0.0
    height, width = (bottom - top) * tile + rows, (right - left) * tile + columns
    return float(height * width * per_pixel[top, bottom - 1] + fixed)


@njit(cache=True, nogil=True)
def split(  # type: ignore[no-untyped-def]
    sums: AnyArray, per_pixel: F64, tile: int, rows: float, columns: float, fixed: float, out: AnyArray
):
    """Boxes around all marked tiles: one, cut in two wherever the two together cost less.

    ``sums`` (n + 1, m + 1) int32 summed-area table of the tiles; ``per_pixel`` (n, n) float64, work of a pixel of boxes
    from the first to the last row; ``rows``, ``columns``: margins [px]. Fills ``out`` (K, 4) int64 with top, left,
    bottom, right in tiles, and returns their number and total cost; -1 when there are more than K.
    """
    n = 0
    total = 0.0
    waiting = np.empty((len(out) + 1, 4), np.int64)
    waiting[0] = np.array([0, 0, sums.shape[0] - 1, sums.shape[1] - 1])
    left_over = 1
    while left_over > 0:
        left_over -= 1
        box = tight(sums, waiting[left_over, 0], waiting[left_over, 1], waiting[left_over, 2], waiting[left_over, 3])
        best = cost(box, per_pixel, tile, rows, columns, fixed)
        if best == 0.0:
            continue
        one, other, is_cut = box, box, False
        for axis in range(2):
            for cut in range(box[axis] + 1, box[axis + 2]):
                if axis == 0:
                    a = tight(sums, box[0], box[1], cut, box[3])
                    b = tight(sums, cut, box[1], box[2], box[3])
                else:
                    a = tight(sums, box[0], box[1], box[2], cut)
                    b = tight(sums, box[0], cut, box[2], box[3])
                both = cost(a, per_pixel, tile, rows, columns, fixed)
                both += cost(b, per_pixel, tile, rows, columns, fixed)
                if both < best:
                    best, one, other, is_cut = both, a, b, True
        if n + left_over + 2 > len(out):
            return -1, total
        if is_cut:
            waiting[left_over] = np.array(one)
            waiting[left_over + 1] = np.array(other)
            left_over += 2
        else:
            out[n] = np.array(box)
            total += best
            n += 1
    return n, total
