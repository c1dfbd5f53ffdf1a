"""Times of frames as recorders write them: names of images, lists and tables. ``calib.times`` reads them."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import entries, expecting, read_text
from calib.times import NS, SLOW_S, UNITS, Stamps, clock_is_set, is_time, read_stamps, within_seconds
from calib.types import F64, I64

_NAMED_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?([01]\d)[-_.]?([0-3]\d)[-_T. ]{0,2}([0-2]\d)[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)"
    r"(?:[-_.,]?(\d{1,9}))?(?!\d)"
)
_NAMED_NUMBER = re.compile(r"(?<![\d.])(?:(\d{7,20})(?:[-_.](\d{1,9}))?|(\d{1,6})\.(\d{2,9}))(?![\d.])")


def stamps_in_names(stems: Sequence[str]) -> Stamps | None:
    """Times that the names of files hold: dates with a time of day, and numbers with decimals or as large as only
    a clock counts. None where names number the frames, or hold no number."""
    if len(stems) < 2:
        return None
    for pattern, read in ((_NAMED_DATE, _of_dates), (_NAMED_NUMBER, _of_numbers)):
        matches = [list(pattern.finditer(stem)) for stem in stems]
        count = len(matches[0])
        if any(len(each) != count for each in matches):
            continue
        for place in reversed(range(count)):
            stamps = None
            with suppress(InputError):  # more than any clock counts
                stamps = read([each[place] for each in matches])
            # Whole seconds only order the frames.
            if stamps is not None and len(set(stamps.ns.tolist())) > 0.5 * len(stems):
                return stamps
    return None


def _of_dates(matches: Sequence[re.Match[str]]) -> Stamps | None:
    dates = ["{}-{}-{} {}:{}:{}".format(*match.groups()) for match in matches]
    seconds = read_stamps("", dates).ns // NS["s"]
    return _with_parts(seconds, [match[7] for match in matches], matches)


def _of_numbers(matches: Sequence[re.Match[str]]) -> Stamps | None:
    wholes = [match[1] or match[3] for match in matches]
    if any(whole.startswith("00") for whole in wholes):
        return None  # a counter with leading zeros
    if read_stamps("", wholes).unit == "s":
        parts = [match[2] or match[4] for match in matches]
        return _with_parts(np.array(wholes, dtype=np.int64), parts, matches)
    texts = [match[0] for match in matches]
    have_points = all("." in text for text in texts)
    return _read_unless_counter(texts if have_points else wholes)


def _read_unless_counter(texts: Sequence[str]) -> Stamps | None:
    """Times, unless whole numbers rise by one from frame to frame."""
    stamps = read_stamps("", texts)
    steps = np.diff(np.sort(stamps.ns)) / NS[stamps.unit]
    return None if np.median(steps) <= 1 else stamps


def _with_parts(seconds: I64, parts: Sequence[str | None], matches: Sequence[re.Match[str]]) -> Stamps | None:
    """Times of whole seconds and the numbers within them, which follow at once, else at the end of the name."""
    have_points = any(parts) and all(re.search(r"[.,]\d+$", match[0]) for match in matches)
    if not any(parts):
        parts = [(re.findall(r"\d+", match.string[match.end() :]) or [None])[-1] for match in matches]
    if not any(parts):
        is_counter = np.median(np.diff(np.sort(seconds))) <= 1
        return None if is_counter else Stamps(seconds * NS["s"], "s")
    decimals = within_seconds(seconds.tolist(), [part or "0" for part in parts], may_count=not have_points)
    if decimals is None:
        return None
    nanoseconds = np.array([int(part[:9].ljust(9, "0")) for part in decimals], dtype=np.int64)
    return Stamps(seconds * NS["s"] + nanoseconds, "s")


LISTS = ("timestamps.txt", "times.txt", "timestamp.txt")
"""Names of lists with one time a line."""
MAX_BYTES = 1 << 25
"""Size above which a file is not read as a table of frames: half a day at 30 Hz fills this."""
_WORDS = re.compile(r"(frames?_?)?(time_?stamps?|times?|stamps?|ts)")
_FRAME = re.compile(r"frame|(frame_?)?(id|number|no|index|idx)|seq|n")
_TIME = re.compile(rf"(?:date_?time|timestamp|time|stamp|t)s?(?:[ _]?[\[(]?({'|'.join(UNITS)})[\])]?)?")
_BLANK = re.compile(r"(?<=[-/]\d\d) +(?=\d\d:)")
"""Between a date and its time of day."""


class Row(NamedTuple):
    """A line of a list or table of frames: its number, from 1, and its cells."""

    line: int
    cells: list[str]


def read_rows(path: Path, what: str) -> list[Row]:
    """The lines of a file that are neither empty nor a comment, cut into cells at commas, semicolons or tabs, else at
    blanks. Raises InputError: no text, or too large."""
    rows: list[Row] = []
    between = ""
    for number, line in enumerate(read_text(path, what, MAX_BYTES).split("\n"), 1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        if not rows:
            between = next((mark for mark in "\t;," if mark in line), "")
        if between == ";":  # as spreadsheets write tables where the comma is the decimal point
            line = line.replace(",", ".")
        if between:
            with expecting(path, what, csv.Error):
                cells = next(csv.reader([line], delimiter=between, skipinitialspace=True))
        else:
            cells = _BLANK.sub("T", line).split()
        rows.append(Row(number, [cell.strip() for cell in cells]))
    return rows


class TimedRows(NamedTuple):
    """Contents of a list or table of times: the number of each frame, None where there is none, the times as they are
    written, and their unit where the file names it."""

    path: Path
    frames: list[int] | None
    texts: list[str]
    unit: str | None = None

    @property
    def stamps(self) -> Stamps:
        """The times."""
        return read_stamps(self.path, self.texts, self.unit)


def timed_rows(path: Path) -> TimedRows:
    """The rows of a list, with a time in each line, behind the number of its frame where it has one; or of a table,
    whose first line names its columns. Raises InputError: a row without a time, or a table without such columns."""
    rows = read_rows(path, "a table of times")
    cells = [row.cells for row in rows]
    if cells and not is_time(cells[0][0]):
        return _table(path, [name.lower() for name in cells[0]], rows[1:])
    firsts = [row[0] for row in cells]
    if _count_rows(cells):
        return TimedRows(path, [int(first) for first in firsts], [row[1] for row in cells])
    if all(len(row) == 2 and ":" in row[0] and row[1].isdecimal() for row in cells):  # as Python's logs write them
        return TimedRows(path, None, [".".join(row) for row in cells])
    return TimedRows(path, None, firsts)


def _count_rows(rows: Sequence[Sequence[str]]) -> bool:
    """True if the first of several cells counts the frames: whole numbers that rise by one, but for gaps."""
    if not all(len(cells) > 1 and cells[0].isdecimal() and is_time(cells[1]) for cells in rows):
        return False
    steps = np.diff([int(cells[0]) for cells in rows])
    return not len(steps) or (np.median(steps) == 1 and bool((steps > 0).all()))


def _table(path: Path, names: Sequence[str], rows: Sequence[Row]) -> TimedRows:
    """The frames and times of a table whose columns have names."""
    frame = next((i for i, name in enumerate(names) if _FRAME.fullmatch(name)), None)
    time = next((i for i, name in enumerate(names) if _TIME.fullmatch(name)), None)
    if time is None:
        raise InputError(f"{path}: expected the columns frame,timestamp_s, found {','.join(names)[:80]}")
    if not rows:
        raise InputError(f"{path}: expected rows of frame,timestamp_s, found none")
    frames: list[int] = []
    for line, cells in rows:
        number = f"{len(frames)}" if frame is None else "".join(cells[frame : frame + 1])
        if not re.fullmatch(r"\d{1,18}(\.0*)?", number) or not "".join(cells[time : time + 1]):
            raise InputError(f"{path}: expected a frame and its time in line {line}, found {','.join(cells)[:80]!r}")
        frames.append(int(number.partition(".")[0]))
    unit = _TIME.sub(r"\1", names[time])
    return TimedRows(path, frames, [row.cells[time] for row in rows], UNITS.get(unit))


class TimeTable(NamedTuple):
    """(n,) float64 [s] by frame since the first row, NaN for frames without one; and what was found on the way."""

    times_s: F64
    notes: tuple[str, ...]


def load_timestamps(path: Path, numbers: Sequence[int], there: Sequence[int]) -> TimeTable:
    """Times of the frames of a recording in a table. Where the clock was set, they run on at the usual rate.

    Args:
        numbers: of every frame, by which a table may call it.
        there: positions of the frames that have an image.
    """
    rows = timed_rows(path)
    ns, unit = rows.stamps
    if len(ns) == 0:
        raise InputError(f"{path}: expected a frame and its time in each line, found none")
    frames, notes = _positions(rows, ns, np.array(numbers, dtype=np.int64), np.array(there, dtype=np.int64))
    order = np.argsort(frames, kind="stable")
    frames = frames[order]
    seconds = np.asarray((ns[order] - ns[order[0]]) / NS["s"])
    steps = np.diff(seconds)
    apart = np.diff(frames)
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    jumps = clock_is_set(steps, period)
    for i in np.flatnonzero((steps <= 0) & ~jumps | (apart == 0)):
        pair = " and ".join(f"frame {frames[k]} at {seconds[k]:g} s" for k in (i, i + 1))
        raise InputError(f"{path}: expected times that increase, found {pair}")
    for i in np.flatnonzero(jumps):
        notes.append(f"the clock jumps by {steps[i]:+.6g} s after frame {frames[i]}: times run on at the usual rate")
    seconds[1:] -= np.cumsum(np.where(jumps, steps - period * apart, 0.0))
    times = np.full(max(len(numbers), int(frames[-1]) + 1), np.nan)
    times[frames] = seconds
    if len(steps) and float(np.median(np.diff(seconds))) > SLOW_S:
        notes.insert(0, f"another unit in {path.name}? The column's name gives it: timestamp_s, _ms, _us or _ns")
    elif unit != "s":
        notes.insert(0, f"times of {path.name} are taken as {'dates' if unit == 'date' else unit}")
    return TimeTable(times, tuple(notes))


def _positions(rows: TimedRows, ns: I64, numbers: I64, there: I64) -> tuple[I64, list[str]]:
    """The frame to which each row belongs, and a note: its frames may be numbered as the images are, from 0, from 1, or
    by a camera's counter. Raises InputError: none of these."""
    frames = np.arange(len(ns)) if rows.frames is None else np.array(rows.frames, dtype=np.int64)
    first = int(frames.min())
    last = int(frames.max())
    is_run = last - first == len(frames) - 1
    same_names = bool(np.isin(frames, numbers).all())
    if len(frames) == len(there) and (is_run or not same_names):
        in_order = bool((np.diff(ns) > 0).all())
        order = np.arange(len(frames)) if in_order else np.argsort(np.argsort(frames, kind="stable"))
        if same_names:
            return there[order], []
        span = f"from {first}" if is_run else f"from {first} to {last}, with gaps"
        return there[order], [f"frames of {rows.path.name} are counted {span}: its rows are the images in order"]
    if same_names:
        order = np.argsort(numbers)
        return order[np.searchsorted(numbers, frames, sorter=order)], []
    if last < len(numbers) or (is_run and first == 0):
        return frames, []
    if first == 1 and last == len(numbers):
        return frames - 1, [f"frames of {rows.path.name} are counted from 1"]
    raise InputError(
        f"{rows.path}: expected a row for each of {len(there)} images, found {len(frames)} rows for frames {first} to "
        f"{last}: number the frames from 0, in the order of the images"
    )


def list_in(folder: Path) -> Path | None:
    """The list of times in a folder, None without one."""
    return next((folder / name for name in LISTS if (folder / name).is_file()), None)


def files_of_times(folder: Path, camera: str = "", suffixes: Sequence[str] = (".csv", ".txt")) -> list[Path]:
    """Tables and lists with a word for times in their names, next to that of a camera where one is named."""
    camera_words = set(re.split(r"[-_. ]", camera.lower())) if camera else set()
    files = []
    for file in entries(folder):
        words = re.split(r"[-_. ]", file.stem.lower())
        if file.suffix.lower() in suffixes and file.is_file() and camera_words <= set(words):
            files += [file] if any(map(_WORDS.fullmatch, words)) else []
    return files


def camera_times(at: Path, folder: Path, count: int) -> Path | None:
    """The file with the times of one camera: in its own folder, or in the recording's under the camera's name
    (left/timestamps.csv, left_timestamps.csv, or left.csv with a time for each of ``count`` frames)."""
    inside = files_of_times(at) if at.is_dir() and at != folder else []
    alike = [folder / f"{at.stem}{suffix}" for suffix in (".csv", ".txt")]
    listed = (file for file in alike if file.is_file() and len(read_rows(file, "times")) in (count, count + 1))
    return next(iter([*inside, *files_of_times(folder, at.stem), *listed]), None)


def read_times(path: Path, count: int) -> Stamps:
    """The times of ``count`` frames, of a list or of a table with a line of names. Raises InputError: of others."""
    rows = timed_rows(path)
    if len(rows.texts) != count:
        raise InputError(f"{path}: expected a time for each of {count} images, found {len(rows.texts)}")
    return rows.stamps


def stamps_of(files: Sequence[Path], at: Path, folder: Path) -> Stamps | None:
    """Times of the images of a camera: of its own file of times, of the list of all, or in their names; None without.
    Raises InputError: a list of another length."""
    listed = camera_times(at, folder, len(files)) or list_in(folder)
    return read_times(listed, len(files)) if listed else stamps_in_names([file.stem for file in files])


def unused_times(folder: Path, used: Path | None) -> tuple[str, ...]:
    """A note on files of times in a recording other than the one used."""
    if not folder.is_dir():
        return ()
    found = []
    for place in (folder, *filter(Path.is_dir, entries(folder))):
        files = files_of_times(place, "", (".csv", ".txt", ".tsv", ".json", ".npy", ".yaml"))
        found += [str(file.relative_to(folder)) for file in files if file != used]
    if not found:
        return ()
    why = f"the times of {used.name} count" if used else "each camera needs times of its own, or all timestamps.csv"
    return (f"not used: {', '.join(found[:4])} ({why})",)
