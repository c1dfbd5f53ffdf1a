"""Maps of several rigs that look at one floor: whose surface counts, and how they view a place together.

One rig measures the surface of a body that faces it (Harville's occupancy, Z^2/(fu fv) summed). Two rigs that see the
same body measure two such surfaces, front and back or twice the front; their sum is no property of the body, and every
rule about visible surface (how much a head, a person, a part of a person shows) is about one view. What is counted is
therefore the surface that the best of the views shows, shared out among the rigs by what each shows:

    O(c) = sum_k a_k(c) O_k(c),   a_k(c) = max_j S_j(c) / sum_j S_j(c)

with O_k the occupancy of rig k and S_k its sum over a body's surroundings of the cell. Where one rig sees a place the
factor is 1, and nothing changes when a body walks into or out of the other's view, or is hidden from it (ours).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.types import F32, F64, AnyArray
from planview.maps.builder import (
    CameraViewpoint,
    FloorPoints,
    MapParams,
    PlanViewMaps,
    Raster,
)
from planview.maps.grid import Grid


@dataclass(frozen=True, eq=False)
class MultiRigViewpoint:
    """Several cameras above one floor: a ``Viewpoint``.

    Attributes:
        rigs: of each camera.
        grid: of the shares.
        shares: (K, n_rows, n_cols) float32, what each rig shows of the surface around a cell; they sum to 1, or are
            all zero where no surface is.
    """

    rigs: tuple[CameraViewpoint, ...]
    grid: Grid
    shares: F32

    def sees(self, x_m: float, y_m: float, z_m: float) -> bool:
        """Whether a world point lies in an image."""
        return any(rig.sees(x_m, y_m, z_m) for rig in self.rigs)

    def footprint(
        self, x_m: float, y_m: float, radius_m: float, sigmas: float = 2.0
    ) -> tuple[float, float, tuple[float, float]]:
        """The ellipse around the ellipses of all rigs that view the place, along the longest (see ``Viewpoint``)."""
        # A rig that has this height of a place in its image counts as viewing it [m].
        viewing = [rig for rig in self.rigs if rig.sees(x_m, y_m, 1.0)] or list(self.rigs)
        ellipses = [rig.footprint(x_m, y_m, radius_m, sigmas) for rig in viewing]
        _, along, ray = max(ellipses, key=lambda ellipse: ellipse[1])
        return max(_reach(ellipse, (-ray[1], ray[0])) for ellipse in ellipses), along, ray

    def viewing(self, people_m: F64) -> tuple[F64, F64]:
        """Mean direction away from the rigs and mean depression, weighted by what each rig shows of a person.

        A camera shows the near side of a body: the centroid of what several show lies in front of the axis by the mean
        of their single offsets, which nearly vanishes between two opposite rigs (see ``Viewpoint``).
        """
        weights = self._weights(people_m)
        each = [rig.viewing(people_m) for rig in self.rigs]
        depression = sum(w * d for w, (_, d) in zip(weights, each, strict=True))
        offset = sum((w * np.cos(d))[:, None] * away for w, (away, d) in zip(weights, each, strict=True))
        return np.asarray(offset / np.cos(depression)[:, None]), np.asarray(depression)

    def _weights(self, people_m: F64) -> F64:
        """(K rigs, N) shares at places; the nearest cell of the grid's edge outside, equal where no surface is."""
        g = self.grid
        cols = np.clip((people_m[:, 0] - g.x_min_m) // g.cell_m, 0, g.n_cols - 1).astype(int)
        rows = np.clip((people_m[:, 1] - g.y_min_m) // g.cell_m, 0, g.n_rows - 1).astype(int)
        weights = self.shares[:, rows, cols].astype(np.float64)
        total = weights.sum(axis=0)
        return np.where(total > 0, weights / np.where(total > 0, total, 1.0), 1.0 / len(self.rigs))


class MultiRigMapBuilder:
    """One set of maps from the foreground points of several rigs.

    Args:
        grids: of the rigs' own maps, with cells of one size; the joint grid covers them all.
        views: of the rigs.
        params: of the maps.
    Raises:
        ValueError: the floor covered together is larger than a grid may be.
    """

    def __init__(self, grids: Sequence[Grid], views: Sequence[CameraViewpoint], params: MapParams) -> None:
        self.grid = Grid.covering(
            min(g.x_min_m for g in grids),
            min(g.y_min_m for g in grids),
            max(g.x_max_m for g in grids),
            max(g.y_max_m for g in grids),
            params.cell_m,
        )
        self._views = tuple(views)
        self._raster = Raster(self.grid, params)

    def __call__(self, points: Sequence[FloorPoints | None]) -> PlanViewMaps:
        """The maps of one moment.

        Args:
            points: of each rig in the common world, None of a rig without a frame. Pixels of the result are those of
                the rigs, one rig after the other.
        """
        present = [p if p is not None else _nothing() for p in points]
        shares, factor = self._shares(present)
        joint = self._joined(present, factor)
        return self._raster.maps(joint, MultiRigViewpoint(self._views, self.grid, shares))

    def _shares(self, points: Sequence[FloorPoints]) -> tuple[F32, F32]:
        """Shares (K, n_rows, n_cols) of the surface around every cell, and the factor max S / sum S (0 without S)."""
        # Side of the square in which the rigs' shares of a body are compared [m]: 2 W_avg, a template.
        side = 2 * max(1, round(0.8 / 2 / self.grid.cell_m)) + 1
        surface = np.stack([_around(self._raster.accumulate(p)[1], side) for p in points])
        total = surface.sum(axis=0)
        whole = np.where(total > 0, total, np.float32(1.0))
        return np.asarray(surface / whole), np.asarray(surface.max(axis=0) / whole)

    def _joined(self, points: Sequence[FloorPoints], factor: F32) -> FloorPoints:
        """All points together, each with the surface that it counts for."""
        every = concatenated(points)
        g = self.grid
        cols = np.floor((every.xyz[:, 0] - g.x_min_m) / g.cell_m).astype(np.int64)
        rows = np.floor((every.xyz[:, 1] - g.y_min_m) / g.cell_m).astype(np.int64)
        inside = (cols >= 0) & (rows >= 0) & (cols < g.n_cols) & (rows < g.n_rows)
        weight = np.zeros(len(every.xyz), dtype=np.float32)
        weight[inside] = factor[rows[inside], cols[inside]]
        # Points below height_min_m are in no sum: where only they are, they keep their surface.
        weight[weight == 0.0] = 1.0
        return replace(every, area=every.area * weight)


def concatenated(points: Sequence[FloorPoints]) -> FloorPoints:
    """The points of several rigs one after the other; colours only when all that have points have them."""
    coloured = all(p.colours is not None or not len(p.xyz) for p in points)
    colours = [p.colours for p in points if p.colours is not None]
    return FloorPoints(
        np.concatenate([p.xyz for p in points]),
        np.concatenate([p.area for p in points]),
        np.concatenate([p.pixels for p in points]),
        np.concatenate(colours) if coloured and colours else None,
    )


def _nothing() -> FloorPoints:
    return FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))


def _around(occupancy: F32, side: int) -> F32:
    """Sums over squares of cells."""
    summed: AnyArray = cv2.boxFilter(occupancy, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    # Running sums leave crumbs where nothing is.
    return np.asarray(np.where(summed > 1e-6, summed, 0.0), dtype=np.float32)


def _reach(ellipse: tuple[float, float, tuple[float, float]], direction: tuple[float, float]) -> float:
    """How far an ellipse reaches in a direction [m]."""
    across, along, ray = ellipse
    cos = ray[0] * direction[0] + ray[1] * direction[1]
    return math.hypot(along * cos, across * math.sqrt(max(0.0, 1.0 - cos * cos)))
