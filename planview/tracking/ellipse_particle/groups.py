"""Which objects and measurements must be judged together."""

from __future__ import annotations

import numpy as np

from calib.types import F64, I64, Bool


def overlaps(ellipses: F64, others: F64, margin: F64) -> Bool:
    """(N, M) whether ellipses, grown by (N, 2) margins in x and y, can overlap others.

    Boxes of two thirds of the axes are compared: the corners of a box are not part of its ellipse.
    """
    reach = half_extents(ellipses) * 0.67 + margin
    reach_others = half_extents(others) * 0.67
    gap = np.abs(ellipses[:, None, :2] - others[None, :, :2]) - reach[:, None] - reach_others[None]
    return np.asarray((gap < 0).all(axis=-1))


def half_extents(ellipses: F64) -> F64:
    """(N, 2) half width and half height of the boxes around (N, 5) ellipses."""
    _, _, a, b, angle = ellipses.T
    s, c = np.sin(angle), np.cos(angle)
    return np.column_stack([np.hypot(a * s, b * c), np.hypot(a * c, b * s)])


def group(objects: Bool, measurements: Bool, joint: bool) -> list[tuple[I64, I64]]:
    """Connected groups of objects that can overlap each other or share a measurement.

    Args:
        objects: (N, N) objects that can overlap.
        measurements: (N, M) measurements that each object can overlap.
        joint: everything in one group.
    Returns:
        per group, its objects and its measurements (indices); groups in order of their first object.
    """
    n = len(measurements)
    if n == 0:
        return []
    if joint:
        return [(np.arange(n), np.flatnonzero(measurements.any(axis=0)))]
    linked = objects | objects.T | ((measurements.astype(np.int64) @ measurements.T.astype(np.int64)) > 0)
    left = set(range(n))
    groups = []
    for first in range(n):
        if first not in left:
            continue
        members, frontier = {first}, [first]
        while frontier:
            new = set(np.flatnonzero(linked[frontier].any(axis=0)).tolist()) - members
            members |= new
            frontier = sorted(new)
        left -= members
        index = np.array(sorted(members), dtype=np.int64)
        groups.append((index, np.flatnonzero(measurements[index].any(axis=0))))
    return groups
