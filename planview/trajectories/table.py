"""``tracks.csv`` and ``truth.csv``: trajectories on disk and as columns."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from calib.errors import InputError
from calib.io import reason, require_file
from calib.types import F64, I64, AnyArray, Bool
from planview.trajectories.state import TrackState

if TYPE_CHECKING:
    from pandas import DataFrame

KEY_MAX = 2**53
"""Largest frame number or id that a float64 holds exactly."""
WordColumn = np.ndarray[tuple[int], np.dtype[np.str_]]
BLOCK_ROWS = 5_000
"""Rows in memory as text at a time: more take longer, since their cells leave the processor's cache (our choice)."""
TRACK_COLUMNS = (
    "frame", "timestamp_s", "id", "x_m", "y_m", "vx_mps", "vy_mps", "height_m", "state",
    "left_px", "top_px", "width_px", "height_px",
)  # fmt: skip
NUMBER_COLUMNS = tuple(name for name in TRACK_COLUMNS if name != "state")
TRUTH_COLUMNS = ("frame", "id", "x_m", "y_m", "height_m")
STATES = ("tentative", "confirmed", "lost")
PERSON_S = 0.5
"""A track is a person once it is confirmed for so long in all [s]. Our choice: flickers of foreground are shorter,
people who cross the view are observed for longer."""
IGNORED = -1.0
"""``visible`` of a truth row that never counts: a distractor of a benchmark."""


def read_numbers(path: Path, delimiter: str | None, expected: str) -> F64:
    """(N, M) numbers of a text file; None for blanks as delimiter. Raises InputError: unreadable, rows of different
    lengths, or values that are not numbers; ``expected`` is named."""
    require_file(path, expected)
    try:
        with warnings.catch_warnings():
            # A file with nothing but comments is an empty table.
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            return np.loadtxt(path, delimiter=delimiter, ndmin=2, dtype=np.float64, encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected {expected}, found {reason(error)}") from error


def sorted_rows(path: Path, table: F64, frame: int, track_id: int) -> F64:
    """Rows by frame, then id (given their columns). Raises InputError: a frame or id that is not a whole number up to
    KEY_MAX, or two rows of one frame and id."""
    keys = table[:, [frame, track_id]]
    if not np.isfinite(keys).all() or (keys != np.floor(keys)).any():
        raise InputError(f"{path}: expected whole numbers for frame and id, found others")
    if (np.abs(keys) > KEY_MAX).any():
        raise InputError(f"{path}: expected frames and ids up to {KEY_MAX}, found {np.abs(keys).max():g}")
    order = np.lexsort((keys[:, 1], keys[:, 0]))
    require_unique(path, keys[order][:, 0], keys[order][:, 1])
    return np.asarray(table[order])


def require_unique(path: Path, frame: F64 | I64, track_id: F64 | I64) -> None:
    """Refuse two rows of one frame and id, in (N,) columns sorted by frame, then id. Raises InputError: there are
    two."""
    twice = np.flatnonzero((np.diff(frame) == 0) & (np.diff(track_id) == 0))
    if len(twice):
        first = int(twice[0])
        raise InputError(
            f"{path}: expected one row per frame and id, found two for frame {frame[first]:g}, id {track_id[first]:g}"
        )


def csv_blocks(path: Path, required: Sequence[str], what: str) -> Iterator[CsvColumns]:
    """The rows of a file in blocks, at least one.

    Args:
        required: columns that the header must name.
        what: the file should be, for messages.
    Raises:
        InputError: unreadable, not UTF-8, or a column missing.
    """
    require_file(path, f"a {what} file")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            names = next(reader, [])
            missing = [name for name in required if name not in names]
            if missing:
                raise InputError(f"{path}: expected a {what} file with the column {missing[0]!r}, found {names}")
            filled = ((reader.line_num, row) for row in reader if row)
            yield CsvColumns(path, names, list(islice(filled, BLOCK_ROWS)))
            while block := list(islice(filled, BLOCK_ROWS)):
                yield CsvColumns(path, names, block)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a {what} file, found {reason(error)}") from error


class CsvColumns:
    """Rows of a CSV file by column, converted on request with errors that name file, line and column.

    Args:
        names: of the columns.
        rows: numbers of lines, and cells.
    """

    def __init__(self, path: Path, names: Sequence[str], rows: Sequence[tuple[int, list[str]]]) -> None:
        self._path = path
        self._lines, self._rows = [line for line, _ in rows], [row for _, row in rows]
        self._column = {name: i for i, name in enumerate(names)}

    def numbers(self, name: str, default: float) -> F64:
        """(N,) values; ``default`` where the cell is empty, and throughout (read-only) where the column is missing."""
        if name not in self._column:
            return np.broadcast_to(np.float64(default), len(self._rows))
        cells = self._cells(name)
        try:
            known = [cell or str(default) for cell in cells] if "" in cells else cells
            return np.fromiter(map(float, known), dtype=np.float64, count=len(cells))
        except ValueError:
            return np.array([self._number(name, row, default) for row in range(len(cells))], dtype=np.float64)

    def integers(self, name: str) -> I64:
        """(N,) int64; an empty cell is refused."""
        values = self.numbers(name, np.nan)
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(~(np.abs(values) < 2.0**63) | (values != np.floor(values)))
        if len(bad):
            raise self._refused(f"a whole number in {name!r}", name, int(bad[0]))
        return values.astype(np.int64)

    def words(self, name: str, allowed: Sequence[str], default: str) -> WordColumn:
        """(N,) words of a closed list; ``default`` where the cell is empty or the column missing."""
        kind = f"<U{max(map(len, allowed))}"
        if name not in self._column:
            return np.broadcast_to(np.array(default, dtype=kind), len(self._rows))
        cells = self._cells(name)
        foreign = set(cells) - {"", *allowed}
        if foreign:
            first = next(row for row, cell in enumerate(cells) if cell in foreign)
            raise self._refused(f"a {name} of {', '.join(allowed)}", name, first)
        return np.array([cell or default for cell in cells], dtype=kind)

    def _cells(self, name: str) -> list[str]:
        column = self._column[name]
        try:
            return list(map(itemgetter(column), self._rows))
        except IndexError:
            line = next(line for line, row in zip(self._lines, self._rows, strict=True) if len(row) <= column)
            n = len(self._column)
            raise InputError(f"{self._path}: expected {n} cells in line {line}, found fewer") from None

    def _number(self, name: str, row: int, default: float) -> float:
        text = self._rows[row][self._column[name]]
        try:
            return float(text) if text.strip() else default
        except ValueError:
            raise self._refused(f"a number in {name!r}", name, row) from None

    def _refused(self, expected: str, name: str, row: int) -> InputError:
        found = self._rows[row][self._column[name]]
        return InputError(f"{self._path}: expected {expected}, line {self._lines[row]}, found {found!r}")


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Rows of a tracks or truth file, as columns of equal length (N,), sorted by frame then id.

    Attributes:
        frame, track_id: int64.
        timestamp_s, x_m, y_m, height_m: float64, NaN where unknown.
        state: (N,) of "tentative", "confirmed" or "lost"; "confirmed" throughout for truth.
        visible: unoccluded fraction 0..1 of a truth row, or IGNORED; 1 for tracks.
        box_px: (N, 4) float64 left, top, width, height; NaN where unknown.
        velocity_mps: (N, 2) float64; NaN where unknown.
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

    def __len__(self) -> int:
        return len(self.frame)

    def where(self, keep: Bool | I64) -> Trajectories:
        """The rows where a (N,) mask is true, or those of (M,) indices in that order; itself where all are kept."""
        if keep.dtype == np.bool_ and keep.all():
            return self
        return Trajectories(**{name: _picked(getattr(self, name), keep) for name in self.__dataclass_fields__})

    def __repr__(self) -> str:
        span = f", frames {self.frame.min()} to {self.frame.max()}" if len(self) else ""
        return f"Trajectories({len(self)} rows of {len(np.unique(self.track_id))} ids{span})"

    @staticmethod
    def from_dataframe(frame: DataFrame) -> Trajectories:
        """The rows of a pandas DataFrame with columns of ``tracks.csv``; ``frame``, ``id``, ``x_m`` and ``y_m`` must be
        there, and rows are "confirmed" where no state is given. Raises InputError: a column missing, or values that are
        not what it holds."""
        missing = [name for name in ("frame", "id", "x_m", "y_m") if name not in frame.columns]
        if missing:
            raise InputError(f"expected tracks with the column {missing[0]!r}, found {list(map(str, frame.columns))}")
        n = len(frame)
        try:
            known = {
                name: np.asarray(frame[name], dtype=np.float64) for name in NUMBER_COLUMNS if name in frame.columns
            }
        except (TypeError, ValueError) as error:
            raise InputError(f"expected numbers in the columns of tracks, found {reason(error)}") from error
        states = frame["state"].to_numpy(dtype=np.str_) if "state" in frame.columns else np.full(n, "confirmed")
        numbers = np.column_stack([known.get(name, np.full(n, np.nan)) for name in NUMBER_COLUMNS])
        return numbers_table(numbers, states, Path("DataFrame"))

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with the columns of ``tracks.csv`` (``TRACK_COLUMNS``), a row per person and frame. Raises
        InputError: pandas is not installed."""
        try:
            import pandas
        except ImportError as error:
            raise InputError("expected the package pandas; install planview[table]") from error
        states = pandas.Series(self.state, dtype="str")
        box, velocity = self.box_px.T, self.velocity_mps.T
        place = self.x_m, self.y_m, *velocity, self.height_m
        columns = (self.frame, self.timestamp_s, self.track_id, *place, states, *box)
        frame: DataFrame = pandas.DataFrame(dict(zip(TRACK_COLUMNS, columns, strict=True)))
        return frame


def _picked(column: AnyArray, keep: Bool | I64) -> AnyArray:
    """Some rows of a column; one that repeats a single value goes on taking no memory."""
    if column.strides[0] or not len(column):
        return column[keep]
    n = int(np.count_nonzero(keep)) if keep.dtype == np.bool_ else len(keep)
    return np.broadcast_to(column[0], (n, *column.shape[1:]))


def positions_table(
    frame: I64,
    track_id: I64,
    xy_m: F64,
    height_m: F64 | None = None,
    timestamp_s: F64 | None = None,
    box_px: F64 | None = None,
    visible: F64 | None = None,
) -> Trajectories:
    """A table of confirmed rows from arrays of length N (sorted by frame, then id); what is not given is NaN."""
    n = len(frame)
    unknown = np.full(n, np.nan)
    return Trajectories(
        frame=frame,
        track_id=track_id,
        timestamp_s=unknown if timestamp_s is None else timestamp_s,
        x_m=xy_m[:, 0],
        y_m=xy_m[:, 1],
        height_m=unknown if height_m is None else height_m,
        state=np.full(n, "confirmed"),
        visible=np.ones(n) if visible is None else visible,
        box_px=np.full((n, 4), np.nan) if box_px is None else box_px,
        velocity_mps=np.full((n, 2), np.nan),
    )


def numbers_table(numbers: F64, state: WordColumn, path: Path | None = None) -> Trajectories:
    """Tracks from (N, 12) numbers in the order of NUMBER_COLUMNS, and (N,) states.

    Args:
        path: of the file that the rows come from; they are sorted then, and checked.
    Raises:
        InputError: see ``sorted_rows``.
    """
    if path is not None:
        numbers = sorted_rows(path, np.column_stack([numbers, np.arange(len(numbers))]), frame=0, track_id=2)
        state, numbers = state[numbers[:, -1].astype(np.int64)], numbers[:, :-1]
    frame, track_id = numbers[:, [0, 2]].T.astype(np.int64)
    return Trajectories(
        frame, track_id, numbers[:, 1], numbers[:, 3], numbers[:, 4], numbers[:, 7], state, np.ones(len(numbers)),
        box_px=numbers[:, 8:], velocity_mps=numbers[:, 5:7],
    )  # fmt: skip


def concatenated(tables: Sequence[Trajectories]) -> Trajectories:
    """The rows of at least one table together, sorted by frame, then id."""
    names = Trajectories.__dataclass_fields__
    return _sorted(Trajectories(**{name: np.concatenate([getattr(t, name) for t in tables]) for name in names}))


def _sorted(table: Trajectories) -> Trajectories:
    order = np.lexsort((table.track_id, table.frame))
    return table if (np.diff(order) == 1).all() else table.where(order)


def rows_by_id(track_id: I64) -> Iterator[tuple[int, I64]]:
    """Every id with its rows in their order, by rising id."""
    order = np.argsort(track_id, kind="stable")
    ids, starts = np.unique(track_id[order], return_index=True)
    return zip(ids.tolist(), np.split(order, starts[1:]), strict=False)


def write_header(file: IO[str]) -> None:
    file.write(",".join(TRACK_COLUMNS) + "\n")


def write_rows(file: IO[str], frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
    """Append one frame's tracks; an unknown value is an empty cell."""
    for track in tracks:
        cells = [
            str(frame),
            _cell(timestamp_s, 4),
            str(track.track_id),
            *(_cell(v, 4) for v in (track.x_m, track.y_m, track.vx_mps, track.vy_mps, track.height_m)),
            track.state,
            *(_cell(v, 1) for v in track.box_px),
        ]
        file.write(",".join(cells) + "\n")


def write_table(file: IO[str], table: Trajectories) -> None:
    """All of ``tracks.csv``: the header and every row."""
    write_header(file)
    for row in range(len(table)):
        write_rows(file, int(table.frame[row]), float(table.timestamp_s[row]), [row_state(table, row)])


def row_state(table: Trajectories, row: int) -> TrackState:
    """One row as a tracker gave it."""
    return row_states(table, slice(row, row + 1))[0]


def row_states(table: Trajectories, rows: slice) -> list[TrackState]:
    """Rows as a tracker gave them."""
    columns = (table.track_id, table.state, table.x_m, table.y_m, *table.velocity_mps.T, table.height_m)
    boxes = map(tuple, table.box_px[rows].tolist())
    return [TrackState(*cells) for cells in zip(*(column[rows].tolist() for column in columns), boxes, strict=True)]


class TrajectoryCollector:
    """Gathers tracks in memory, with the values that ``write_rows`` and ``read_tracks`` would give."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, float, TrackState]] = []

    def add(self, frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
        """Take one frame's tracks; every (frame, id) once."""
        self._rows += [(frame, timestamp_s, track) for track in tracks]

    def trajectories(self) -> Trajectories:
        """Everything gathered so far, rounded as in ``tracks.csv``: 0.1 mm, 0.1 ms, 0.1 px."""
        rows = sorted(self._rows, key=lambda row: (row[0], row[2].track_id))
        numbers = [
            (frame, _rounded(time, 4), t.track_id,
             *(_rounded(value, 4) for value in (t.x_m, t.y_m, t.vx_mps, t.vy_mps, t.height_m)),
             *(_rounded(value, 1) for value in t.box_px))
            for frame, time, t in rows
        ]  # fmt: skip
        states = np.array([track.state for _, _, track in rows], dtype=np.str_)
        return numbers_table(np.array(numbers, dtype=np.float64).reshape(-1, len(NUMBER_COLUMNS)), states)


def read_tracks(path: Path, *, boxes: bool = True) -> Trajectories:
    """Read ``tracks.csv``.

    Args:
        boxes: also read boxes and velocities, which are half of the file; else they are unknown.
    Raises:
        InputError: unreadable, columns missing, or a value that is not what its column holds.
    """
    return _read(path, ("frame", "timestamp_s", "id", "x_m", "y_m", "state"), "tracks", boxes)


def read_truth(path: Path) -> Trajectories:
    """Read ``truth.csv`` (same errors as ``read_tracks``)."""
    return _read(path, TRUTH_COLUMNS, "truth")


def _cell(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"


def _rounded(value: float, digits: int) -> float:
    """With as many digits as the file has; NaN where its cell is empty."""
    return float(_cell(value, digits) or "nan")


def _read(path: Path, required: tuple[str, ...], what: str, boxes: bool = True) -> Trajectories:
    parts = [_block_columns(block, boxes) for block in csv_blocks(path, required, what)]
    # One column after the other, so that the rows are in memory once.
    table = _sorted(Trajectories(**{name: _stacked([part.pop(name) for part in parts]) for name in list(parts[0])}))
    require_unique(path, table.frame, table.track_id)
    return table


def _block_columns(columns: CsvColumns, boxes: bool) -> dict[str, AnyArray]:
    """The columns of ``Trajectories`` by name."""
    number = columns.numbers
    moving = ("left_px", "top_px", "width_px", "height_px"), ("vx_mps", "vy_mps")
    unread = number("", np.nan)
    box_px, velocity_mps = ([number(name, np.nan) if boxes else unread for name in names] for names in moving)
    return {
        "frame": columns.integers("frame"),
        "track_id": columns.integers("id"),
        "timestamp_s": number("timestamp_s", np.nan),
        "x_m": number("x_m", np.nan),
        "y_m": number("y_m", np.nan),
        "height_m": number("height_m", np.nan),
        "state": columns.words("state", STATES, "confirmed"),
        "visible": number("visible", 1.0),
        "box_px": _beside(box_px),
        "velocity_mps": _beside(velocity_mps),
    }


def _beside(columns: Sequence[F64]) -> F64:
    """(N, M) of M columns; where each repeats the same value it goes on taking no memory."""
    if len(columns[0]) and not any(column.strides[0] for column in columns):
        return np.broadcast_to(columns[0][:1, None], (len(columns[0]), len(columns)))
    return np.column_stack(columns)


def _stacked(blocks: Sequence[AnyArray]) -> AnyArray:
    """Blocks of a column one after the other."""
    filled = [block for block in blocks if len(block)]
    if filled and not any(block.strides[0] for block in filled):
        return np.broadcast_to(filled[0][:1], (sum(map(len, filled)), *filled[0].shape[1:]))
    return np.concatenate(blocks)


def frame_period_s(table: Trajectories, fallback_s: float) -> float:
    """Median time per frame [s] over rows with timestamps.

    The mean where most frames share a timestamp; ``fallback_s`` where fewer than two frames have one or time stands.
    """
    known = np.isfinite(table.timestamp_s)
    frames, first = np.unique(table.frame[known], return_index=True)
    times = table.timestamp_s[known][first]
    if len(frames) < 2 or times[-1] <= times[0]:
        return fallback_s
    period = float(np.median(np.diff(times) / np.diff(frames)))
    return period if period > 0 else float((times[-1] - times[0]) / (frames[-1] - frames[0]))


def is_person(confirmed_frames: I64, frame_s: float) -> Bool:
    """(N,) whether tracks confirmed in so many frames are people."""
    return np.asarray(confirmed_frames * frame_s >= PERSON_S - 1e-9)


def people_of(tracks: Trajectories, frame_s: float) -> I64:
    """(P,) ids of the people, ascending: those of tracks that are confirmed for at least PERSON_S in all.

    Args:
        frame_s: time from frame to frame [s].
    """
    ids, frames = np.unique(tracks.track_id[tracks.state == "confirmed"], return_counts=True)
    return np.asarray(ids[is_person(frames, frame_s)])
