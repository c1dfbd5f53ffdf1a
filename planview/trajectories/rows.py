"""Trajectories in rows of text whose columns a line names: PeTrack and PedPy, simulations, spreadsheets."""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import UNITS_M, expecting
from calib.times import NS, UNITS, seconds_of
from calib.types import F64
from planview.trajectories.clock import at_times
from planview.trajectories.file import TrajectoryFile, parse_rate
from planview.trajectories.table import (
    HEIGHTS_M,
    after_one_another,
    recording_numbers,
    renumber,
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
"""Names that programs have for the columns of trajectories, in lower case and without units, blanks and signs."""
_COLUMNS = {"time": "timestamp_s", "x": "x_m", "y": "y_m", "z": "height_m"}
LABORATORY_FPS = 16.0
LABORATORY_SPAN_CM = 100.0
"""Frame rate of the laboratory experiments of Juelich, whose rows no line names, and how far people walk at least."""
RATE_HZ = 10.0
"""Frames per second of positions whose times are uneven, between which they are interpolated."""
DAY_S = 86400.0
"""Times that begin later are those of a clock, such as seconds since 1970."""
STEPS_S = (1e-4, 20.0)
"""Times between a person's rows of any recording or simulation: others are days, minutes or milliseconds."""


class Column(NamedTuple):
    """The place of a column in a row, and its unit in metres or seconds, None where it names none."""

    place: int
    unit: float | None = None


def columns_of(text: str) -> tuple[int, dict[str, Column]] | None:
    """The first line, from 0, that names an id, a frame or time, x and y, and the columns it names. It may be a comment
    and name units, e.g. "# frame id x/cm y/cm" or "ped_id;time_ms;X_world [m];Y_world [m]"."""
    for number, line in enumerate(text.splitlines()):
        columns = _named_columns(line)
        if {"id", "x", "y"} <= columns.keys() and columns.keys() & {"frame", "time"}:
            return number, columns
    return None


def _named_columns(line: str) -> dict[str, Column]:
    columns: dict[str, Column] = {}
    line = re.sub(r"\s+(?=[(\[])", "", line.strip(" \t#%"))
    separator = r"[;,\t]" if re.search(r"[;,\t]", line) else r"\s+"
    for place, cell in enumerate(re.split(separator, line)):
        # Viswalk begins its names with "$PEDESTRIAN:", Vadere ends them with "-PID1".
        name = re.sub(r"^\$\w+:|-PID\d+$", "", cell.strip(" \"'"))
        unit = _UNIT.search(name)
        plain = re.sub(r"[\s_.-]", "", _UNIT.sub("", name)).lower()
        for role, pattern in _NAMES.items():
            is_first = role not in columns or "world" in plain  # the image may have x and y, too
            if is_first and re.fullmatch(pattern, plain):
                columns[role] = Column(place, _UNITS[unit[1].lower()] if unit else None)
                break
    return columns


def read_rows(path: Path, start: str) -> TrajectoryFile:
    """Rows of numbers whose columns a line in the ``start`` of the file names: PeTrack, PedPy, simulations and others.

    Comments give the frame rate, and the unit where names have none; simulations, which have times for frames, are in
    metres. Rows without names are what fits best. A z of 0 or less counts as unknown."""
    comments = re.match(r"(?:[ \t\r]*\n|#.*\n?)*", start)[0]  # type: ignore[index]
    header, columns = columns_of(start) or (-1, {})
    table = _read_numbers(path, start, header + 1, columns)
    rate_text = _RATE.search(comments)
    rate = parse_rate(path, rate_text[1]) if rate_text else None
    unit_text = _STATED.search(comments)
    unit = _LENGTHS[unit_text[1].lower()] if unit_text else None
    note = ""
    if not columns:
        columns = dict.fromkeys(_order(table)[: table.shape[1]], Column(0))
        note = f"no line names the columns: taken as {' '.join(columns)}"
        if not comments.strip():
            unit = METRES["m"]
            note += ", metres"
            if _is_laboratory(table):
                unit = METRES["cm"]
                rate = LABORATORY_FPS
                note = note.replace("metres", f"centimetres, {rate:g} frames per second")
    unit = columns["x"].unit or unit
    if unit is None:
        if "frame" in columns:
            raise InputError(
                f"{path}: expected the unit of x and y in their names or a comment (x/m or x/cm), found none"
            )
        unit = METRES["m"]
    cells = {}
    for (role, column), values in zip(columns.items(), table.T, strict=False):
        if role in ("x", "y", "z"):
            values = values * (column.unit or unit)
        elif role == "time":
            values = values * column.unit if column.unit not in (None, 1.0) else seconds_of(path, values)
        cells[_COLUMNS.get(role, role)] = values
    if "z" in columns:
        cells["height_m"] = np.where(cells["height_m"] > 0, cells["height_m"], np.nan)
    if "frame" in cells:
        return TrajectoryFile(table_of(cells, path), rate, note=note)
    return _by_time(path, cells)


def _read_numbers(path: Path, start: str, first: int, columns: dict[str, Column]) -> F64:
    """(N, M) numbers of the columns, or of all where none is named, from a line of the file on; dates are seconds."""
    rows = [line for line in start.splitlines()[first:] if line.strip() and line[0] not in "#*"] or [""]
    if columns and not re.search(r"\d", rows[0]):
        first += 1  # Pathfinder's line of units
    between, decimal = separators(rows[0])

    def number(text: str) -> float:
        try:
            return float(text.replace(decimal, "."))
        except ValueError:
            return float(seconds_of(path, np.array([text]))[0])

    expected = f"rows of {' '.join(columns) or 'id frame x y z'}"
    with expecting(path, expected, OSError, ValueError), warnings.catch_warnings():
        # A file with nothing but comments is an empty table.
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")
        table = np.loadtxt(
            path, comments="*" if start.startswith("$") else "#", delimiter=between if between in rows[0] else None,
            skiprows=first, usecols=[column.place for column in columns.values()] or None, ndmin=2, quotechar='"',
            encoding="utf-8-sig", converters=number,
        )  # fmt: skip
    if not len(table):
        return np.empty((0, len(columns) or 5))
    if table.shape[1] < 4:
        raise InputError(f"{path}: expected the columns id frame x y z, found {table.shape[1]} columns")
    return table


def _order(table: F64) -> tuple[str, ...]:
    """The columns of (N, 4 or more) rows without names: ids are those by which people move least from row to row."""
    if _usual_step(table, 1, 0) < _usual_step(table, 0, 1):
        return ("frame", "id", "x", "y", "z")
    return ("id", "frame", "x", "y", "z")


def _usual_step(table: F64, ids: int, frames: int) -> float:
    """Distance that people move from row to row if these are the columns of ids and frames."""
    rows = table[np.lexsort((table[:, frames], table[:, ids]))]
    steps = np.hypot(np.diff(rows[:, 2]), np.diff(rows[:, 3]))[np.diff(rows[:, ids]) == 0]
    return float(np.median(steps)) if len(steps) else math.inf


def _is_laboratory(table: F64) -> bool:
    """True if such rows are in centimetres, and not in metres: by heights, else by how far people walk."""
    heights = table[:, 4:5][table[:, 4:5] > 0]
    if len(heights):
        return bool(np.median(heights) > HEIGHTS_M[1])
    return bool(np.ptp(table[:, 2:4], axis=0).max(initial=0.0) > LABORATORY_SPAN_CM)


def write_petrack(path: Path, file: TrajectoryFile, unit: str = "m") -> None:
    """Rows with known positions by id, then frame, to 0.1 mm in a unit, "m" or "cm"; an unknown height is ``nan``."""
    table = file.table
    values = np.column_stack([table.x_m, table.y_m, table.height_m]) / METRES[unit]
    rows: F64 = np.column_stack([table.track_id, table.frame, values])[np.lexsort((table.frame, table.track_id))]
    digits = "%.4f" if unit == "m" else "%.2f"
    header = f"# framerate: {file.fps:g} fps\n# id frame x/{unit} y/{unit} z/{unit}"
    np.savetxt(path, rows, ["%d", "%d", digits, digits, digits], header=header, comments="")


def _by_time(path: Path, columns: dict[str, F64]) -> TrajectoryFile:
    """Columns with times in place of frames; the time between a person's gives the frames, and where it is uneven
    (Vadere writes footsteps), everything is interpolated."""
    track_id = columns["id"].astype(np.int64)
    times_s = columns["timestamp_s"]
    notes = []
    recording = recording_numbers(times_s, track_id)
    if recording.any():
        # Each of them begins a second after the end of the one before.
        times_s = after_one_another(times_s, recording, 1.0)
        track_id = renumber(track_id, recording)
        notes.append(f"times begin again: {recording.max() + 1} recordings, whose people have ids of their own")
    order = np.lexsort((times_s, track_id))
    ids = track_id[order]
    times_s = times_s[order]
    steps_s = np.diff(times_s)[np.diff(ids) == 0]
    if not (np.isfinite(times_s).all() and (steps_s > 0).any()):
        raise InputError(f"{path}: expected people at several times, found none")
    span_s = float(np.ptp(times_s))
    begin_s = times_s.min()
    if begin_s > DAY_S:
        notes = [f"times begin at {begin_s:.0f} s: frame 0 is then"]
        times_s = times_s - begin_s
    steps_s = steps_s[steps_s > 0]
    step_s = float(np.mean(steps_s[steps_s < 1.5 * np.median(steps_s)]))  # rounded ones are right in the mean
    if not STEPS_S[0] < step_s < STEPS_S[1]:
        raise InputError(f"{path}: people's rows are {step_s:.3g} s apart; name the unit of the times, such as time_ms")
    period_s = span_s / round(span_s / step_s)
    frames = times_s / period_s
    is_even = (np.abs(frames - np.round(frames)) <= 0.1).all()
    ticks = np.round(frames if is_even else 1e3 * times_s)
    others = {name: values[order] for name, values in columns.items()}
    table = table_of({**others, "id": ids, "frame": ticks, "timestamp_s": times_s}, path)
    if not is_even:
        notes.append(f"times are uneven: positions are interpolated to {RATE_HZ:g} frames per second")
        period_s = 1 / RATE_HZ
        grid = np.arange(math.floor(RATE_HZ * times_s.min()), math.ceil(RATE_HZ * times_s.max()) + 1)
        table = at_times(table, grid, grid * period_s)
    return TrajectoryFile(table, 1 / period_s, note="; ".join(notes), is_timed=True)
