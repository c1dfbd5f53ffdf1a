"""Compiled loops of matching, registration and windows.

Their plain numpy twins are in tests/reference/stereo_kernels.py and windows.py.
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8, AnyArray


@njit(cache=True, nogil=True, error_model="numpy")
def disparity_from_fixed(
    fixed: AnyArray,
    mask: U8,
    right_mask: U8,
    darkest: U8,
    brightest: U8,
    left: int,
    step: int,
    lowest: int,
    subpixel: F32,
    saturated_level: int,
    texture_min: int,
    out: F32,
) -> None:
    """Sixteenths to pixels, of every ``step``-th column from ``left`` on; NaN where nothing can have been measured.

    That is where the left or the matched right pixel is masked or outside, where the value is below ``lowest``, and
    where the surroundings are saturated or without texture.
    """
    for row in range(fixed.shape[0]):
        for col in range(fixed.shape[1]):
            value = np.int32(fixed[row, col])
            whole = value >> 4
            low, high = np.int32(darkest[row, col]), np.int32(brightest[row, col])
            if (
                mask[row, col] == 0
                or value < lowest
                or whole > left + step * col
                or right_mask[row, left + step * col - whole] == 0
                or low >= saturated_level
                or high - low < texture_min
            ):
                out[row, col] = np.nan
            else:
                out[row, col] = np.float32(whole) + subpixel[value & 15]


@njit(cache=True, nogil=True, error_model="numpy")
def register_depth(
    depth: F32, rays: F32, shift: F64, pinhole: F64, distorted: F32, half_px: float, nearest: F32
) -> None:
    """Depth of one camera as another sees it: the nearest surface of each of its pixels.

    ``rays`` (h, w, 3) is the ray of each depth pixel at unit depth, turned into the other camera's frame; ``shift`` its
    translation there; ``pinhole`` (fu, fv, cu, cv) of the other camera without distortion, ``distorted`` (H', W', 2)
    the recorded pixel of each of the pinhole's, NaN where there is none. A point fills the pixels within ``half_px`` of
    its own. Fills ``nearest`` (H, W), NaN where no point falls.
    """
    nearest[:] = np.inf
    rows, cols = nearest.shape
    table_rows, table_cols = distorted.shape[0] - 1, distorted.shape[1] - 1
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            d = depth[row, col]
            z = d * rays[row, col, 2] + shift[2]
            if not (d > 0.0 and z > 0.0):
                continue
            u = pinhole[0] * (d * rays[row, col, 0] + shift[0]) / z + pinhole[2]
            v = pinhole[1] * (d * rays[row, col, 1] + shift[1]) / z + pinhole[3]
            if not (u >= 0.0 and v >= 0.0 and u < table_cols and v < table_rows):
                continue
            i, j = int(v), int(u)
            a, b = v - i, u - j
            x = (1.0 - a) * ((1.0 - b) * distorted[i, j, 0] + b * distorted[i, j + 1, 0])
            x += a * ((1.0 - b) * distorted[i + 1, j, 0] + b * distorted[i + 1, j + 1, 0])
            y = (1.0 - a) * ((1.0 - b) * distorted[i, j, 1] + b * distorted[i, j + 1, 1])
            y += a * ((1.0 - b) * distorted[i + 1, j, 1] + b * distorted[i + 1, j + 1, 1])
            if not (x > -half_px - 1.0 and y > -half_px - 1.0 and x < cols + half_px and y < rows + half_px):
                continue
            for r in range(max(0, math.ceil(y - half_px)), min(rows, math.ceil(y + half_px))):
                for c in range(max(0, math.ceil(x - half_px)), min(cols, math.ceil(x + half_px))):
                    nearest[r, c] = min(nearest[r, c], np.float32(z))
    for row in range(rows):
        for col in range(cols):
            if nearest[row, col] == np.inf:
                nearest[row, col] = np.nan


MAX_NODES = 1024
"""Boxes that are tried at most; what is left then is not cut further."""


@njit(cache=True, nogil=True, error_model="numpy")
def _count(sums: AnyArray, top: int, left: int, bottom: int, right: int) -> int:
    """Marked tiles of a box, from the summed-area table."""
    return int(sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left])


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def cost(box: tuple[int, int, int, int], per_pixel: F64, tile: int, rows: float, columns: float, fixed: float) -> float:
    """Of matching a box: its pixels and a margin times the work per pixel, and what a window costs besides."""
    top, left, bottom, right = box
    if top >= bottom or left >= right:
        return 0.0
    height, width = (bottom - top) * tile + rows, (right - left) * tile + columns
    return float(height * width * per_pixel[top, bottom - 1] + fixed)


@njit(cache=True, nogil=True, error_model="numpy")
def best_cut(  # type: ignore[no-untyped-def]
    sums: AnyArray, box: tuple[int, int, int, int], per_pixel: F64, tile: int, rows: float, columns: float, fixed: float
):
    """The two parts of a tight box that cost least together; the box twice when it is a single tile."""
    best, one, other = np.inf, box, box
    for axis in range(2):
        for cut in range(box[axis] + 1, box[axis + 2]):
            if axis == 0:
                a = tight(sums, box[0], box[1], cut, box[3])
                b = tight(sums, cut, box[1], box[2], box[3])
            else:
                a = tight(sums, box[0], box[1], box[2], cut)
                b = tight(sums, box[0], cut, box[2], box[3])
            both = cost(a, per_pixel, tile, rows, columns, fixed) + cost(b, per_pixel, tile, rows, columns, fixed)
            if both < best:
                best, one, other = both, a, b
    return one, other


@njit(cache=True, nogil=True, error_model="numpy")
def _keep(nodes: I64, k: int, box: tuple[int, int, int, int]) -> None:
    nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3] = box


@njit(cache=True, nogil=True, error_model="numpy")
def split(  # type: ignore[no-untyped-def]
    sums: AnyArray, per_pixel: F64, tile: int, rows: float, columns: float, fixed: float, out: AnyArray
):
    """Boxes around all marked tiles: one, cut in two again and again where all its parts together cost less.

    ``sums`` (n + 1, m + 1) int32 summed-area table of the tiles; ``per_pixel`` (n, n) float64, work of a pixel of boxes
    from the first to the last row; ``rows``, ``columns``: margins [px]. Fills ``out`` (K, 4) int64 with top, left,
    bottom, right in tiles, and returns their number and total cost; -1 when there are more than K.
    """
    nodes = np.empty((MAX_NODES, 4), np.int64)
    part = np.zeros(MAX_NODES, np.int64)
    work = np.zeros(MAX_NODES)
    _keep(nodes, 0, tight(sums, 0, 0, sums.shape[0] - 1, sums.shape[1] - 1))
    n_nodes, k = 1, 0
    while k < n_nodes:
        box = (nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3])
        work[k] = cost(box, per_pixel, tile, rows, columns, fixed)
        area = (box[2] - box[0]) * (box[3] - box[1])
        if _count(sums, box[0], box[1], box[2], box[3]) < area and n_nodes + 2 <= MAX_NODES:
            one, other = best_cut(sums, box, per_pixel, tile, rows, columns, fixed)
            part[k] = n_nodes
            _keep(nodes, n_nodes, one)
            _keep(nodes, n_nodes + 1, other)
            n_nodes += 2
        k += 1
    for k in range(n_nodes - 1, -1, -1):
        if part[k] > 0:
            parts = work[part[k]] + work[part[k] + 1]
            if parts < work[k]:
                work[k] = parts
            else:
                part[k] = 0
    n, left_over = 0, 1
    waiting = np.zeros(MAX_NODES, np.int64)
    while left_over > 0 and work[0] > 0.0:
        left_over -= 1
        k = waiting[left_over]
        if part[k] > 0:
            waiting[left_over], waiting[left_over + 1] = part[k], part[k] + 1
            left_over += 2
        elif n == len(out):
            return -1, work[0]
        else:
            _keep(out, n, (nodes[k, 0], nodes[k, 1], nodes[k, 2], nodes[k, 3]))
            n += 1
    return n, work[0]
