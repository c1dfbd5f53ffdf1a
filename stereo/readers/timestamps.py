"""Tables of times: ``timestamps.csv`` of a recording, and lists of a camera's times as other recorders write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.text import reason
from calib.types import F64
from stereo.readers.stamps import read_stamps
from stereo.readers.time_pairs import pair_stamps

LISTS = ("timestamps.txt", "times.txt", "timestamp.txt")
"""Names of lists with one time a line."""
MAX_BYTES = 1 << 28
"""Larger tables are none of frames."""
_FRAME = ("frame", "frame_id", "index", "id")
_TIME = re.compile(r"#?\s*(timestamp|time|stamp|t)s?(?:[ _]?[\[(]?(ns|us|ms|s|sec|nsec|usec|msec)[\])]?)?")
_UNITS = {"sec": "s", "nsec": "ns", "usec": "us", "msec": "ms"}


class StampList(NamedTuple):
    """One time a line, as text."""

    path: Path
    texts: Sequence[str]


class TimeTable(NamedTuple):
    """Times by frame index, and what was found on the way.

    Attributes:
        times_s: (last frame + 1,) float64 [s] since the first row; NaN for frames without a row.
    """

    times_s: F64
    notes: tuple[str, ...]


def load_timestamps(path: Path) -> TimeTable:
    """Times by frame index.

    The unit is recognised from magnitude and steps (``stamps.unit_of``), whatever the column is called; a clock that
    jumps ahead runs on at the nominal rate.

    Args:
        path: CSV with the columns ``frame,timestamp_s`` (also time, timestamp_ns and the like); frames count from 0.
    Raises:
        InputError: unreadable, columns missing, not a number, or times that do not increase with the frame.
    """
    rows, unit = _rows(path)
    try:
        stamps = read_stamps([text for _, text in rows], unit)
    except ValueError as error:
        raise InputError(f"{path}: expected the columns frame,timestamp_s with numbers, found {error}") from error
    frames = [frame for frame, _ in rows]
    in_seconds = np.array([float(text) for _, text in rows]) if stamps.unit == "s" else stamps.ns / 1e9
    seconds = in_seconds - in_seconds[0]
    for i in np.flatnonzero((np.diff(stamps.ns) <= 0) | (np.diff(frames) == 0)):
        raise InputError(
            f"{path}: expected times that increase, found frame {frames[i]} at {seconds[i]:g} s "
            f"and frame {frames[i + 1]} at {seconds[i + 1]:g} s"
        )
    if frames[-1] > 100 * len(rows) + 1000:
        raise InputError(f"{path}: expected frames counted from 0, found frame {frames[-1]} in {len(rows)} rows")
    paired = pair_stamps(stamps.ns, stamps.ns)
    times = np.full(frames[-1] + 1, np.nan)
    times[frames] = paired.times_s if paired.notes else seconds
    note = () if stamps.unit == "s" else (f"times of {path.name} are taken as {_unit_text(stamps.unit)}",)
    return TimeTable(times, (*note, *paired.notes))


def stamp_list(folder: Path) -> StampList | None:
    """The list of times in a folder; None without one.

    Raises:
        InputError: there is one that cannot be read.
    """
    path = next((folder / name for name in LISTS if (folder / name).is_file()), None)
    if path is None:
        return None
    return StampList(path, [_first_field(line) for line in _text(path).splitlines() if line.strip(" \t#") and
                            not line.lstrip().startswith("#")])  # fmt: skip


def _first_field(line: str) -> str:
    """The time of a line: a date with its blank, or what comes before the first blank or comma."""
    line = line.strip()
    return line if re.match(r"\d{4}-\d\d-\d\d ", line) else re.split(r"[\s,;]", line)[0]


def _rows(path: Path) -> tuple[list[tuple[int, str]], str | None]:
    """Frame and time of every row, and the unit that the column names; a column of seconds may hold anything."""
    try:
        reader = csv.DictReader(_text(path).splitlines())
        columns = _columns(path, reader.fieldnames or ())
        rows = [_row(path, row, columns, n) for n, row in enumerate(reader)]
    except csv.Error as error:
        raise InputError(f"{path}: expected the columns frame,timestamp_s, found {error}") from error
    if not rows:
        raise InputError(f"{path}: expected rows of frame,timestamp_s, found none")
    match = _TIME.fullmatch(columns[1].strip().lower())
    unit = match[2] if match else None
    return sorted(rows, key=lambda row: row[0]), None if unit in (None, "s", "sec") else _UNITS.get(unit, unit)


def _columns(path: Path, names: Sequence[str]) -> tuple[str | None, str]:
    frame = next((name for name in names if name.strip().lower() in _FRAME), None)
    time = next((name for name in names if _TIME.fullmatch(name.strip().lower())), None)
    if time is None or (frame is None and len(names) > 2):
        raise InputError(f"{path}: expected the columns frame,timestamp_s with numbers, found {','.join(names)[:80]}")
    return frame, time


def _row(path: Path, row: dict[str, str], columns: tuple[str | None, str], position: int) -> tuple[int, str]:
    frame, time = columns
    text = row[frame] if frame is not None else str(position)
    if text is None or not re.fullmatch(r"\s*\d{1,12}\s*", text) or not row[time]:
        raise InputError(f"{path}: expected the columns frame,timestamp_s with numbers, found {row}")
    return int(text), row[time]


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: expected a table of times, found {path.stat().st_size} bytes")
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a table of times, found {reason(error)}") from error


def _unit_text(unit: str) -> str:
    return "dates" if unit == "date" else unit
