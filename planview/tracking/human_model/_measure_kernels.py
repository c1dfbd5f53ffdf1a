"""Compiled kernels of what a placed model covers; ``tests/reference/human_model.py`` defines them in plain numpy.

See ``_kernels`` for how models and maps are passed.
"""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I32, I64, U8
from planview.tracking.human_model._kernels import fill_spans


@njit(cache=True, nogil=True)
def measure_models(
    evidence: U8, motion: U8, cover: U8, labels: I32, left: I32, right: I32, claimed: U8,
    index: I32, origin_u: int, origin_v: int, step: int, foot: F32, hull: F32,
    position: F64, scale: F64, ring: float, claim: float, votes: I64, counts: I64, extent: F64,
) -> None:  # fmt: skip
    """What each placed model covers.

    ``evidence`` is 2 where salient, 1 where less salient. Fills ``counts`` (N, 7): area, evidence, evidence covered by
    this model alone, pixels shared with another model, motion on the model, motion without evidence on it, label of the
    blob it covers most (0: none). Fills ``extent``
    (N, 3): mean of the foreground's columns minus the model's, mean square deviation of the foreground's columns, both
    over model and ring [px, px^2], and foreground pixels used for it. Marks the model and ``claim`` times its
    mean width beside it in ``claimed``. ``votes`` is
    a zeroed workspace with one cell per label.
    """
    width = evidence.shape[1]
    for t in range(len(scale)):
        top, bottom = fill_spans(
            index, origin_u, origin_v, step, foot, hull, position[t, 0], position[t, 1], scale[t], width, left, right
        )
        counts[t, :] = 0
        extent[t, :] = 0.0
        area = 0
        for y in range(top, bottom):
            area += max(0, right[y] - left[y])
        margin = int(ring * area / max(1, bottom - top) + 0.5)
        near = int(claim * area / max(1, bottom - top) + 0.5)
        best = 0
        for y in range(top, bottom):
            if left[y] >= right[y]:
                continue
            middle = 0.5 * (left[y] + right[y] - 1)
            for x in range(max(0, left[y] - margin), min(width, right[y] + margin)):
                if left[y] - near <= x < right[y] + near:
                    claimed[y, x] = 1
                inside = left[y] <= x < right[y]
                if evidence[y, x] > 1 and (cover[y, x] == 0 or (inside and cover[y, x] == 1)):
                    extent[t, 0] += x - middle
                    extent[t, 1] += (x - middle) ** 2
                    extent[t, 2] += 1
                if not inside:
                    continue
                if cover[y, x] > 1:
                    counts[t, 3] += 1
                if motion[y, x] > 0:
                    counts[t, 4] += 1
                    if evidence[y, x] == 0:
                        counts[t, 5] += 1
                if evidence[y, x] > 0:
                    counts[t, 1] += evidence[y, x]
                    if cover[y, x] == 1:
                        counts[t, 2] += evidence[y, x]
                    label = labels[y, x]
                    votes[label] += 1
                    if best == 0 or votes[label] > votes[best]:
                        best = label
        counts[t, 0] = area
        counts[t, 6] = best
        for y in range(top, bottom):
            for x in range(left[y], right[y]):
                votes[labels[y, x]] = 0


@njit(cache=True, nogil=True)
def body_extent(  # type: ignore[no-untyped-def]
    evidence: U8, cover: U8, foot_u: float, foot_v: float, axis_u: float, axis_v: float, half_width: float,
    bins: I64,
):  # fmt: skip
    """How far evidence that no other model covers reaches along a body's axis: (low, high), foot 0 and head 1.

    Pixels within ``half_width`` of the axis are counted in ``bins`` from -0.4 to 1.4 of the axis; from the middle
    outwards, the body ends where two bins in a row hold less than a tenth of its width. (0, 0) where there is none.
    """
    n = len(bins)
    bins[:] = 0
    height, width = evidence.shape
    length2 = axis_u * axis_u + axis_v * axis_v
    length = math.sqrt(length2)
    reach_u, reach_v = 0.5 * half_width + half_width, 1.5 * half_width
    x0 = max(0, math.floor(min(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) - reach_u))
    x1 = min(width, math.ceil(max(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) + reach_u) + 1)
    y0 = max(0, math.floor(min(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) - reach_v))
    y1 = min(height, math.ceil(max(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) + reach_v) + 1)
    for y in range(y0, y1):
        for x in range(x0, x1):
            if evidence[y, x] == 0 or cover[y, x] > 1:
                continue
            du, dv = x - foot_u, y - foot_v
            if abs(du * axis_v - dv * axis_u) > half_width * length:
                continue
            k = math.floor(((du * axis_u + dv * axis_v) / length2 + 0.4) / 1.8 * n)
            if 0 <= k < n:
                bins[k] += evidence[y, x]
    least = 0.1 * 2.0 * (2.0 * half_width) * (1.8 * length / n)
    middle = int(0.9 / 1.8 * n)
    if bins[middle] < least and bins[middle - 1] < least:
        return 0.0, 0.0
    low = middle
    while low > 0 and (bins[low - 1] >= least or (low > 1 and bins[low - 2] >= least)):
        low -= 1
    high = middle
    while high < n - 1 and (bins[high + 1] >= least or (high < n - 2 and bins[high + 2] >= least)):
        high += 1
    while low < high and bins[low] < least:
        low += 1
    while high > low and bins[high] < least:
        high -= 1
    return low / n * 1.8 - 0.4, (high + 1) / n * 1.8 - 0.4


@njit(cache=True, nogil=True)
def colour_histogram(
    image: U8, evidence: U8, cover: U8, left: I32, right: I32, top: int, bottom: int, level: U8, n_levels: int,
    histogram: F32,
) -> None:  # fmt: skip
    """Colours of the foreground that only this model covers, per horizontal part of the body.

    ``level`` (256,) quantises a channel to ``n_levels``. Fills ``histogram`` (parts, n_levels^3), each part summing to
    one (zero if nothing of it is seen).
    """
    parts, n_bins = histogram.shape
    histogram[:, :] = 0.0
    for y in range(top, bottom):
        part = min(parts - 1, (y - top) * parts // max(1, bottom - top))
        for x in range(left[y], right[y]):
            if evidence[y, x] > 0 and cover[y, x] == 1:
                b = (level[image[y, x, 0]] * n_levels + level[image[y, x, 1]]) * n_levels + level[image[y, x, 2]]
                histogram[part, b] += 1.0
    for part in range(parts):
        total = np.float32(0.0)
        for b in range(n_bins):
            total += histogram[part, b]
        if total > 0:
            for b in range(n_bins):
                histogram[part, b] /= total
