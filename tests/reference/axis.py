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
