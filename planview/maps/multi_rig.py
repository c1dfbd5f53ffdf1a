"""Maps of several rigs that look at one floor: whose surface counts.

One rig measures the surface of a body that faces it (Harville's occupancy, Z^2/(fu fv) summed). Two rigs that see the
same body measure two such surfaces, front and back or twice the front; their sum is no property of the body, and every
rule about visible surface (how much a head, a person, a part of a person shows) is about one view. What is counted is
therefore the surface that the best of the views shows, shared out among the rigs by what each shows:

    O(c) = sum_k a_k(c) O_k(c),   a_k(c) = max_j S_j(c) / sum_j S_j(c)

with O_k the occupancy of rig k and S_k its sum over a body's surroundings of the cell. Where one rig sees a place the
factor is 1, and nothing changes when a body walks into or out of the other's view, or is hidden from it (ours).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.types import F32, AnyArray
from planview.maps.builder import TEMPLATE_M, FloorPoints, MapParams, PlanViewMaps, accumulated, plan_view
from planview.maps.grid import Grid


def joint_grid(grids: Sequence[Grid]) -> Grid:
    """The grid that covers those of all rigs, whose cells have one size.

    Raises:
        ValueError: the floor covered together is larger than a grid may be.
    """
    if len(grids) == 1:
        return grids[0]
    return Grid.covering(
        min(g.x_min_m for g in grids),
        min(g.y_min_m for g in grids),
        max(g.x_max_m for g in grids),
        max(g.y_max_m for g in grids),
        grids[0].cell_m,
    )


def joint_maps(points: Sequence[FloorPoints], grid: Grid, params: MapParams) -> PlanViewMaps:
    """One set of maps from the foreground points of every rig that has a frame, in the common world.

    Pixels of the maps' points are those of the rigs, one rig after the other.
    """
    return plan_view(points[0] if len(points) == 1 else _joined(points, grid, params.height_min_m), grid, params)


def _joined(points: Sequence[FloorPoints], g: Grid, height_min_m: float) -> FloorPoints:
    """All points together, each with the surface that it counts for."""
    side = 2 * max(1, round(TEMPLATE_M / 2 / g.cell_m)) + 1
    surface = np.stack([_around(accumulated(p, g, height_min_m)[1], side) for p in points])
    total = surface.sum(axis=0)
    factor = surface.max(axis=0) / np.where(total > 0, total, np.float32(1.0))  # max S / sum S, 0 without S
    every = concatenated(points)
    cols = np.floor((every.xyz[:, 0] - g.x_min_m) / g.cell_m).astype(np.int64)
    rows = np.floor((every.xyz[:, 1] - g.y_min_m) / g.cell_m).astype(np.int64)
    inside = (cols >= 0) & (rows >= 0) & (cols < g.n_cols) & (rows < g.n_rows)
    weight = np.zeros(len(every.xyz), dtype=np.float32)
    weight[inside] = factor[rows[inside], cols[inside]]
    # Points below height_min_m are in no sum: where only they are, they keep their surface.
    weight[weight == 0.0] = 1.0
    return replace(every, area=every.area * weight)


def concatenated(points: Sequence[FloorPoints]) -> FloorPoints:
    """The points of several rigs one after the other; colours only when all that have points have them."""
    coloured = all(p.colours is not None or not len(p.xyz) for p in points)
    colours = [p.colours for p in points if p.colours is not None]
    return FloorPoints(
        np.concatenate([p.xyz for p in points]),
        np.concatenate([p.area for p in points]),
        np.concatenate([p.pixels for p in points]),
        np.concatenate(colours) if coloured and colours else None,
    )


def _around(occupancy: F32, side: int) -> F32:
    """Sums over squares of cells."""
    summed: AnyArray = cv2.boxFilter(occupancy, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    # Running sums leave crumbs where nothing is.
    return np.asarray(np.where(summed > 1e-6, summed, 0.0), dtype=np.float32)
