"""Compiled kernels of the plan-view maps; ``tests/reference/maps.py`` defines them in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, U8

F = np.float32


@njit(cache=True, nogil=True, error_model="numpy")
def back_project(disparity: F32, mask: U8, camera: F64, pose: F64, limits, out):  # type: ignore[no-untyped-def]
    """Foreground pixels with a disparity to world points (Harville 2002, eq. 1 and 2).

    ``camera``: fu, fv, cu, cv, fu times the baseline; ``pose``: (3, 4) world_SE3_left. Fills ``out``, points (N, 3),
    area (N) = Z^2/(fu fv) and pixels (N) = row * width + column, and returns N. Less disparity than the first of
    ``limits`` and points above the second are dropped.
    """
    fu, fv, cu, cv, focal_baseline = camera
    (disparity_min, height_max_m), (points, area, pixels) = limits, out
    rows, cols = disparity.shape
    n = 0
    for row in range(rows):
        ray_y = (row - cv) / fv
        bx = pose[0, 1] * ray_y + pose[0, 2]
        by = pose[1, 1] * ray_y + pose[1, 2]
        bz = pose[2, 1] * ray_y + pose[2, 2]
        for col in range(cols):
            if mask[row, col] == 0:
                continue
            d = disparity[row, col]
            if not d >= disparity_min:
                continue
            z = focal_baseline / d
            ray_x = (col - cu) / fu
            height = z * (pose[2, 0] * ray_x + bz) + pose[2, 3]
            if height > height_max_m:
                continue
            points[n, 0] = z * (pose[0, 0] * ray_x + bx) + pose[0, 3]
            points[n, 1] = z * (pose[1, 0] * ray_x + by) + pose[1, 3]
            points[n, 2] = height
            area[n] = z * z / (fu * fv)
            pixels[n] = row * cols + col
            n += 1
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(  # type: ignore[no-untyped-def]
    points: F32,
    weight: F32,
    height_min_m: float,
    x_min_m: float,
    y_min_m: float,
    cell_m: float,
    height: F32,
    occupancy: F32,
):
    """Highest point and summed weight per cell in one pass (Harville 2002, section 3).

    ``height`` and ``occupancy`` (n_rows, n_cols) are zeroed first; points outside the grid or lower than
    ``height_min_m`` are skipped.
    """
    height[:] = 0.0
    occupancy[:] = 0.0
    rows, cols = height.shape
    for i in range(len(points)):
        if points[i, 2] < height_min_m:
            continue
        col = math.floor((float(points[i, 0]) - x_min_m) / cell_m)
        row = math.floor((float(points[i, 1]) - y_min_m) / cell_m)
        if col < 0 or row < 0 or col >= cols or row >= rows:
            continue
        height[row, col] = max(height[row, col], points[i, 2])
        occupancy[row, col] += weight[i]


@njit(cache=True, nogil=True, error_model="numpy")
def encode_colours(  # type: ignore[no-untyped-def]
    image: U8, channels: int, pixels: I32, gain: float, offset: float,
    luma_cells: int, edges: F32, codes: U8,
):  # fmt: skip
    """Colour codes of some pixels of a flat image (``planview.maps.colour``), in float32.

    ``edges`` are those of the cells of U and V; fills ``codes`` (N,).
    """
    g, o, scale = F(gain), F(offset), F(luma_cells / 256.0)
    top, chroma_cells = F(luma_cells - 1), len(edges) + 1
    for i in range(len(pixels)):
        at = channels * pixels[i]
        luma = F(image[at])
        u = v = F(0)
        if channels > 1:
            blue, green, red = F(image[at]), F(image[at + 1]), F(image[at + 2])
            luma = F(0.114) * blue + F(0.587) * green + F(0.299) * red
            u, v = F(0.492) * (blue - luma) / g, F(0.877) * (red - luma) / g
        code = int(min(max((luma - o) / g * scale, F(0)), top))
        for value in (u, v):
            cell = 0
            for edge in edges:
                cell += value > edge
            code = code * chroma_cells + cell
        codes[i] = code
