"""Compiled kernels of the body-axis measurement; ``tests/reference/axis.py`` defines them in plain numpy."""

import math

from numba import njit

from calib.types import F32, F64, I32


@njit(cache=True, nogil=True)
def height_histograms(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, people: F64, radius_m: float, bin_m: float, label: I32, histogram: F64
):
    """Give each point to the nearest of ``people`` (K, 2) within ``radius_m`` and sum its area per height bin.

    Fills ``label`` (N,), -1 for no person, and ``histogram`` (K, B), where the last bin takes everything higher.
    """
    histogram[:] = 0.0
    bins = histogram.shape[1]
    for i in range(len(xyz)):
        label[i] = -1
        nearest = radius_m * radius_m
        for k in range(len(people)):
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
