"""Compiled loops of matching and registration; their plain numpy twins are in tests/reference/stereo_kernels.py."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, U8, AnyArray


@njit(cache=True, nogil=True, error_model="numpy")
def coarse_disparity(fixed: AnyArray, usable: U8, right_mask: U8, step: int, lowest: int, out: F32) -> None:
    """Sixteenths of a sample to pixels; NaN where nothing can have been measured.

    That is where ``usable`` is 0, where the matched right sample is masked or outside, and where the value is below
    ``lowest``. A sample is ``step`` pixels wide.
    """
    for row in range(fixed.shape[0]):
        for col in range(fixed.shape[1]):
            value = np.int32(fixed[row, col])
            right = col - (value >> 4)
            if usable[row, col] == 0 or value < lowest or right < 0 or right_mask[row, right] == 0:
                out[row, col] = np.nan
            else:
                out[row, col] = np.float32(value * step) / np.float32(16.0)


@njit(cache=True, nogil=True, error_model="numpy")
def differences(left: U8, right: U8, disparity: F32, first: int, step: int, apart: int, error: F32, slope: F32) -> None:
    """How much brighter each left sample is than the right image at its disparity, and the right image's slope.

    Sample (r, c) of ``left`` (h, w) is pixel ``first`` + ``step`` (r, c) of ``right`` (H, W) without a disparity; the
    slope [1/px] is taken over ``apart`` pixels either way. Both are 0 without a disparity and where it leads out of the
    image.
    """
    height, width = right.shape
    for row in range(disparity.shape[0]):
        v = min(first + step * row, height - 1)
        for col in range(disparity.shape[1]):
            x = np.float32(first + step * col) - disparity[row, col]
            if not (x >= apart and x < width - 1 - apart):
                error[row, col] = slope[row, col] = np.float32(0.0)
                continue
            i = int(x)
            t = x - np.float32(i)
            here = np.float32(right[v, i])
            here += t * (np.float32(right[v, i + 1]) - here)
            behind, ahead = np.float32(right[v, i - apart]), np.float32(right[v, i + apart])
            behind += t * (np.float32(right[v, i + 1 - apart]) - behind)
            ahead += t * (np.float32(right[v, i + 1 + apart]) - ahead)
            error[row, col] = np.float32(left[row, col]) - here
            slope[row, col] = (ahead - behind) / np.float32(2 * apart)


@njit(cache=True, nogil=True, error_model="numpy")
def shared_step(disparity: F32, error: F32, slope: F32, same_px: float, noise: float, out: F32) -> None:
    """A Gauss-Newton step to the one disparity of each 5x5 samples, as far as they are within ``same_px`` of it.

    With slope g and error e of sample j: sum g_j (g_j (d_j - d) - e_j) / (sum g_j^2 + noise) is added to d (Lucas and
    Kanade 1981, along the row).
    """
    height, width = disparity.shape
    near = np.float32(same_px)
    d = np.full((height + 4, width + 4), np.float32(-1e6))  # samples without a disparity are near none
    g2, ge = np.zeros_like(d), np.zeros_like(d)
    for row in range(height):
        for col in range(width):
            if not np.isnan(disparity[row, col]):
                d[row + 2, col + 2] = disparity[row, col]
                g2[row + 2, col + 2] = slope[row, col] * slope[row, col]
                ge[row + 2, col + 2] = slope[row, col] * error[row, col]
    above, below = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(height):
        above[:], below[:] = np.float32(0.0), np.float32(noise)
        here = d[row + 2, 2 : width + 2]
        for r in range(row, row + 5):
            for c in range(5):  # so that the loop over columns, which is the longest, runs on vectors
                there, g2_there, ge_there = d[r, c : c + width], g2[r, c : c + width], ge[r, c : c + width]
                for col in range(width):
                    apart = there[col] - here[col]
                    same = np.float32(1.0) if abs(apart) < near else np.float32(0.0)
                    above[col] += same * (g2_there[col] * apart - ge_there[col])
                    below[col] += same * g2_there[col]
        for col in range(width):
            out[row, col] = disparity[row, col] + above[col] / below[col]


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
