"""A file of trajectories in any format: its rows, what it holds for all of them, and regions of the floor."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from calib.errors import InputError
from calib.io import read_text
from calib.types import Bool
from planview.trajectories.table import Trajectories

ROWS_MAX = 50_000_000
"""Most rows read of a file whose header claims its size: a month of one person at 20 Hz."""
FPS_MAX = 10_000.0
AREA_MARGIN_M = 1.0
"""Between the outermost position and the walkable area where none is known [m]."""
_WKT = re.compile(r"(POLYGON|MULTIPOLYGON|GEOMETRYCOLLECTION)[\s(),.\dA-Za-z+-]*", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class TrajectoryFile:
    """The rows of trajectories, and what their file gives for all of them.

    Attributes:
        fps: frames per second; None where the file does not give it.
        walkable_wkt: the floor where people may walk, a polygon in well-known text [m]; None where it is not given.
        note: what was assumed about the file, in a sentence; empty when nothing was.
    """

    table: Trajectories
    fps: float | None = None
    walkable_wkt: str | None = None
    note: str = ""


def checked_rate(path: Path, value: object) -> float:
    """A frame rate from a file [1/s]. Raises InputError: not a number above 0 and up to FPS_MAX."""
    try:
        fps = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        fps = float("nan")
    if not 0 < fps <= FPS_MAX:
        raise InputError(f"{path}: expected a frame rate above 0 and up to {FPS_MAX:g}, found {str(value)[:40]!r}")
    return fps


def checked_area(text: str, where: str) -> str:
    """Well-known text of a walkable area. Raises InputError: not a POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION, or
    parentheses that do not pair up."""
    wkt = " ".join(text.split())
    if not _WKT.fullmatch(wkt) or wkt.count("(") != wkt.count(")") or "(" not in wkt:
        raise InputError(f"{where}: expected a walkable area like POLYGON ((0 0, 4 0, 4 3, 0 0)), found {wkt[:60]!r}")
    return wkt


def surrounding_area(table: Trajectories) -> str:
    """The upright rectangle AREA_MARGIN_M around all positions, as well-known text."""
    xy = np.column_stack([table.x_m, table.y_m])
    xy = xy[np.isfinite(xy).all(axis=1)] if np.isfinite(xy).all(axis=1).any() else np.zeros((1, 2))
    low, high = xy.min(axis=0) - AREA_MARGIN_M, xy.max(axis=0) + AREA_MARGIN_M
    return str(shapely.to_wkt(shapely.box(*low, *high, ccw=True), rounding_precision=3, trim=False))


def refuse_many(path: Path, rows: int) -> None:
    """Refuse a table before allocating memory. Raises InputError: more rows than ROWS_MAX."""
    if rows > ROWS_MAX:
        raise InputError(f"{path}: expected up to {ROWS_MAX} rows, found {rows}")


class Region:
    """Polygons, with or without holes, of a POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION [m]; ``where`` it stands is
    named. Raises InputError: not such a text, or a ring of fewer than three points."""

    def __init__(self, text: str, where: str) -> None:
        self.wkt = checked_area(text, where)
        try:
            self._area = shapely.make_valid(shapely.from_wkt(self.wkt, on_invalid="fix"))
        except shapely.GEOSException:
            self._area = shapely.Polygon()
        if not self._area.area > 0:
            raise InputError(f"{where}: expected rings of at least three points x y, found {self.wkt[:60]}")

    def contains(self, table: Trajectories) -> Bool:
        """(N,) whether rows lie in a polygon or on its border, and in none of its holes; unknown positions do not."""
        return np.asarray(shapely.intersects_xy(self._area, table.x_m, table.y_m))


def region_of(text: str, option: str) -> Region:
    """A region of well-known text, or of a file with it. Raises InputError: neither."""
    with suppress(OSError):  # text that is too long for a file's name
        if Path(text).is_file():
            return Region(read_text(Path(text), "a polygon"), text)
    return Region(text, option)


def limited(file: TrajectoryFile, region: str | None, ignore: str | None) -> TrajectoryFile:
    """Trajectories inside one region and outside another, each well-known text or a file; None for no limit. Raises
    InputError: see ``region_of``."""
    table = file.table
    if region is not None:
        table = table.where(region_of(region, "region=").contains(table))
    if ignore is not None:
        table = table.where(~region_of(ignore, "ignore=").contains(table))
    return replace(file, table=table)
