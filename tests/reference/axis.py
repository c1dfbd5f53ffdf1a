"""Plain numpy twins of planview/tracking/_axis_kernels.py; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, F64, I32


def height_histograms(
    xyz: F32, area: F32, people: F64, radius_m: float, bin_m: float, label: I32, histogram: F64
) -> None:
    squared = ((xyz[:, None, :2].astype(np.float64) - people[None]) ** 2).sum(axis=2)
    label[:] = np.where(squared.min(axis=1) <= radius_m**2, squared.argmin(axis=1), -1)
    histogram[:] = 0.0
    bins = np.minimum(np.floor(xyz[:, 2].astype(np.float64) / bin_m), histogram.shape[1] - 1).astype(np.int64)
    keep = (label >= 0) & (xyz[:, 2] >= 0)
    np.add.at(histogram, (label[keep], bins[keep]), area[keep])


def slab_centroids(
    xyz: F32, area: F32, label: I32, low_m: F64, high_m: F64, centres: F64, radius_m: float, sums: F64
) -> None:
    sums[:] = 0.0
    for k in range(len(sums)):
        near = ((xyz[:, :2].astype(np.float64) - centres[k]) ** 2).sum(axis=1) <= radius_m**2
        keep = (label == k) & (xyz[:, 2] >= low_m[k]) & (xyz[:, 2] <= high_m[k]) & near
        weight = area[keep].astype(np.float64)
        sums[k] = (*(weight @ xyz[keep, :2]), weight.sum())


def tops(histogram: F64, cap_area: F64, bin_m: float, cap_m: float, top: F64) -> None:
    above = np.cumsum(histogram[:, ::-1], axis=1)
    total = above[:, -1]
    wanted = np.minimum(cap_area, total)
    first = np.argmax(above >= wanted[:, None], axis=1)
    rows = np.arange(len(histogram))
    before = np.where(first > 0, above[rows, first - 1], 0.0)
    share = (wanted - before) / np.maximum(above[rows, first] - before, 1e-12)
    level = (histogram.shape[1] - first - share) * bin_m
    top[:] = np.where(total > 0.0, level + cap_m, np.nan)


def body_and_head(
    xyz: F32, area: F32, label: I32, people: F64, radius_m: float,
    chin_m: F64, head_radius_m: float, bodies: F64, heads: F64,
) -> None:  # fmt: skip
    everywhere = np.full(len(people), np.inf)

    def centroids(low: F64, centres: F64, radius: float) -> F64:
        sums = np.empty((len(people), 3))
        slab_centroids(xyz, area, label, low, everywhere, centres, radius, sums)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.column_stack([sums[:, :2] / sums[:, 2:], sums[:, 2]])

    once = centroids(-everywhere, people, radius_m)
    bodies[:] = centroids(-everywhere, once[:, :2], radius_m)
    once = centroids(chin_m, bodies[:, :2], radius_m)
    heads[:] = centroids(chin_m, once[:, :2], 2 * head_radius_m)
