"""Compiled matching costs at every n-th row and column; tests/reference/sampled_matching.py defines them.

An image lies in step x step planes, plane (y mod step, x mod step) holding the pixels of one phase, so that every loop
runs along memory: what is n pixels away is a fixed number of places away in one of the planes. Each plane has a guard
at both ends, and its rows have margins in which the image's edge is repeated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import I16, U8, AnyArray

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


class Layout(NamedTuple):
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


def layout(height: int, width: int, step: int, block_px: int) -> Layout:
    """For a window of a size [px]; blocks reach beyond it, and interpolation and slope a pixel more each."""
    half = block_px // 2
    after = -(-(half + 2) // step)
    before = -(-(half + 2 + CHUNK - 1) // step)
    rows, columns = -(-height // step), -(-width // step)
    pitch = before + columns + after
    guard = (after + 1) * pitch + before
    shift = next(bits for bits in range(8) if block_px * block_px * (MAX_COST >> bits) <= MAX_BLOCK_COST)
    return Layout(step, rows, columns, half, after, before, rows + 2 * after, pitch, guard, shift)


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
def spread(image: U8, left: int, at: Layout, raw: U8) -> None:
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
def shifted(planes: AnyArray, dy: int, dx: int, at: Layout) -> AnyArray:
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
def prepare(image: U8, left: int, at: Layout, planes: U8) -> None:
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
def pixel_costs(left: U8, right: U8, disparity: int, at: Layout, out: U8) -> None:
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
def block_costs(pixels: U8, at: Layout, lines: I16, out: I16) -> None:
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
def line_at(lines: I16, dy: int, at: Layout) -> I16:
    by = dy // at.step * at.pitch
    return lines[dy % at.step, at.guard + by : lines.shape[1] - at.guard + by]


@njit(cache=True, nogil=True)
def add_rows(lines: I16, at: Layout, out: I16) -> None:
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
    left: U8, right: U8, offset: int, first: int, at: Layout, planes: U8, lines: I16, by_row: I16, by_column: I16
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
