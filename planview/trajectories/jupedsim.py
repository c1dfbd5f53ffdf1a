"""Trajectories in JuPedSim's sqlite database, versions 1 (read) and 2 (read and written).

Tables: ``trajectory_data`` (frame, id, pos_x, pos_y, ori_x, ori_y), ``metadata`` (version, fps and bounds as text),
``geometry`` (walkable areas in well-known text with a hash) and, from version 2, ``frame_data`` (the area of a frame).
"""

from __future__ import annotations

import hashlib
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, checked_area, checked_rate, refuse_many, replaced
from planview.trajectories.rows import sorted_rows
from planview.trajectories.table import positions_table

VERSION = 2
AREAS_MAX = 100
"""Most walkable areas that are read."""
_SCHEMA = """
CREATE TABLE trajectory_data (frame INTEGER NOT NULL, id INTEGER NOT NULL, pos_x REAL NOT NULL, pos_y REAL NOT NULL,
    ori_x REAL NOT NULL, ori_y REAL NOT NULL);
CREATE TABLE metadata (key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE geometry (wkt TEXT NOT NULL, hash INTEGER NOT NULL DEFAULT 0);
CREATE TABLE frame_data (frame INTEGER NOT NULL, geometry_hash INTEGER NOT NULL);
CREATE INDEX frame_id_idx ON trajectory_data (frame, id);
"""


def read_jupedsim(path: Path) -> TrajectoryFile:
    """Read a database; several walkable areas come as one collection.

    Raises:
        InputError: another database, damaged, of another version, without its frame rate, or too large.
    """
    try:
        with closing(sqlite3.connect(path.resolve().as_uri() + "?mode=ro&immutable=1", uri=True)) as database:
            database.execute("PRAGMA trusted_schema = OFF")
            return _read(path, database)
    except (sqlite3.Error, ValueError, OverflowError) as error:
        raise InputError(f"{path}: expected a database of JuPedSim, found {error}") from error


def write_jupedsim(path: Path, file: TrajectoryFile) -> None:
    """Write rows with known positions; the orientation is the direction of the velocity, (0, 0) where unknown.

    Raises:
        WorkError: the file cannot be written.
    """
    table, area = file.table, file.walkable_wkt or ""
    area_hash = int.from_bytes(hashlib.sha256(area.encode()).digest()[:8], "big", signed=True)
    speed = np.hypot(*table.velocity_mps.T)[:, None]
    heading = np.where(speed > 0, table.velocity_mps / np.where(speed > 0, speed, 1.0), 0.0)
    rows = zip(*(c.tolist() for c in (table.frame, table.track_id, table.x_m, table.y_m, *heading.T)), strict=True)
    with replaced(path) as part, closing(sqlite3.connect(part)) as database, database:
        database.executescript(_SCHEMA)
        database.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?, ?, ?)", rows)
        database.executemany("INSERT INTO metadata VALUES (?, ?)", _metadata(file))
        database.execute("INSERT INTO geometry VALUES (?, ?)", (area, area_hash))
        frames = [(int(frame), area_hash) for frame in np.unique(table.frame)]
        database.executemany("INSERT INTO frame_data VALUES (?, ?)", frames)


def _metadata(file: TrajectoryFile) -> list[tuple[str, str]]:
    rows = [("version", str(VERSION)), ("fps", f"{file.fps!r}")]
    if len(file.table):
        for axis, values in (("x", file.table.x_m), ("y", file.table.y_m)):
            rows += [(f"{axis}min", f"{values.min()}"), (f"{axis}max", f"{values.max()}")]
    return rows


def _read(path: Path, database: sqlite3.Connection) -> TrajectoryFile:
    # Views and virtual tables could run queries of their own without end: only plain tables are read.
    kinds = database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
    tables = {name for name, sql in kinds if not str(sql).upper().startswith("CREATE VIRTUAL")}
    if not {"trajectory_data", "metadata"} <= tables:
        raise InputError(
            f"{path}: expected the tables trajectory_data and metadata, found {', '.join(sorted(tables)) or 'none'}"
        )
    metadata = dict(database.execute("SELECT key, value FROM metadata LIMIT 100").fetchall())
    if str(metadata.get("version")) not in ("1", "2"):
        raise InputError(f"{path}: expected version 1 or 2, found {metadata.get('version')!r}")
    table = sorted_rows(path, _numbers(path, database), frame=0, track_id=1)
    frame, track_id = table[:, :2].astype(np.int64).T
    rows, fps = positions_table(frame, track_id, table[:, 2:4]), checked_rate(path, metadata.get("fps"))
    return TrajectoryFile(rows, fps, _area(path, database) if "geometry" in tables else None)


def _area(path: Path, database: sqlite3.Connection) -> str | None:
    found = database.execute("SELECT DISTINCT wkt FROM geometry LIMIT ?", (AREAS_MAX,)).fetchall()
    areas = [checked_area(str(wkt), str(path)) for (wkt,) in found if wkt]
    return areas[0] if len(areas) == 1 else f"GEOMETRYCOLLECTION ({', '.join(areas)})" if areas else None


def _numbers(path: Path, database: sqlite3.Connection) -> F64:
    """(N, 4) frame, id, x, y."""
    refuse_many(path, int(database.execute("SELECT count(*) FROM trajectory_data").fetchone()[0]))
    rows = database.execute("SELECT frame, id, pos_x, pos_y FROM trajectory_data")
    try:
        return np.array(rows.fetchall(), dtype=np.float64).reshape(-1, 4)
    except TypeError as error:
        raise ValueError(f"values that are not numbers ({error})") from error
