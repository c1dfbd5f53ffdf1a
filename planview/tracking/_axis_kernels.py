"""Compiled kernels of the body-axis measurement; ``tests/reference/axis.py`` defines them in plain numpy."""

import math

import numpy as np
from numba import njit

from calib.types import F32, F64, I32
from planview.tracking._near_kernels import cell_of, near_people


@njit(cache=True, nogil=True)
def height_histograms(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, people: F64, radius_m: float, bin_m: float, label: I32, histogram: F64
):
    """Give each point to the nearest of ``people`` (K, 2) within ``radius_m`` and sum its area per height bin.

    Fills ``label`` (N,), -1 for no person, and ``histogram`` (K, B), where the last bin takes everything higher.
    """
    histogram[:] = 0.0
    bins = histogram.shape[1]
    near = near_people(people, radius_m)
    for i in range(len(xyz)):
        label[i] = -1
        nearest = radius_m * radius_m
        cell = cell_of(near, float(xyz[i, 0]), float(xyz[i, 1]))
        if cell < 0:
            continue
        for k in near.people[near.starts[cell] : near.starts[cell + 1]]:
            dx = float(xyz[i, 0]) - people[k, 0]
            dy = float(xyz[i, 1]) - people[k, 1]
            squared = dx * dx + dy * dy
            if squared <= nearest:
                nearest = squared
                label[i] = k
        if label[i] >= 0 and xyz[i, 2] >= 0.0:
            b = min(math.floor(float(xyz[i, 2]) / bin_m), bins - 1)
            histogram[label[i], b] += area[i]


@njit(cache=True, nogil=True)
def slab_centroids(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, label: I32, low_m: F64, high_m: F64, centres: F64, radius_m: float, sums: F64
):
    """Area-weighted sums of each person's points with low <= z <= high within ``radius_m`` of ``centres`` (K, 2).

    Fills ``sums`` (K, 3): x times area, y times area, area.
    """
    sums[:] = 0.0
    for i in range(len(xyz)):
        k = label[i]
        if k < 0 or xyz[i, 2] < low_m[k] or xyz[i, 2] > high_m[k]:
            continue
        dx = float(xyz[i, 0]) - centres[k, 0]
        dy = float(xyz[i, 1]) - centres[k, 1]
        if dx * dx + dy * dy > radius_m * radius_m:
            continue
        sums[k, 0] += xyz[i, 0] * area[i]
        sums[k, 1] += xyz[i, 1] * area[i]
        sums[k, 2] += area[i]


@njit(cache=True, nogil=True)
def tops(histogram: F64, cap_area: F64, bin_m: float, cap_m: float, top: F64):  # type: ignore[no-untyped-def]
    """Height (K,) above which just as much area is visible as a head's cap shows, plus that cap; NaN without points.

    ``histogram`` (K, B): visible area per height bin. ``cap_area`` (K,): of the caps.
    """
    people, bins = histogram.shape
    for k in range(people):
        total = 0.0
        for b in range(bins):
            total += histogram[k, bins - 1 - b]
        top[k] = math.nan
        if total <= 0.0:
            continue
        wanted, above, first = min(cap_area[k], total), 0.0, 0
        before = 0.0
        for b in range(bins):
            before, above, first = above, above + histogram[k, bins - 1 - b], b
            if above >= wanted:
                break
        share = (wanted - before) / max(above - before, 1e-12)
        top[k] = (bins - first - share) * bin_m + cap_m


@njit(cache=True, nogil=True, error_model="numpy")
def centroids(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, label: I32, low_m: F64, high_m: F64, centres: F64, radius_m: float, means: F64
):
    """As ``slab_centroids``, with the sums of x and y divided by that of area: NaN where there are no points."""
    slab_centroids(xyz, area, label, low_m, high_m, centres, radius_m, means)
    for k in range(len(means)):
        means[k, 0] /= means[k, 2]
        means[k, 1] /= means[k, 2]


@njit(cache=True, nogil=True)
def body_and_head(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, label: I32, people: F64, radius_m: float,
    chin_m: F64, head_radius_m: float, bodies: F64, heads: F64,
):  # fmt: skip
    """Centroids x, y and area (K, 3) of what is visible of bodies and of heads, which are above ``chin_m`` (K,).

    Twice: the second time around the body, or the head itself, so that a raised arm does not pull it.
    """
    low, high = np.full(len(people), -np.inf), np.full(len(people), np.inf)
    around = people.copy()
    centroids(xyz, area, label, low, high, around, radius_m, bodies)
    around[:, :] = bodies[:, :2]
    centroids(xyz, area, label, low, high, around, radius_m, bodies)
    around[:, :] = bodies[:, :2]
    centroids(xyz, area, label, chin_m, high, around, radius_m, heads)
    around[:, :] = heads[:, :2]
    centroids(xyz, area, label, chin_m, high, around, 2 * head_radius_m, heads)
