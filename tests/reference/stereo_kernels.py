"""Plain numpy twins of stereo/_kernels.py; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, U8, AnyArray


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
    value = fixed.astype(np.int32)
    whole = value >> 4
    column = np.arange(fixed.shape[1])[None, :] - whole
    matched = np.take_along_axis(right_mask, np.clip(column, 0, fixed.shape[1] - 1), axis=1)
    good = (mask > 0) & (value >= lowest) & (column >= 0) & (matched > 0)
    good &= (darkest < saturated_level) & (brightest.astype(np.int32) - darkest >= texture_min)
    out[:] = np.where(good, whole.astype(np.float32) + subpixel[value & 15], np.float32(np.nan))
