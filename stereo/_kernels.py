"""Compiled loops; their plain numpy twins are in tests/reference/stereo_kernels.py."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, U8, AnyArray


@njit(cache=True, nogil=True)
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
