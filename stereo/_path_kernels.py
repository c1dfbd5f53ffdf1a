"""Compiled semi-global matching of samples: path costs, the best disparity, its tests and its fraction; their plain
twin is tests/reference/sampled_matching.py.

Numba's cache of this file does not notice changes of ``_cost_kernels``: change or touch both.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from calib.types import I16, I64, U8
from stereo._cost_kernels import N_PLANES, RAW, Layout, add, costs, larger, smaller

NO_COST = np.int16(32_767)
BLOCKED = np.int16(16_000)
"""Cost of a disparity that is not searched."""
NONE = np.int16(-16)
"""Instead of a disparity."""


class Choice(NamedTuple):
    """How disparities are chosen.

    Attributes:
        p1, p2: penalties on a change of disparity by one, and by more, in the costs of blocks.
        uniqueness_percent: by so much the best cost must be below all that are not beside it.
        left_right: largest difference between the disparities of the left and the right sample [px].
    """

    p1: int
    p2: int
    uniqueness_percent: int
    left_right: int


class Paths(NamedTuple):
    """Costs of one path at its last sample, for a line of samples that are as many paths side by side.

    Attributes:
        last: int16 ((count + 2) * n) costs by disparity, one more disparity at both ends that is blocked.
        lowest: int16 (count * n) the lowest of each path, once per disparity.
        work: int16 (count * n).
    """

    last: I16
    lowest: I16
    work: I16


@njit(cache=True, nogil=True)
def begin(paths: Paths, n: int) -> None:
    """Before the first sample of paths, which starts with its own costs."""
    paths.last[:] = 0
    paths.last[:n] = BLOCKED
    paths.last[paths.last.size - n :] = BLOCKED
    paths.lowest[:] = 0


@njit(cache=True, nogil=True)
def extend(cost: I16, below: I16, same: I16, above: I16, lowest: I16, p1: Any, p2: Any, out: I16) -> None:
    """Hirschmueller 2008, eq. (13): L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q)."""
    for k in range(out.size):
        x = smaller(np.int16(smaller(below[k], above[k]) + p1), same[k])
        x = smaller(x, np.int16(lowest[k] + p2))
        out[k] = np.int16(cost[k] + np.int16(x - lowest[k]))


@njit(cache=True, nogil=True)
def smaller_of(a: I16, b: I16, out: I16) -> None:
    for k in range(out.size):
        out[k] = smaller(a[k], b[k])


@njit(cache=True, nogil=True)
def lower(a: I16, out: I16) -> None:
    for k in range(out.size):
        out[k] = smaller(out[k], a[k])


@njit(cache=True, nogil=True)
def copy(a: I16, out: I16) -> None:
    for k in range(out.size):
        out[k] = a[k]


@njit(cache=True, nogil=True)
def minimum(costs_: I16, n: int, out: I16) -> None:
    """The lowest of every n-th value, for the first n; written over all of ``out``."""
    count = costs_.size // n
    half = count // 2
    smaller_of(costs_[: half * n], costs_[half * n : 2 * half * n], out[: half * n])
    if count % 2:
        lower(costs_[2 * half * n :], out[:n])
    while half > 1:
        rest, half = half % 2, half // 2
        lower(out[half * n : 2 * half * n], out[: half * n])
        if rest:
            lower(out[2 * half * n : (2 * half + 1) * n], out[:n])
    done = n
    while done < out.size:
        part = min(done, out.size - done)
        copy(out[:part], out[done : done + part])
        done += part


@njit(cache=True, nogil=True)
def step_on(cost: I16, paths: Paths, n: int, p1: Any, p2: Any) -> None:
    """The paths' costs at the next samples, left in ``paths.last``."""
    size, last = cost.size, paths.last
    extend(cost, last[:size], last[n : n + size], last[2 * n : 2 * n + size], paths.lowest, p1, p2, paths.work)
    minimum(paths.work, n, paths.lowest)
    copy(paths.work, last[n : n + size])


@njit(cache=True, nogil=True)
def along_rows(by_column: I16, choice: Choice, paths: Paths, sums: I16, out: I16) -> None:
    """Sum of the paths from the left and from the right: (columns, count, rows) to (rows, count, columns).

    The samples of a column are as many paths side by side. ``by_column`` and ``sums``, which is to work in, have one
    disparity more: lines a power of two apart would share places of the processor's cache.
    """
    columns, _, rows = by_column.shape
    size = paths.work.size
    p1, p2 = np.int16(choice.p1), np.int16(choice.p2)
    begin(paths, rows)
    for i in range(columns):
        step_on(by_column[i].ravel()[:size], paths, rows, p1, p2)
        copy(paths.work, sums[i].ravel()[:size])
    begin(paths, rows)
    for i in range(columns - 1, -1, -1):
        step_on(by_column[i].ravel()[:size], paths, rows, p1, p2)
        add(paths.work, sums[i].ravel()[:size])
    for d in range(size // rows):
        for j in range(rows):
            for i in range(columns):
                out[j, d, i] = sums[i, d, j]


@njit(cache=True, nogil=True)
def find_best(total: I16, n: int, best: I16, where: I16) -> None:
    """Lowest cost and its disparity, the first of several."""
    best[:] = total[:n]
    where[:] = 0
    for d in range(1, total.size // n):
        line, here = total[d * n : (d + 1) * n], np.int16(d)
        for k in range(n):
            cost, old = line[k], best[k]
            where[k] = here if cost < old else where[k]
            best[k] = smaller(cost, old)


@njit(cache=True, nogil=True)
def find_rivals(total: I16, n: int, bound: I16, where: I16, rivalled: I16) -> None:
    """1 where a cost up to the bound is not at the best disparity or beside it."""
    rivalled[:] = 0
    for d in range(total.size // n):
        line, here = total[d * n : (d + 1) * n], np.int16(d)
        for k in range(n):
            apart = np.int16(here - where[k])
            other = (line[k] <= bound[k]) & ((apart > np.int16(1)) | (apart < np.int16(-1)))
            rivalled[k] = np.int16(rivalled[k] | (np.int16(1) if other else np.int16(0)))


@njit(cache=True, nogil=True, error_model="numpy")
def fraction(total: I16, n: int, i: int, d: int) -> int:
    """Disparity in sixteenths, where a parabola through the best cost and its neighbours is lowest."""
    if d == 0 or d == total.size // n - 1:
        return 16 * d
    before, best, after = int(total[(d - 1) * n + i]), int(total[d * n + i]), int(total[(d + 1) * n + i])
    bend = max(before + after - 2 * best, 1)
    return 16 * d + math.floor(((before - after) * 16.0 + bend) / (2.0 * bend))


@njit(cache=True, nogil=True)
def decide(total: I16, shift: I64, n: int, choice: Choice, lines: I16, out: I16) -> None:
    """Disparities of a row of samples in sixteenths above the lowest; NONE where a test fails.

    Args:
        total: (count * n) sums of the paths' costs.
        shift: (count + 1) by how many samples the right image's sample of a disparity is further on.
        lines: (6, at least n + count) to work in.
    """
    best, where, bound, rivalled = lines[0, :n], lines[1, :n], lines[2, :n], lines[3, :n]
    right_best, right = lines[4], lines[5]
    find_best(total, n, best, where)
    factor = 100.0 / (100 - choice.uniqueness_percent)
    for i in range(n):
        bound[i] = np.int16(math.ceil(best[i] * factor) - 1)
    find_rivals(total, n, bound, where, rivalled)
    right_best[:] = NO_COST
    for i in range(n):
        x = i + shift[where[i]]
        if rivalled[i] == 0 and best[i] < right_best[x]:
            right_best[x], right[x] = best[i], where[i]
    for i in range(n):
        out[i] = NONE
        if rivalled[i] == 0:
            d = where[i]
            d16 = fraction(total, n, i, d)
            low, high = i + shift[d16 >> 4], i + shift[(d16 + 15) >> 4]
            apart = choice.left_right
            if (
                right_best[low] == NO_COST
                or abs(right[low] - d) <= apart
                or right_best[high] == NO_COST
                or abs(right[high] - d) <= apart
            ):
                out[i] = np.int16(d16)


@njit(cache=True, nogil=True)
def along_columns(by_row: I16, rows_sum: I16, choice: Choice, step: int, paths: Paths, lines: I16, out: I16) -> None:
    """Add the path from above, and decide row by row: (rows, count, columns) costs and sums to (rows, columns)."""
    rows, count, columns = by_row.shape
    p1, p2 = np.int16(choice.p1), np.int16(choice.p2)
    begin(paths, columns)
    right = np.array([(-d) // step + count // step + 1 for d in range(count + 1)])
    for j in range(rows):
        step_on(by_row[j].reshape(count * columns), paths, columns, p1, p2)
        add(rows_sum[j].reshape(count * columns), paths.work)
        decide(paths.work, right, columns, choice, lines, out[j])


@njit(cache=True, nogil=True)
def extremes(planes: U8, at: Layout, darkest: U8, brightest: U8) -> None:
    """Range of the grey levels of a sample and the pixels up to the next one."""
    start = at.guard + at.above * at.pitch + at.before
    for plane in range(planes.shape[0]):
        for j in range(at.rows):
            line = planes[plane, start + j * at.pitch : start + j * at.pitch + at.columns]
            low, high = darkest[j], brightest[j]
            for i in range(at.columns):
                low[i] = line[i] if plane == 0 else smaller(low[i], line[i])
                high[i] = line[i] if plane == 0 else larger(high[i], line[i])


@njit(cache=True, nogil=True)
def paths_of(n: int, count: int, work: I16) -> Paths:
    """Of ``n`` samples side by side, in (3 count + 2) n places."""
    size = count * n
    return Paths(work[: size + 2 * n], work[size + 2 * n : 2 * size + 2 * n], work[2 * size + 2 * n : 3 * size + 2 * n])


@njit(cache=True, nogil=True)
def match_samples(
    left: U8,
    right: U8,
    offset: int,
    first: int,
    count: int,
    at: Layout,
    choice: Choice,
    planes: U8,
    work: I16,
    out: I16,
    darkest: U8,
    brightest: U8,
) -> None:
    """Disparities of the samples of a window in sixteenths above ``first``, and the range of grey levels around them.

    Args:
        left, right: grey; column x of ``left`` without disparity is column x + offset of ``right``.
        planes, work: to work in, of the sizes that ``room`` gives.
        out: (rows, columns) int16. darkest, brightest: (rows, columns) uint8.
    """
    rows, columns = at.rows, at.columns
    volume, more = rows * columns * count, rows * columns * (count + 1)
    by_row = work[:volume].reshape(rows, count, columns)
    by_column = work[volume : volume + more].reshape(columns, count + 1, rows)
    sums = work[volume + more : volume + 2 * more].reshape(columns, count + 1, rows)
    rest = work[volume + 2 * more :]
    both = rest[:volume].reshape(rows, count, columns)
    rest = rest[volume:]
    lines = rest[: (at.step + 1) * planes.shape[2]].reshape(at.step + 1, planes.shape[2])
    costs(left, right, offset, first, at, planes, lines, by_row, by_column)
    extremes(planes[RAW], at, darkest, brightest)
    along_rows(by_column, choice, paths_of(rows, count, rest), sums, both)
    rest, tail = rest[: (3 * count + 2) * columns], rest[(3 * count + 2) * columns :]
    lines = tail[: 6 * (columns + count + 2)].reshape(6, columns + count + 2)
    along_columns(by_row, both, choice, at.step, paths_of(columns, count, rest), lines, out)


def room(at: Layout, count: int) -> tuple[tuple[int, int, int], int]:
    """Shape of ``planes`` and size of ``work`` for ``match_samples``."""
    side = max(at.rows, at.columns)
    lines = max((at.step + 1) * at.places, (3 * count + 2) * side + 6 * (side + count + 2))
    return (2 * N_PLANES + 1, at.step * at.step, at.places), at.rows * at.columns * (4 * count + 2) + lines
