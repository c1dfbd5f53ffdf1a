"""Plan-view maps of height and occupancy (Harville 2002, section 3), of one rig or of several above one floor.

One rig measures the surface of a body that faces it (Harville's occupancy, Z^2/(fu fv) summed). Two rigs that see the
same body measure two such surfaces, front and back or twice the front; their sum is no property of the body, and every
rule about visible surface (how much a head, a person, a part of a person shows) is about one view. What is counted is
therefore the surface that the best of the views shows, shared out among the rigs by what each shows:

    O(c) = sum_k a_k(c) O_k(c),   a_k(c) = max_j S_j(c) / sum_j S_j(c)

with O_k the occupancy of rig k and S_k its sum over a body's surroundings of the cell. Where one rig sees a place the
factor is 1, and nothing changes when a body walks into or out of the other's view, or is hidden from it (ours).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.kernels import kernel
from calib.types import F32, I32, U8, AnyArray
from planview.maps.grid import Grid, MapParams

TEMPLATE_M = 0.8
"""Side of a person's template, 2 W_avg [m] (Harville 2002, section 4)."""


@dataclass(frozen=True, eq=False)
class FloorPoints:
    """Foreground points of one frame in the world frame.

    Attributes:
        xyz: (N, 3) float32 [m].
        area: (N,) float32, surface that the pixel subtends, Z^2/(fu fv) [m^2].
        pixels: (N,) int32, row * width + column in the foreground mask.
        colours: (N,) uint8 colour codes (``planview.maps.view``), None where no image was given.
    """

    xyz: F32
    area: F32
    pixels: I32
    colours: U8 | None = None


@dataclass(frozen=True, eq=False)
class PlanViewMaps:
    """Maps of one frame, all (n_rows, n_cols) float32 on the same grid.

    Attributes:
        grid: where the cells are.
        height_raw: highest point per cell [m], 0 where none fell.
        occupancy_raw: visible foreground surface per cell [m^2].
        height: smoothed and masked height H_masked [m].
        occupancy: smoothed occupancy O_sm [m^2].
        occupancy_min: theta_occ of this grid [m^2 per cell].
        points: the points that the maps were made of.
    """

    grid: Grid
    height_raw: F32
    occupancy_raw: F32
    height: F32
    occupancy: F32
    occupancy_min: float
    points: FloorPoints

    def around(self, x_m: float, y_m: float) -> tuple[F32, F32]:
        """The maps around a place as a template (Harville 2002, section 4), 0 outside of the grid.

        Returns:
            T_H [m] and T_O [m^2], (n, n) float32 of TEMPLATE_M, centred on the cell of the place.
        """
        half = round(TEMPLATE_M / 2 / self.grid.cell_m)
        row, col = self.grid.nearest(x_m, y_m)
        window = np.s_[row : row + 2 * half + 1, col : col + 2 * half + 1]
        height = np.pad(self.height, half)[window]
        occupancy = np.pad(self.occupancy, half)[window]
        return height, occupancy


def raw_maps(points: FloorPoints, grid: Grid, height_min_m: float) -> tuple[F32, F32]:
    """Highest point [m] and summed area [m^2] of every cell, of points above ``height_min_m``."""
    corner = (grid.x_min_m, grid.y_min_m, grid.cell_m)
    height_m, area_m2 = accumulate(points.xyz, points.area, height_min_m, corner, grid.shape)
    return height_m, area_m2


def plan_view(sensors: Sequence[FloorPoints], grid: Grid, params: MapParams) -> PlanViewMaps:
    """The points of every rig to maps: accumulate, smooth, mask.

    Height is smoothed over occupied cells only, or edges would sink. Pixels of the maps' points are those of the rigs,
    one rig after the other.
    """
    points = sensors[0] if len(sensors) == 1 else join_points(sensors, grid, params.height_min_m)
    height_raw, occupancy_raw = raw_maps(points, grid, params.height_min_m)
    sigma = params.smoothing_m / grid.cell_m
    part = _occupied_part(occupancy_raw, margin=2 * math.ceil(3 * sigma))
    occupancy_min = params.occupancy_min * grid.cell_m**2
    height = np.zeros_like(height_raw)
    occupancy = np.zeros_like(occupancy_raw)
    smooth_height = height_raw[part]
    occupancy[part] = occupancy_raw[part]
    if sigma > 0.0 and occupancy[part].size:
        occupancy[part] = _blur(occupancy_raw[part], sigma)
        occupied_share = _blur((height_raw[part] > 0.0).astype(np.float32), sigma)
        smooth_height = np.divide(_blur(height_raw[part], sigma), np.maximum(occupied_share, 1e-3), dtype=np.float32)
    np.copyto(height[part], smooth_height, where=occupancy[part] >= np.float32(occupancy_min))
    return PlanViewMaps(grid, height_raw, occupancy_raw, height, occupancy, occupancy_min, points)


def _occupied_part(occupancy: F32, margin: int) -> tuple[slice, slice]:
    """The part around occupied cells, with a margin: most of the floor is empty and need not be smoothed."""
    left, top, width, height = cv2.boundingRect((occupancy > 0.0).view(np.uint8))
    if width == 0:
        return slice(0, 0), slice(0, 0)
    rows = slice(max(0, top - margin), top + height + margin)
    cols = slice(max(0, left - margin), left + width + margin)
    return rows, cols


def _blur(image: F32, sigma: float) -> F32:
    size = 2 * max(1, round(3 * sigma)) + 1
    smooth = cv2.GaussianBlur(image, (size, size), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(smooth, np.float32)


def joint_grid(grids: Sequence[Grid]) -> Grid:
    """The grid that covers those of all rigs, whose cells have one size. Raises ValueError: the floor covered together
    is larger than a grid may be."""
    if len(grids) == 1:
        return grids[0]
    x_min_m = min(grid.x_min_m for grid in grids)
    y_min_m = min(grid.y_min_m for grid in grids)
    x_max_m = max(grid.x_max_m for grid in grids)
    y_max_m = max(grid.y_max_m for grid in grids)
    return Grid.covering(x_min_m, y_min_m, x_max_m, y_max_m, grids[0].cell_m)


def join_points(sensors: Sequence[FloorPoints], grid: Grid, height_min_m: float) -> FloorPoints:
    """All points together, each with the surface that it counts for."""
    side = 2 * max(1, round(TEMPLATE_M / 2 / grid.cell_m)) + 1
    surfaces = []
    for points in sensors:
        _, occupancy = raw_maps(points, grid, height_min_m)
        surfaces.append(_sum_around(occupancy, side))
    total = np.sum(surfaces, axis=0)
    factor = np.max(surfaces, axis=0) / np.where(total > 0, total, np.float32(1.0))  # max S / sum S, 0 without S
    every = concatenate_points(sensors)
    cols = np.floor((every.xyz[:, 0] - grid.x_min_m) / grid.cell_m).astype(np.int64)
    rows = np.floor((every.xyz[:, 1] - grid.y_min_m) / grid.cell_m).astype(np.int64)
    inside = (cols >= 0) & (rows >= 0) & (cols < grid.n_cols) & (rows < grid.n_rows)
    weight = np.zeros(len(every.xyz), dtype=np.float32)
    weight[inside] = factor[rows[inside], cols[inside]]
    # Points below height_min_m are in no sum: where only they are, they keep their surface.
    weight[weight == 0.0] = 1.0
    return replace(every, area=every.area * weight)


def concatenate_points(sensors: Sequence[FloorPoints]) -> FloorPoints:
    """The points of several rigs one after the other; colours only when all that have points have them."""
    xyz = np.concatenate([points.xyz for points in sensors])
    area = np.concatenate([points.area for points in sensors])
    pixels = np.concatenate([points.pixels for points in sensors])
    colours = [points.colours for points in sensors if points.colours is not None]
    coloured_points = sum(map(len, colours))
    if not colours or coloured_points < len(xyz):
        return FloorPoints(xyz, area, pixels)
    return FloorPoints(xyz, area, pixels, np.concatenate(colours))


def _sum_around(occupancy: F32, side: int) -> F32:
    """Sums over squares of ``side`` x ``side`` cells."""
    summed: AnyArray = cv2.boxFilter(occupancy, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    # Running sums leave crumbs where nothing is.
    return np.asarray(np.where(summed > 1e-6, summed, 0.0), dtype=np.float32)


@kernel
def accumulate(
    points: F32, weight: F32, height_min_m: float, corner: tuple[float, float, float], shape: tuple[int, int]
) -> tuple[F32, F32]:
    """Highest point and summed weight per cell in one pass (Harville 2002, section 3), ``shape`` float32 each.

    ``corner``: x and y where the grid begins, and the side of a cell [m]. Points outside the grid or lower than
    ``height_min_m`` are skipped.
    """
    height = np.zeros(shape, np.float32)
    occupancy = np.zeros(shape, np.float32)
    x_min_m, y_min_m, cell_m = corner
    for i in range(len(points)):
        if points[i, 2] < height_min_m:
            continue
        col = math.floor((float(points[i, 0]) - x_min_m) / cell_m)
        row = math.floor((float(points[i, 1]) - y_min_m) / cell_m)
        if 0 <= col < shape[1] and 0 <= row < shape[0]:
            height[row, col] = max(height[row, col], points[i, 2])
            occupancy[row, col] += weight[i]
    return height, occupancy
