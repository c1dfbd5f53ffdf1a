"""Plain numpy twin of ``planview.tracking._appearance_kernels``."""

import numpy as np


def colour_histograms(xyz, area, colours, people, radius_m, bounds, n_codes):
    """(K, P, CODES) visible surface by nearest person, part of the body and colour code."""
    histograms = np.zeros((len(people), len(bounds), n_codes), np.float32)
    squared = ((xyz[:, None, :2].astype(np.float64) - people[None, :, :2]) ** 2).sum(axis=2)
    who = squared.argmin(axis=1)
    share = xyz[:, 2] / people[who, 2]
    part = np.searchsorted(bounds, share, side="right") - 1
    used = (squared.min(axis=1) < radius_m**2) & (part >= 0) & (share <= 1.1)
    np.add.at(histograms, (who[used], part[used], colours[used]), area[used])
    return histograms
