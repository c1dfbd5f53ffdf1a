"""The floor through clicked points; those off the plane of the others are refused with their distance."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.floor.find import floor_from_points
from calib.rig import Floor
from calib.types import F64, Bool
from planview.calibration.browser.marks import Point
from planview.calibration.floor import FloorView

OFF_PLANE_M = 0.06
"""A point this far from the plane of the others is not on the floor [m] (our choice: lower than a step)..."""
OFF_PLANE_STDS = 3.0
"""...or so many deviations of its depth, where that is more (our choice)."""
TRIPLES = 400
"""Planes tried at most (our choice: all of 14 points)."""


class FloorFit(NamedTuple):
    """A floor and what every point says of it.

    Attributes:
        floor: through the points that are used.
        distance_m: (n,) signed distance of every point from it, up positive [m].
        used: (n,) whether the point lies on it.
    """

    floor: Floor
    distance_m: F64
    used: Bool


def fit_floor(view: FloorView, pixels: Sequence[Point]) -> FloorFit:
    """The plane that most points lie on; of several with as many, that of the points clicked first.

    Raises:
        InputError: fewer than three points, a point without depth, or no three that span a floor.
    """
    points = view.points_at(np.array(pixels, dtype=np.float64).reshape(-1, 2))
    limit = np.array([max(OFF_PLANE_M, OFF_PLANE_STDS * view.geometry.depth_std_m(float(p[2]))) for p in points])
    return fit_plane(points, limit)


def fit_plane(points: F64, limit_m: F64) -> FloorFit:
    """As ``fit_floor``, of (n, 3) points [m] in the left camera's frame with (n,) distances that are allowed [m]."""
    best: FloorFit | None = None
    problem = InputError(f"expected three or more floor points, found {len(points)}")
    for triple in islice(combinations(range(len(points)), 3), TRIPLES):
        try:
            fit = _through(points, points[list(triple)], limit_m)
        except InputError as error:
            problem = error
            continue
        if best is None or fit.used.sum() > best.used.sum():
            best = fit
    if best is None:
        raise problem
    return _through(points, points[best.used], limit_m)


def _through(points: F64, chosen: F64, limit_m: F64) -> FloorFit:
    floor = floor_from_points(chosen, "floor points")
    distance = (floor.world_SE3_left @ points)[:, 2]
    return FloorFit(floor, distance, np.abs(distance) <= limit_m)
