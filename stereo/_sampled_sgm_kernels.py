"""Compiled semi-global matching at every n-th row and column; tests/reference/sampled_matching.py defines it.

Costs of matches, path costs, the best disparity, its tests and its fraction.

An image lies in step x step planes, plane (y mod step, x mod step) holding the pixels of one phase, so that every loop
runs along memory: what is n pixels away is a fixed number of places away in one of the planes. Each plane has a guard
at both ends, and its rows have margins in which the image's edge is repeated.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from calib.types import I16, I64, U8, AnyArray

CHUNK = 16
"""Disparities for which the right image is laid out together."""
CAP = np.int16(31)
"""Largest horizontal slope that counts [levels], as OpenCV's preFilterCap."""
MAX_COST = 2 * int(CAP) + 63
"""Of a pixel: its slopes, and a quarter of its grey levels."""
MAX_BLOCK_COST = 10_200
"""Three paths' costs, each with a penalty, are to fit int16."""
RAW, RAW_LOW, RAW_HIGH, SLOPE, SLOPE_LOW, SLOPE_HIGH = range(6)
N_PLANES = 6


class SampleLayout(NamedTuple):
    """Where the samples of a window lie.

    Attributes:
        step: every n-th row and column is a sample.
        rows, columns: number of samples.
        half: pixels of the block on each side of its centre.
        above, before: margins of the planes [rows, columns].
        plane_rows, pitch: rows of a plane and columns of each, with margins.
        guard: places before and after a plane.
        shift: bits by which the costs of pixels are made smaller.
    """

    step: int
    rows: int
    columns: int
    half: int
    above: int
    before: int
    plane_rows: int
    pitch: int
    guard: int
    shift: int

    @property
    def places(self) -> int:
        """Of a plane with its guards."""
        return self.plane_rows * self.pitch + 2 * self.guard


def layout(height: int, width: int, step: int, block_px: int) -> SampleLayout:
    """For a window of a size [px]; blocks reach beyond it, and interpolation and slope a pixel more each."""
    half = block_px // 2
    after = -(-(half + 2) // step)
    before = -(-(half + 2 + CHUNK - 1) // step)
    rows, columns = -(-height // step), -(-width // step)
    pitch = before + columns + after
    guard = (after + 1) * pitch + before
    shift = next(bits for bits in range(8) if block_px * block_px * (MAX_COST >> bits) <= MAX_BLOCK_COST)
    return SampleLayout(step, rows, columns, half, after, before, rows + 2 * after, pitch, guard, shift)


@njit(cache=True, nogil=True)
def smaller(a, b):  # type: ignore[no-untyped-def]
    return a if a < b else b


@njit(cache=True, nogil=True)
def larger(a, b):  # type: ignore[no-untyped-def]
    return a if a > b else b


@njit(cache=True, nogil=True)
def excess(a, b):  # type: ignore[no-untyped-def]
    """a - b, 0 where that is negative, of uint8."""
    return np.uint8(larger(a, b) - b)


@njit(cache=True, nogil=True)
def spread(image: U8, left: int, at: SampleLayout, raw: U8) -> None:
    """Lay an image out whose column ``left`` is that of the first sample."""
    height, width = image.shape
    for py in range(at.step):
        for px in range(at.step):
            plane = raw[py * at.step + px, at.guard :]
            start = px - at.before * at.step + left
            inside = min(max((-start + at.step - 1) // at.step, 0), at.pitch)
            end = min(max((width - 1 - start) // at.step + 1, inside), at.pitch)
            for j in range(at.plane_rows):
                line = image[min(max(at.step * (j - at.above) + py, 0), height - 1)]
                row = plane[j * at.pitch : (j + 1) * at.pitch]
                for i in range(inside):
                    row[i] = line[0]
                part, pixels = row[inside:end], line[max(start + at.step * inside, 0) :]
                for i in range(part.size):
                    part[i] = pixels[i * at.step]
                for i in range(end, at.pitch):
                    row[i] = line[width - 1]


@njit(cache=True, nogil=True)
def shifted(planes: AnyArray, dy: int, dx: int, at: SampleLayout) -> AnyArray:
    """The places of the pixels that are (dx, dy) pixels from the samples."""
    plane = planes[dy % at.step * at.step + dx % at.step]
    by = dy // at.step * at.pitch + dx // at.step
    found: AnyArray = plane[at.guard + by : plane.size - at.guard + by]
    return found


@njit(cache=True, nogil=True)
def slopes(a: U8, b: U8, c: U8, d: U8, e: U8, f: U8, out: U8) -> None:
    """OpenCV's prefilter: b - a + 2 (d - c) + f - e within the cap, from 0 on."""
    for k in range(out.size):
        v = np.int16(np.int16(b[k]) - np.int16(a[k]))
        v = np.int16(v + np.int16(np.int16(f[k]) - np.int16(e[k])))
        m = np.int16(np.int16(d[k]) - np.int16(c[k]))
        v = np.int16(np.int16(v + m) + m)
        out[k] = np.uint8(np.int16(larger(smaller(v, CAP), np.int16(-CAP)) + CAP))


@njit(cache=True, nogil=True)
def halfway(a: U8, b: U8, c: U8, low: U8, high: U8) -> None:
    """Least and largest value within half a pixel of c, whose neighbours are a and b (Birchfield, Tomasi 1998)."""
    for k in range(c.size):
        x = c[k]
        m, n = smaller(a[k], b[k]), larger(a[k], b[k])
        m = np.uint8(np.uint8(m & x) + np.uint8(np.uint8(m ^ x) >> 1))
        n = np.uint8(np.uint8(n & x) + np.uint8(np.uint8(n ^ x) >> 1))
        low[k], high[k] = smaller(m, x), larger(n, x)


@njit(cache=True, nogil=True)
def prepare(image: U8, left: int, at: SampleLayout, planes: U8) -> None:
    """Grey levels and slopes of an image, with the range of each within half a pixel: planes (6, step^2, places)."""
    spread(image, left, at, planes[RAW])
    raw = planes[RAW]
    for py in range(at.step):
        for px in range(at.step):
            slopes(
                shifted(raw, py - 1, px - 1, at), shifted(raw, py - 1, px + 1, at),
                shifted(raw, py, px - 1, at), shifted(raw, py, px + 1, at),
                shifted(raw, py + 1, px - 1, at), shifted(raw, py + 1, px + 1, at),
                shifted(planes[SLOPE], py, px, at),
            )  # fmt: skip
    for kind in (RAW, SLOPE):
        of = planes[kind]
        for py in range(at.step):
            for px in range(at.step):
                halfway(
                    shifted(of, py, px - 1, at), shifted(of, py, px + 1, at), shifted(of, py, px, at),
                    shifted(planes[kind + 1], py, px, at), shifted(planes[kind + 2], py, px, at),
                )  # fmt: skip


@njit(cache=True, nogil=True)
def unlike(a: U8, b: U8, c: U8, x: U8, y: U8, z: U8, d: U8, e: U8, f: U8, u: U8, v: U8, w: U8, out: U8) -> None:
    """Dissimilarity of slopes (a in b ... c; x in y ... z) plus a quarter of that of grey levels (d in e ... f; u in
    v ... w)."""
    for k in range(out.size):
        slope = smaller(larger(excess(a[k], z[k]), excess(y[k], a[k])), larger(excess(x[k], c[k]), excess(b[k], x[k])))
        level = smaller(larger(excess(d[k], w[k]), excess(v[k], d[k])), larger(excess(u[k], f[k]), excess(e[k], u[k])))
        out[k] = np.uint8(slope + np.uint8(level >> 2))


@njit(cache=True, nogil=True)
def pixel_costs(left: U8, right: U8, disparity: int, at: SampleLayout, out: U8) -> None:
    """Of all pixels at one disparity, counted from that for which the right image is laid out."""
    for py in range(at.step):
        for px in range(at.step):
            q = px - disparity
            unlike(
                shifted(left[SLOPE], py, px, at), shifted(left[SLOPE_LOW], py, px, at),
                shifted(left[SLOPE_HIGH], py, px, at), shifted(right[SLOPE], py, q, at),
                shifted(right[SLOPE_LOW], py, q, at), shifted(right[SLOPE_HIGH], py, q, at),
                shifted(left[RAW], py, px, at), shifted(left[RAW_LOW], py, px, at),
                shifted(left[RAW_HIGH], py, px, at), shifted(right[RAW], py, q, at),
                shifted(right[RAW_LOW], py, q, at), shifted(right[RAW_HIGH], py, q, at),
                shifted(out, py, px, at),
            )  # fmt: skip


@njit(cache=True, nogil=True)
def reduce(pixels: U8, bits: int) -> None:
    """Smaller costs, where blocks are so large that their sums would not fit."""
    for k in range(pixels.size):
        pixels[k] = pixels[k] >> bits


@njit(cache=True, nogil=True)
def add(a: AnyArray, out: I16) -> None:
    for k in range(out.size):
        out[k] = np.int16(out[k] + np.int16(a[k]))


@njit(cache=True, nogil=True)
def add_three(a: AnyArray, b: AnyArray, c: AnyArray, out: I16) -> None:
    for k in range(out.size):
        out[k] = np.int16(np.int16(np.int16(a[k]) + np.int16(b[k])) + np.int16(c[k]))


@njit(cache=True, nogil=True)
def add_two(a: AnyArray, b: AnyArray, out: I16) -> None:
    for k in range(out.size):
        out[k] = np.int16(out[k] + np.int16(np.int16(a[k]) + np.int16(b[k])))


@njit(cache=True, nogil=True)
def block_costs(pixels: U8, at: SampleLayout, lines: I16, out: I16) -> None:
    """Sums over the blocks around the samples: along the rows first, then of the rows."""
    for py in range(at.step):
        line = lines[py, at.guard : lines.shape[1] - at.guard]
        middle = shifted(pixels, py, 0, at)
        if at.half == 0:
            line[:] = 0
            add(middle, line)
        for dx in range(1, at.half + 1):
            one, other = shifted(pixels, py, -dx, at), shifted(pixels, py, dx, at)
            if dx == 1:
                add_three(one, middle, other, line)
            else:
                add_two(one, other, line)
    add_rows(lines, at, out)


@njit(cache=True, nogil=True)
def line_at(lines: I16, dy: int, at: SampleLayout) -> I16:
    by = dy // at.step * at.pitch
    return lines[dy % at.step, at.guard + by : lines.shape[1] - at.guard + by]


@njit(cache=True, nogil=True)
def add_rows(lines: I16, at: SampleLayout, out: I16) -> None:
    """The second half of ``block_costs``."""
    total = out[at.guard : out.size - at.guard]
    if at.half == 0:
        total[:] = line_at(lines, 0, at)
    for dy in range(1, at.half + 1):
        one, other = line_at(lines, -dy, at), line_at(lines, dy, at)
        if dy == 1:
            add_three(one, line_at(lines, 0, at), other, total)
        else:
            add_two(one, other, total)


@njit(cache=True, nogil=True)
def costs(
    left: U8, right: U8, offset: int, first: int, at: SampleLayout, planes: U8, lines: I16, by_row: I16, by_column: I16
) -> None:
    """Block costs of a window, by rows (rows, count, columns) and by columns (columns, count + 1, rows).

    Args:
        left, right: grey; column x of ``left`` without disparity is column x + offset of ``right``.
        first: lowest disparity.
        planes: uint8 (2 * N_PLANES + 1, step^2, places) to work in; those of the left image stay there.
        lines: int16 (step + 1, places) to work in.
    """
    ours, theirs, pixels = planes[:N_PLANES], planes[N_PLANES : 2 * N_PLANES], planes[2 * N_PLANES]
    total = lines[at.step]
    prepare(left, 0, at, ours)
    start = at.guard + at.above * at.pitch + at.before
    for d in range(by_row.shape[1]):
        if d % CHUNK == 0:
            prepare(right, offset - first - d, at, theirs)
        pixel_costs(ours, theirs, d % CHUNK, at, pixels)
        if at.shift > 0:
            reduce(pixels.ravel(), at.shift)
        block_costs(pixels, at, lines, total)
        inside = total[start : start + at.rows * at.pitch].reshape(at.rows, at.pitch)
        for j in range(at.rows):
            for i in range(at.columns):
                by_row[j, d, i] = inside[j, i]
        for i in range(at.columns):
            for j in range(at.rows):
                by_column[i, d, j] = inside[j, i]


NO_COST = np.int16(32_767)
BLOCKED = np.int16(16_000)
"""Cost of a disparity that is not searched."""
NONE = np.int16(-16)
"""Instead of a disparity."""


class PathParams(NamedTuple):
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
def along_rows(by_column: I16, choice: PathParams, paths: Paths, sums: I16, out: I16) -> None:
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
def decide(total: I16, shift: I64, n: int, choice: PathParams, lines: I16, out: I16) -> None:
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
def along_columns(
    by_row: I16, rows_sum: I16, choice: PathParams, step: int, paths: Paths, lines: I16, out: I16
) -> None:
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
def extremes(planes: U8, at: SampleLayout, darkest: U8, brightest: U8) -> None:
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
    at: SampleLayout,
    choice: PathParams,
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


def room(at: SampleLayout, count: int) -> tuple[tuple[int, int, int], int]:
    """Shape of ``planes`` and size of ``work`` for ``match_samples``."""
    side = max(at.rows, at.columns)
    lines = max((at.step + 1) * at.places, (3 * count + 2) * side + 6 * (side + count + 2))
    return (2 * N_PLANES + 1, at.step * at.step, at.places), at.rows * at.columns * (4 * count + 2) + lines
