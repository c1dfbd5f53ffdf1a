"""Plain numpy twins of stereo/_kernels.py; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, F64, U8, AnyArray


def disparity_from_fixed(
    fixed: AnyArray, mask: U8, right_mask: U8, darkest: U8, brightest: U8, left: int, step: int, lowest: int,
    subpixel: F32, saturated_level: int, texture_min: int, out: F32,
) -> None:  # fmt: skip
    value = fixed.astype(np.int32)
    whole = value >> 4
    column = left + step * np.arange(fixed.shape[1])[None, :] - whole
    matched = np.take_along_axis(right_mask, np.clip(column, 0, right_mask.shape[1] - 1), axis=1)
    good = (mask > 0) & (value >= lowest) & (column >= 0) & (matched > 0)
    good &= (darkest < saturated_level) & (brightest.astype(np.int32) - darkest >= texture_min)
    out[:] = np.where(good, whole.astype(np.float32) + subpixel[value & 15], np.float32(np.nan))


def register_depth(
    depth: F32, rays: F32, shift: F64, pinhole: F64, distorted: F32, half_px: float, nearest: F32
) -> None:
    points = depth[..., None].astype(np.float64) * rays + shift
    points = points[(depth > 0) & (points[..., 2] > 0)]
    u, v = (pinhole[i] * points[:, i] / points[:, 2] + pinhole[i + 2] for i in (0, 1))
    inside = (u >= 0) & (v >= 0) & (u < distorted.shape[1] - 1) & (v < distorted.shape[0] - 1)
    u, v, z = u[inside], v[inside], points[inside, 2]
    i, j = v.astype(int), u.astype(int)
    a, b = (v - i)[:, None], (u - j)[:, None]
    top = (1 - b) * distorted[i, j] + b * distorted[i, j + 1]
    bottom = (1 - b) * distorted[i + 1, j] + b * distorted[i + 1, j + 1]
    x, y = ((1 - a) * top + a * bottom).T
    nearest[:] = np.inf
    rows, cols = np.mgrid[: nearest.shape[0], : nearest.shape[1]]
    for n in np.flatnonzero(np.isfinite(x)):
        hit = (rows >= y[n] - half_px) & (rows < y[n] + half_px) & (cols >= x[n] - half_px) & (cols < x[n] + half_px)
        nearest[hit] = np.minimum(nearest[hit], np.float32(z[n]))
    nearest[np.isinf(nearest)] = np.nan
