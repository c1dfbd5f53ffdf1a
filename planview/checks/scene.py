"""The scene: how much of it has a disparity, its floor, and how well depth can be told."""

from __future__ import annotations

import math

import numpy as np

from calib.rig import Floor
from planview.checks.check import Check, at_least, at_most, between
from planview.checks.evidence import SceneEvidence
from planview.maps.grid import GridParams
from stereo.depth import RectifiedGeometry

MIN_VALID = 0.35
"""Share of pixels with a disparity; bare walls and saturated floors have none, people must (our choice)."""
MIN_FLOOR = 0.10
"""Share of valid depth on the floor (our choice: a hand's breadth of floor between furniture still shows it)."""
MAX_FLATNESS = 0.12
"""Deviation of floor points from the plane [m]: with more, a foot cannot be told from a shadow (our choice)."""
HEIGHT_BETWEEN = (1.2, 10.0)
"""Camera heights above the floor that see people [m]."""
MAX_DEPTH = {2.0: 0.15, 4.0: 0.5, 8.0: math.inf}
"""Predicted depth deviation at a distance [m]: at 4 m half a metre is a person's width (our choice)."""


def scene_checks(evidence: SceneEvidence) -> list[Check]:
    """Share of valid disparity, floor share, flatness and height, depth and cell error at 2, 4 and 8 m."""
    inside = evidence.rectifier.mask > 0
    shares = [float(np.mean(np.isfinite(d[inside]))) for d in evidence.disparities]
    return [
        at_least("valid disparity", float(np.median(shares)), MIN_VALID, "", "share of the picture, median frame"),
        *floor_checks(evidence.floor, evidence.floor_refused),
        *depth_checks(evidence.rectifier.geometry),
    ]


def floor_checks(floor: Floor | None, refused: str = "") -> list[Check]:
    """Share, flatness and distance of the floor.

    Args:
        floor: None when ``refused`` says why none was found.
    """
    share = floor.inlier_fraction if floor else math.nan
    why = "share of valid depth that lies on it" if floor else refused
    return [
        at_least("floor share", share, MIN_FLOOR, "", why, needed=floor is None),
        at_most("floor flatness", floor.residual_m if floor else math.nan, MAX_FLATNESS, "m", "rms from the plane"),
        between(
            "camera height", floor.height_m if floor else math.nan, HEIGHT_BETWEEN, "m", "of the (left) camera above it"
        ),
    ]


def depth_checks(geometry: RectifiedGeometry) -> list[Check]:
    """Predicted deviation of depth, and of a point's place in cells of the plan-view map, at 2, 4 and 8 m."""
    checks = []
    cell_m = GridParams().cell_m
    cells_of = f"cells of {cell_m * 100:g} cm"
    for distance, most in MAX_DEPTH.items():
        deviation = geometry.depth_std_m(distance)
        name, note = f"depth error at {distance:g} m", "predicted standard deviation"
        if math.isfinite(most):
            checks.append(at_most(name, deviation, most, "m", note))
        else:
            checks.append(Check(name, True, deviation, "m", note=note))
        across = distance / geometry.focal_u_px * geometry.disparity_std_px
        cells = math.hypot(deviation, across) / cell_m
        checks.append(Check(f"cell error at {distance:g} m", True, cells, "cells", note=cells_of))
    return checks
