"""One of the two plan-view statistics alone (Harville 2002, section 5)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from planview.engine.config import Config
from planview.maps.builder import FloorPoints, PlanViewMaps
from planview.maps.grid import Grid
from planview.tracking.base import Observation
from planview.tracking.template import TemplateTracker
from planview.trajectories.state import TrackState

Statistic = Literal["both", "height", "occupancy"]
NOMINAL_HEIGHT_M = 1.7
"""Height of everything where height is not measured [m]: an adult, so that no test of height refuses it."""


class OneStatistic(TemplateTracker):
    """The paper's tracker on maps of which one statistic is left.

    Args:
        config: its parameters and those of the maps.
        statistic: the one that is left; the other is a constant and carries no information.
    """

    def __init__(self, config: Config, statistic: Statistic) -> None:
        super().__init__(config.template, config.maps.height_max_m)
        self._statistic = statistic

    def update(self, observation: Observation) -> tuple[TrackState, ...]:
        """Track one frame."""
        assert observation.maps is not None
        maps = reduced(observation.maps, self._statistic)
        return super().update(replace(observation, build_maps=lambda: maps))


def reduced(maps: PlanViewMaps, statistic: Statistic) -> PlanViewMaps:
    """The maps with what is left of them."""
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
