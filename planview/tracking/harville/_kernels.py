"""Compiled kernels of the template tracker; ``tests/reference/template.py`` defines them in plain numpy.

Maps arrive padded by the templates' half side, so that a template centred on any cell stays inside.
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, Bool

NEGLIGIBLE = 100.0
"""Squared deviations beyond which a Gaussian is below a double's resolution of 1: exp(-50)."""


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
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


@njit(cache=True, nogil=True)
def mean_where(values: F32, known: F32) -> float:
    """Mean of the values where ``known``, of the same shape, is positive; 0 where it is nowhere."""
    total, count = 0.0, 0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            if known[i, j] > 0.0:
                total += values[i, j]
                count += 1
    return total / count if count else 0.0


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def rivals(people: F64, counts: Bool, row: float, col: float, radius: float) -> I64:
    """Which of ``people`` (K, 2) that count may be nearer to a cell than (row, col) is, within ``radius`` of it."""
    near = np.empty(len(people), np.int64)
    n = 0
    for k in range(len(people)):
        if counts[k] and (people[k, 0] - row) ** 2 + (people[k, 1] - col) ** 2 <= 4 * radius * radius:
            near[n] = k
            n += 1
    return near[:n]


@njit(cache=True, nogil=True)
def nearer_to_another(people: F64, near: I64, row: int, col: int, squared: float) -> bool:
    """Whether a cell is nearer than the root of ``squared`` to one of the people whose rows ``near`` lists."""
    nearer = False
    for k in near:
        nearer |= (row - people[k, 0]) ** 2 + (col - people[k, 1]) ** 2 < squared
    return nearer


@njit(cache=True, nogil=True)
def clear(  # type: ignore[no-untyped-def]
    height: F32, occupancy: F32, row: float, col: float, ray_row: float, ray_col: float,
    across_cells: float, along_cells: float, others: F64, expected: Bool,
):  # fmt: skip
    """Zero both padded maps within an ellipse whose long axis follows the viewing ray.

    Cells nearer to one of ``others`` (K, 2: padded rows and cols) that is ``expected`` (K,) are left, since they are
    another person's.
    """
    reach = math.ceil(max(across_cells, along_cells))
    rows, cols = height.shape
    near = rivals(others, expected, row, col, max(across_cells, along_cells))
    centre_row, centre_col = round(row), round(col)
    for r in range(max(0, centre_row - reach), min(rows, centre_row + reach + 1)):
        for c in range(max(0, centre_col - reach), min(cols, centre_col + reach + 1)):
            along = (r - row) * ray_row + (c - col) * ray_col
            across = -(r - row) * ray_col + (c - col) * ray_row
            if (along / along_cells) ** 2 + (across / across_cells) ** 2 > 1.0:
                continue
            mine = (r - row) ** 2 + (c - col) ** 2
            if not nearer_to_another(others, near, r, c, mine):
                height[r, c] = 0.0
                occupancy[r, c] = 0.0


@njit(cache=True, nogil=True)
def others_near(people: F64, me: int, row: int, col: int, n: int) -> I64:
    """``rivals`` of person ``me`` in the n x n window from (row, col)."""
    counts = np.ones(len(people), np.bool_)
    counts[me] = False
    high = max(abs(row - people[me, 0]), abs(row + n - 1 - people[me, 0]))
    wide = max(abs(col - people[me, 1]), abs(col + n - 1 - people[me, 1]))
    return rivals(people, counts, people[me, 0], people[me, 1], math.hypot(high, wide))


@njit(cache=True, nogil=True)
def adapt(  # type: ignore[no-untyped-def]
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32, row: int, col: int,
    people: F64, me: int, gain: float, occupancy_min: float,
):  # fmt: skip
    """Blend the map around a person into the templates; returns the share of cells with height and their centroid.

    ``row``, ``col``: the window's first cell in the padded maps. Cells nearer to another of ``people`` (K, 2: padded
    rows and cols) than to person ``me`` are theirs and count as empty. Height is kept where the adapted occupancy is
    at least ``occupancy_min``. Centroid offsets are in cells from the template's centre.
    """
    n = template_height.shape[0]
    near = others_near(people, me, row, col, n)
    count = 0
    sum_row = 0.0
    sum_col = 0.0
    for i in range(n):
        for j in range(n):
            r, c = row + i, col + j
            mine = (r - people[me, 0]) ** 2 + (c - people[me, 1]) ** 2
            map_height = height[r, c]
            map_occupancy = occupancy[r, c]
            if nearer_to_another(people, near, r, c, mine):
                map_height = 0.0
                map_occupancy = 0.0
            template_occupancy[i, j] += gain * (map_occupancy - template_occupancy[i, j])
            if map_height > 0.0:
                if template_height[i, j] > 0.0:
                    template_height[i, j] += gain * (map_height - template_height[i, j])
                else:
                    template_height[i, j] = map_height
            if template_occupancy[i, j] < occupancy_min:
                template_height[i, j] = 0.0
            if template_height[i, j] > 0.0:
                count += 1
                sum_row += i
                sum_col += j
    if count == 0:
        return 0.0, 0.0, 0.0
    half = (n - 1) / 2
    return count / (n * n), sum_row / count - half, sum_col / count - half


@njit(cache=True, nogil=True)
def occupancy_peak(  # type: ignore[no-untyped-def]
    occupancy: F32, row: int, col: int, n: int, people: F64, me: int
):
    """Padded cell of the largest occupancy in the n x n window from (row, col), others' cells left out; -1 if empty."""
    near = others_near(people, me, row, col, n)
    best = 0.0
    best_row, best_col = -1, -1
    for r in range(row, row + n):
        for c in range(col, col + n):
            if occupancy[r, c] <= best:
                continue
            mine = (r - people[me, 0]) ** 2 + (c - people[me, 1]) ** 2
            if not nearer_to_another(people, near, r, c, mine):
                best = occupancy[r, c]
                best_row, best_col = r, c
    return best_row, best_col
