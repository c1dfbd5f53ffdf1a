"""A file of trajectories in any format: its rows, what it holds for all of them, and regions of the floor."""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from calib.errors import InputError
from calib.io import read_text
from calib.types import F64, Bool
from planview.trajectories.table import Trajectories, frame_period_s

ROWS_MAX = 50_000_000
"""Most rows read of a file whose header claims its size: a month of one person at 20 Hz."""
FPS_MAX = 10_000.0
AREA_MARGIN_M = 1.0
"""Between the outermost position and the walkable area where none is known [m]."""
SPECK = 100.0
"""A polygon that is this many times as wide as the floor that people use, or as a metre, is in another unit,
centimetres at least."""
_WKT = re.compile(r"(POLYGON|MULTIPOLYGON|GEOMETRYCOLLECTION)[\s(),.\dA-Za-z+-]*", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class TrajectoryFile:
    """The rows of trajectories, and what their file gives for all of them.

    Attributes:
        fps: frames per second; None where the file does not give it.
        walkable_wkt: the floor where people may walk, a polygon in well-known text [m]; None where it is not given.
        note: what was assumed about the file, in a sentence; empty when nothing was.
        is_timed: True where rows have times and no frames: frames were made of these.
    """

    table: Trajectories
    fps: float | None = None
    walkable_wkt: str | None = None
    note: str = ""
    is_timed: bool = False


def parse_rate(path: Path, value: object) -> float:
    """A frame rate from a file [1/s]. Raises InputError: not a number above 0 and up to FPS_MAX."""
    try:
        fps = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        fps = float("nan")
    if not 0 < fps <= FPS_MAX:
        raise InputError(f"{path}: expected a frame rate above 0 and up to {FPS_MAX:g}, found {str(value)[:40]!r}")
    return fps


def parse_area(text: str, where: str) -> str:
    """Well-known text of a walkable area. Raises InputError: not a POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION, or
    parentheses that do not pair up."""
    wkt = " ".join(text.split())
    if not _WKT.fullmatch(wkt) or wkt.count("(") != wkt.count(")") or "(" not in wkt:
        raise InputError(f"{where}: expected a walkable area like POLYGON ((0 0, 4 0, 4 3, 0 0)), found {wkt[:60]!r}")
    return wkt


def surrounding_area(table: Trajectories) -> str:
    """The upright rectangle AREA_MARGIN_M around all positions, as well-known text."""
    xy = _known_places(table)
    if not len(xy):
        xy = np.zeros((1, 2))
    low = xy.min(axis=0) - AREA_MARGIN_M
    high = xy.max(axis=0) + AREA_MARGIN_M
    return str(shapely.to_wkt(shapely.box(*low, *high, ccw=True), rounding_precision=3, trim=False))


def _known_places(table: Trajectories) -> F64:
    """(N, 2) positions on the floor, of the rows that have one."""
    xy = np.column_stack([table.x_m, table.y_m])
    return np.asarray(xy[np.isfinite(xy).all(axis=1)])


def refuse_many(path: Path, rows: int) -> None:
    """Refuse a table before allocating memory. Raises InputError: more rows than ROWS_MAX."""
    if rows > ROWS_MAX:
        raise InputError(f"{path}: expected up to {ROWS_MAX} rows, found {rows}")


class Region:
    """Polygons, with or without holes, of a POLYGON, MULTIPOLYGON or GEOMETRYCOLLECTION [m]; ``where`` it stands is
    named. Raises InputError: not such a text, a ring of fewer than three points, or one that crosses itself."""

    def __init__(self, text: str, where: str) -> None:
        self.wkt = parse_area(text, where)
        self._name = where.rstrip("=:")
        try:
            given = shapely.from_wkt(self.wkt, on_invalid="fix")
        except shapely.GEOSException:
            given = shapely.Polygon()
        if "Self-intersection" in shapely.is_valid_reason(given):
            raise InputError(f"{where}: expected a polygon whose border does not cross itself, found {self.wkt[:60]}")
        self._area = shapely.make_valid(given)
        if not self._area.area > 0:
            raise InputError(f"{where}: expected rings of at least three points x y, found {self.wkt[:60]}")

    def doubt(self, table: Trajectories) -> str:
        """A sentence where nobody is inside, or where all of the people's floor is a speck of it; else empty."""
        xy = _known_places(table)
        if not len(xy):
            return ""
        x_min, y_min, x_max, y_max = self._area.bounds
        (x_low, y_low), (x_high, y_high) = xy.min(axis=0), xy.max(axis=0)
        people = f"people are at x {x_low:.1f} to {x_high:.1f} m, y {y_low:.1f} to {y_high:.1f} m"
        if not self.contains(table).any():
            spans = f"x {x_min:g} to {x_max:g} m, y {y_min:g} to {y_max:g} m"
            return f"nobody is inside the polygon of {self._name}: it spans {spans}; {people}"
        size_m = max(x_max - x_min, y_max - y_min)
        if size_m > SPECK * max(x_high - x_low, y_high - y_low, 1.0):
            return f"the polygon of {self._name} is {size_m:,.0f} m wide; {people}: is it in another unit?"
        return ""

    def contains(self, table: Trajectories) -> Bool:
        """(N,) whether rows lie in a polygon or on its border, and in none of its holes; unknown positions do not."""
        return np.asarray(shapely.intersects_xy(self._area, table.x_m, table.y_m))


def region_of(text: str, option: str) -> Region:
    """A region of well-known text, which a geometry of shapely becomes, or of a file with it. Raises InputError:
    neither."""
    text = str(text)
    with suppress(OSError):  # text that is too long for a file's name
        if Path(text).is_file():
            return Region(read_text(Path(text), "a polygon"), text)
    return Region(text, option)


def limit(file: TrajectoryFile, region: str | None, ignore: str | None) -> TrajectoryFile:
    """Trajectories inside one region and outside another, each well-known text or a file; None for no limit. The rate
    is that of all rows. Warns of a region with nobody inside. Raises InputError: see ``region_of``."""
    table = file.table
    keep = np.ones(len(table), dtype=np.bool_)
    if region is not None:
        kept = region_of(region, "region=")
        warn_of(kept.doubt(table))
        keep &= kept.contains(table)
    if ignore is not None:
        left_out = region_of(ignore, "ignore=")
        warn_of(left_out.doubt(table))
        keep &= ~left_out.contains(table)
    return replace(file, table=table.where(keep), fps=file.fps or measure_rate(table))


def warn_of(sentence: str) -> None:
    """Warn with a sentence, unless it is empty."""
    if sentence:
        warnings.warn(sentence, stacklevel=3)


def measure_rate(table: Trajectories) -> float | None:
    """Frames per second over all timestamps; that of the median frame where the clock jumps; None without times."""
    period = frame_period_s(table, 0.0)
    if period <= 0:
        return None
    first, last = np.flatnonzero(np.isfinite(table.timestamp_s))[[0, -1]].tolist()
    mean = (table.timestamp_s[last] - table.timestamp_s[first]) / (table.frame[last] - table.frame[first])
    # Decimals of a rate that is measured from times rounded to 0.1 ms.
    return round(1 / float(mean if abs(mean - period) < 0.01 * period else period), 3)
