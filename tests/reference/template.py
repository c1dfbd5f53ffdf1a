"""Plain numpy twins of planview/tracking/template/_kernels.py; they define what the compiled loops compute."""

import math

import numpy as np

from calib.types import F32, F64


def differences(
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32, row: int, col: int, one_sided: float
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
    template_height: F32, template_occupancy: F32, height: F32, occupancy: F32, row: float, col: float, reach: int,
    one_sided: float, height_weight: float, occupancy_weight: float, distance_weight: float,
    separation_weight: float, separation_cells: float, others: F64, result: F64,
) -> None:  # fmt: skip
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
