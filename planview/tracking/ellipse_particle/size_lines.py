"""Lines of a person's length over the rows of the feet, and how well they account for the lengths of regions.

Feet stand on the floor, so lengths are a line over their rows whatever the camera; centres are too, but before a low
camera those of people at all distances lie in nearly the same row.
"""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64, Bool

PAIRED = 40
"""Samples, evenly spread over the rows, between which lines are tried."""
SPREAD = 0.16
"""Deviation of the logarithm of a person's length from the law. Our choice: silhouettes of people drawn walking differ
by 0.09 (stature, a step, a way off the law), and what is lost of feet and heads by as much again and half."""
ROUNDING = 0.5
"""The same in cells: both ends are rounded. Our choice."""
ONE, GROUP, PIECE = 0.6, 0.25, 0.15
"""Shares of whole regions that are one person, several behind one another (up to ``GROUPED`` times as long as one), and
pieces of one. Our choice."""
LASTING_S = 1.0
"""A region that has been whole for so long is no piece of somebody: pieces come and go, and a person alone would be one
of the group that walks in front. Their share falls with the time beyond it. Our choice: two steps. Sizes learned on 168
drawn views are off by more than 0.3 in the logarithm for 10.1 % of the people in place of 11.1 %, in corridors 9.6 in
place of 15.9 %."""
GROUPED = 2.5
"""Longest group, in lengths of the person in front: with perspective the others add less than where all are of one
size."""
BREADTH_SPREAD, BREADTHS = 0.4, 8.0
"""Deviation of the logarithm of one person's width over the length, arms and stride included, and the ratio between the
widths that anything else may have. People at all distances are as broad as they are long, but one whose legs are lost
is not, though head and feet then lie on the same line as those of a farther person. Our choice."""
SMALLER = 0.4
"""Of sizes that explain the regions alike the smaller is believed: the density of length falls with its power. Our
choice: between that of lengths (1) and that of their logarithms (0)."""
CLUTTER = 0.004
"""Density of the logarithm of length for everything else; bounds what one region can say against a line."""
STEEPEST = 1.5
"""Length gained per row of the feet: a person's height over the camera's, 1.7 m over 1.13 m. Our choice: before a lower
camera feet are seldom seen."""


def lines(foot: F64, length: F64, cut: Bool, n_rows: int) -> tuple[F64, F64]:
    """(level at row 0, slope) of the lines to be tried, (L,) each: horizontal ones, and rising ones through pairs.

    Whom the border cuts (``cut``) has the feet elsewhere, or is longer: through these are horizontal lines only.
    """
    chosen = np.argsort(foot, kind="stable")[np.linspace(0, len(foot) - 1, min(len(foot), PAIRED)).astype(np.int64)]
    i, j = (chosen[k] for k in np.triu_indices(len(chosen), 1))
    apart = (np.abs(foot[i] - foot[j]) > 0.1 * n_rows) & ~cut[i] & ~cut[j]
    i, j = i[apart], j[apart]
    slope = (length[i] - length[j]) / (foot[i] - foot[j])
    rising = (slope > 0) & (slope < STEEPEST)
    i, slope = i[rising], slope[rising]
    levels = np.concatenate([length[chosen], length[i] - slope * foot[i]])
    return levels, np.concatenate([np.zeros(len(chosen)), slope])


def over_centres(level: float, slope: float) -> tuple[float, float]:
    """A line over the rows of the feet as one over those of the centres: foot = centre + length / 2."""
    return level / (1 - slope / 2), slope / (1 - slope / 2)


def line(x: F64, y: F64, weight: F64, tilted: bool) -> tuple[float, float]:
    """(level at x = 0, slope from 0 to ``STEEPEST``) of a weighted least-squares line; slope 0 unless tilted."""
    mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = np.average((x - mean_x) ** 2, weights=weight)
    slope = 0.0
    if tilted and spread > 1e-9:
        slope = float(np.clip(np.average((x - mean_x) * (y - mean_y), weights=weight) / spread, 0.0, STEEPEST))
    return float(mean_y - slope * mean_x), slope


def deviation(fitted: F64) -> F64:
    """Standard deviation of the logarithm of one person's length."""
    return np.asarray(np.hypot(SPREAD, ROUNDING / fitted))


def log_density(length: F64, width: F64, fitted: F64, cut: Bool, lasted_s: F64) -> F64:
    """Logarithm of the density of the logarithms of (N,) lengths, and of the widths of single people over them.

    Args:
        length, width: (N,) of the regions.
        cut: (N,) whether the border cuts them: then any part of a person may show, and the width says nothing.
        fitted: (..., N) expected of one person whose feet are where the region ends.
        lasted_s: (N,) for how long the region has been whole [s].
    """
    ratio = length / fitted
    sigma = deviation(fitted)
    one = np.exp(-0.5 * (np.log(ratio) / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)
    breadth = np.log(width / fitted)
    broader = (breadth - np.median(breadth, axis=-1, keepdims=True)) / BREADTH_SPREAD
    one *= np.exp(-0.5 * broader**2) / (math.sqrt(2 * math.pi) * BREADTH_SPREAD) * math.log(BREADTHS)
    # The front one of a group in depth stands where the group ends.
    group = ((ratio > 1) & (ratio < GROUPED)) / math.log(GROUPED)
    # A piece, or the part inside the border, may have any length up to all of it: evenly spread in length.
    part = np.where(ratio < 1, ratio, 0.0)
    whole = ONE * one + GROUP * group + PIECE * part * LASTING_S / np.maximum(lasted_s, LASTING_S)
    # The border may just graze a person: the density ends softly.
    grazed = (1 - GROUP) * np.where(ratio < 1, ratio, np.exp(-0.5 * (np.log(ratio) / sigma) ** 2)) + GROUP * group
    return np.asarray(np.log(np.where(cut, grazed, whole) + CLUTTER) - SMALLER * np.log(fitted))
