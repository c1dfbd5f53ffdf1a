"""One of the two plan-view statistics alone (Harville 2002, section 5)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from planview.maps.builder import FloorPoints, PlanViewMaps
from planview.maps.grid import Grid
from planview.tracking.base import Decision, Observation, Tracker, TrackerDebug
from planview.trajectories.state import TrackState

Statistic = Literal["both", "height", "occupancy"]
NOMINAL_HEIGHT_M = 1.7
"""Height of everything where height is not measured [m]: an adult, so that no test of height refuses it."""


class OneStatistic:
    """A tracker of plan-view maps that is given one statistic alone."""

    def __init__(self, tracker: Tracker, statistic: Statistic) -> None:
        self._tracker, self._statistic = tracker, statistic

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """See ``Tracker``."""
        return self._tracker.decisions

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """See ``Tracker``."""
        assert observation.maps is not None
        maps = reduced(observation.maps, self._statistic)
        return self._tracker.update(replace(observation, build_maps=lambda: maps))

    def debug(self) -> TrackerDebug:
        """See ``Tracker``."""
        return self._tracker.debug()

    def reset(self) -> None:
        """See ``Tracker``."""
        self._tracker.reset()


def reduced(maps: PlanViewMaps, statistic: Statistic) -> PlanViewMaps:
    """The maps with what is left of them; the statistic that is not named is a constant and carries no information."""
    if statistic == "both":
        return maps
    return height_only(maps) if statistic == "height" else occupancy_only(maps)


def height_only(maps: PlanViewMaps) -> PlanViewMaps:
    """Maps without occupancy: a cell with height counts as full, and of its points the highest is left.

    Height comes from the maps as they are: built with ``maps.occupancy_min=0`` it is not pruned by occupancy.
    """
    cell_m2 = np.float32(maps.grid.cell_m**2)
    known = maps.height_raw > 0
    full = np.where(known, cell_m2, np.float32(0.0))
    return replace(
        maps,
        occupancy_raw=full,
        occupancy=full,
        height=np.where(known, maps.height, np.float32(0.0)),
        occupancy_min=float(cell_m2) / 2,
        points=highest_points(maps.points, maps.grid),
    )


def occupancy_only(maps: PlanViewMaps) -> PlanViewMaps:
    """Maps without height: everything is ``NOMINAL_HEIGHT_M`` high."""
    nominal = np.float32(NOMINAL_HEIGHT_M)
    xyz = maps.points.xyz.copy()
    xyz[:, 2] = nominal
    return replace(
        maps,
        height_raw=np.where(maps.height_raw > 0, nominal, np.float32(0.0)),
        height=np.where(maps.height > 0, nominal, np.float32(0.0)),
        points=replace(maps.points, xyz=xyz),
    )


def highest_points(points: FloorPoints, grid: Grid) -> FloorPoints:
    """The highest point of every cell, each with a cell's area."""
    order = np.argsort(-points.xyz[:, 2], kind="stable")
    cols = np.floor((points.xyz[order, 0] - grid.x_min_m) / grid.cell_m).astype(np.int64)
    rows = np.floor((points.xyz[order, 1] - grid.y_min_m) / grid.cell_m).astype(np.int64)
    _, first = np.unique(rows * grid.n_cols + cols, return_index=True)
    kept = order[first]
    area = np.full(len(kept), grid.cell_m**2, dtype=np.float32)
    colours = None if points.colours is None else points.colours[kept]
    return FloorPoints(points.xyz[kept], area, points.pixels[kept], colours)
