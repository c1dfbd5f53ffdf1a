"""Ellipses on the plan-view occupancy map: sizes are known, and depth tells people from parts of people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import cv2
import numpy as np

from calib.types import F32, F64, I64, U8, Bool
from planview.maps.builder import PlanViewMaps
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.outputs import BodyMeasures, floor_state
from planview.tracking.ellipse_particle.params import FloorPlaneParams
from planview.tracking.ellipse_particle.planes import Estimates, PlaneView
from planview.tracking.newcomers import inseparable, is_part_of, top_height_m
from planview.trajectories.state import TrackState

REACH_M = 0.5
"""How far from an ellipse's centre its body's points are taken for the axis and the height [m]. Our choice: half a
shoulder breadth, a bent arm, and the offset between the visible side and the axis."""
HEAD_M = 0.13
"""How far from an ellipse's centre the highest point may lie [m]: a head's breadth less than half."""
BODY_M = 0.2
"""Half the side of the square in which the visible surface is summed [m]: half of W_avg (Harville 2002, section 4)."""
ANYWHERE = PlaneModel(
    angle_spread=math.radians(45.0),
    angle_limit=math.radians(90.0),
    angle_walk=math.radians(30.0),
    separation=0.0,
    proposal=1.0,
    outside_weight=0.0,
)
"""From above a body may point anywhere. A person who is hidden leaves no occupancy, and must not be pulled to those in
front: equation (8) as it is, without a weight outside. Our choice."""
CELLS_PER_HALF = 4
"""Half a body's length on the floor spans at least so many cells; maps finer than that are averaged."""


class FloorPlane:
    """Foreground of the floor: occupancy against the density of a person's visible surface over its ellipse."""

    name: Literal["image", "floor"] = "floor"
    foreground_columns: int | None = None
    notes: tuple[str, ...] = ()

    def __init__(self, params: FloorPlaneParams) -> None:
        self._params = params
        body = math.pi * params.half_length_m**2 * params.aspect
        self._full_density = 0.5 * params.person_area_m2 / body
        self.model = ANYWHERE._replace(separation=params.separation_m / params.half_length_m)
        self.reset()

    def reset(self) -> None:
        self._bodies = BodyMeasures(REACH_M)

    def study(self, observations: Iterable[Observation]) -> None:
        """Sizes on the floor are known."""

    def __call__(self, observation: Observation) -> PlaneView | None:
        """The frame's cells; None when the observation has no maps."""
        maps = observation.maps
        if maps is None:
            return None
        grid = maps.grid
        step = max(1, int(self._params.half_length_m / (CELLS_PER_HALF * grid.cell_m)))
        rows, cols = max(1, grid.n_rows // step), max(1, grid.n_cols // step)
        density = cv2.resize(maps.occupancy[: rows * step, : cols * step], (cols, rows), interpolation=cv2.INTER_AREA)
        mask = np.clip(density / np.float32(self._full_density * grid.cell_m**2), 0, 1).astype(np.float32)
        middle = (step - 1) / 2
        return PlaneView(mask, step * grid.cell_m, grid.centre_of(middle, middle), observation)

    def view(self, observation: Observation) -> PlaneView | None:
        return self(observation)

    def prior(self, view: PlaneView) -> SizePrior | None:
        """The constant metric size in cells of a view."""
        return SizePrior(self._params.half_length_m / view.scale, 0.0, self._params.aspect)

    def cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        return np.full(len(rows), 1.0 / view.scale)

    def turns(self, measured: Bool, confirmed: Bool) -> list[I64]:
        """Confirmed people first: a newcomer may be a part of one of them, and must not move them."""
        return [np.flatnonzero(measured & confirmed), np.flatnonzero(measured & ~confirmed)]

    def separation(self, view: PlaneView) -> float:
        return self._params.separation_m / view.scale

    def long_enough(self, view: PlaneView, ellipses: F64, order: I64, confirmed: Bool, prior: SizePrior) -> Bool:
        return np.ones(len(ellipses), dtype=np.bool_)

    def is_person(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """As high as a person, and no part of a known person."""
        p, maps = self._params, _maps(view)
        here = _place(view, cell)
        if top_height_m(maps, here, HEAD_M) < p.height_min_m:
            return False
        others = [_place(view, other) for other in known]
        return not any(is_part_of(maps, here, other, p.piece_area, p.arm_m, BODY_M) for other in others)

    def is_separate(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Whether depth noise cannot have split the place off a known person's body."""
        viewpoint, here = _maps(view).view, _place(view, cell)
        return not any(inseparable(viewpoint, here, _place(view, k), self._params.separation_m) for k in known)

    def may_be_part(self, view: PlaneView, cell: F64, known: F64) -> bool:
        return False

    def protect(self, outlines: Sequence[F32]) -> None:
        """The maps' background is not the tracker's to keep."""

    def feedback(self) -> U8 | None:
        return None

    def states(self, view: PlaneView, estimates: Estimates) -> list[TrackState]:
        """Floor positions of the bodies' axes and heights."""
        places = view.to_plane(estimates.ellipses[:, :2])
        self._bodies.update(estimates.evidence, places, _maps(view), view.observation.timestamp_s)
        rows = zip(estimates.evidence, places, estimates.velocities, strict=True)
        return [floor_state(e.who, self._bodies.of(e.who), place, velocity) for e, place, velocity in rows]


def _maps(view: PlaneView) -> PlanViewMaps:
    assert view.observation.maps is not None
    return view.observation.maps


def _place(view: PlaneView, cell: F64) -> tuple[float, float]:
    x, y = view.to_plane(cell)
    return float(x), float(y)
