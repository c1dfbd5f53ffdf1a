"""What is expected of an ellipse before anything is measured: its size per row, and what its plane allows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.types import F64


class SizeLaw(NamedTuple):
    """A size prior as kernels take it.

    Attributes:
        half_0: half length of an object centred in row 0 [cells].
        slope: its growth per row [cells/cell].
        half_min: smallest half length [cells].
        aspect: width / length.
    """

    half_0: float
    slope: float
    half_min: float
    aspect: float


@dataclass(frozen=True)
class SizePrior:
    """Size expected of an object, linear in the row of its centre, in cells of the grid it is fitted on.

    A linear law of the centre row is a linear law of the foot row too (foot = centre + half the length); it holds for
    objects on a plane seen by a camera without roll, so no calibration is asked for.

    Attributes:
        half_length_0: half length of an object centred in row 0 [cells].
        half_length_slope: its growth per row [cells/cell].
        aspect: width / length.
        half_length_min: half length below which nothing is expected, however far away [cells]; a line must not run on
            to objects of no size at the horizon.
        any_direction: length axes point anywhere, as those of people seen from straight above; else they are upright.
    Raises:
        ValueError: aspect not positive.
    """

    half_length_0: float
    half_length_slope: float
    aspect: float
    half_length_min: float = 1.0
    any_direction: bool = False

    def __post_init__(self) -> None:
        values = tuple(self.law)
        if not all(math.isfinite(v) for v in values) or min(self.aspect, self.half_length_min) <= 0:
            raise ValueError(f"expected finite sizes and a positive aspect and minimum, got {values}")

    @property
    def law(self) -> SizeLaw:
        return SizeLaw(
            float(self.half_length_0), float(self.half_length_slope), float(self.half_length_min), float(self.aspect)
        )

    def rounded(self) -> SizePrior:
        """Circles of the same areas, for objects whose direction is not known yet."""
        radius = math.sqrt(self.aspect)
        level, slope, least = self.half_length_0, self.half_length_slope, self.half_length_min
        return SizePrior(radius * level, radius * slope, 1.0, radius * least, self.any_direction)

    def is_near_enough(self, row: float, limit: float) -> bool:
        """Whether objects centred in a row have by the line at least the smallest half length over ``limit``."""
        return limit * (self.half_length_0 + self.half_length_slope * row) >= self.half_length_min

    def half_length(self, row: float) -> float:
        """Half length in cells of an object centred in a row."""
        return max(self.half_length_min, self.half_length_0 + self.half_length_slope * row)

    def half_lengths(self, rows: F64) -> F64:
        """``half_length`` of many rows, (N,) float64."""
        return np.asarray(np.maximum(self.half_length_min, self.half_length_0 + self.half_length_slope * rows))

    def half_lengths_standing(self, rows: F64) -> F64:
        """(N,) float64 half lengths of objects whose feet, half a length below the centre, are in rows (N,)."""
        grown = (self.half_length_0 + self.half_length_slope * rows) / (1.0 + self.half_length_slope)
        return np.asarray(np.maximum(self.half_length_min, grown))


class PlaneModel(NamedTuple):
    """What the plane in which ellipses lie says about them.

    Attributes:
        angle_spread: deviation of the length axis from the +row direction where an ellipse is measured [rad].
        angle_limit: largest angle of a measured ellipse [rad].
        angle_walk: stationary deviation of the length axis of a tracked object [rad].
        separation: smallest distance of two centres, in half lengths; 0 where people hide one another.
        proposal: part of ``EllipseFitParams.min_gain`` with which the cover proposes an ellipse.
        outside_weight: weight of object area outside every measurement in the likelihood of the particles.
        looseness: deviation of sizes among people centred in one row, over that among people whose feet are in one row:
            1 + the growth of half lengths per row. Before a low camera people at all distances are centred in nearly
            the same row.
    """

    angle_spread: float
    angle_limit: float
    angle_walk: float
    separation: float
    proposal: float
    outside_weight: float
    looseness: float = 1.0

    @property
    def upright(self) -> bool:
        """Whether length axes are limited to one direction."""
        return self.angle_limit < math.pi / 4
