"""Trajectories in JSON lines, and in binary files: the Ped Data Archive (HDF5), JuPedSim (SQLite), Parquet.

Every reader takes a path and raises InputError: unreadable, damaged, not what its format asks for, or too large.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from calib.errors import InputError
from calib.io import expecting
from calib.types import F64, AnyArray
from planview.trajectories.file import TrajectoryFile, parse_area, parse_rate, refuse_many
from planview.trajectories.hdf5 import open_hdf5
from planview.trajectories.state import SURE_FACING
from planview.trajectories.table import (
    BOX_COLUMNS,
    NUMBER_COLUMNS,
    TRACK_COLUMNS,
    Trajectories,
    row_states,
    rows_by_id,
    table_of,
)

LINE_MAX = 10_000_000
"""Most characters of a line: a frame of 50,000 people."""


def stream_jsonl(out: IO[str], table: Trajectories) -> None:
    """JSON lines: one per frame that has rows; what is unknown is null."""
    for frame, rows in rows_by_id(table.frame):
        people = []
        for person in row_states(table, rows):
            people.append({name.removeprefix("track_"): _or_null(value) for name, value in vars(person).items()})
        time_s = _or_null(float(table.timestamp_s[rows[0]]))
        out.write(json.dumps({"frame": frame, "timestamp_s": time_s, "people": people}) + "\n")


def _or_null(value: Any) -> Any:
    """The value; None where it is, or holds, NaN."""
    cells = value if isinstance(value, tuple) else (value,)
    return None if any(cell != cell for cell in cells) else value


def read_jsonl(path: Path) -> TrajectoryFile:
    """JSON lines, of a frame with its people or of a person in a frame; a last one that is cut short (the writer was
    interrupted) is left out."""
    states: list[str] = []
    numbers: list[F64] = []
    times: list[Any] = []
    with expecting(path, "JSON lines", OSError, UnicodeDecodeError), path.open(encoding="utf-8") as file:
        for number, text in enumerate(iter(lambda: file.readline(LINE_MAX), ""), 1):
            if not text.strip():
                continue
            try:
                frame = json.loads(text, parse_constant=_refuse)
            except (ValueError, RecursionError) as error:
                if number > 1 and not text.endswith("\n") and len(text) < LINE_MAX:
                    break
                raise InputError(f"{path}: expected JSON in line {number}, found {error}") from error
            try:
                for person in frame.get("people", [frame]):
                    states.append(str(person.get("state", "confirmed")))
                    numbers.append(_numbers(frame, person))
                    times.append(frame.get("timestamp_s"))
            except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
                fault = f"no {error}" if isinstance(error, KeyError) else error
                raise InputError(f"{path}: expected a frame with people in line {number}, found {fault}") from error
    table = np.reshape(numbers, (-1, len(NUMBER_COLUMNS)))
    columns: dict[str, Any] = dict(zip(NUMBER_COLUMNS, table.T, strict=True))
    columns["state"] = states
    if any(isinstance(time, str) for time in times):
        columns["timestamp_s"] = np.array(times, dtype=object)
    return TrajectoryFile(table_of(columns, path))


def _numbers(frame: dict[str, Any], person: dict[str, Any]) -> F64:
    """The NUMBER_COLUMNS of one person, NaN where one is null or missing, and for a time in words."""
    cells = dict(zip(BOX_COLUMNS, person.get("box_px") or [None] * 4, strict=True))
    time = frame.get("timestamp_s")
    cells |= {"frame": frame["frame"], "timestamp_s": None if isinstance(time, str) else time, "id": person["id"]}
    return np.array([cells.get(name, person.get(name)) for name in NUMBER_COLUMNS], dtype=np.float64)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"the constant {constant}")


_ROW = np.dtype([("id", "<i8"), ("frame", "<i8"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
_SCHEMA = """
CREATE TABLE trajectory_data (frame INTEGER NOT NULL, id INTEGER NOT NULL, pos_x REAL NOT NULL, pos_y REAL NOT NULL,
    ori_x REAL NOT NULL, ori_y REAL NOT NULL);
CREATE TABLE metadata (key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE geometry (wkt TEXT NOT NULL, hash INTEGER NOT NULL DEFAULT 0);
CREATE TABLE frame_data (frame INTEGER NOT NULL, geometry_hash INTEGER NOT NULL);
CREATE INDEX frame_id_idx ON trajectory_data (frame, id);
"""


def read_ped_data_archive(path: Path) -> TrajectoryFile:
    """HDF5 of the Ped Data Archive; a z of 0 or less counts as unknown."""
    import h5py  # a tenth of a second, and only these files need it

    with (
        expecting(path, "an HDF5 file of the Ped Data Archive", OSError, KeyError, ValueError, TypeError, RuntimeError),
        open_hdf5(path) as file,
    ):
        trajectory = file.get("trajectory")
        if not isinstance(trajectory, h5py.Dataset):
            raise InputError(f"{path}: expected the dataset 'trajectory', found {', '.join(file)[:200] or 'nothing'}")
        names = trajectory.dtype.names or ()
        if {"id", "frame", "x", "y"} - set(names) or trajectory.ndim != 1:
            listed = ", ".join(names) or "none"
            raise InputError(f"{path}: expected a list with the fields id, frame, x, y, found {listed}")
        refuse_many(path, len(trajectory))
        rows: AnyArray = trajectory[:]
        fps = parse_rate(path, trajectory.attrs.get("fps"))
        area = file.attrs.get("wkt_geometry")
    columns = {"id": rows["id"], "frame": rows["frame"], "x_m": rows["x"], "y_m": rows["y"]}
    if "z" in names:
        columns["height_m"] = np.where(rows["z"] > 0, rows["z"], np.nan)
    if isinstance(area, bytes):
        area = area.decode("utf-8", "replace")
    wkt = None if area is None else parse_area(str(area), str(path))
    return TrajectoryFile(table_of(columns, path), fps, wkt)


def write_ped_data_archive(path: Path, file: TrajectoryFile) -> None:
    """Rows with known positions by id, then frame."""
    import h5py

    table = file.table
    columns = [table.track_id, table.frame, table.x_m, table.y_m, table.height_m]
    rows = np.rec.fromarrays(columns, dtype=_ROW)[np.lexsort((table.frame, table.track_id))]
    with h5py.File(path, "w") as out:
        out.attrs.update(file_version="1.0.0", wkt_geometry=file.walkable_wkt or "", source="planview")
        dataset = out.create_dataset("trajectory", data=rows, compression="gzip" if len(rows) else None)
        dataset.attrs.update(
            fps=file.fps, id="unique identifier for pedestrian", frame="frame number",
            x="pedestrian x-coordinate (meter [m])", y="pedestrian y-coordinate (meter [m])",
            z="pedestrian z-coordinate (meter [m])",
        )  # fmt: skip


def read_jupedsim(path: Path) -> TrajectoryFile:
    """A database of JuPedSim; several walkable areas come as one collection."""
    with (
        expecting(path, "a database of JuPedSim", sqlite3.Error, ValueError, OverflowError),
        closing(sqlite3.connect(path.resolve().as_uri() + "?mode=ro&immutable=1", uri=True)) as database,
    ):
        database.execute("PRAGMA trusted_schema = OFF")
        # A view, or a virtual table, may have rows without end.
        listed = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'"
        tables = {name for (name,) in database.execute(listed)}
        if not {"trajectory_data", "metadata"} <= tables:
            listed = ", ".join(sorted(tables)) or "none"
            raise InputError(f"{path}: expected the tables trajectory_data and metadata, found {listed}")
        metadata = dict(database.execute("SELECT key, value FROM metadata LIMIT 100").fetchall())
        if str(metadata.get("version")) not in ("1", "2"):
            raise InputError(f"{path}: expected version 1 or 2, found {metadata.get('version')!r}")
        refuse_many(path, int(database.execute("SELECT count(*) FROM trajectory_data").fetchone()[0]))
        rows = database.execute("SELECT frame, id, pos_x, pos_y FROM trajectory_data").fetchall()
        areas = []
        if "geometry" in tables:
            areas = database.execute("SELECT DISTINCT wkt FROM geometry WHERE wkt != '' LIMIT 100").fetchall()
    cells = np.array(rows, dtype=object).reshape(-1, 4)
    table = table_of(dict(zip(("frame", "id", "x_m", "y_m"), cells.T, strict=True)), path)
    wkt = ", ".join(parse_area(str(area), str(path)) for (area,) in areas)
    if len(areas) > 1:
        wkt = f"GEOMETRYCOLLECTION ({wkt})"
    return TrajectoryFile(table, parse_rate(path, metadata.get("fps")), wkt or None)


def write_jupedsim(path: Path, file: TrajectoryFile) -> None:
    """Rows with known positions; the orientation is where a person surely faces, else the direction of the velocity,
    (0, 0) where both are unknown."""
    table = file.table
    area = file.walkable_wkt or ""
    area_hash = int.from_bytes(hashlib.sha256(area.encode()).digest()[:8], "big", signed=True)
    speed = np.hypot(*table.velocity_mps.T)[:, None]
    heading = np.divide(table.velocity_mps, speed, out=np.zeros_like(table.velocity_mps), where=speed > 0)
    facing = np.radians(table.facing_deg)
    is_sure = np.isfinite(facing) & ~(table.facing_confidence < SURE_FACING)
    heading[is_sure] = np.column_stack([np.cos(facing), np.sin(facing)])[is_sure]
    columns = [table.frame, table.track_id, table.x_m, table.y_m, *heading.T]
    rows = zip(*[column.tolist() for column in columns], strict=True)
    metadata = [("version", "2"), ("fps", f"{file.fps!r}")]
    if len(table):
        metadata += [("xmin", f"{table.x_m.min()}"), ("xmax", f"{table.x_m.max()}")]
        metadata += [("ymin", f"{table.y_m.min()}"), ("ymax", f"{table.y_m.max()}")]
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(_SCHEMA)
        database.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?, ?, ?)", rows)
        database.executemany("INSERT INTO metadata VALUES (?, ?)", metadata)
        database.execute("INSERT INTO geometry VALUES (?, ?)", (area, area_hash))
        frames = [(frame, area_hash) for frame in np.unique(table.frame).tolist()]
        database.executemany("INSERT INTO frame_data VALUES (?, ?)", frames)


def write_parquet(path: Path, file: TrajectoryFile) -> None:
    """All rows. Raises InputError: pyarrow is not installed."""
    _require_pyarrow()
    frame = file.table.to_dataframe()
    frame.attrs.update(fps=file.fps, walkable_wkt=file.walkable_wkt)
    frame.to_parquet(path, engine="pyarrow", index=False)


def read_parquet(path: Path) -> TrajectoryFile:
    """A table; a column that is missing is unknown. Raises InputError also: pyarrow is not installed."""
    _require_pyarrow()
    import pandas
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    with expecting(path, "trajectories in Parquet", OSError, ValueError, TypeError, ArrowException):
        with ParquetFile(path) as file:
            refuse_many(path, file.metadata.num_rows)
            names = [name for name in TRACK_COLUMNS if name in file.schema_arrow.names]
        frame = pandas.read_parquet(path, engine="pyarrow", columns=names)
        fps = frame.attrs.get("fps")
        area = frame.attrs.get("walkable_wkt")
        return TrajectoryFile(
            table_of(frame, path),
            None if fps is None else parse_rate(path, fps),
            None if area is None else parse_area(str(area), str(path)),
        )


def _require_pyarrow() -> None:
    if find_spec("pyarrow") is None:
        raise InputError("expected the package pyarrow; install planview[table]")
