"""Lines of a person's length over the rows of an image, and how well they account for the lengths of regions."""

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
GROUPED = 2.5
"""Longest group, in lengths of the person in front: with perspective the others add less than where all are of one
size."""
SMALLER = 0.4
"""Of sizes that explain the regions alike the smaller is believed: the density of length falls with its power. Our
choice: between that of lengths (1) and that of their logarithms (0)."""
CLUTTER = 0.004
"""Density of the logarithm of length for everything else; bounds what one region can say against a line."""
STEEPEST = 1.5
"""Length gained per row, more than a camera 2 m above the floor sees: k / (1 - k/2), k = 1.7 m / 2 m."""


def lines(row: F64, length: F64, n_rows: int) -> tuple[F64, F64]:
    """(level at row 0, slope) of the lines to be tried, (L,) each: horizontal ones, and rising ones through pairs."""
    chosen = np.argsort(row, kind="stable")[np.linspace(0, len(row) - 1, min(len(row), PAIRED)).astype(np.int64)]
    i, j = (chosen[k] for k in np.triu_indices(len(chosen), 1))
    apart = np.abs(row[i] - row[j]) > 0.1 * n_rows
    i, j = i[apart], j[apart]
    slope = (length[i] - length[j]) / (row[i] - row[j])
    rising = (slope > 0) & (slope < STEEPEST)
    i, slope = i[rising], slope[rising]
    levels = np.concatenate([length[chosen], length[i] - slope * row[i]])
    return levels, np.concatenate([np.zeros(len(chosen)), slope])


def line(x: F64, y: F64, weight: F64, tilted: bool) -> tuple[float, float]:
    """(level at x = 0, slope >= 0) of a weighted least-squares line; slope 0 unless tilted."""
    mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = np.average((x - mean_x) ** 2, weights=weight)
    slope = 0.0
    if tilted and spread > 1e-9:
        slope = max(0.0, float(np.average((x - mean_x) * (y - mean_y), weights=weight) / spread))
    return float(mean_y - slope * mean_x), slope


def deviation(fitted: F64) -> F64:
    """Standard deviation of the logarithm of one person's length."""
    return np.asarray(np.hypot(SPREAD, ROUNDING / fitted))


def front_lengths(row: F64, length: F64, level: F64, slope: F64) -> F64:
    """Length expected of a person whose feet are where each region ends: the front of a group in depth.

    With foot = centre + length / 2 the line of centres, length = level + slope * centre, is one of feet.

    Args:
        row, length: (N,) of the regions.
        level, slope: of lines, (..., 1).
    """
    return np.asarray(np.maximum((level + slope * (row + length / 2)) / (1 + slope / 2), 1.0))


def log_density(length: F64, fitted: F64, front: F64, cut: Bool) -> F64:
    """Logarithm of the density of the logarithms of (N,) lengths.

    Args:
        fitted: (..., N) expected of one person centred where the region is.
        front: (..., N) expected of one person who ends where the region does.
    """
    ratio, lined_up = length / fitted, length / front
    sigma = deviation(fitted)
    one = np.exp(-0.5 * (np.log(ratio) / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)
    group = ((lined_up > 1) & (lined_up < GROUPED)) / math.log(GROUPED)
    # A piece, or the part inside the border, may have any length up to all of it: evenly spread in length.
    part = np.where(ratio < 1, ratio, 0.0)
    whole = ONE * one + GROUP * group + PIECE * part
    # The border may just graze a person: the density ends softly.
    grazed = (1 - GROUP) * np.where(ratio < 1, ratio, np.exp(-0.5 * (np.log(ratio) / sigma) ** 2)) + GROUP * group
    return np.asarray(np.log(np.where(cut, grazed, whole) + CLUTTER) - SMALLER * np.log(fitted))
