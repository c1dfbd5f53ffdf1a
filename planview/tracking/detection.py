"""Newcomers in what is left of the maps after all tracked people are cleared (Harville 2002, section 4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64, Bool
from planview.maps.builder import PlanViewMaps, Viewpoint
from planview.tracking._near_kernels import pairs_within
from planview.tracking.body_axis import BodyAxis

_MAX_CANDIDATES = 20


class PersonDetectionParams(Params):
    """What counts as a person who is not tracked yet; our choices where no source is named."""

    height_min_m: float = Field(0.85, gt=0.0)
    """Plausible minimum height [m] (Harville 2002, section 4): a child of two years. Chairs reach 1.1 m: what is as low
    must move by itself to be confirmed, apart from all people."""
    low_m: float = Field(0.4, gt=0.0)
    """The same where a person was lost [m]: people crouch and sit on the floor (head at about 0.75 m), and are looked
    for where they vanished before anything else is thought of."""
    area_min_m2: float = Field(0.06, gt=0.0)
    """Visible surface within W_avg [m^2] ("high occupancy"): a head and neck seen over a partition."""
    head_width_max_m: float = Field(0.55, gt=0.0)
    """Widest extent, across the viewing ray, of what lies within a head's height of the top [m]: shoulders of a broad
    person are 0.5 m; doors, shelves and boards are wider."""
    separation_m: float = Field(0.45, gt=0.0)
    """Smallest distance between a newcomer and a tracked person [m]: shoulders side by side. Nearer it may be an arm,
    or a far body's second clump of depth. Along the viewing ray it grows with the depth noise (``inseparable``)."""


@dataclass(frozen=True)
class PersonCandidate:
    """A place where a person may stand.

    Attributes:
        x_m, y_m: centroid of the visible surface, of the head where it is visible [m].
        axis_m: (x, y) of the body's axis [m].
        height_m: how tall [m].
        area_m2: visible surface within W_avg [m^2].
        part_of: index of the tracked person that it cannot be told apart from, None for a separate one.
        low: too low for a newcomer; it may be a lost person only.
    """

    x_m: float
    y_m: float
    axis_m: tuple[float, float]
    height_m: float
    area_m2: float
    part_of: int | None = None
    low: bool = False


class PersonDetector:
    """Finds local occupancy maxima with a person's height and head.

    Args:
        axis: measures how tall a candidate is.
        width_m: W_avg [m].
    """

    def __init__(self, params: PersonDetectionParams, axis: BodyAxis, width_m: float) -> None:
        self.params = params
        self._axis = axis
        self._width_m = width_m

    def __call__(
        self,
        maps: PlanViewMaps,
        height: F32,
        occupancy: F32,
        taken: Sequence[tuple[float, float]],
        lost: Sequence[tuple[float, float]] = (),
    ) -> list[PersonCandidate]:
        """Candidates, largest visible surface first; those that may be part of a tracked person say of whom.

        Args:
            maps: the frame's maps (grid, points, view).
            height, occupancy: (n_rows, n_cols) float32, cleared under known people.
            taken: (x, y) of tracked people [m].
            lost: (x, y) where people vanished [m].
        """
        tall = height >= self.params.height_min_m
        for place in lost:
            near = self._around(maps, place)
            tall[near] |= height[near] >= self.params.low_m
        if not tall.any():
            return []
        area, cells, (row0, col0) = self._areas(maps, tall, occupancy)
        found: list[PersonCandidate] = []
        for _ in range(_MAX_CANDIDATES):
            row, col = divmod(int(np.argmax(area)), area.shape[1])
            peak = float(area[row, col])
            if peak < self.params.area_min_m2:
                break
            candidate = self._candidate(maps, occupancy, taken, (row0 + row, col0 + col), cells, peak)
            if candidate and self._owner(maps, candidate, [(c.x_m, c.y_m) for c in found]) is None:
                found.append(replace(candidate, part_of=self._owner(maps, candidate, taken)))
            r = cells
            area[max(0, row - r) : row + r + 1, max(0, col - r) : col + r + 1] = 0.0
        return found

    def _around(self, maps: PlanViewMaps, place: tuple[float, float]) -> tuple[slice, slice]:
        """Cells within 2 W_avg of a place."""
        row, col = (round(i) for i in maps.grid.index_of(*place))
        reach = round(2 * self._width_m / maps.grid.cell_m)
        return slice(max(0, row - reach), max(0, row + reach + 1)), slice(max(0, col - reach), max(0, col + reach + 1))

    def _areas(self, maps: PlanViewMaps, tall: Bool, occupancy: F32) -> tuple[F32, int, tuple[int, int]]:
        """Visible surface within W_avg around each cell, zero where nothing tall is near; W_avg in cells.

        Only of the part of the map that holds something tall, whose first cell is given too.
        """
        cells = max(1, round(self._width_m / maps.grid.cell_m))
        side = 2 * (cells // 2) + 1
        left, top, width, height = cv2.boundingRect(tall.view(np.uint8))
        row0, col0 = max(0, top - side), max(0, left - side)
        part = slice(row0, top + height + side), slice(col0, left + width + side)
        area = cv2.boxFilter(occupancy[part], -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        near = cv2.dilate(tall[part].astype(np.uint8), np.ones((side, side), dtype=np.uint8))
        area[near == 0] = 0.0
        return np.asarray(area, dtype=np.float32), cells, (row0, col0)

    def _candidate(
        self,
        maps: PlanViewMaps,
        occupancy: F32,
        taken: Sequence[tuple[float, float]],
        peak: tuple[int, int],
        cells: int,
        area: float,
    ) -> PersonCandidate | None:
        row, col = peak
        half = cells // 2
        r0, c0 = max(0, row - half), max(0, col - half)
        window = occupancy[r0 : row + half + 1, c0 : col + half + 1]
        total = float(window.sum())
        if total <= 0.0:
            return None
        row_mean = float(window.sum(axis=1) @ np.arange(window.shape[0])) / total
        col_mean = float(window.sum(axis=0) @ np.arange(window.shape[1])) / total
        x, y = maps.grid.centre_of(r0 + row_mean, c0 + col_mean)
        measured = self._axis(maps.points, np.array([(x, y), *taken]), self._width_m)[0]
        top = measured.height_m
        if not top >= self.params.low_m:
            return None
        if self._head_width(maps, occupancy, x, y, top) > self.params.head_width_max_m:
            return None
        if measured.from_head:
            x, y = measured.visible_m
        return PersonCandidate(x, y, (measured.x_m, measured.y_m), top, area, low=top < self.params.height_min_m)

    def _head_width(self, maps: PlanViewMaps, occupancy: F32, x: float, y: float, top: float) -> float:
        """Extent across the viewing ray of free points near the top [m]: root of 12 times their variance."""
        xyz, area = maps.points.xyz, maps.points.area
        across, along, ray = maps.view.footprint(x, y, 2 * self._width_m)
        near = (np.abs(xyz[:, 0] - x) < along) & (np.abs(xyz[:, 1] - y) < along) & (xyz[:, 2] > top - 0.25)
        near[near] = free_cells(maps, occupancy, xyz[near])
        sideways = -(xyz[near, 0] - x) * ray[1] + (xyz[near, 1] - y) * ray[0]
        inside = np.abs(sideways) < across
        weight = area[near][inside]
        if weight.sum() <= 0:
            return 0.0
        mean = np.average(sideways[inside], weights=weight)
        return math.sqrt(12 * float(np.average((sideways[inside] - mean) ** 2, weights=weight)))

    def _owner(
        self, maps: PlanViewMaps, candidate: PersonCandidate, taken: Sequence[tuple[float, float]]
    ) -> int | None:
        may_be = inseparable_from(maps.view, (candidate.x_m, candidate.y_m), self.params.separation_m)
        return next((i for i, other in enumerate(taken) if may_be(other)), None)


def free_cells(maps: PlanViewMaps, occupancy: F32, xyz: F32) -> Bool:
    """Which points (N, 3) fall into cells that still hold occupancy."""
    grid = maps.grid
    cols = np.clip((xyz[:, 0] - grid.x_min_m) / grid.cell_m, 0, grid.n_cols - 1).astype(np.intp)
    rows = np.clip((xyz[:, 1] - grid.y_min_m) / grid.cell_m, 0, grid.n_rows - 1).astype(np.intp)
    return np.asarray(occupancy[rows, cols] > 0)


def inseparable(view: Viewpoint, one_m: tuple[float, float], other_m: tuple[float, float], distance_m: float) -> bool:
    """Whether two floor positions may be one body: within a distance, stretched along the ray by depth noise.

    Matching favours whole disparities, so a far body may fall into two clumps one disparity step apart: four of its
    standard deviations of 0.25 px.
    """
    return inseparable_from(view, one_m, distance_m)(other_m)


def inseparable_from(
    view: Viewpoint, one_m: tuple[float, float], distance_m: float
) -> Callable[[tuple[float, float]], bool]:
    """``inseparable`` of one place and any other."""
    across, along, (ray_x, ray_y) = view.footprint(*one_m, distance_m, sigmas=4.0)

    def test(other_m: tuple[float, float]) -> bool:
        dx, dy = other_m[0] - one_m[0], other_m[1] - one_m[1]
        radial, lateral = dx * ray_x + dy * ray_y, -dx * ray_y + dy * ray_x
        return (radial / along) ** 2 + (lateral / across) ** 2 < 1.0

    return test


def inseparable_pairs(view: Viewpoint, places_m: F64, distance_m: float) -> list[tuple[int, int]]:
    """All i < j for which places i and j of (K, 2) are ``inseparable`` [m]."""
    footprints = [view.footprint(x, y, distance_m, sigmas=4.0) for x, y in places_m.tolist()]
    ellipses = np.array([(across, along, *ray) for across, along, ray in footprints]).reshape(-1, 4)
    return [(i, j) for i, j in pairs_within(places_m, ellipses).tolist()]
