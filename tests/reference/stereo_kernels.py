"""Plain numpy twins of the compiled loops of stereo/matcher.py and stereo/rgbd.py; they define what these compute."""

import numpy as np

from calib.types import F32, F64, U8, AnyArray


def coarse_disparity(fixed: AnyArray, usable: U8, right_mask: U8, step: int, lowest: int) -> F32:
    value = fixed.astype(np.int32)
    column = np.arange(fixed.shape[1])[None, :] - (value >> 4)
    matched = np.take_along_axis(right_mask, np.clip(column, 0, right_mask.shape[1] - 1), axis=1)
    good = (usable > 0) & (value >= lowest) & (column >= 0) & (matched > 0)
    return np.where(good, value * step / 16, np.nan).astype(np.float32)


def differences(left: U8, right: U8, disparity: F32, first: int, step: int, apart: int) -> tuple[F32, F32]:
    rows, cols = np.mgrid[: disparity.shape[0], : disparity.shape[1]] * step
    v = np.minimum(first + rows, right.shape[0] - 1)
    x = first + cols - disparity
    inside = (x >= apart) & (x < right.shape[1] - 1 - apart)

    def at(shift):
        columns = np.arange(right.shape[1])
        return np.array([np.interp(xs + shift, columns, right[r]) for xs, r in zip(x, v[:, 0], strict=True)])

    error = np.where(inside, left - at(0), 0.0)
    return error, np.where(inside, (at(apart) - at(-apart)) / (2 * apart), 0.0)


def shared_step(disparity: F32, error: F32, slope: F32, same_px: float, noise: float) -> F32:
    out = np.full_like(disparity, np.nan)
    for row, col in np.argwhere(np.isfinite(disparity)):
        window = slice(max(0, row - 2), row + 3), slice(max(0, col - 2), col + 3)
        apart = disparity[window] - disparity[row, col]
        g, e = np.where(np.abs(apart) < same_px, (slope[window], error[window]), 0.0)
        out[row, col] = disparity[row, col] + np.sum(g * (g * np.nan_to_num(apart) - e)) / (np.sum(g * g) + noise)
    return out


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
