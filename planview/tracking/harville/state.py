"""A tracked person, and one frame's maps as the template tracker needs them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.types import F32, F64
from planview.maps.builder import PlanViewMaps
from planview.maps.raster import occupied_part
from planview.tracking.base import NO_TERMS, ScoreTerms
from planview.tracking.kalman import FloorKalman
from planview.tracking.lifecycle import Existence


@dataclass(eq=False)
class TemplatePerson:
    """Everything that changes over time about a tracked person.

    Attributes:
        existence: id, state and times of life.
        kalman: of the visible surface on which the templates are centred.
        axis: of the body axis, which is reported.
        template_height, template_occupancy: T_H and T_O, (n, n) float32.
        at_m: where the visible surface was last observed [m].
        spawned_m: where it was first observed [m].
        height_m: smoothed height of the top of the head [m].
        tallest_m: greatest height so far [m].
        offset_m: from the visible surface to the body axis [m].
        head: the head was measured in this frame.
        head_in_view: the top of the head has been inside the image; until then the height is not known.
        alone_s: time when it was last within reach of another person, before it was confirmed [s].
        clear_s: time of the last clear measurement of the appearance [s].
        too_low: now lower than a newcomer may be.
        score, terms, reach_cells, searched_m: of the last search, for debugging.
    """

    existence: Existence
    kalman: FloorKalman
    axis: FloorKalman
    template_height: F32
    template_occupancy: F32
    at_m: tuple[float, float]
    spawned_m: tuple[float, float]
    height_m: float
    tallest_m: float
    offset_m: tuple[float, float] = (0.0, 0.0)
    head: bool = False
    head_in_view: bool = False
    alone_s: float = -math.inf
    clear_s: float = -math.inf
    too_low: bool = False
    score: float = math.nan
    terms: ScoreTerms = NO_TERMS
    reach_cells: int = 0
    searched_m: tuple[float, float] = (math.nan, math.nan)

    @property
    def observed(self) -> bool:
        """Matched in this frame."""
        return self.existence.observed

    @property
    def lost(self) -> bool:
        """Confirmed, and not matched in this frame."""
        return self.existence.lost

    @property
    def confirmed(self) -> bool:
        """No newcomer any more."""
        return self.existence.confirmed

    @property
    def predicted_m(self) -> tuple[float, float]:
        """Where the visible surface is predicted or filtered [m]."""
        return self.kalman.x_m, self.kalman.y_m

    def jump(self, kalman: FloorKalman) -> None:
        """Go on from another place, where the axis is still to be measured."""
        self.kalman = self.axis = kalman
        self.at_m, self.offset_m = (kalman.x_m, kalman.y_m), (0.0, 0.0)


class TemplateFrame:
    """One frame's maps, padded by half a template, and a copy from which placed people are cleared.

    Attributes:
        maps: as observed.
        half: the padding [cells]; a template centred on a cell begins at that cell's index in the padded maps.
        occupied: part of the padded maps outside of which all is zero.
        height, occupancy: padded maps.
        free_height, free_occupancy: what is left of them.
    """

    def __init__(self, maps: PlanViewMaps, half: int) -> None:
        self.maps = maps
        self.half = half
        part = occupied_part(maps.occupancy, 0)
        self.occupied = (
            slice(part[0].start + half, part[0].stop + half),
            slice(part[1].start + half, part[1].stop + half),
        )
        self.height, self.free_height = (self._padded(maps.height[part]) for _ in range(2))
        self.occupancy, self.free_occupancy = (self._padded(maps.occupancy[part]) for _ in range(2))

    def _padded(self, occupied: F32) -> F32:
        """With zeros around it; ``np.pad`` does the same ten times slower."""
        grid = self.maps.grid
        padded = np.zeros((grid.n_rows + 2 * self.half, grid.n_cols + 2 * self.half), dtype=np.float32)
        padded[self.occupied] = occupied
        return padded

    def free(self) -> tuple[F32, F32]:
        """Copies of what is left of height and occupancy in the occupied part."""
        return self.free_height[self.occupied].copy(), self.free_occupancy[self.occupied].copy()

    def restore(self, free: tuple[F32, F32]) -> None:
        """Undo what was cleared since ``free`` was asked."""
        self.free_height[self.occupied], self.free_occupancy[self.occupied] = free

    @property
    def inner(self) -> tuple[slice, slice]:
        """The maps within the padding."""
        grid = self.maps.grid
        return slice(self.half, self.half + grid.n_rows), slice(self.half, self.half + grid.n_cols)

    def padded_cells(self, places_m: Sequence[tuple[float, float]]) -> F64:
        """(K, 2) fractional rows and columns in the padded maps of floor positions [m]."""
        cells = [self.maps.grid.index_of(*place) for place in places_m]
        return np.array(cells, dtype=np.float64).reshape(-1, 2) + self.half
