"""``tracks.csv`` and ``truth.csv``: trajectories on disk and as columns."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from calib.errors import InputError
from calib.io import expecting, require_file
from calib.times import NS, doubts, is_time, period_of, run_on, seconds_of
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
"""Decimals of each column: 0.1 mm, 0.1 ms, 0.1 px, 0.1 degrees, 0.01 or 0.1 %; None for whole numbers."""
_ROW = ",".join("%s" if decimals is None else f"%.{decimals}f" for decimals in DECIMALS) + "\n"
NUMBER_COLUMNS = tuple(name for name in TRACK_COLUMNS if name != "state")
COLUMNS = (*TRACK_COLUMNS, "visible")
TIMES = {"timestamp_s": "s"} | {f"{name}_{unit}": unit for unit in NS for name in ("timestamp", "time")}
TIMES |= dict.fromkeys(("timestamp", "time"), "s")
"""Columns of times with their unit, the first that there is counts; without a unit, seconds unless too many."""
BOX_COLUMNS = TRACK_COLUMNS[9:13]
LAST_COLUMNS = TRACK_COLUMNS[13:]
NEEDED = ("frame", "id", "x_m", "y_m")
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
    for name in NEEDED:
        if name not in columns:
            raise InputError(f"{source}: expected the column {name!r}, found {', '.join(map(str, columns)) or 'none'}")
    cells = {name: np.asarray(columns[name]) for name in COLUMNS if name in columns}
    for name in [name for name in TIMES if name in columns][:1]:
        cells["timestamp_s"] = seconds_of(source, np.asarray(columns[name]), TIMES[name])
    unknown = np.full(len(cells["frame"]), np.nan)
    with expecting(source, "numbers in the columns of tracks", TypeError, ValueError, OverflowError):
        number = {name: np.array(cells.get(name, unknown), np.float64) for name in (*NUMBER_COLUMNS, "visible")}
    state = cells.get("state", unknown).astype(np.str_)
    state[np.isin(state, ("nan", "None"))] = "confirmed"
    visible = number["visible"]
    visible[np.isnan(visible)] = 1.0
    keys = np.stack([number["frame"], number["id"]])
    _refuse_values(keys, state, visible, source)
    frame, track_id = _recordings_apart(keys.astype(np.int64), source)
    box_px = np.column_stack([number[name] for name in BOX_COLUMNS])
    velocity_mps = np.column_stack([number["vx_mps"], number["vy_mps"]])
    rows = Trajectories(
        frame, track_id, number["timestamp_s"], number["x_m"], number["y_m"], number["height_m"], state.astype("<U9"),
        visible, box_px, velocity_mps, number["facing_deg"], number["facing_confidence"], number["confidence"],
        number["std_m"],
    )  # fmt: skip
    table = rows.where(np.lexsort((track_id, frame)))
    is_repeated = (np.diff(table.frame) == 0) & (np.diff(table.track_id) == 0)
    if is_repeated.any():
        second = 1 + np.argmax(is_repeated)
        where = f"frame {table.frame[second]}, id {table.track_id[second]}"
        raise InputError(f"{source}: expected one row per frame and id, found two for {where}")
    return table


def _refuse_values(keys: F64, state: WordColumn, visible: F64, source: Path | str) -> None:
    """Refuse (2, N) frames and ids, states and shares that none can have."""
    foreign = set(state.tolist()) - set(STATES)
    if foreign:
        raise InputError(f"{source}: expected a state of {', '.join(STATES)}, found {min(foreign)!r}")
    odd = keys[~((np.abs(keys) <= KEY_MAX) & (keys % 1 == 0))]
    if len(odd):
        raise InputError(f"{source}: expected whole numbers up to {KEY_MAX} for frame and id, found {odd[0]:g}")
    odd = visible[(visible != IGNORED) & ~((visible >= 0) & (visible <= 1))]
    if len(odd):
        raise InputError(f"{source}: expected shares of 0 to 1 in the column 'visible', found {odd[0]:g}")


def _recordings_apart(keys: I64, source: Path | str) -> I64:
    """(2, N) frames and ids of recordings that follow one another, each with frames after those of the one before and
    with ids of its own, and a warning; rows that repeat a frame and id otherwise stay."""
    frame, track_id = keys
    recording = recording_numbers(frame, track_id)
    if not recording.any():
        return keys
    frame = after_one_another(frame, recording, 1)
    track_id = renumber(track_id, recording)
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


def renumber(track_id: I64, recording: I64) -> I64:
    """(N,) ids of which none is used in two recordings, by the (N,) numbers of these from 0; the first one's stay."""
    step = int(np.abs(track_id).max(initial=0)) + 1
    sign = np.where(track_id < 0, -1, 1)
    return sign * (np.abs(track_id) + step * recording)


def separators(text: str) -> tuple[str, str]:
    """The separators of the cells in the first lines of a table, and of its fractions: spreadsheets of some countries
    write 1,5 between semicolons or tabs."""
    between = next((separator for separator in "\t;" if separator in text), ",")
    return between, "," if between != "," and re.search(r"\d,\d", text) else "."


def _read(file: Path | str, what: str) -> Trajectories:
    path = Path(file)
    require_file(path, f"a {what} file")
    with expecting(path, f"a {what} file", OSError, ValueError, csv.Error):
        header, *rows = path.read_text(encoding="utf-8-sig").split("\n")
        between, decimal = separators(header + "".join(rows[:1]))
        names = next(csv.reader([header], delimiter=between), [])
        if not set(NEEDED) <= set(names):
            expected = f"{', '.join(NEEDED)}, or frame, id, left, top, width, height of boxes"
            raise InputError(f"{path}: expected the columns {expected}, found {', '.join(names)}")
        kinds = {name: "U16" if name == "state" else "f8" for name in (*COLUMNS, *TIMES) if name in names}
        if ":" in "".join(rows[:1]):  # dates
            kinds |= {name: "U40" for name in TIMES if name in kinds}
        kinds.setdefault(names[-1], "U1")  # a row that is cut short lacks its last cell at least
        try:
            cells = _read_cells([row.replace(decimal, ".") for row in rows if row.strip()], names, kinds, between)
            return table_of({name: cells[name] for name in kinds}, path)
        except (ValueError, InputError):
            _refuse_first_fault(path, between, decimal)
            raise


def _read_cells(rows: Sequence[str], names: Sequence[str], kinds: dict[str, str], between: str) -> AnyArray:
    """(N,) cells of rows by name, of columns of different kinds, as numpy reads them; pandas takes half a second to
    import."""
    if not rows:
        return np.empty(0, [*kinds.items()])
    empty = re.compile(f"{between} *(NA|N/A|null)? *(?={between}|$)")
    # With a separator before it the first cell is one like the others.
    filled = [empty.sub(f"{between}nan", between + row) for row in rows]
    places = [1 + names.index(name) for name in kinds]
    return np.loadtxt(filled, [*kinds.items()], None, between, usecols=places, ndmin=1, quotechar='"')


def _refuse_first_fault(path: Path, between: str, decimal: str) -> None:
    """Raise InputError for the first row of a table that is cut short or has a cell that is not what its column
    holds."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, delimiter=between)
        names = next(reader, [])
        for row in filter(None, reader):
            line = reader.line_num
            if len(row) < len(names):
                raise InputError(f"{path}: expected {len(names)} cells in line {line}, found fewer")
            for name, cell in zip(names, row, strict=False):
                expected = _expectation(name, cell.strip().replace(decimal, "."))
                if expected:
                    raise InputError(f"{path}: expected {expected}, line {line}, found {cell!r}")


def _expectation(name: str, cell: str) -> str:
    """The content expected of a cell; empty where it is there."""
    if not cell or name not in COLUMNS:
        return ""
    if name == "state":
        return "" if cell in STATES else f"a state of {', '.join(STATES)}"
    if name == "timestamp_s":
        return "" if is_time(cell) else "a time (a number, or a date such as 2023-10-29T02:59:59)"
    try:
        number = float(cell)
    except ValueError:
        return f"a number in {name!r}"
    return f"a whole number in {name!r}" if name in ("frame", "id") and number % 1 else ""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Rows of a tracks or truth file, as columns of equal length (N,), sorted by frame then id.

    Its length is the number of rows; iterating gives each as a named tuple of the columns of tracks.csv, as pandas'
    ``itertuples`` does: ``for row in tracks: row.frame, row.id, row.x_m``.

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

    def __iter__(self) -> Iterator[Any]:
        return iter(self.to_dataframe().itertuples(index=False, name="Row"))

    def where(self, keep: Bool | I64) -> Trajectories:
        """The rows where a (N,) mask is true, or those of (M,) indices in that order; itself where all are kept."""
        if keep.dtype == np.bool_ and keep.all():
            return self
        return replace(self, **{name: getattr(self, name)[keep] for name in ROW_FIELDS})

    def __repr__(self) -> str:
        span = f", frames {self.frame.min()} to {self.frame.max()}" if len(self) else ""
        return f"Trajectories({len(self)} rows of {len(people_of(self))} people{span})"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().head().to_html())

    @staticmethod
    def from_dataframe(frame: DataFrame) -> Trajectories:
        """The rows of a DataFrame with columns of ``tracks.csv``, at least ``frame``, ``id``, ``x_m`` and ``y_m``; rows
        are "confirmed" without a state. Raises InputError: a column is missing, or values that do not belong."""
        whole = {name: frame.attrs[name] for name in WHOLE_FIELDS if name in frame.attrs}
        return replace(table_of(frame, "DataFrame"), **whole)

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with the columns of ``tracks.csv`` (``TRACK_COLUMNS``), a row per person and frame."""
        import pandas

        columns: dict[str, Any] = {"id": self.track_id, "state": pandas.Series(self.state, dtype="str")}
        columns |= {
            name: getattr(self, name) for name in ("frame", "timestamp_s", "x_m", "y_m", "height_m", *LAST_COLUMNS)
        }
        columns |= zip(("vx_mps", "vy_mps"), self.velocity_mps.T, strict=True)
        columns |= zip(BOX_COLUMNS, self.box_px.T, strict=True)
        table = pandas.DataFrame(columns, columns=list(TRACK_COLUMNS))
        table.attrs = {name: getattr(self, name) for name in WHOLE_FIELDS}
        return table


WHOLE_FIELDS = ("first_frame", "n_frames")
ROW_FIELDS = tuple(name for name in Trajectories.__dataclass_fields__ if name not in WHOLE_FIELDS)
"""Fields for all rows together, and for every row."""


def concatenate(tables: Sequence[Trajectories]) -> Trajectories:
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


def _cells(frame: int, timestamp_s: float, track: TrackState) -> tuple[Any, ...]:
    """The cells of TRACK_COLUMNS."""
    place = track.x_m, track.y_m, track.vx_mps, track.vy_mps, track.height_m
    last = track.facing_deg, track.facing_confidence, track.confidence, track.std_m
    return frame, timestamp_s, track.track_id, *place, track.state, *track.box_px, *last


def write_rows(file: IO[str], frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
    """Append one frame's tracks; an unknown value is an empty cell."""
    for track in tracks:
        file.write((_ROW % _cells(frame, timestamp_s, track)).replace("nan", ""))


def write_table(file: IO[str], table: Trajectories) -> None:
    """All of ``tracks.csv``: the header and every row."""
    write_header(file)
    people = row_states(table, slice(None))
    for frame, time_s, person in zip(table.frame.tolist(), table.timestamp_s.tolist(), people, strict=True):
        write_rows(file, frame, time_s, [person])


def row_states(table: Trajectories, rows: slice | I64) -> list[TrackState]:
    """Rows as a tracker gave them."""
    boxes = list(map(tuple, table.box_px[rows].tolist()))
    before = (table.track_id, table.state, table.x_m, table.y_m, *table.velocity_mps.T, table.height_m)
    after = (table.facing_deg, table.facing_confidence, table.confidence, table.std_m)
    first = [column[rows].tolist() for column in before]
    last = [column[rows].tolist() for column in after]
    return [TrackState(*cells) for cells in zip(*first, boxes, *last, strict=True)]


class TrajectoryCollector:
    """Gathers tracks in memory, with the values that ``write_rows`` and ``read_tracks`` would give."""

    def __init__(self) -> None:
        self._rows: list[tuple[Any, ...]] = []

    def add(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
        """Take one frame's tracks; every (frame, id) once."""
        self._rows += [_cells(frame, timestamp_s, track) for track in tracks]

    def trajectories(self) -> Trajectories:
        """Everything gathered so far, rounded as in ``tracks.csv`` (DECIMALS)."""
        columns: dict[str, list[Any]] = {}
        for name, decimals, *cells in zip(TRACK_COLUMNS, DECIMALS, *self._rows, strict=True):
            columns[name] = cells
            if decimals is not None:
                columns[name] = [round(cell, decimals) for cell in cells]
        return table_of(columns, "tracks")


def read_tracks(path: Path | str) -> Trajectories:
    """Read ``tracks.csv``. Raises InputError: unreadable, columns missing, or a value that is not what its column
    holds."""
    return _read(path, "tracks")


def read_truth(path: Path | str) -> Trajectories:
    """Read ``truth.csv`` (same errors as ``read_tracks``)."""
    return _read(path, "truth")


def frame_times(table: Trajectories) -> tuple[I64, F64]:
    """(F,) frames of which a row has a time, ascending, and their times [s]."""
    has_time = np.isfinite(table.timestamp_s)
    frames, first = np.unique(table.frame[has_time], return_index=True)
    return frames, table.timestamp_s[has_time][first]


def frame_period_s(table: Trajectories, fallback_s: float) -> float:
    """Median time per frame [s] over rows with timestamps: the mean where most frames share one, ``fallback_s`` where
    fewer than two frames have one or time stands."""
    return period_of(*frame_times(table), fallback_s)


def judge_times(table: Trajectories) -> tuple[Trajectories, tuple[str, ...]]:
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
    """Sentence on what no people are or do: of another unit, rate or order of columns; empty where there is none.
    A table without times is taken as one of two frames per second at least."""
    confirmed = table.where(table.state == "confirmed")
    placed = confirmed.where(np.isfinite(confirmed.x_m) & np.isfinite(confirmed.y_m))
    n_ids = len(np.unique(confirmed.track_id))
    n_frames = len(np.unique(confirmed.frame))
    heights = list[float]()
    speeds = list[float]()
    times_s = placed.frame * frame_period_s(placed, PERSON_S)
    for _, rows in rows_by_id(placed.track_id):
        apart = rows[np.unique(times_s[rows] // PERSON_S, return_index=True)[1]]  # longer than positions flicker
        sizes = placed.height_m[apart]
        sizes = sizes[np.isfinite(sizes)]
        if len(sizes):
            heights.append(float(np.median(sizes)))
        if len(apart) > 1:
            steps_m = np.hypot(np.diff(placed.x_m[apart]), np.diff(placed.y_m[apart]))
            speeds.append(float(np.median(steps_m / np.diff(times_s[apart]))))
    doubts = list[str]()
    for values, low, high, unit in ((heights, *HEIGHTS_M, "m tall"), (speeds, 0.0, FASTEST_MPS, "m/s fast")):
        odd = [value for value in values if not low <= value <= high]
        if odd:
            doubts.append(f"{len(odd)} of {n_ids} people would be {np.median(odd):.3g} {unit}")
    if len(placed) and n_ids > 1:
        span_m = max(np.ptp(placed.x_m), np.ptp(placed.y_m))
        if span_m < SPAN_MIN_M:
            doubts.append(f"all {n_ids} people would be within {span_m:.2g} m")
    if n_frames > 1 and n_ids > IDS_PER_FRAME_MAX * n_frames:
        doubts.append(f"{n_ids} people would pass in {n_frames} frames")
    return f"{', '.join(doubts)}: another unit, frame rate or order of columns?" if doubts else ""


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
    row_s = frame_s
    if len(steps):
        row_s *= max(1.0, float(np.median(steps)))
    ids, rows = np.unique(tracks.track_id[tracks.state == "confirmed"], return_counts=True)
    return ids[is_person(rows.astype(np.float64) * row_s)]
