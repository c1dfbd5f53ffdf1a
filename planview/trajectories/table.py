"""``tracks.csv`` and ``truth.csv``: trajectories on disk and as columns."""

from __future__ import annotations

import csv
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from calib.errors import InputError
from calib.io import expecting, reason, require_file
from calib.times import doubts, is_time, period_of, run_on, seconds_of
from calib.types import F64, I64, AnyArray, Bool
from planview.trajectories.state import TrackState

if TYPE_CHECKING:
    from pandas import DataFrame

KEY_MAX = 2**53
"""Largest frame number or id that a float64 holds exactly."""
WordColumn = np.ndarray[tuple[int], np.dtype[np.str_]]
TRACK_COLUMNS = (
    "frame", "timestamp_s", "id", "x_m", "y_m", "vx_mps", "vy_mps", "height_m", "state",
    "left_px", "top_px", "width_px", "height_px", "facing_deg", "facing_confidence", "confidence", "std_m",
)  # fmt: skip
DECIMALS = (None, 4, None, *[4] * 5, None, *[1] * 5, 3, 4, 4)
"""Of each column as it is written: 0.1 mm, 0.1 ms, 0.1 px, 0.1 degrees, 0.01 or 0.1 %; None where it is no fraction."""
NUMBER_COLUMNS = tuple(name for name in TRACK_COLUMNS if name != "state")
COLUMNS = (*TRACK_COLUMNS, "visible")
BOX_COLUMNS = TRACK_COLUMNS[9:13]
LAST_COLUMNS = TRACK_COLUMNS[13:]
TRUTH_COLUMNS = ("frame", "id", "x_m", "y_m", "height_m")
STATES = ("tentative", "confirmed", "lost")
PERSON_S = 0.5
"""A track is a person once it is confirmed for so long in all [s]. Flickers of foreground are shorter,
people who cross the view are observed for longer."""
HEIGHTS_M = (0.3, 3.0)
FASTEST_MPS = 6.0
SPAN_MIN_M = 0.3
IDS_PER_FRAME_MAX = 10
"""Beyond these a table does not hold people: the smallest and the tallest, the fastest marathon, the room that two of
them need, and how many of a crowd pass in a frame."""
IGNORED = -1.0
"""``visible`` of a truth row that never counts: a distractor of a benchmark."""


def table_of(columns: Mapping[str, Any] | DataFrame, source: Path | str) -> Trajectories:
    """A table of columns named as in ``tracks.csv``, and "visible", with rows in any order; a column that is missing is
    unknown, and rows without a state are "confirmed". Messages name their source. Raises InputError: no frame, id, x_m
    or y_m, values that are not what a column holds, or two rows of one frame and id."""
    for name in ("frame", "id", "x_m", "y_m"):
        if name not in columns:
            raise InputError(f"{source}: expected the column {name!r}, found {', '.join(map(str, columns)) or 'none'}")
    known = {name: np.asarray(columns[name]) for name in COLUMNS if name in columns}
    if "timestamp_s" in known:
        known["timestamp_s"] = seconds_of(source, known["timestamp_s"])
    names = *NUMBER_COLUMNS, "visible"
    with expecting(source, "numbers in the columns of tracks", TypeError, ValueError, OverflowError):
        unknown = np.full(len(known["frame"]), np.nan)
        numbers = np.stack([np.asarray(known.get(name, unknown), dtype=np.float64) for name in names])
    frames, timestamp_s, ids, x_m, y_m, vx_mps, vy_mps, height_m, *others, visible = numbers
    given = known.get("state", unknown).astype(np.str_)
    states = np.where(np.isin(given, ("nan", "None")), "confirmed", given)
    if foreign := set(states.tolist()) - set(STATES):
        raise InputError(f"{source}: expected a state of {', '.join(STATES)}, found {min(foreign)!r}")
    keys = np.stack([frames, ids])
    if len(odd := keys[~((np.abs(keys) <= KEY_MAX) & (keys == np.round(keys)))]):
        raise InputError(f"{source}: expected whole numbers up to {KEY_MAX} for frame and id, found {odd[0]:g}")
    visible[np.isnan(visible)] = 1.0
    if len(odd := visible[(visible != IGNORED) & ~((visible >= 0) & (visible <= 1))]):
        raise InputError(f"{source}: expected shares of 0 to 1 in the column 'visible', found {odd[0]:g}")
    frame, track_id = _recordings_apart(keys.astype(np.int64), source)
    box_px = np.column_stack(others[:4])
    velocity_mps = np.column_stack([vx_mps, vy_mps])
    rows = Trajectories(
        frame, track_id, timestamp_s, x_m, y_m, height_m, states.astype("<U9"), visible, box_px, velocity_mps,
        *others[4:],
    )  # fmt: skip
    table = rows.where(np.lexsort((track_id, frame)))
    twice = (np.diff(table.frame) == 0) & (np.diff(table.track_id) == 0)
    if twice.any():
        where = f"frame {table.frame[1:][twice][0]}, id {table.track_id[1:][twice][0]}"
        raise InputError(f"{source}: expected one row per frame and id, found two for {where}")
    return table


def _recordings_apart(keys: I64, source: Path | str) -> I64:
    """(2, N) frames and ids of recordings that follow one another, each with frames after those of the one before and
    with ids of its own, and a warning; rows that repeat a frame and id otherwise stay."""
    frame, track_id = keys
    recording = recording_numbers(frame, track_id)
    if not recording.any():
        return keys
    frame = after_one_another(frame, recording, 1)
    track_id = renumbered(track_id, recording)
    lowest = np.abs(track_id[recording > 0]).min()
    warnings.warn(
        f"{source}: frames begin again, so another recording follows from frame {frame[recording > 0].min()} on: its "
        f"people get ids of their own, from {lowest} on",
        stacklevel=3,
    )
    return np.stack([frame, track_id])


def recording_numbers(moment: I64 | F64, track_id: I64 | F64) -> I64:
    """(N,) number from 0 of the recording of each row, by (N,) frames or times and ids in the order of a file: another
    one begins where moments go back and then repeat those of ids, for more than one moment."""
    numbers = np.zeros(len(moment), dtype=np.int64)
    goes_back = np.diff(moment, prepend=moment[:1]) < 0
    keys_so_far = set[tuple[float, float]]()
    for rows in np.split(np.arange(len(moment)), np.flatnonzero(goes_back)):
        keys = set(zip(moment[rows].tolist(), track_id[rows].tolist(), strict=True))
        if len(keys) < len(rows):
            return np.zeros_like(numbers)  # the same row twice
        if keys & keys_so_far:
            if len(np.unique(moment[rows[0] :])) < 2:
                return np.zeros_like(numbers)
            numbers[rows[0] :] += 1
            keys_so_far = set()
        keys_so_far |= keys
    return numbers


def after_one_another(moment: AnyArray, recording: I64, step: float) -> AnyArray:
    """(N,) frames or times of which each recording's begin a step after the end of the one before."""
    shifted = moment.copy()
    for number in range(1, int(recording.max(initial=0)) + 1):
        shifted[recording == number] += shifted[recording == number - 1].max() + step
    return shifted


def renumbered(track_id: I64, recording: I64) -> I64:
    """(N,) ids of which none is used in two recordings, by the (N,) numbers of these from 0; the first one's stay."""
    step = int(np.abs(track_id).max(initial=0)) + 1
    sign = np.where(track_id < 0, -1, 1)
    return sign * (np.abs(track_id) + step * recording)


def separators(text: str) -> tuple[str, str]:
    """What stands between the cells of the first lines of a table, and in its fractions: spreadsheets of some countries
    write 1,5 between semicolons or tabs."""
    between = next((separator for separator in "\t;" if separator in text), ",")
    return between, "," if between != "," and re.search(r"\d,\d", text) else "."


def _read(file: Path | str, required: Sequence[str], what: str) -> Trajectories:
    path = Path(file)
    require_file(path, f"a {what} file")
    missing: list[str] = []
    between = ","
    decimal = "."
    try:
        first, *rows = path.read_text(encoding="utf-8-sig").split("\n")
        between, decimal = separators(first + "".join(rows[:1]))
        names = next(csv.reader([first], delimiter=between), [])
        if missing := [name for name in required if name not in names]:
            raise InputError(f"{path}: expected a {what} file with the column {missing[0]!r}, found {names}")
        kinds = {name: "U16" if name == "state" else "f8" for name in COLUMNS if name in names}
        if "timestamp_s" in kinds and ":" in rows[0]:  # dates
            kinds["timestamp_s"] = "U40"
        kinds.setdefault(names[-1], "U1")  # a row that is cut short lacks its last cell at least
        empty = re.compile(f"{between}(?= *({between}|$))")
        # With a separator before it the first cell is one like the others. Pandas takes half a second to import.
        filled = [empty.sub(f"{between}nan", between + row.replace(decimal, ".")) for row in rows if row.strip()]
        cells = np.empty(0, [*kinds.items()])
        if filled:
            places = [1 + names.index(name) for name in kinds]
            cells = np.loadtxt(filled, cells.dtype, None, between, usecols=places, ndmin=1, quotechar='"')
        return table_of({name: cells[name] for name in COLUMNS if name in kinds}, path)
    except (OSError, ValueError, csv.Error, InputError) as error:
        if not missing and (fault := _first_fault(path, between, decimal)):
            raise InputError(f"{path}: {fault}") from error
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: expected a {what} file, found {reason(error)}") from error


def _first_fault(path: Path, between: str, decimal: str) -> str:
    """The first row of a table that is cut short or has a cell that is not what its column holds; empty where there is
    none."""
    with suppress(OSError, UnicodeDecodeError, csv.Error), path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, delimiter=between)
        names = next(reader, [])
        for row in filter(None, reader):
            if len(row) < len(names):
                return f"expected {len(names)} cells in line {reader.line_num}, found fewer"
            for name, cell in zip(names, row, strict=False):
                if expected := _expected(name, cell.strip().replace(decimal, ".")):
                    return f"expected {expected}, line {reader.line_num}, found {cell!r}"
    return ""


def _expected(name: str, cell: str) -> str:
    """What a cell should be; empty where it is."""
    if name == "state":
        return "" if cell in ("", *STATES) else f"a state of {', '.join(STATES)}"
    if name == "timestamp_s" and is_time(cell):
        return ""
    try:
        whole = float(cell or "nan") % 1 == 0 or name not in ("frame", "id")
    except ValueError:
        return f"a number in {name!r}" if name in COLUMNS else ""
    return "" if whole else f"a whole number in {name!r}"


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Rows of a tracks or truth file, as columns of equal length (N,), sorted by frame then id.

    Attributes:
        frame, track_id: int64.
        timestamp_s, x_m, y_m, height_m: float64, NaN where unknown.
        state: (N,) of "tentative", "confirmed" or "lost"; "confirmed" throughout for truth.
        visible: unoccluded fraction 0..1 of a truth row, or IGNORED; 1 for tracks.
        box_px, velocity_mps: (N, 4) left, top, width, height and (N, 2), float64; NaN where unknown.
        facing_deg: float64, where the chest points on the floor: 0 along X, 90 along Y, -180 to 180; NaN where unknown.
        facing_confidence: float64, how probably ``facing_deg`` is not back to front, 0.5 to 1; NaN where unknown.
        confidence, std_m: float64, the probability that somebody is there, and the standard deviation of the place
            along each axis [m]; NaN where unknown.
        first_frame: first frame that was tracked, which may show nobody.
        n_frames: frames of the recording up to the last one that was tracked, where that is known; it may show nobody.
    """

    frame: I64
    track_id: I64
    timestamp_s: F64
    x_m: F64
    y_m: F64
    height_m: F64
    state: WordColumn
    visible: F64
    box_px: F64
    velocity_mps: F64
    facing_deg: F64
    facing_confidence: F64
    confidence: F64
    std_m: F64
    first_frame: int = 0
    n_frames: int | None = None

    @property
    def tracked(self) -> tuple[int, int] | None:
        """First and last frame that were tracked, where that is known."""
        if self.n_frames is None:
            return None
        return self.first_frame, max(self.first_frame, self.n_frames - 1)

    def __len__(self) -> int:
        return len(self.frame)

    def where(self, keep: Bool | I64) -> Trajectories:
        """The rows where a (N,) mask is true, or those of (M,) indices in that order; itself where all are kept."""
        if keep.dtype == np.bool_ and keep.all():
            return self
        return replace(self, **{name: getattr(self, name)[keep] for name in ROW_FIELDS})

    def __repr__(self) -> str:
        span = f", frames {self.frame.min()} to {self.frame.max()}" if len(self) else ""
        return f"Trajectories({len(self)} rows of {len(people_of(self))} people{span})"

    def _repr_html_(self) -> str:
        return str(self.where(np.arange(min(5, len(self)))).to_dataframe().to_html())

    @staticmethod
    def from_dataframe(frame: DataFrame) -> Trajectories:
        """The rows of a DataFrame with columns of ``tracks.csv``, at least ``frame``, ``id``, ``x_m`` and ``y_m``; rows
        are "confirmed" without a state. Raises InputError: a column is missing, or values that do not belong."""
        whole = {name: frame.attrs[name] for name in WHOLE_FIELDS if name in frame.attrs}
        return replace(table_of(frame, "DataFrame"), **whole)

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with the columns of ``tracks.csv`` (``TRACK_COLUMNS``), a row per person and frame."""
        import pandas

        states = pandas.Series(self.state, dtype="str")
        box = self.box_px.T
        velocity = self.velocity_mps.T
        place = self.x_m, self.y_m, *velocity, self.height_m
        last = (getattr(self, name) for name in LAST_COLUMNS)
        columns = (self.frame, self.timestamp_s, self.track_id, *place, states, *box, *last)
        table = pandas.DataFrame(dict(zip(TRACK_COLUMNS, columns, strict=True)))
        table.attrs = {name: getattr(self, name) for name in WHOLE_FIELDS}
        return table


WHOLE_FIELDS = ("first_frame", "n_frames")
ROW_FIELDS = tuple(name for name in Trajectories.__dataclass_fields__ if name not in WHOLE_FIELDS)
"""What a table holds for all of its rows, and for every row."""


def positions_table(
    frame: I64, track_id: I64, xy_m: F64, height_m: F64 | None = None, timestamp_s: F64 | None = None,
    box_px: F64 | None = None, visible: F64 | None = None,
) -> Trajectories:  # fmt: skip
    """A table of confirmed rows from arrays of length N; what is not given is unknown."""
    columns = {"frame": frame, "id": track_id, "x_m": xy_m[:, 0], "y_m": xy_m[:, 1], "height_m": height_m}
    columns |= {"timestamp_s": timestamp_s, "visible": visible}
    columns |= {} if box_px is None else dict(zip(BOX_COLUMNS, box_px.T, strict=True))
    return table_of({name: values for name, values in columns.items() if values is not None}, "tracks")


def concatenated(tables: Sequence[Trajectories]) -> Trajectories:
    """The rows of at least one table together, sorted by frame, then id."""
    joined = {name: np.concatenate([getattr(t, name) for t in tables]) for name in ROW_FIELDS}
    table = replace(tables[0], **joined, first_frame=0, n_frames=None)
    order = np.lexsort((table.track_id, table.frame))
    return table if (np.diff(order) == 1).all() else table.where(order)


def rows_by_id(track_id: I64) -> Iterator[tuple[int, I64]]:
    """Every id with its rows in order, by rising id."""
    order = np.argsort(track_id, kind="stable")
    ids, starts = np.unique(track_id[order], return_index=True)
    return zip(ids.tolist(), np.split(order, starts[1:]), strict=False)


def write_header(file: IO[str]) -> None:
    file.write(",".join(TRACK_COLUMNS) + "\n")


def _row(frame: int, timestamp_s: float, track: TrackState) -> tuple[Any, ...]:
    """The cells of TRACK_COLUMNS."""
    place = track.x_m, track.y_m, track.vx_mps, track.vy_mps, track.height_m
    last = (getattr(track, name) for name in LAST_COLUMNS)
    return frame, timestamp_s, track.track_id, *place, track.state, *track.box_px, *last


def write_rows(file: IO[str], frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
    """Append one frame's tracks; an unknown value is an empty cell."""
    for track in tracks:
        cells = zip(_row(frame, timestamp_s, track), DECIMALS, strict=True)
        file.write(",".join(str(c) if n is None else "" if math.isnan(c) else f"{c:.{n}f}" for c, n in cells) + "\n")


def write_table(file: IO[str], table: Trajectories) -> None:
    """All of ``tracks.csv``: the header and every row."""
    write_header(file)
    people = row_states(table, slice(None))
    for frame, time_s, person in zip(table.frame.tolist(), table.timestamp_s.tolist(), people, strict=True):
        write_rows(file, frame, time_s, [person])


def row_states(table: Trajectories, rows: slice) -> list[TrackState]:
    """Rows as a tracker gave them."""
    columns = (table.track_id, table.state, table.x_m, table.y_m, *table.velocity_mps.T, table.height_m)
    numbers = [column[rows].tolist() for column in columns]
    last = [getattr(table, name)[rows].tolist() for name in LAST_COLUMNS]
    return [TrackState(*cells) for cells in zip(*numbers, map(tuple, table.box_px[rows].tolist()), *last, strict=True)]


class TrajectoryCollector:
    """Gathers tracks in memory, with the values that ``write_rows`` and ``read_tracks`` would give."""

    def __init__(self) -> None:
        self._rows: list[list[Any]] = []

    def add(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
        """Take one frame's tracks; every (frame, id) once."""
        for track in tracks:
            cells = zip(_row(frame, timestamp_s, track), DECIMALS, strict=True)
            self._rows.append([c if n is None or math.isnan(c) else round(c, n) for c, n in cells])

    def trajectories(self) -> Trajectories:
        """Everything gathered so far, rounded as in ``tracks.csv`` (DECIMALS)."""
        columns = zip(*self._rows, strict=True) if self._rows else [()] * len(TRACK_COLUMNS)
        return table_of(dict(zip(TRACK_COLUMNS, columns, strict=True)), "tracks")


def read_tracks(path: Path | str) -> Trajectories:
    """Read ``tracks.csv``. Raises InputError: unreadable, columns missing, or a value that is not what its column
    holds."""
    return _read(path, TRUTH_COLUMNS[:4], "tracks")


def read_truth(path: Path | str) -> Trajectories:
    """Read ``truth.csv`` (same errors as ``read_tracks``)."""
    return _read(path, TRUTH_COLUMNS, "truth")


def frame_times(table: Trajectories) -> tuple[I64, F64]:
    """(F,) frames of which a row has a time, ascending, and their times [s]."""
    known = np.isfinite(table.timestamp_s)
    frames, first = np.unique(table.frame[known], return_index=True)
    return frames, table.timestamp_s[known][first]


def frame_period_s(table: Trajectories, fallback_s: float) -> float:
    """Median time per frame [s] over rows with timestamps: the mean where most frames share one, ``fallback_s`` where
    fewer than two frames have one or time stands."""
    return period_of(*frame_times(table), fallback_s)


def with_times_judged(table: Trajectories) -> tuple[Trajectories, tuple[str, ...]]:
    """The table with times that run on where they begin again, and what is odd about them, a sentence each."""
    frames, times = frame_times(table)
    judged, notes = run_on(times, frames)
    if notes:
        table = replace(table, timestamp_s=np.interp(table.frame, frames, judged))
    return table, (*notes, *doubts(frames, judged))


def frame_step(frames: I64) -> int:
    """The usual distance of (N,) rising frame numbers: above 1 where only about every n-th frame was looked at, and 1
    of fewer than two."""
    return max(1, int(np.median(np.diff(frames)))) if len(frames) > 1 else 1


def ordinal(number: int) -> str:
    """2nd, 3rd, 4th, 11th, 21st."""
    last = 0 if number % 100 in (11, 12, 13) else number % 10
    return f"{number}{('th', 'st', 'nd', 'rd')[last] if last < 4 else 'th'}"


def doubt(table: Trajectories) -> str:
    """What no people are or do, in a sentence: of another unit, rate or order of columns; empty where there is none.
    A table without times is taken as one of two frames per second at least."""
    known = table.where((table.state == "confirmed") & np.isfinite(table.x_m) & np.isfinite(table.y_m))
    ids = len(np.unique(known.track_id))
    frames = len(np.unique(known.frame))
    heights = list[float]()
    speeds = list[float]()
    found = list[str]()
    times = known.frame * frame_period_s(known, PERSON_S)
    for _, rows in rows_by_id(known.track_id):
        rows = rows[np.unique(times[rows] // PERSON_S, return_index=True)[1]]  # longer than positions flicker
        sizes = known.height_m[rows][np.isfinite(known.height_m[rows])]
        heights += [float(np.median(sizes))] if len(sizes) else []
        steps = np.hypot(np.diff(known.x_m[rows]), np.diff(known.y_m[rows])) / np.diff(times[rows])
        speeds += [float(np.median(steps))] if len(steps) else []
    for values, (low, high), unit in ((heights, HEIGHTS_M, "m tall"), (speeds, (0.0, FASTEST_MPS), "m/s fast")):
        if odd := [value for value in values if not low <= value <= high]:
            found.append(f"{len(odd)} of {ids} people would be {np.median(odd):.3g} {unit}")
    if ids > 1 and (span := max(np.ptp(known.x_m), np.ptp(known.y_m))) < SPAN_MIN_M:
        found.append(f"all {ids} people would be within {span:.2g} m")
    if frames > 1 and ids > IDS_PER_FRAME_MAX * frames:
        found.append(f"{ids} people would pass in {frames} frames")
    return f"{', '.join(found)}: another unit, frame rate or order of columns?" if found else ""


def is_person(confirmed_s: F64) -> Bool:
    """(N,) whether tracks that were confirmed for so long in all [s] are people; times are rounded."""
    return confirmed_s >= 0.99 * PERSON_S


def people_of(tracks: Trajectories, frame_s: float | None = None) -> I64:
    """(P,) ids of the people, ascending: tracks confirmed for at least PERSON_S, at ``frame_s`` [s] a frame or the rate
    of the rows. Where people have rows in every n-th frame only, a row stands for n frames."""
    if frame_s is None:
        frame_s = frame_period_s(tracks, 1 / 30)
    order = np.lexsort((tracks.frame, tracks.track_id))
    is_same = np.diff(tracks.track_id[order]) == 0
    steps = np.diff(tracks.frame[order])[is_same]
    row_s = frame_s * (max(1.0, float(np.median(steps))) if len(steps) else 1.0)
    ids, rows = np.unique(tracks.track_id[tracks.state == "confirmed"], return_counts=True)
    return ids[is_person(rows.astype(np.float64) * row_s)]
