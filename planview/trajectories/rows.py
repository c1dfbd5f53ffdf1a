"""Trajectories in rows of text whose columns a line names: PeTrack and PedPy, simulations, spreadsheets."""

from __future__ import annotations

import math
import re
import warnings
from itertools import takewhile
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.io import UNITS_M, expecting
from calib.times import NS, UNITS, seconds_of
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, checked_rate
from planview.trajectories.table import (
    HEIGHTS_M,
    after_one_another,
    recording_numbers,
    renumbered,
    separators,
    table_of,
)

METRES = {"m": 1.0, "cm": 0.01}
_LENGTHS = {**UNITS_M, **dict.fromkeys(("meter", "meters", "metre", "metres"), 1.0)}
_UNITS = {**_LENGTHS, **{name: NS[unit] / NS["s"] for name, unit in UNITS.items()}}
_RATE = re.compile(r"(?:framerate\s*[:=]?|(?:frame rate|fps)\s*[:=])\s*([^\s,;]+)", re.IGNORECASE)
_STATED = re.compile(rf"(?:\bin\s+|x\s*[/\[(]\s*)({'|'.join(_LENGTHS)})\b", re.IGNORECASE)
_UNIT = re.compile(rf"(?:\s+in)?[\s/_(\[]+({'|'.join(_UNITS)})\s*[)\]]?$", re.IGNORECASE)
_PLACE = (
    "(pos|position|start|coordcent|world|map|floor|ground|cent(er|re))?{}(pos|position|world|map|floor|ground|coord)?"
)
_NAMES = {
    "id": "((ped|pedestrian|pers|person|agent|track|obj|object|human)(s|id|no|nr|number)?)|p?id|no",
    "frame": "(frame|fr)(id|no|nr|number|index|num)?|timestep",
    "time": "t|(sim|global)?time(stamp)?|simsec",
    "x": _PLACE.format("x"), "y": _PLACE.format("y"), "z": _PLACE.format("z") + "|(head|body)?height",
    "visible": "vis(ible|ibility)?",
}  # fmt: skip
"""What programs call the columns of trajectories, in lower case and without units, blanks and signs."""
LABORATORY_FPS = 16.0
LABORATORY_SPAN_CM = 100.0
"""Of the laboratory experiments of Juelich, whose rows no line names: frame rate, and how far people walk at least."""
RATE_HZ = 10.0
"""Frames per second of positions whose times are uneven, between which they are interpolated."""
DAY_S = 86400.0
"""Times that begin later are those of a clock, such as seconds since 1970."""


Columns = dict[str, tuple[int, float | None]]
"""Places of id, frame, time, x, y, z and visible in a row, and their units in metres or seconds, None where they name
none."""


def columns_of(text: str) -> tuple[int, Columns] | None:
    """The first line, from 0, that names an id, a frame or time, x and y, and the columns it names. It may be a comment
    and name units, e.g. "# frame id x/cm y/cm" or "ped_id;time_ms;X_world [m];Y_world [m]"."""
    for number, line in enumerate(text.splitlines()):
        found: Columns = {}
        line = re.sub(r"\s+(?=[(\[])", "", line.strip(" \t#%"))
        for place, cell in enumerate(re.split(r"[;,\t]" if re.search(r"[;,\t]", line) else r"\s+", line)):
            # Viswalk begins its names with "$PEDESTRIAN:", Vadere ends them with "-PID1".
            cell = re.sub(r"^\$\w+:|-PID\d+$", "", cell.strip(" \"'"))
            unit = _UNIT.search(cell)
            plain = re.sub(r"[\s_.-]", "", _UNIT.sub("", cell)).lower()
            role = next((role for role, names in _NAMES.items() if re.fullmatch(names, plain)), None)
            if role and (role not in found or "world" in plain):  # the image may have x and y, too
                found[role] = place, _UNITS[unit[1].lower()] if unit else None
        if {"id", "x", "y"} <= found.keys() and found.keys() & {"frame", "time"}:
            return number, found
    return None


def read_rows(path: Path, start: str) -> TrajectoryFile:
    """Rows of numbers whose columns a line in the ``start`` of the file names: PeTrack, PedPy, simulations and others.

    Comments give the frame rate, and the unit where names have none; simulations, which have times for frames, are in
    metres. Rows without names are what fits best. A z of 0 or less, or none, is no height."""
    comments = "".join(takewhile(lambda line: line[0] == "#" or not line.strip(), start.splitlines(keepends=True)))
    header, columns = columns_of(start) or (-1, {})
    rows = [line for line in start.splitlines()[header + 1 :] if line.strip() and line[0] not in "#*"] or [""]
    between, decimal = separators(rows[0])
    expected = f"rows of {' '.join(columns) or 'id frame x y z'}"
    times, time_unit = columns.get("time", (-1, None))
    dates = ":" in (re.split(between, rows[0])[times : times + 1] or [""])[0]
    with (
        expecting(path, expected, OSError, ValueError),
        warnings.catch_warnings(),
        path.open(encoding="utf-8-sig") as lines,
    ):
        # A file with nothing but comments is an empty table.
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")
        table = np.loadtxt(
            lines if decimal == "." else (line.replace(decimal, ".") for line in lines),
            comments="*" if start.startswith("$") else "#", delimiter=between if between in rows[0] else None,
            skiprows=header + 1 + (header >= 0 and re.search(r"\d", rows[0]) is None),  # Pathfinder's line of units
            usecols=[place for place, _ in columns.values()] or None,
            ndmin=2, dtype=np.float64, quotechar='"',
            converters={times: lambda text: float(seconds_of(path, np.array([text]))[0])} if dates else None,
        )  # fmt: skip
    table = table if len(table) else np.empty((0, len(columns) or 5))
    if table.shape[1] < 4:
        raise InputError(f"{path}: expected the columns id frame x y z, found {table.shape[1]} columns")
    rate = checked_rate(path, found[1]) if (found := _RATE.search(comments)) else None
    unit = _LENGTHS[found[1].lower()] if (found := _STATED.search(comments)) else None
    note = ""
    if not columns:
        columns = dict.fromkeys(_order(table)[: table.shape[1]], (0, None))
        note = f"no line names the columns: taken as {' '.join(columns)}"
        if not comments.strip():
            unit, rate = (METRES["cm"], LABORATORY_FPS) if _is_laboratory(table) else (METRES["m"], None)
            note += f", centimetres, {rate:g} frames per second" if rate else ", metres"
    if "frame" not in columns:
        unit = unit or METRES["m"]
    if unit is None and None in (columns["x"][1], columns["y"][1]):
        raise InputError(f"{path}: expected the unit of x and y in their names or a comment (x/m or x/cm), found none")
    units = {"id": 1.0, "frame": 1.0, "time": 1.0, "visible": 1.0}
    named = zip(columns.items(), table.T, strict=False)
    values = {name: cells * (own or units.get(name, unit)) for (name, (_, own)), cells in named}
    if time_unit in (None, 1.0) and "time" in values:
        values["time"] = seconds_of(path, values["time"])
    names = {"time": "timestamp_s", "x": "x_m", "y": "y_m", "z": "height_m"}
    cells = {names.get(name, name): column for name, column in values.items()}
    if "z" in values:
        cells["height_m"] = np.where(values["z"] > 0, values["z"], np.nan)
    return TrajectoryFile(table_of(cells, path), rate, note=note) if "frame" in cells else _by_time(path, cells)


def _order(table: F64) -> tuple[str, ...]:
    """What (N, 4 or more) rows without names hold: ids are those by which people move least from row to row."""

    def step(ids: F64, frames: F64) -> float:
        order = np.lexsort((frames, ids))
        moved = np.hypot(*np.diff(table[order, 2:4], axis=0).T)[np.diff(ids[order]) == 0]
        return float(np.median(moved)) if len(moved) else math.inf

    exchanged = step(table[:, 1], table[:, 0]) < step(table[:, 0], table[:, 1])
    return (*(("frame", "id") if exchanged else ("id", "frame")), "x", "y", "z")


def _is_laboratory(table: F64) -> bool:
    """Whether such rows are in centimetres, and not in metres: by heights, else by how far people walk."""
    heights = table[:, 4:5][table[:, 4:5] > 0]
    if len(heights):
        return bool(np.median(heights) > HEIGHTS_M[1])
    return bool(np.ptp(table[:, 2:4], axis=0).max(initial=0.0) > LABORATORY_SPAN_CM)


def write_petrack(path: Path, file: TrajectoryFile, unit: str = "m") -> None:
    """Rows with known positions by id, then frame, to 0.1 mm in a unit, "m" or "cm"; an unknown height is ``nan``."""
    table = file.table
    order = np.lexsort((table.frame, table.track_id))
    values = np.column_stack([table.x_m, table.y_m, table.height_m])[order] / METRES[unit]
    rows: F64 = np.column_stack([table.track_id[order], table.frame[order], values])
    digits = "%.4f" if unit == "m" else "%.2f"
    header = f"# framerate: {file.fps:g} fps\n# id frame x/{unit} y/{unit} z/{unit}"
    np.savetxt(path, rows, ["%d", "%d", digits, digits, digits], header=header, comments="")


def _by_time(path: Path, columns: dict[str, F64]) -> TrajectoryFile:
    """Columns with times in place of frames; the time between a person's gives the frames, and where it is uneven
    (Vadere writes footsteps), everything is interpolated."""
    recording = recording_numbers(columns["timestamp_s"], columns["id"])
    if recording.any():
        # Each of them begins a second after the end of the one before.
        times_s = after_one_another(columns["timestamp_s"], recording, 1.0)
        ids = renumbered(columns["id"].astype(np.int64), recording)
        columns = columns | {"timestamp_s": times_s, "id": ids.astype(np.float64)}
    others = [name for name in columns if name not in ("id", "timestamp_s")]
    rows = np.column_stack([columns[name] for name in ("id", "timestamp_s", *others)])
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    steps = np.diff(rows[:, 1])[np.diff(rows[:, 0]) == 0]
    if not (np.isfinite(rows[:, :2]).all() and (steps > 0).any()):
        raise InputError(f"{path}: expected people at several times, found none")
    (begin_s, span_s), note = (float(rows[:, 1].min()), float(np.ptp(rows[:, 1]))), ""
    if recording.any():
        note = f"times begin again: {recording.max() + 1} recordings, whose people have ids of their own"
    if begin_s > DAY_S:
        note = f"times begin at {begin_s:.0f} s: frame 0 is then"
        rows[:, 1] -= begin_s
    period_s = span_s / round(span_s / float(np.median(steps[steps > 0])))  # steps are rounded
    frames = rows[:, 1] / period_s
    if (np.abs(frames - np.round(frames)) > 0.1).any():
        uneven = f"times are uneven: positions are interpolated to {RATE_HZ:g} frames per second"
        note = "; ".join(filter(None, (note, uneven)))
        period_s = 1 / RATE_HZ
        rows = np.concatenate([_even(rows[rows[:, 0] == i]) for i in np.unique(rows[:, 0])])
        frames = rows[:, 1] / period_s
    even = dict(zip(("id", "timestamp_s", *others), rows.T, strict=True)) | {"frame": np.round(frames)}
    del even["timestamp_s"]  # from frames
    return TrajectoryFile(table_of(even, path), 1 / period_s, note=note)


def _even(rows: F64) -> F64:
    """(M, N) rows of one person at even times, from rows that begin with id and time, by time."""
    frames = np.arange(np.ceil(rows[0, 1] * RATE_HZ - 1e-9), np.floor(rows[-1, 1] * RATE_HZ + 1e-9) + 1)
    times = frames / RATE_HZ
    others = [np.interp(times, rows[:, 1], column) for column in rows[:, 2:].T]
    return np.column_stack([np.full(len(times), rows[0, 0]), times, *others])
