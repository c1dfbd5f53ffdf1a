"""Compiled loops; their plain numpy twins are in tests/reference/stereo_kernels.py."""

import numpy as np
from numba import njit

from calib.types import F32, U8, AnyArray


@njit(cache=True, nogil=True)
def disparity_from_fixed(
    fixed: AnyArray,
    mask: U8,
    right_mask: U8,
    darkest: U8,
    brightest: U8,
    lowest: int,
    subpixel: F32,
    saturated_level: int,
    texture_min: int,
    out: F32,
) -> None:
    """Sixteenths to pixels; NaN where nothing can have been measured.

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
                or whole > col
                or right_mask[row, col - whole] == 0
                or low >= saturated_level
                or high - low < texture_min
            ):
                out[row, col] = np.nan
            else:
                out[row, col] = np.float32(whole) + subpixel[value & 15]
