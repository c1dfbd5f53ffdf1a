"""Lines on the floor as a camera shows them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64

Project = Callable[[ArrayLike], F64]
"""(N, 3) world points [m] to (N, 2) pixels, NaN where unseen."""
SAMPLE_M = 0.2
SAMPLES_MAX = 2000


class GridLine(NamedTuple):
    """A part of a line of the grid that is near the image: ``coordinate`` [m] and (k, 2) pixels."""

    coordinate: float
    pixels: F64


def grid_lines(
    project: Project, extent_m: tuple[float, float, float, float], size: tuple[int, int], step_m: float = 1.0
) -> list[GridLine]:
    """Lines of a floor grid as seen.

    Args:
        extent_m: (x_min, y_min, x_max, y_max) of the floor to cover.
        size: (width, height) of the image [px].
        step_m: between lines.
    """
    x_min, y_min = math.floor(extent_m[0]), math.floor(extent_m[1])
    x_max, y_max = math.ceil(extent_m[2]), math.ceil(extent_m[3])
    lines = []
    for x in np.arange(x_min, x_max + 1e-9, step_m).tolist():
        ends = np.array([(x, y_min), (x, y_max)], dtype=np.float64)
        lines += [GridLine(x, part) for part in visible_parts(project, ends, size)]
    for y in np.arange(y_min, y_max + 1e-9, step_m).tolist():
        ends = np.array([(x_min, y), (x_max, y)], dtype=np.float64)
        lines += [GridLine(y, part) for part in visible_parts(project, ends, size)]
    return lines


def visible_parts(project: Project, places_m: F64, size: tuple[int, int]) -> list[F64]:
    """A line on the floor in pixels, in parts of at least two points near the image.

    Args:
        places_m: (N, 2) corners of the line [m]; those that are not known are passed over.
        size: (width, height) of the image [px].
    """
    known = places_m[np.isfinite(places_m).all(axis=1)]
    if len(known) < 2:
        return []
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(known, axis=0).T))])
    if along[-1] <= 0:
        return []
    samples = min(SAMPLES_MAX, math.ceil(along[-1] / SAMPLE_M) + 1)
    at = np.union1d(along, np.linspace(0.0, along[-1], samples))
    xyz = np.column_stack([np.interp(at, along, known[:, 0]), np.interp(at, along, known[:, 1]), np.zeros(len(at))])
    pixels, limits = project(xyz), np.array(size)
    with np.errstate(invalid="ignore"):
        near = np.asarray(((pixels > -0.5 * limits) & (pixels < 1.5 * limits)).all(axis=1))  # not NaN either
    cuts = np.flatnonzero(np.diff(near.astype(np.int8))) + 1
    parts = zip(np.split(pixels, cuts), np.split(near, cuts), strict=True)
    return [part for part, visible in parts if len(part) > 1 and visible[0]]
