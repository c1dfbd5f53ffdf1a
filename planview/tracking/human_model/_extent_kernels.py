"""Compiled kernels of where a body ends along its axis; ``tests/reference/human_model.py`` has them in plain numpy."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from calib.types import F32, F64, I64, U8

CHEST = 0.75
"""Share of the height from which a head is looked for (our choice): below the neck of a person who sinks by a tenth."""


class Axis(NamedTuple):
    """A body's axis in the image [px]: the foot, the way from foot to head, half the body's width."""

    foot_u: float
    foot_v: float
    along_u: float
    along_v: float
    half_width: float


class BodyLine(NamedTuple):
    """A body's axis, its length [px], and where the ends of the outline lie along it: the foot 0 and the head 1."""

    axis: Axis
    length: float
    low: float
    high: float


@njit(cache=True, nogil=True)
def line_of(foot: F32, head: F32, hull: F32, scale: float, position: F64) -> BodyLine:
    """Axis of a scaled model that stands at a (2,) foot pixel.

    foot, head: (2,) of the map's entry; hull: (K, 2) its outline [px].
    """
    along_u, along_v = scale * np.float64(head[0] - foot[0]), scale * np.float64(head[1] - foot[1])
    length = math.hypot(along_u, along_v)
    low, high, across = math.inf, -math.inf, 0.0
    for k in range(len(hull)):
        u, v = scale * np.float64(hull[k, 0] - foot[0]), scale * np.float64(hull[k, 1] - foot[1])
        share = (u * along_u + v * along_v) / length**2 if length > 0.0 else 0.0
        low, high = min(low, share), max(high, share)
        across = max(across, abs(u * along_v - v * along_u))
    half_width = across / length if length > 0.0 else 0.0
    return BodyLine(Axis(position[0], position[1], along_u, along_v, half_width), length, low, high)


@njit(cache=True, nogil=True)
def body_extent(evidence: U8, cover: U8, axis: Axis, bins: I64) -> tuple[float, float, float]:
    """How far evidence that no other model covers reaches along a body's axis: (low, high, head), foot 0 and head 1.

    Pixels within ``half_width`` of the axis are counted in ``bins`` from -0.4 to 1.4 of the axis; from the middle
    outwards, the body ends where two bins in a row hold less than a tenth of its width. Where the middle is empty, as a
    shirt like the wall leaves it, from what is next to it on both sides. (0, 0) where there is none.
    The head ends likewise upwards from the chest or, where nothing is there, below it; 0 where there is none.
    """
    n = len(bins)
    bins[:] = 0
    foot_u, foot_v, axis_u, axis_v, half_width = axis
    height, width = evidence.shape
    length2 = axis_u * axis_u + axis_v * axis_v
    length = math.sqrt(length2)
    reach_u, reach_v = 0.5 * half_width + half_width, 1.5 * half_width
    x0 = max(0, math.floor(min(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) - reach_u))
    x1 = min(width, math.ceil(max(foot_u - 0.4 * axis_u, foot_u + 1.4 * axis_u) + reach_u) + 1)
    y0 = max(0, math.floor(min(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) - reach_v))
    y1 = min(height, math.ceil(max(foot_v - 0.4 * axis_v, foot_v + 1.4 * axis_v) + reach_v) + 1)
    places = np.empty(max(0, x1 - x0), np.int32)
    for y in range(y0, y1):
        dv = y - foot_v
        left, right = _columns_beside(axis, dv, half_width * length, x0, x1)
        row, models, place = evidence[y, left:right], cover[y, left:right], places[: right - left]
        # Places of all pixels first, since they are found on vector registers and sums by place are not.
        for i in range(np.uintp(len(row))):
            du = (left + np.int32(i)) - foot_u
            near = abs(du * axis_v - dv * axis_u) <= half_width * length
            k = np.int32(np.floor(((du * axis_u + dv * axis_v) / length2 + 0.4) / 1.8 * n))
            place[i] = k if near & (models[i] <= 1) else np.int32(-1)
        for i in range(np.uintp(len(row))):
            if row[i] > 0 and 0 <= place[i] < n:
                bins[place[i]] += row[i]
    minimum = 0.1 * 2.0 * (2.0 * half_width) * (1.8 * length / n)
    middle = int(0.9 / 1.8 * n)
    head = _head_end(bins, minimum, int((CHEST + 0.4) / 1.8 * n)) / n * 1.8 - 0.4
    low, high = middle, middle
    if bins[middle] < minimum and bins[middle - 1] < minimum:
        low, high = _beside_gap(bins, minimum, middle)
    if high == n:
        return 0.0, 0.0, head
    while low > 0 and (bins[low - 1] >= minimum or (low > 1 and bins[low - 2] >= minimum)):
        low -= 1
    while high < n - 1 and (bins[high + 1] >= minimum or (high < n - 2 and bins[high + 2] >= minimum)):
        high += 1
    while low < high and bins[low] < minimum:
        low += 1
    while high > low and bins[high] < minimum:
        high -= 1
    return low / n * 1.8 - 0.4, (high + 1) / n * 1.8 - 0.4, head


@njit(cache=True, nogil=True)
def _beside_gap(bins: I64, minimum: float, middle: int) -> tuple[int, int]:
    """The nearest bins below and above an empty middle between foot and head; the number of bins for none on a side."""
    n = len(bins)
    low, high, foot, head = middle, middle, int(0.4 / 1.8 * n), int(1.4 / 1.8 * n)
    while low >= foot and bins[low] < minimum:
        low -= 1
    while high < head and bins[high] < minimum:
        high += 1
    return (low, high) if low >= foot and high < head else (n, n)


@njit(cache=True, nogil=True)
def _columns_beside(axis: Axis, dv: float, reach: float, x0: int, x1: int) -> tuple[int, int]:
    """Columns from x0 to x1 that may be near the axis in a row dv below the foot, with one more on both sides.

    reach: of the product of the axis and the way from the foot [px^2].
    """
    if abs(axis.along_v) < 1.0:
        return x0, x1
    middle, half = axis.foot_u + dv * axis.along_u / axis.along_v, reach / abs(axis.along_v)
    left = min(max(math.floor(middle - half) - 1, x0), x1)
    return left, max(left, min(math.ceil(middle + half) + 2, x1))


@njit(cache=True, nogil=True)
def _head_end(bins: I64, minimum: float, chest: int) -> int:
    """The bin after the last one of a head: up from the chest, or down where that is empty; foot level for none."""
    foot = int(0.4 / 1.8 * len(bins))
    end = chest
    if bins[end] < minimum and bins[end - 1] < minimum:
        while end > foot and bins[end] < minimum:
            end -= 1
        return end + 1 if end > foot else foot
    while end < len(bins) - 1 and (bins[end + 1] >= minimum or (end < len(bins) - 2 and bins[end + 2] >= minimum)):
        end += 1
    while bins[end] < minimum:
        end -= 1
    return end + 1
