"""Compiled grouping of pixels; OpenCV's ``connectedComponentsWithStats`` (CCL_BBDT) defines it."""

from __future__ import annotations

import numpy as np
from numba import njit

from calib.types import I32, I64, U8

STRIDE = 32
"""Empty pixels that are passed over at once, on vector registers."""


@njit(cache=True, nogil=True)
def find_runs(mask: U8, runs: I32, parents: I32) -> int:
    """Rows y and columns x0 <= x < x1 of runs of pixels that are not 0, (N, 3) in order; returns how many there are.

    Two runs of one group lead to the same root over ``parents``, (N,): the first run of the group.
    """
    height, width = mask.shape
    n, above, above_end = 0, 0, 0
    for y in range(height):
        row, first = mask[y], n
        x = 0
        while True:
            x = _next_pixel(row, x)
            if x == width:
                break
            start = x
            while x < width and row[x] > 0:
                x += 1
            runs[n, 0], runs[n, 1], runs[n, 2], parents[n] = y, start, x, n
            # Diagonal neighbours touch.
            while above < above_end and runs[above, 2] < start:
                above += 1
            i = above
            while i < above_end and runs[i, 1] <= x:
                _join(parents, i, n)
                i += 1
            n += 1
        above, above_end = first, n
    return n


@njit(cache=True, nogil=True)
def _next_pixel(row: U8, x: int) -> int:
    """First column from x on that is not 0; the width where there is none."""
    width = len(row)
    while x + STRIDE <= width:
        some = np.uint8(0)
        part = row[x : x + STRIDE]
        for i in range(np.uintp(STRIDE)):
            some |= part[i]
        if some > 0:
            break
        x += STRIDE
    while x < width and row[x] == 0:
        x += 1
    return x


@njit(cache=True, nogil=True)
def _root(parents: I32, i: int) -> int:
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@njit(cache=True, nogil=True)
def _join(parents: I32, i: int, k: int) -> None:
    i, k = _root(parents, i), _root(parents, k)
    parents[max(i, k)] = min(i, k)


@njit(cache=True, nogil=True)
def label_runs(runs: I32, parents: I32, labels: I32) -> tuple[I64, I32]:
    """Label the groups of (N, 3) runs in (H, W) zeros, from 1 on in the order of their first blocks of 2x2 pixels.

    Returns:
        (n + 1,) areas and (n + 1, 4) left, top, width, height of the groups, zeros for label 0.
    """
    n_runs, blocks = len(runs), labels.shape[1] // 2 + 1
    group, first = np.full(n_runs, -1, np.int32), np.empty(n_runs, np.int64)
    n = 0
    for i in range(n_runs):
        root = _root(parents, i)
        block = np.int64(runs[i, 0] // 2) * blocks + runs[i, 1] // 2
        if root == i:
            group[i] = n
            first[n] = block
            n += 1
        else:
            group[i] = group[root]
            first[group[i]] = min(first[group[i]], block)
    number = np.empty(n, np.int32)
    number[np.argsort(first[:n])] = np.arange(1, n + 1).astype(np.int32)
    area, box = np.zeros(n + 1, np.int64), np.zeros((n + 1, 4), np.int32)
    box[1:, 0] = labels.shape[1]
    for i in range(n_runs):
        y, x0, x1 = runs[i]
        label = number[group[i]]
        labels[y, x0:x1] = label
        if area[label] == 0:
            box[label, 1] = y
        area[label] += x1 - x0
        # Until all runs are known, the last two are right and bottom.
        box[label, 0] = min(box[label, 0], x0)
        box[label, 2] = max(box[label, 2], x1)
        box[label, 3] = y + 1
    box[1:, 2:] -= box[1:, :2]
    return area, box
