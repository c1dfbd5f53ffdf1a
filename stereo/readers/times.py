"""Times of frames as recorders write them: numbers, dates, names of files, tables and lists."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from decimal import Decimal
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import entries, read_text
from calib.times import SLOW_S
from calib.types import F64, I64
from stereo.readers.pairing import pair_stamps

LATEST_S = 4.2e9
"""No clock counts more seconds; larger times are of another unit, whatever their column is called."""
NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}
"""Nanoseconds of a unit."""
_MAX_STEP = {"s": 2, "ms": 2_000, "us": 2_000_000}
"""Steps between frames up to 2 s give the unit of a clock that counts from the start of the machine: two units differ
by a factor of 1000, the periods of cameras (1 to 250 Hz) by 250."""
_NUMBER = re.compile(r"[+-]?\d{1,20}(\.\d{0,30})?([eE][+-]?\d{1,2})?")
_DATE = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\d*(?:Z|\+00:?00)?")
_DAY = re.compile(r"\d{4}-\d\d-\d\d ")
_NAMED_DAY = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)[-_T. ]{0,2}([0-2]\d)[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)"
    r"(?:[-_.,]?(\d{1,9}))?(?!\d)"
)
_NAME = re.compile(r"(?<![\d.])(\d{7,20}(?:\.\d{1,9}|_\d{6,9})?|\d{1,6}\.\d{2,9})(?![\d.])")


class Stamps(NamedTuple):
    """Times of one camera's frames in the order of the recording: (n,) int64 [ns] by the recorder's clock, and the unit
    in which they were written: "ns", "us", "ms", "s" or "date"."""

    ns: I64
    unit: str


def read_stamps(source: Path, texts: Sequence[str], unit: str | None = None) -> Stamps:
    """Times from the text of a source, exactly: all numbers, or all dates as ISO 8601 writes them (UTC); the unit of
    numbers is recognised from their magnitude and steps where the file does not name it."""
    dates = [match for text in texts if (match := _DATE.fullmatch(text.strip()))]
    if texts and len(dates) == len(texts):
        # Of a date the whole seconds and the digits behind them.
        days = [(datetime.fromisoformat(match[1]).replace(tzinfo=UTC), match[2] or "0") for match in dates]
        unit, values = "date", [round(day.timestamp()) * NS["s"] + int(digits.ljust(9, "0")) for day, digits in days]
    else:
        numbers = [_number(text, source) for text in texts]
        if unit is None or (unit == "s" and max(map(abs, numbers), default=0) > LATEST_S):
            unit = unit_of(numbers)
        values = [int(number * NS[unit]) for number in numbers]
    if beyond := [text for text, value in zip(texts, values, strict=True) if abs(value) > 2**62]:
        raise InputError(f"{source}: expected times, found {beyond[0][:40]!r} ({unit})")
    return Stamps(np.array(values, dtype=np.int64), unit)


def unit_of(numbers: Sequence[Decimal]) -> str:
    """The unit of times: of a clock that was set by their magnitude, else by their median step."""
    largest = max((abs(number) for number in numbers), default=Decimal(0))
    for unit, ns in NS.items():
        if 9.0e8 <= float(largest) * ns / 1e9 <= LATEST_S:  # seconds since 1970 of the years 1998 to 2103
            return unit
    steps = np.abs(np.diff(np.array([float(number) for number in numbers])))
    steps = steps[steps > 0]
    if not steps.size:
        return "s"
    step = float(np.median(steps))
    return next((unit for unit, most in _MAX_STEP.items() if step <= most), "ns")


def stamps_in_names(stems: Sequence[str]) -> Stamps | None:
    """Times that the names of files hold: dates with a time of day, or one number each, with a decimal part, as large
    as only a clock counts, or in the even but not equal steps of milliseconds; None where the names number the frames
    instead, or hold no number."""
    if len(stems) < 2:
        return None
    days = [_NAMED_DAY.findall(stem) for stem in stems]
    if all(len(found) == 1 for found in days):
        texts = ["{}-{}-{} {}:{}:{}.{:0<1}".format(*found[0]) for found in days]
    else:
        found = [_NAME.findall(stem) or re.findall(r"\d+", stem)[-1:] for stem in stems]
        if any(len(numbers) != 1 for numbers in found):
            return None
        texts = _of_one_width([numbers[0].replace("_", ".") for numbers in found])
        if any(text.startswith("00") for text in texts):
            return None  # a counter with leading zeros
        steps = [b - a for a, b in pairwise(sorted(map(Decimal, texts)))]
        short = all(len(text) < 7 and text.isdecimal() for text in texts)
        if set(steps) in ({Decimal(1)}, {Decimal(0)}) or (
            short and not _as_milliseconds([int(step) for step in steps])
        ):
            return None
    with suppress(InputError):  # larger than any clock counts
        stamps = read_stamps(Path(), texts)
        # Names that hold whole seconds only order the frames.
        return stamps if len(set(stamps.ns.tolist())) > 0.5 * len(stems) else None
    return None


def _as_milliseconds(steps: Sequence[int]) -> bool:
    """Whether numbers step as a clock of milliseconds does, 33, 33, 34; a counter with gaps steps by multiples."""
    common, usual = math.gcd(*steps), float(np.median(steps))
    even = np.mean([abs(step - usual) <= 0.1 * usual + 1 for step in steps])
    return len(steps) >= 5 and 4 <= usual <= 2000 and common < 0.5 * min(steps) and bool(even >= 0.8)


def _of_one_width(texts: Sequence[str]) -> list[str]:
    """Times whose parts behind the point were written without leading zeros (seconds and nanoseconds of two numbers)
    with these zeros, where that makes their steps more even."""
    parts = [text.partition(".") for text in texts]
    width = max(len(rest) for _, _, rest in parts)
    if width < 6 or all(len(rest) == width for _, _, rest in parts):
        return list(texts)
    padded = [f"{whole}.{rest.zfill(width)}" for whole, _, rest in parts]

    def unevenness(numbers: Sequence[str]) -> float:
        return float(np.std(np.diff(sorted(float(Decimal(number) - Decimal(parts[0][0])) for number in numbers))))

    return min(list(texts), padded, key=unevenness)


def _number(text: str, source: Path) -> Decimal:
    text = text.strip()
    if not _NUMBER.fullmatch(text) or abs(Decimal(text)) > 10**19:
        raise InputError(f"{source}: expected a time, found {text[:40]!r}")
    return Decimal(text)


LISTS = ("timestamps.txt", "times.txt", "timestamp.txt")
"""Names of lists with one time a line."""
_WORDS = re.compile(r"(frames?_?)?(time_?stamps?|times?|stamps?|ts)")
MAX_BYTES = 1 << 25
"""Larger files are no tables of frames: half a day at 30 Hz fills this."""
_FRAME = ("frame", "frame_id", "frame_number", "frame_no", "frame_index", "index", "idx", "id", "seq", "n")
_TIME = re.compile(r"#?\s*(timestamp|time|stamp|t)s?(?:[ _]?[\[(]?(ns|us|ms|s|sec|nsec|usec|msec)[\])]?)?")
_UNITS = {"nsec": "ns", "usec": "us", "msec": "ms", "sec": "s", "ns": "ns", "us": "us", "ms": "ms", "s": "s"}


class TimeTable(NamedTuple):
    """(last frame + 1,) float64 [s] by frame index since the first row, NaN for frames without one; and what was found
    on the way."""

    times_s: F64
    notes: tuple[str, ...]


def load_timestamps(path: Path) -> TimeTable:
    """Times by frame index, from 0, in a CSV with the columns ``frame,timestamp_s`` (also time, timestamp_ns and the
    like). The unit is the one that the column names, else it is recognised from magnitude and steps (``unit_of``); a
    clock that jumps ahead runs on at the nominal rate."""
    rows, unit = _rows(path)
    stamps = read_stamps(path, [text for _, text in rows], unit)
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
    unit = "dates" if stamps.unit == "date" else stamps.unit
    note = () if unit == "s" else (f"times of {path.name} are taken as {unit}",)
    if len(seconds) > 1 and float(np.median(np.diff(seconds))) > SLOW_S:
        note = (f"another unit in {path.name}? The column's name gives it: timestamp_s, _ms, _us or _ns",)
    return TimeTable(times, (*note, *paired.notes))


def stamp_list(folder: Path) -> tuple[Path, list[str]] | None:
    """The list of times in a folder and its entries as text, one a line; None without one."""
    path = _list_in(folder)
    return None if path is None else (path, _listed(path))


def _list_in(folder: Path) -> Path | None:
    return next((folder / name for name in LISTS if (folder / name).is_file()), None)


def _listed(path: Path) -> list[str]:
    """The time in each line: a date with its blank, or what comes before the first blank or comma, but for a number of
    the frame."""
    lines = [line.strip() for line in read_text(path, "a list of times", MAX_BYTES).splitlines()]
    rows = [[line] if _DAY.match(line) else re.split(r"[\s,;]+", line) for line in lines if line and line[0] != "#"]
    counted = all(len(row) > 1 and row[0] in (str(i), str(i + 1)) for i, row in enumerate(rows))
    return [row[1] if counted else row[0] for row in rows]


def files_of_times(folder: Path, camera: str = "", suffixes: Sequence[str] = (".csv", ".txt")) -> list[Path]:
    """Tables and lists with a word for times in their names, next to that of a camera where one is named."""
    files = (f for f in entries(folder) if f.suffix.lower() in suffixes and f.is_file())
    parts = {f: re.split(r"[-_. ]", f.stem.lower()) for f in files}
    named = re.split(r"[-_. ]", camera.lower()) if camera else []
    return [f for f, own in parts.items() if any(map(_WORDS.fullmatch, own)) and set(named) <= set(own)]


def camera_times(at: Path, folder: Path, count: int) -> Path | None:
    """The file with the times of one camera: in its own folder, or in the recording's under the camera's name
    (left/timestamps.csv, left_timestamps.csv, or left.csv with a time for each of ``count`` frames)."""
    inside = files_of_times(at) if at.is_dir() and at != folder else []
    alike = [folder / f"{at.stem}{suffix}" for suffix in (".csv", ".txt")]
    listed = (f for f in alike if f.is_file() and len(_listed(f)) in (count, count + 1))
    return next(iter([*inside, *files_of_times(folder, at.stem), *listed]), None)


def read_times(path: Path, count: int) -> Stamps:
    """The times of ``count`` frames, of a list or of a table with a line of names. Raises InputError: of others."""
    texts, unit = _listed(path), None
    if texts and not _NUMBER.fullmatch(texts[0]) and not _DATE.fullmatch(texts[0]):
        rows, unit = _rows(path)
        texts = [text for _, text in rows]
    if len(texts) != count:
        raise InputError(f"{path}: expected a time for each of {count} images, found {len(texts)}")
    return read_stamps(path, texts, unit)


def stamps_of(files: Sequence[Path], at: Path, folder: Path) -> Stamps | None:
    """Times of the images of a camera: of its own file of times, of the list of all, or in their names; None without.
    Raises InputError: a list of another length."""
    listed = camera_times(at, folder, len(files)) or _list_in(folder)
    return read_times(listed, len(files)) if listed else stamps_in_names([file.stem for file in files])


def unused_times(folder: Path, used: Path | None) -> tuple[str, ...]:
    """A note on files of times in a recording other than the one used."""
    places = [folder, *(place for place in entries(folder) if place.is_dir())] if folder.is_dir() else []
    kinds = (".csv", ".txt", ".tsv", ".json", ".npy", ".yaml")
    found = [str(f.relative_to(folder)) for place in places for f in files_of_times(place, "", kinds) if f != used]
    why = f"the times of {used.name} count" if used else "each camera needs times of its own, or all timestamps.csv"
    return (f"not used: {', '.join(found[:4])} ({why})",) if found else ()


def _rows(path: Path) -> tuple[list[tuple[int, str]], str | None]:
    """Frame and time of every row, and the unit that the column names."""
    expected = f"{path}: expected the columns frame,timestamp_s with numbers"
    rows: list[tuple[int, str]] = []
    try:
        text = read_text(path, "a table of times", MAX_BYTES)
        if ";" in text.partition("\n")[0]:  # as spreadsheets write tables where the comma is the decimal point
            text = text.replace(",", ".").replace(";", ",")
        lines = csv.reader(StringIO(text, newline=""))
        names = [name.strip().lower() for name in next(lines, [])]
        frame = next((i for i, name in enumerate(names) if name in _FRAME), None)
        time = next((i for i, name in enumerate(names) if _TIME.fullmatch(name)), None)
        if time is None or (frame is None and len(names) > 2):
            raise InputError(f"{expected}, found {','.join(names)[:80] or 'an empty file'}")
        for row in filter(None, lines):
            text = str(len(rows)) if frame is None else row[frame] if frame < len(row) else ""
            if not re.fullmatch(r"\s*\d{1,12}\s*", text) or time >= len(row) or not row[time]:
                raise InputError(f"{expected}, found {','.join(row)[:80]!r} in line {lines.line_num}")
            rows.append((int(text.strip()), row[time].strip()))
    except csv.Error as error:
        raise InputError(f"{path}: expected the columns frame,timestamp_s, found {error}") from error
    if not rows:
        raise InputError(f"{path}: expected rows of frame,timestamp_s, found none")
    return sorted(rows, key=lambda row: row[0]), _UNITS.get(_TIME.sub(r"\2", names[time]))
