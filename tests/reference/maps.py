"""Plain numpy twins of the compiled loops of planview/maps; they define what these compute."""

import numpy as np

from calib.types import F32, F64, I32, U8
from planview.maps.view import CHROMA_CELLS, CHROMA_EDGES, LUMA_CELLS


def back_project(disparity: F32, mask: U8, camera: F64, pose: F64, limits: tuple[float, float]) -> tuple[F32, F32, I32]:
    fu, fv, cu, cv, focal_baseline = camera
    disparity_min, height_max_m = limits
    row, col = np.nonzero((mask > 0) & (disparity >= disparity_min))
    z = focal_baseline / disparity[row, col].astype(np.float64)
    seen = np.column_stack([(col - cu) / fu * z, (row - cv) / fv * z, z])
    world = seen @ pose[:, :3].T + pose[:, 3]
    keep = world[:, 2] <= height_max_m
    points, area, pixels = world, z * z / (fu * fv), row * disparity.shape[1] + col
    return points[keep].astype(np.float32), area[keep].astype(np.float32), pixels[keep].astype(np.int32)


def accumulate(
    points: F32, weight: F32, height_min_m: float, corner: tuple[float, float, float], shape: tuple[int, int]
) -> tuple[F32, F32]:
    height, occupancy = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    x_min_m, y_min_m, cell_m = corner
    xy = points[:, :2].astype(np.float64)
    col = np.floor((xy[:, 0] - x_min_m) / cell_m).astype(np.int64)
    row = np.floor((xy[:, 1] - y_min_m) / cell_m).astype(np.int64)
    keep = (points[:, 2] >= height_min_m) & (col >= 0) & (row >= 0) & (col < shape[1]) & (row < shape[0])
    np.maximum.at(height, (row[keep], col[keep]), points[keep, 2])
    np.add.at(occupancy, (row[keep], col[keep]), weight[keep])
    return height, occupancy


def encode_colours(image: U8, pixels: I32, gain: float, offset: float, codes: U8) -> None:
    chosen = image[pixels].astype(np.float32)
    luma, u, v = chosen[:, 0], np.zeros(len(pixels), np.float32), np.zeros(len(pixels), np.float32)
    if image.shape[1] > 1:
        b, g, r = chosen.T
        luma = 0.114 * b + 0.587 * g + 0.299 * r
        u, v = 0.492 * (b - luma) / gain, 0.877 * (r - luma) / gain
    level = np.clip((luma - offset) / gain * (LUMA_CELLS / 256.0), 0, LUMA_CELLS - 1).astype(np.int32)
    cells = [np.searchsorted(np.float32(CHROMA_EDGES), chroma) for chroma in (u, v)]
    codes[:] = (level * CHROMA_CELLS + cells[0]) * CHROMA_CELLS + cells[1]
