"""Plain numpy twins of planview/tracking/harville/_kernels.py; they define what the compiled loops compute."""

import math

import numpy as np

from calib.types import F32, F64, Bool


def differences(
    template_height: F32,
    template_occupancy: F32,
    height: F32,
    occupancy: F32,
    row: int,
    col: int,
    one_sided: float,
) -> tuple[float, float]:
    n = len(template_height)
    seen_height = height[row : row + n, col : col + n].astype(np.float64)
    seen_occupancy = occupancy[row : row + n, col : col + n].astype(np.float64)
    either = (template_height > 0) | (seen_height > 0)
    both = (template_height > 0) & (seen_height > 0)
    if not either.any():
        return one_sided, 0.0
    apart = np.where(both, np.abs(template_height - seen_height), one_sided)
    return float(apart[either].mean()), float(np.abs(template_occupancy - seen_occupancy)[either].mean())


def search(
    template_height: F32,
    template_occupancy: F32,
    height: F32,
    occupancy: F32,
    row: float,
    col: float,
    reach: int,
    one_sided: float,
    height_weight: float,
    occupancy_weight: float,
    distance_weight: float,
    separation_weight: float,
    separation_cells: float,
    others: F64,
    result: F64,
) -> None:
    n = len(template_height)
    rows, cols = height.shape[0] - n + 1, height.shape[1] - n + 1
    r0, c0 = min(max(round(row), 0), rows - 1), min(max(round(col), 0), cols - 1)
    result[0] = math.inf
    passes = [(reach, 1)] if reach <= 2 else [(reach, 2), (1, 1)]
    for number, (radius, step) in enumerate(passes):
        if number == 1:
            r0, c0 = int(result[1]), int(result[2])
        for r in range(max(0, r0 - radius), min(rows, r0 + radius + 1), step):
            for c in range(max(0, c0 - radius), min(cols, c0 + radius + 1), step):
                apart = differences(template_height, template_occupancy, height, occupancy, r, c, one_sided)
                squared = (r - others[:, 0]) ** 2 + (c - others[:, 1]) ** 2
                terms = (
                    height_weight * apart[0],
                    occupancy_weight * apart[1],
                    distance_weight * math.hypot(r - row, c - col),
                    float(separation_weight * np.exp(-0.5 * squared / separation_cells**2).sum()),
                )
                if sum(terms) < result[0]:
                    result[:] = (sum(terms), r, c, *terms)


def clear(
    height: F32,
    occupancy: F32,
    row: float,
    col: float,
    ray_row: float,
    ray_col: float,
    across_cells: float,
    along_cells: float,
    others: F64,
    expected: Bool,
) -> None:
    r, c = np.indices(height.shape)
    along = (r - row) * ray_row + (c - col) * ray_col
    across = -(r - row) * ray_col + (c - col) * ray_row
    inside = (along / along_cells) ** 2 + (across / across_cells) ** 2 <= 1.0
    for other_row, other_col in others[expected]:
        inside &= (r - other_row) ** 2 + (c - other_col) ** 2 >= (r - row) ** 2 + (c - col) ** 2
    height[inside] = 0.0
    occupancy[inside] = 0.0


def _others_cells(row: int, col: int, n: int, people: F64, me: int) -> np.ndarray:
    r, c = np.indices((n, n)) + np.array([row, col])[:, None, None]
    squared = (r - people[:, 0, None, None]) ** 2 + (c - people[:, 1, None, None]) ** 2
    return (np.delete(squared, me, axis=0) < squared[me]).any(axis=0)


def adapt(
    template_height: F32,
    template_occupancy: F32,
    height: F32,
    occupancy: F32,
    row: int,
    col: int,
    people: F64,
    me: int,
    gain: float,
    occupancy_min: float,
) -> tuple[float, float, float]:
    n = len(template_height)
    theirs = _others_cells(row, col, n, people, me)
    seen_height = np.where(theirs, 0.0, height[row : row + n, col : col + n])
    seen_occupancy = np.where(theirs, 0.0, occupancy[row : row + n, col : col + n])
    template_occupancy += (gain * (seen_occupancy - template_occupancy)).astype(np.float32)
    known = template_height > 0
    blended = np.where(known, template_height + gain * (seen_height - template_height), seen_height)
    template_height[:] = np.where(seen_height > 0, blended, template_height)
    template_height[template_occupancy < occupancy_min] = 0.0
    r, c = np.nonzero(template_height > 0)
    if len(r) == 0:
        return 0.0, 0.0, 0.0
    half = (n - 1) / 2
    return len(r) / (n * n), float(r.mean() - half), float(c.mean() - half)


def occupancy_peak(occupancy: F32, row: int, col: int, n: int, people: F64, me: int) -> tuple[int, int]:
    window = np.where(_others_cells(row, col, n, people, me), 0.0, occupancy[row : row + n, col : col + n])
    if window.max() <= 0:
        return -1, -1
    r, c = np.unravel_index(np.argmax(window), window.shape)
    return row + int(r), col + int(c)
