"""``tracks.csv`` and ``truth.csv``: trajectories on disk."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64
from planview.trajectories.state import TrackState

TRACK_COLUMNS = (
    "frame", "timestamp_s", "id", "x_m", "y_m", "vx_mps", "vy_mps", "height_m", "state",
    "left_px", "top_px", "width_px", "height_px",
)  # fmt: skip
TRUTH_COLUMNS = ("frame", "id", "x_m", "y_m", "height_m")
STATES = ("tentative", "confirmed", "lost")


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Rows of a tracks or truth file, as columns of equal length (N,), sorted by frame then id.

    Attributes:
        frame, track_id: int64.
        timestamp_s, x_m, y_m, height_m: float64, NaN where unknown.
        state: (N,) of "tentative", "confirmed" or "lost"; "confirmed" throughout for truth.
        visible: unoccluded fraction 0..1 of a truth row; 1 for tracks.
        box_px: (N, 4) float64 left, top, width, height; NaN where unknown.
        velocity_mps: (N, 2) float64; NaN where unknown.
    """

    frame: I64
    track_id: I64
    timestamp_s: F64
    x_m: F64
    y_m: F64
    height_m: F64
    state: np.ndarray[tuple[int], np.dtype[np.str_]]
    visible: F64
    box_px: F64
    velocity_mps: F64

    def __len__(self) -> int:
        return len(self.frame)

    def where(self, keep: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Trajectories:
        """The rows where a (N,) mask is true."""
        return Trajectories(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def write_header(file: IO[str]) -> None:
    file.write(",".join(TRACK_COLUMNS) + "\n")


def write_rows(file: IO[str], frame: int, timestamp_s: float, tracks: Sequence[TrackState]) -> None:
    """Append one frame's tracks; an unknown value is an empty cell."""
    for track in tracks:
        cells = [
            str(frame),
            f"{timestamp_s:.4f}",
            str(track.track_id),
            *(_cell(v, 4) for v in (track.x_m, track.y_m, track.vx_mps, track.vy_mps, track.height_m)),
            track.state,
            *(_cell(v, 1) for v in track.box_px),
        ]
        file.write(",".join(cells) + "\n")


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
        tracks = [track for _, _, track in rows]
        place = _rounded([(t.x_m, t.y_m, t.height_m, t.vx_mps, t.vy_mps) for t in tracks], 5, 4)
        return Trajectories(
            frame=np.array([frame for frame, _, _ in rows], dtype=np.int64),
            track_id=np.array([track.track_id for track in tracks], dtype=np.int64),
            timestamp_s=_rounded([(time,) for _, time, _ in rows], 1, 4)[:, 0],
            x_m=place[:, 0],
            y_m=place[:, 1],
            height_m=place[:, 2],
            state=np.array([track.state for track in tracks], dtype=np.str_),
            visible=np.ones(len(rows)),
            box_px=_rounded([track.box_px for track in tracks], 4, 1),
            velocity_mps=place[:, 3:],
        )


def read_tracks(path: Path) -> Trajectories:
    """Read ``tracks.csv``.

    Raises:
        InputError: unreadable, columns missing, or a value that is not what its column holds.
    """
    return _read(path, ("frame", "timestamp_s", "id", "x_m", "y_m", "state"), "tracks")


def read_truth(path: Path) -> Trajectories:
    """Read ``truth.csv`` (same errors as ``read_tracks``)."""
    return _read(path, TRUTH_COLUMNS, "truth")


def _cell(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}f}"


def _rounded(rows: Sequence[Sequence[float]], columns: int, digits: int) -> F64:
    """(N, columns) values with as many digits as the file has; NaN where its cell is empty."""
    values = [[float(_cell(value, digits) or "nan") for value in row] for row in rows]
    return np.array(values, dtype=np.float64).reshape(-1, columns)


def _read(path: Path, required: tuple[str, ...], what: str) -> Trajectories:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            names = reader.fieldnames or []
            missing = [name for name in required if name not in names]
            if missing:
                raise InputError(f"{path}: expected a {what} file with the column {missing[0]!r}, found {list(names)}")
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a {what} file, found {error}") from error

    def column(name: str, default: float) -> F64:
        if name not in names:
            return np.full(len(rows), default)
        values = np.full(len(rows), default)
        for i, row in enumerate(rows):
            text = row[name]
            if text is None:
                raise InputError(f"{path}: expected {len(names)} cells in line {i + 2}, found fewer")
            if text.strip():
                try:
                    values[i] = float(text)
                except ValueError:
                    raise InputError(f"{path}: expected a number in {name!r}, line {i + 2}, found {text!r}") from None
        return values

    def integers(name: str) -> I64:
        values = column(name, np.nan)
        bad = ~np.isfinite(values) | (values != np.floor(np.nan_to_num(values)))
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise InputError(f"{path}: expected a whole number in {name!r}, line {i + 2}, found {rows[i][name]!r}")
        return values.astype(np.int64)

    states = np.array([row.get("state") or "confirmed" for row in rows], dtype=np.str_)
    for i, state in enumerate(states):
        if state not in STATES:
            raise InputError(f"{path}: expected a state of {', '.join(STATES)} in line {i + 2}, found {str(state)!r}")
    box = np.column_stack([column(n, np.nan) for n in ("left_px", "top_px", "width_px", "height_px")])
    velocity = np.column_stack([column(n, np.nan) for n in ("vx_mps", "vy_mps")])
    table = Trajectories(
        integers("frame"), integers("id"), column("timestamp_s", np.nan), column("x_m", np.nan),
        column("y_m", np.nan), column("height_m", np.nan), states, column("visible", 1.0), box, velocity,
    )  # fmt: skip
    order = np.lexsort((table.track_id, table.frame))
    ordered = Trajectories(**{name: getattr(table, name)[order] for name in table.__dataclass_fields__})
    same = (np.diff(ordered.frame) == 0) & (np.diff(ordered.track_id) == 0)
    if same.any():
        i = int(np.flatnonzero(same)[0])
        raise InputError(
            f"{path}: expected one row per frame and id, "
            f"found two for frame {ordered.frame[i]}, id {ordered.track_id[i]}"
        )
    return ordered
