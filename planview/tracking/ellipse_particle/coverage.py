"""How much of each object measurements cover, which measurements objects cover, and where objects may be again."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.types import F64, Bool
from planview.tracking.ellipse_particle.fit import _area as kernels
from planview.tracking.ellipse_particle.fit.ellipses import paint_union
from planview.tracking.ellipse_particle.particles import union_prefix

INSIDE_MIN = 0.25
"""An object of which less is inside the grid is not tracked any longer. Our choice."""
OUTLINE_M = 0.4
"""Two outlines of one object may be this far apart [m]: half a shoulder breadth for each."""
REACH_SIGMAS = 2.5
"""How far from its prediction an object may be reacquired, in deviations of its particles beyond that. Our choice."""


def measured_shares(measured: F64, objects: F64, shape: tuple[int, int]) -> F64:
    """(N, 2) share of each object's ellipse that is measured, and that is measured and in no older object.

    Of an object that is cut by the border only the part inside counts, or ``INSIDE_MIN`` where less is inside.

    Args:
        measured, objects: (M, 5), (N, 5) ellipses; objects in the order of their ids.
        shape: (R, C) of the grid.
    """
    out = np.zeros((len(objects), 4))
    kernels.claim(union_prefix(measured, shape), objects, np.arange(len(objects)), out)
    area = np.maximum(out[:, kernels.AREA], np.maximum(INSIDE_MIN * np.pi * objects[:, 2] * objects[:, 3], 1.0))
    return out[:, [kernels.VALUE, kernels.OWN_VALUE]] / area[:, None]


def uncovered(measured: F64, objects: F64, shape: tuple[int, int], share: float) -> Bool:
    """(M,) measurements that have no object: objects cover less than a share of them, or leave as much beside them.

    One object that lies across two measurements covers enough of both, wherever it is. So each object is given the
    measurement that it covers most, and one that is left over has none when objects leave as much free of it and of
    those that they cover with it as they leave of an uncovered one. Our choice; the paper has no association.
    """
    covered, areas = _covered(objects, measured, shape)
    out = np.asarray(covered < share * areas)
    if len(measured) <= len(objects) or not len(objects):
        return out
    covers = np.array([_covered(one[None], measured, shape)[0] for one in objects])
    left = ~out
    left[linear_sum_assignment(covers, maximize=True)[1]] = False
    free = paint_union(objects, shape) == 0
    for m in np.flatnonzero(left):
        near = (covers[covers[:, m] > 0] > 0).any(axis=0)
        beside = np.count_nonzero(free & (paint_union(measured[near], shape) > 0))
        if beside >= (1 - share) * areas[m]:
            out[m] = True
            free &= paint_union(measured[m : m + 1], shape) == 0
    return out


def _covered(objects: F64, measured: F64, shape: tuple[int, int]) -> tuple[F64, F64]:
    """(M,) cells of each measurement that objects cover, and (M,) all its cells inside the grid, at least one."""
    out = np.zeros((len(measured), 4))
    kernels.claim(union_prefix(objects, shape), measured, np.arange(len(measured)), out)
    return out[:, kernels.VALUE], np.maximum(out[:, kernels.AREA], 1.0)


def reachable(
    measured: F64, positions: F64, deviations: F64, cells_per_m: F64, reach_m: float
) -> list[tuple[float, int, int]]:
    """(distance [m], object, measurement) of the measurements at which objects may be again, nearest first.

    The farther an object's particles have spread the farther it may be: ``OUTLINE_M`` and ``REACH_SIGMAS`` deviations,
    at most ``reach_m``.

    Args:
        measured: (M, 5) ellipses.
        positions, deviations: (N, 2) predicted centres and their spread [cells].
        cells_per_m: (M,) cells per metre at each measurement.
    """
    away = np.hypot(*(measured[None, :, :2] - positions[:, None]).transpose(2, 0, 1)) / cells_per_m
    spread = np.hypot(*deviations.T)[:, None] / cells_per_m
    near = away <= np.minimum(reach_m, OUTLINE_M + REACH_SIGMAS * spread)
    return sorted((float(away[n, m]), int(n), int(m)) for n, m in np.argwhere(near))
