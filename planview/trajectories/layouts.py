"""Trajectories in JSON lines, and in files that are no text: the Ped Data Archive (HDF5), JuPedSim (SQLite), Parquet.

Every reader takes a path and raises InputError: unreadable, damaged, not what its format asks for, or too large.
"""

from __future__ import annotations

import hashlib
import json
import math
import mmap
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from calib.errors import InputError
from calib.io import expecting
from calib.types import F64, AnyArray
from planview.trajectories.file import TrajectoryFile, checked_area, checked_rate, refuse_many
from planview.trajectories.state import SURE_FACING
from planview.trajectories.table import (
    LAST_COLUMNS,
    NUMBER_COLUMNS,
    STATES,
    TRACK_COLUMNS,
    Trajectories,
    row_states,
    table_of,
)

LINE_MAX = 10_000_000
"""Most characters of a line: a frame of 50,000 people."""
_VALUES = ("x_m", "y_m", "vx_mps", "vy_mps", "height_m")


def stream_jsonl(out: IO[str], table: Trajectories) -> None:
    """JSON lines: one per frame that has rows; what is unknown is null."""
    frames, first = np.unique(table.frame, return_index=True)
    ends = np.searchsorted(table.frame, frames, side="right")
    for frame, start, end in zip(frames.tolist(), first.tolist(), ends.tolist(), strict=True):
        people = [
            {name.removeprefix("track_"): _known(value) for name, value in vars(person).items()}
            for person in row_states(table, slice(start, end))
        ]
        line = {"frame": frame, "timestamp_s": _known(float(table.timestamp_s[start])), "people": people}
        out.write(json.dumps(line) + "\n")


def read_jsonl(path: Path) -> TrajectoryFile:
    """JSON lines; a last one that is cut short (the writer was interrupted) is left out."""
    numbers: list[list[float]] = []
    states: list[str] = []
    with expecting(path, "JSON lines", OSError, UnicodeDecodeError), path.open(encoding="utf-8") as file:
        for line, text in enumerate(iter(lambda: file.readline(LINE_MAX), ""), 1):
            try:
                frame = json.loads(text, parse_constant=_refuse) if text.strip() else {"people": ()}
            except (ValueError, RecursionError) as error:
                if not text.endswith("\n") and len(text) < LINE_MAX and line > 1:
                    break
                raise InputError(f"{path}: expected JSON in line {line}, found {error}") from error
            try:
                for person in frame["people"]:
                    numbers.append(_numbers(frame, person))
                    states.append(person.get("state", "confirmed"))
                    if states[-1] not in STATES:
                        raise ValueError(f"the state {str(states[-1])[:40]!r}")
            except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
                found = f"no {error}" if isinstance(error, KeyError) else error
                raise InputError(f"{path}: expected a frame with people in line {line}, found {found}") from error
    table: F64 = np.array(numbers, dtype=np.float64).reshape(-1, len(NUMBER_COLUMNS))
    columns = dict(zip(NUMBER_COLUMNS, table.T, strict=True))
    return TrajectoryFile(table_of({**columns, "state": np.array(states, dtype=np.str_)}, path))


def _numbers(frame: dict[str, Any], person: dict[str, Any]) -> list[float]:
    """The NUMBER_COLUMNS of one person."""
    box = person.get("box_px") or [None] * 4
    if len(box) != 4:
        raise ValueError(f"a box of {len(box)} numbers")
    values = (*(person.get(name) for name in _VALUES), *box, *(person.get(name) for name in LAST_COLUMNS))
    cells = (frame["frame"], frame.get("timestamp_s"), person["id"], *values)
    return [math.nan if cell is None else float(cell) for cell in cells]


def _known(value: Any) -> Any:
    """The value; None where it is, or holds, NaN."""
    cells = value if isinstance(value, tuple) else (value,)
    return None if any(cell != cell for cell in cells) else value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"the constant {constant}")


_ROW = {"id": "<i8", "frame": "<i8", "x": "<f8", "y": "<f8", "z": "<f8"}
_SCHEMA = """
CREATE TABLE trajectory_data (frame INTEGER NOT NULL, id INTEGER NOT NULL, pos_x REAL NOT NULL, pos_y REAL NOT NULL,
    ori_x REAL NOT NULL, ori_y REAL NOT NULL);
CREATE TABLE metadata (key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE geometry (wkt TEXT NOT NULL, hash INTEGER NOT NULL DEFAULT 0);
CREATE TABLE frame_data (frame INTEGER NOT NULL, geometry_hash INTEGER NOT NULL);
CREATE INDEX frame_id_idx ON trajectory_data (frame, id);
"""


SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEAP = b"GCOL\x01\0\0\0"
"""First bytes of a global heap, which holds strings (format specification, III.E); its size and objects follow."""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The file, to read. Raises OSError, RuntimeError: unreadable, or another file. ValueError: a damaged heap of
    strings: libhdf5 2.0 and before walk in place over an object of no size."""
    import h5py  # a tenth of a second, and only these files need it

    with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as data:
        sizes = data[13:15] if data[8:9] in (b"\0", b"\1") else data[9:11]
        if data[:8] != SIGNATURE or sizes != b"\x08\x08":  # bytes of an address and of a length
            raise ValueError("another file")
        start = data.find(_HEAP)
        while start >= 0:
            (size,) = struct.unpack("<Q", data[start + 8 : start + 16].ljust(8, b"\0"))  # a file may end in it
            end = min(start + size, len(data))
            place = start + 16
            while place + 16 <= end:  # object 0 is what is free, header included
                number, length = struct.unpack_from("<H6xQ", data, place)
                step = 16 + (length + 7) // 8 * 8 if number else length
                if not 0 < step <= end - place:
                    raise ValueError(f"a damaged heap of strings at byte {place}")
                place += step
            start = data.find(_HEAP, start + 1)
    with h5py.File(path, "r") as file:
        yield file


def read_ped_data_archive(path: Path) -> TrajectoryFile:
    """HDF5 of the Ped Data Archive; a z of 0 or less, or none, is no height."""
    import h5py  # a tenth of a second, and only these files need it

    with (
        expecting(path, "an HDF5 file of the Ped Data Archive", OSError, KeyError, ValueError, TypeError, RuntimeError),
        opened(path) as file,
    ):
        trajectory = file.get("trajectory")
        if not isinstance(trajectory, h5py.Dataset):
            found = ", ".join(file)[:200] or "nothing"
            raise InputError(f"{path}: expected the dataset 'trajectory', found {found}")
        names = trajectory.dtype.names or ()
        if {"id", "frame", "x", "y"} - set(names) or trajectory.ndim != 1:
            found = ", ".join(names) or "none"
            raise InputError(f"{path}: expected a list with the fields id, frame, x, y, found {found}")
        refuse_many(path, len(trajectory))
        rows: AnyArray = trajectory[:]
        fps = checked_rate(path, trajectory.attrs.get("fps"))
        area = file.attrs.get("wkt_geometry")
    columns = {"id": rows["id"], "frame": rows["frame"], "x_m": rows["x"], "y_m": rows["y"]}
    if "z" in names:
        columns["height_m"] = np.where(rows["z"] > 0, rows["z"], np.nan)
    text = area.decode("utf-8", "replace") if isinstance(area, bytes) else area
    return TrajectoryFile(table_of(columns, path), fps, None if text is None else checked_area(str(text), str(path)))


def write_ped_data_archive(path: Path, file: TrajectoryFile) -> None:
    """Rows with known positions by id, then frame."""
    import h5py

    table = file.table
    order = np.lexsort((table.frame, table.track_id))
    rows = np.empty(len(table), dtype=list(_ROW.items()))
    for name, column in zip(_ROW, (table.track_id, table.frame, table.x_m, table.y_m, table.height_m), strict=True):
        rows[name] = column[order]
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
        kinds = database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
        tables = {name for name, sql in kinds if not str(sql).upper().startswith("CREATE VIRTUAL")}
        if not {"trajectory_data", "metadata"} <= tables:
            found = ", ".join(sorted(tables)) or "none"
            raise InputError(f"{path}: expected the tables trajectory_data and metadata, found {found}")
        metadata = dict(database.execute("SELECT key, value FROM metadata LIMIT 100").fetchall())
        if str(metadata.get("version")) not in ("1", "2"):
            raise InputError(f"{path}: expected version 1 or 2, found {metadata.get('version')!r}")
        refuse_many(path, int(database.execute("SELECT count(*) FROM trajectory_data").fetchone()[0]))
        cells = database.execute("SELECT frame, id, pos_x, pos_y FROM trajectory_data").fetchall()
        columns = zip(("frame", "id", "x_m", "y_m"), np.array(cells, dtype=object).reshape(-1, 4).T, strict=True)
        rows = table_of(dict(columns), path)
        fps = checked_rate(path, metadata.get("fps"))
        area = "SELECT DISTINCT wkt FROM geometry LIMIT 100" if "geometry" in tables else "SELECT NULL"
        areas = [checked_area(str(wkt), str(path)) for (wkt,) in database.execute(area).fetchall() if wkt]
        all_areas = f"GEOMETRYCOLLECTION ({', '.join(areas)})" if len(areas) > 1 else "".join(areas) or None
        return TrajectoryFile(rows, fps, all_areas)


def write_jupedsim(path: Path, file: TrajectoryFile) -> None:
    """Rows with known positions; the orientation is where a person surely faces, else the direction of the velocity,
    (0, 0) where both are unknown."""
    table = file.table
    area = file.walkable_wkt or ""
    area_hash = int.from_bytes(hashlib.sha256(area.encode()).digest()[:8], "big", signed=True)
    speed = np.hypot(*table.velocity_mps.T)[:, None]
    heading = np.where(speed > 0, table.velocity_mps / np.where(speed > 0, speed, 1.0), 0.0)
    facing = np.radians(table.facing_deg)[:, None]
    sure = np.isfinite(facing) & ~(table.facing_confidence < SURE_FACING)[:, None]
    heading = np.where(sure, np.hstack([np.cos(facing), np.sin(facing)]), heading)
    rows = zip(*(c.tolist() for c in (table.frame, table.track_id, table.x_m, table.y_m, *heading.T)), strict=True)
    metadata = [("version", "2"), ("fps", f"{file.fps!r}")]
    for axis, values in (("x", table.x_m), ("y", table.y_m)) if len(table) else ():
        metadata += [(f"{axis}min", f"{values.min()}"), (f"{axis}max", f"{values.max()}")]
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(_SCHEMA)
        database.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?, ?, ?)", rows)
        database.executemany("INSERT INTO metadata VALUES (?, ?)", metadata)
        database.execute("INSERT INTO geometry VALUES (?, ?)", (area, area_hash))
        frames = [(int(frame), area_hash) for frame in np.unique(table.frame)]
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
            None if fps is None else checked_rate(path, fps),
            None if area is None else checked_area(str(area), str(path)),
        )


def _require_pyarrow() -> None:
    if find_spec("pyarrow") is None:
        raise InputError("expected the package pyarrow; install planview[table]")
