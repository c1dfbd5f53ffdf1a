"""Who may be new on the floor: depth tells a person from a piece of somebody known, which masks do not."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F32, F64
from planview.maps.builder import PlanViewMaps
from planview.tracking.detection import inseparable
from planview.tracking.ellipse_particle.params import NewcomerParams


class Newcomers:
    """Judges measurements on the floor as the template tracker does (``planview/tracking/template``).

    Args:
        separation_m: least distance between two people [m].
    """

    def __init__(self, params: NewcomerParams, separation_m: float) -> None:
        self._params = params
        self._separation_m = separation_m

    def split_off(self, maps: PlanViewMaps, place: F64, known: F64) -> bool:
        """Whether depth noise may have split a place (2,) [m] off the body of one of the (N, 2) known [m]."""
        here = (float(place[0]), float(place[1]))
        return any(inseparable(maps.view, here, (x, y), self._separation_m) for x, y in known.tolist())

    def whole(self, maps: PlanViewMaps, place: F64, known: F64) -> bool:
        """Whether a person may stand at a place (2,) [m], and not a piece of one of the (N, 2) known [m]."""
        return self._tall(maps, place) and not self._piece(maps, place, known)

    def _tall(self, maps: PlanViewMaps, place: F64) -> bool:
        """Whether something as high as a person is within half a head's breadth of a place (2,) [m]."""
        near = self._window(maps.height, maps, place, self._params.head_m)
        return bool(near.size) and float(near.max()) >= self._params.height_min_m

    def _piece(self, maps: PlanViewMaps, place: F64, known: F64) -> bool:
        """Within reach of somebody known and much smaller: what he carries, a limb, or what hides him."""
        here, seen = (float(place[0]), float(place[1])), self._surface(maps, place)
        return any(
            seen < self._params.piece_area * self._surface(maps, np.array([x, y]))
            and inseparable(maps.view, here, (x, y), self._params.arm_m)
            for x, y in known.tolist()
        )

    def _surface(self, maps: PlanViewMaps, place: F64) -> float:
        """Visible surface of what stands at a place (2,) [m], in m^2."""
        return float(self._window(maps.occupancy, maps, place, self._params.body_m).sum())

    def _window(self, values: F32, maps: PlanViewMaps, place: F64, half_m: float) -> F32:
        row, col = maps.grid.index_of(float(place[0]), float(place[1]))
        reach = half_m / maps.grid.cell_m
        r0, c0 = max(0, math.floor(row - reach)), max(0, math.floor(col - reach))
        return values[r0 : max(0, math.ceil(row + reach)) + 1, c0 : max(0, math.ceil(col + reach)) + 1]
