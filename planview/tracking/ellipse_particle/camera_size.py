"""Size of people in the image of a calibrated camera."""

from __future__ import annotations

import math

import numpy as np

from calib.ground_camera import GroundCamera
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.size_lines import STEEPEST, over_centres

PERSON_M = 1.7
"""Body height of an adult [m]."""
BREADTH_M = 0.55
"""Breadth of a person in an image, arms and stride included [m]: it differs little with the camera's tilt, so the
aspect tells how much of a body the length shows. Our choice: shoulders are 0.5 m, a stride 0.7 m."""
TILT_MIN = math.radians(35.0)
"""A steeper camera sees people from above, where height says little of their length: there it is learned."""
STEPS = 50
"""Rows below and in the image at which feet are tried. Our choice."""


def size_of_camera(camera: GroundCamera, scale: float, aspect: float) -> SizePrior | None:
    """Length of a standing adult in the middle column against the row of the centre: the line nearest to it.

    None for a steep camera, and for one so low (below 1.3 m where it looks nearly level) that people of all distances
    have their centres in nearly the same row.

    Args:
        scale: pixels per cell.
        aspect: width over length.
    """
    if camera.tilt_rad < TILT_MIN:
        return None
    feet = np.linspace(0.0, 2.0 * camera.height, STEPS)
    floor = camera.back_project(np.column_stack([np.full(STEPS, (camera.width - 1) / 2), feet]))
    heads = camera.project(np.column_stack([floor, np.full(STEPS, PERSON_M)]))[:, 1]
    middle, length = (feet + heads) / 2, feet - heads
    there = np.isfinite(length) & (middle >= 0) & (middle < camera.height) & (length > 1)
    if np.count_nonzero(there) < 2:
        return None
    rows = (middle[there] - (scale - 1) / 2) / scale
    slope, level = np.polyfit(rows, length[there] / 2 / scale, 1)
    if 2 * slope >= over_centres(0.0, STEEPEST)[1]:
        return None
    return SizePrior(float(level), max(0.0, float(slope)), aspect, max(1.0, float(length[there].min()) / 2 / scale))
