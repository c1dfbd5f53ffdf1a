"""Regions of the floor, as polygons in well-known text: where people are kept, or left out."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import F64, Bool
from planview.trajectories.file import TrajectoryFile, checked_area
from planview.trajectories.table import Trajectories

_RING = re.compile(r"\(([^()]+)\)")


class Region:
    """Polygons, with or without holes.

    Args:
        text: POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION [m].
        where: what holds the text, for messages.
    Raises:
        InputError: not such a text, or a ring of fewer than three points.
    """

    def __init__(self, text: str, where: str) -> None:
        self.wkt = checked_area(text, where)
        self._rings = [_ring(points, where) for points in _RING.findall(self.wkt)]

    def contains(self, x: F64, y: F64) -> Bool:
        """(N,) whether points are inside an odd number of rings: in a polygon and in none of its holes."""
        inside = np.zeros(x.shape, dtype=np.bool_)
        for ring in self._rings:
            inside ^= within_ring(ring, x, y)
        return inside


def region_of(text: str, option: str) -> Region:
    """A region of well-known text, or of a file with it.

    Raises:
        InputError: neither.
    """
    path = Path(text)
    try:
        if len(text) < 1000 and path.is_file():
            with path.open(encoding="utf-8") as file:
                return Region(file.read(1_000_000), text)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{text}: expected a file with a polygon, found {error}") from error
    return Region(text, option)


def limited(file: TrajectoryFile, region: str | None, ignore: str | None) -> TrajectoryFile:
    """Trajectories inside one region and outside another, each well-known text or a file; None for no limit.

    Raises:
        InputError: see ``region_of``.
    """
    table = file.table
    if region is not None:
        table = table.where(inside(table, region_of(region, "--region")))
    if ignore is not None:
        table = table.where(~inside(table, region_of(ignore, "--ignore")))
    return replace(file, table=table)


def inside(table: Trajectories, region: Region) -> Bool:
    """(N,) whether rows lie in a region; rows without a floor position do not."""
    return region.contains(table.x_m, table.y_m)


def within_ring(ring: F64, x: F64, y: F64) -> Bool:
    """Whether points (of any shape) lie inside an (N, 2) ring, by the edges that a ray to the right crosses."""
    odd = np.zeros(x.shape, dtype=np.bool_)
    for (px, py), (qx, qy) in zip(ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True):
        if qy != py:
            odd ^= ((py > y) != (qy > y)) & (x < px + (y - py) / (qy - py) * (qx - px))
    return odd


def _ring(text: str, where: str) -> F64:
    try:
        ring = np.array([[float(number) for number in point.split()[:2]] for point in text.split(",")])
    except ValueError:
        ring = np.empty(0)
    if ring.ndim != 2 or ring.shape[0] < 3 or ring.shape[1] != 2:
        raise InputError(f"{where}: expected rings of at least three points x y, found ({text[:40]})")
    return ring
