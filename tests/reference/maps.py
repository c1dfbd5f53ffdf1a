"""Plain numpy twins of planview/maps/_kernels.py; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, F64, I32, U8


def back_project(
    disparity: F32, mask: U8, camera: F64, pose: F64, limits: tuple[float, float], out: tuple[F32, F32, I32]
) -> int:
    fu, fv, cu, cv, focal_baseline = camera
    (disparity_min, height_max_m), (points, area, pixels) = limits, out
    row, col = np.nonzero((mask > 0) & (disparity >= disparity_min))
    z = focal_baseline / disparity[row, col].astype(np.float64)
    seen = np.column_stack([(col - cu) / fu * z, (row - cv) / fv * z, z])
    world = seen @ pose[:, :3].T + pose[:, 3]
    keep = world[:, 2] <= height_max_m
    n = int(keep.sum())
    points[:n] = world[keep]
    area[:n] = (z * z / (fu * fv))[keep]
    pixels[:n] = (row * disparity.shape[1] + col)[keep]
    return n


def accumulate(
    points: F32, weight: F32, height_min_m: float, x_min_m: float, y_min_m: float, cell_m: float,
    height: F32, occupancy: F32,
) -> None:  # fmt: skip
    height[:] = occupancy[:] = 0.0
    xy = points[:, :2].astype(np.float64)
    col = np.floor((xy[:, 0] - x_min_m) / cell_m).astype(np.int64)
    row = np.floor((xy[:, 1] - y_min_m) / cell_m).astype(np.int64)
    rows, cols = height.shape
    keep = (points[:, 2] >= height_min_m) & (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
    np.maximum.at(height, (row[keep], col[keep]), points[keep, 2])
    np.add.at(occupancy, (row[keep], col[keep]), weight[keep])


def encode_colours(
    image: U8, channels: int, pixels: I32, gain: float, offset: float, luma_cells: int, edges: F32, codes: U8
) -> None:
    chosen = image.reshape(-1, channels)[pixels].astype(np.float32)
    luma, u, v = chosen[:, 0], np.zeros(len(pixels), np.float32), np.zeros(len(pixels), np.float32)
    if channels > 1:
        b, g, r = chosen.T
        luma = 0.114 * b + 0.587 * g + 0.299 * r
        u, v = 0.492 * (b - luma) / gain, 0.877 * (r - luma) / gain
    level = np.clip((luma - offset) / gain * (luma_cells / 256.0), 0, luma_cells - 1).astype(np.int32)
    cells = len(edges) + 1
    codes[:] = (level * cells + np.searchsorted(edges, u)) * cells + np.searchsorted(edges, v)
