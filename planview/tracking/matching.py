"""The best pairs of the members of two groups, and the area that boxes share."""

from __future__ import annotations

import numpy as np

from calib.types import F64


def best_pairs(gains: F64) -> dict[int, int]:
    """Columns of rows, each at most once, by the largest sum of (N, M) gains; none where a gain is not above 0."""
    if len(gains) == 1 <= gains.size:
        rows = np.zeros(1, np.int64)
        columns = gains.argmax(axis=1)
    else:
        from scipy.optimize import linear_sum_assignment  # half a second, and newcomers mostly come alone

        rows, columns = linear_sum_assignment(gains, maximize=True)
    return {int(i): int(k) for i, k in zip(rows, columns, strict=True) if gains[i, k] > 0.0}


def common_areas(boxes: F64, others: F64) -> F64:
    """(N, M) area [px^2] that (N, 4) and (M, 4) boxes left, top, width, height share."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, :2] + boxes[:, None, 2:], others[:, :2] + others[:, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=-1))


def overlaps(boxes: F64, others: F64) -> F64:
    """(N, M) intersection over union of (N, 4) and (M, 4) boxes left, top, width, height [px]."""
    shared = common_areas(boxes, others)
    areas = np.prod(boxes[:, 2:], axis=1)[:, None] + np.prod(others[:, 2:], axis=1)
    return np.asarray(shared / (areas - shared))
