"""Compiled search for ghosts; ``tests/reference/ghosts.py`` defines it with whole images."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, I64, U8, Bool

SOBEL_GAIN = np.float32(4.0)
"""Response of the 3x3 Sobel operator to a step of one level."""
REACH = 2
"""Half of the window in which a pixel is compared with what is around its blob [px]: 5 px average noise and texture,
and are narrower than a limb of a person of 60 px. Our choice."""
WINDOW_SHARE = 1.0 / (2 * REACH + 1) ** 2
MIN_COUNT = np.float32(1e-3)


class Box(NamedTuple):
    """Columns x0 <= x < x1 and rows y0 <= y < y1 [px]."""

    x0: int
    x1: int
    y0: int
    y1: int


@njit(cache=True, nogil=True)
def compare_outlines(labels: I32, box: Box, luma: U8, background: U8, length: I64, here: F64, before: F64) -> None:
    """Sum up steps along the boundary of each blob: pixels of it that touch the background.

    labels: (H, W), not 0 only in the box. length, here, before: (n,) zeros; get the number of these pixels and the
    sums of the steps there in the image and in the background [levels].
    """
    width = labels.shape[1]
    inner, rim = np.ones(width + 2, np.uint8), np.zeros(width, np.uint8)
    for y in range(box.y0, box.y1):
        _find_rim(labels, y, inner, rim)
        for x in range(box.x0, box.x1):
            if rim[x] > 0:
                label = labels[y, x]
                length[label] += 1
                here[label] += np.float64(_step(luma, x, y))
                before[label] += np.float64(_step(background, x, y))


@njit(cache=True, nogil=True)
def _find_rim(labels: I32, y: int, inner: U8, rim: U8) -> None:
    """(W,) 1 where a pixel of a blob in row y touches the background; inner is a (W + 2,) workspace, 1 at both ends."""
    height, width = labels.shape
    row, up, down = labels[y], labels[max(0, y - 1)], labels[min(height - 1, y + 1)]
    for x in range(np.uintp(width)):
        inner[x + np.uintp(1)] = (row[x] > 0) & (up[x] > 0) & (down[x] > 0)
    for x in range(np.uintp(width)):
        whole = inner[x] & inner[x + np.uintp(1)] & inner[x + np.uintp(2)]
        rim[x] = (row[x] > 0) & (whole == 0)


@njit(cache=True, nogil=True)
def _step(image: U8, x: int, y: int) -> np.float32:
    """Step [levels] across a pixel, by the 3x3 Sobel operators; the image is mirrored at its border."""
    height, width = image.shape
    up, down = image[_mirrored(y - 1, height)], image[_mirrored(y + 1, height)]
    middle, a, b = image[y], _mirrored(x - 1, width), _mirrored(x + 1, width)
    two = np.int64(2)
    across = (up[b] + two * middle[b] + down[b]) - (up[a] + two * middle[a] + down[a])
    along = (down[a] + two * down[x] + down[b]) - (up[a] + two * up[x] + up[b])
    return np.float32(math.sqrt(np.float32(across * across + along * along))) / SOBEL_GAIN


@njit(cache=True, nogil=True)
def _mirrored(i: int, n: int) -> int:
    """Index of n that i is, mirrored at the first and at the last one."""
    if n == 1:
        return 0
    while i < 0 or i >= n:
        i = -i if i < 0 else 2 * (n - 1) - i
    return i


@njit(cache=True, nogil=True)
def count_moving(labels: I32, box: Box, motion: U8, moving: I64) -> None:
    """Add up the pixels of each blob where motion is not 0; labels are not 0 only in the box, moving is (n,)."""
    for y in range(box.y0, box.y1):
        row, moves = labels[y], motion[y]
        for x in range(box.x0, box.x1):
            if moves[x] > 0:
                moving[row[x]] += 1


@njit(cache=True, nogil=True)
def paint_blobs(labels: I32, box: Box, chosen: Bool, out: U8) -> None:
    """255 in the blobs that are chosen, (n,); labels are not 0 only in the box."""
    for y in range(box.y0, box.y1):
        row, painted = labels[y], out[y]
        for x in range(box.x0, box.x1):
            if chosen[row[x]]:
                painted[x] = 255


@njit(cache=True, nogil=True)
def by_label(values: U8, mask: U8, found: U8) -> None:
    """Values at the pixels where the mask is 0, in order of rows: ``found[k]`` that of the k-th such pixel."""
    height, width = mask.shape
    k = 0
    for y in range(height):
        for x in range(width):
            if mask[y, x] == 0:
                k += 1
                found[k] = values[y, x]


@njit(cache=True, nogil=True)
def compare_around(
    luma: U8, background: U8, inside: U8, nearest: I32, around: U8, ratio: float, levels: float, alike: U8
) -> None:
    """255 where foreground looks like what is around its blob, and the background does not; ``alike`` is zeros.

    All (H, W). Compared is the mean difference over the foreground in a window about a pixel; ``around[nearest]`` is
    what is around. A pixel is alike where that of the background is ``ratio`` times that of the image, and ``levels``
    more.
    """
    height, width = luma.shape
    differences = np.zeros((3, height, width), np.uint8)
    occupied = np.zeros(height, np.bool_)
    for y in range(height):
        for x in range(width):
            if inside[y, x] > 0:
                value = np.int64(around[nearest[y, x]])
                differences[0, y, x] = 1
                differences[1, y, x] = abs(luma[y, x] - value)
                differences[2, y, x] = abs(background[y, x] - value)
                occupied[y] = True
    columns, totals = np.zeros((3, width + 2 * REACH), np.int32), np.zeros((3, width), np.int32)
    ratio32, levels32 = np.float32(ratio), np.float32(levels)
    for y in range(height):
        if not occupied[y]:
            continue
        for k in range(3):
            _sum_window(differences[k], y, columns[k], totals[k])
        row = alike[y]
        for x in range(np.uintp(width)):
            count = max(np.float32(totals[0, x] * WINDOW_SHARE), MIN_COUNT)
            here = np.float32(totals[1, x] * WINDOW_SHARE) / count
            before = np.float32(totals[2, x] * WINDOW_SHARE) / count
            is_alike = (inside[y, x] > 0) & (before >= ratio32 * here + levels32)
            row[x] = 255 if is_alike else 0


@njit(cache=True, nogil=True)
def _sum_window(values: U8, y: int, columns: I32, totals: I32) -> None:
    """Sums (W,) of (H, W) values over the windows about the pixels of a row, mirrored at the borders.

    columns: (W + 2 REACH,) workspace.
    """
    height, width = values.shape
    middle = columns[REACH : REACH + width]
    middle[:] = 0
    for dy in range(-REACH, REACH + 1):
        row = values[_mirrored(y + dy, height)]
        for x in range(np.uintp(width)):
            middle[x] += row[x]
    for i in range(REACH):
        columns[i] = middle[_mirrored(i - REACH, width)]
        columns[REACH + width + i] = middle[_mirrored(width + i, width)]
    for x in range(np.uintp(width)):
        total = np.int32(0)
        for dx in range(2 * REACH + 1):
            total += columns[x + np.uintp(dx)]
        totals[x] = total


@njit(cache=True, nogil=True)
def note_motion(motion: U8, now_s: float, since_s: float, moved_s: F32, moved: U8) -> None:
    """Set (H, W) times of the last motion [s], and ``moved``: 255 where that is later than ``since_s``, else 0."""
    now, since = np.float32(now_s), np.float32(since_s)
    for y in range(motion.shape[0]):
        moves, times, recent = motion[y], moved_s[y], moved[y]
        for x in range(np.uintp(motion.shape[1])):
            last = now if moves[x] > 0 else times[x]
            times[x] = last
            recent[x] = 255 if last > since else 0
