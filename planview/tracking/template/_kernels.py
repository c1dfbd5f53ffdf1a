"""Compiled kernels of equation (4); ``tests/reference/template.py`` defines them in plain numpy.

Maps arrive padded by the templates' half side: the template centred on cell (row, col) of the grid covers the padded
maps from (row, col) on.
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64

NEGLIGIBLE = 100.0
"""Squared deviations beyond which a Gaussian is below a double's resolution of 1: exp(-50)."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def differences(  # type: ignore[no-untyped-def]
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32, row: int, col: int, one_sided: float
):
    """Mean height and occupancy differences over the cells where template or map has height (eq. 4).

    ``row``, ``col``: the window's first cell. A cell with height in exactly one of the two counts as ``one_sided``.
    """
    n = template_height.shape[0]
    map_height = height[row : row + n, col : col + n]
    map_occupancy = occupancy[row : row + n, col : col + n]
    zero, one, gap = np.float32(0.0), np.float32(1.0), np.float32(one_sided)
    height_sum = zero
    occupancy_sum = zero
    used = zero
    for i in range(n):
        for j in range(n):
            # Weights instead of branches, so that the loop runs on vectors.
            known = one if template_height[i, j] > zero else zero
            present = one if map_height[i, j] > zero else zero
            both = known * present
            either = known + present - both
            height_sum += both * abs(template_height[i, j] - map_height[i, j]) + (either - both) * gap
            occupancy_sum += either * abs(template_occupancy[i, j] - map_occupancy[i, j])
            used += either
    if used == 0:
        return one_sided, 0.0
    return height_sum / used, occupancy_sum / used


@njit(cache=True, nogil=True, error_model="numpy")
def search(  # type: ignore[no-untyped-def]
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32,
    row: float, col: float, reach: int, one_sided: float,
    height_weight: float, occupancy_weight: float, distance_weight: float,
    separation_weight: float, separation_cells: float, others: F64, result: F64,
):  # fmt: skip
    """Minimise the match score (eq. 4) over the cells within ``reach`` of the prediction (row, col).

    Every second cell first where the reach is wide, then the neighbours of the best one: the maps are smooth over
    a cell. ``others`` (K, 2): cells of people already placed this frame. Fills ``result`` with
    (score, row, col, height term, occupancy term, distance term, separation term).
    """
    rows = height.shape[0] - template_height.shape[0] + 1
    cols = height.shape[1] - template_height.shape[1] + 1
    centre_row = min(max(round(row), 0), rows - 1)
    centre_col = min(max(round(col), 0), cols - 1)
    result[0] = math.inf
    step = 2 if reach > 2 else 1
    for fine in range(2):
        if fine == 1:
            if step == 1:
                break
            centre_row, centre_col, reach, step = int(result[1]), int(result[2]), 1, 1
        for r in range(max(0, centre_row - reach), min(rows, centre_row + reach + 1), step):
            for c in range(max(0, centre_col - reach), min(cols, centre_col + reach + 1), step):
                distance = distance_weight * math.sqrt((r - row) ** 2 + (c - col) ** 2)
                separation = 0.0
                for k in range(len(others)):
                    squared = ((r - others[k, 0]) ** 2 + (c - others[k, 1]) ** 2) / separation_cells**2
                    if squared < NEGLIGIBLE:
                        separation += separation_weight * math.exp(-0.5 * squared)
                if distance + separation >= result[0]:
                    continue
                sad_height, sad_occupancy = differences(
                    template_height, template_occupancy, height, occupancy, r, c, one_sided
                )
                score = height_weight * sad_height + occupancy_weight * sad_occupancy + distance + separation
                if score < result[0]:
                    result[0], result[1], result[2] = score, r, c
                    result[3], result[4] = height_weight * sad_height, occupancy_weight * sad_occupancy
                    result[5], result[6] = distance, separation
