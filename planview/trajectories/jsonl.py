"""A stream of JSON lines: one object per frame with people, readable while it is written.

``{"frame": 3, "timestamp_s": 0.2, "people": [{"id": 1, "state": "confirmed", "x_m": 0.5, "y_m": 2.0, "vx_mps": 1.2,
"vy_mps": 0.0, "height_m": 1.75, "box_px": [310.0, 95.0, 60.0, 170.0]}]}``; what is unknown is null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from calib.errors import InputError
from calib.io import reason
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, replaced
from planview.trajectories.rows import sorted_rows
from planview.trajectories.table import STATES, Trajectories

LINE_MAX = 10_000_000
"""Most characters of a line: a frame of 50,000 people."""
_VALUES = ("x_m", "y_m", "vx_mps", "vy_mps", "height_m")


def write_jsonl(path: Path, file: TrajectoryFile) -> None:
    """Write all rows.

    Raises:
        WorkError: the file cannot be written.
    """
    with replaced(path) as part, part.open("w", encoding="utf-8") as out:
        stream_jsonl(out, file.table)


def stream_jsonl(out: IO[str], table: Trajectories) -> None:
    """Write a line per frame that has rows."""
    frames, first = np.unique(table.frame, return_index=True)
    for frame, start, end in zip(frames.tolist(), first.tolist(), [*first[1:].tolist(), len(table)], strict=True):
        time = _known(float(table.timestamp_s[start]))
        people = [_person(table, row) for row in range(start, end)]
        out.write(json.dumps({"frame": frame, "timestamp_s": time, "people": people}) + "\n")


def read_jsonl(path: Path) -> TrajectoryFile:
    """Read a stream; a last line that is cut short (the writer was interrupted) is left out.

    Raises:
        InputError: unreadable, or a line that is not a frame with people.
    """
    numbers: list[list[float]] = []
    states: list[str] = []
    for line, frame in _frames(path):
        try:
            for person in frame["people"]:
                numbers.append(_numbers(frame, person))
                states.append(_state(person.get("state", "confirmed")))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(f"{path}: expected a frame with people in line {line}, found {_found(error)}") from error
    rows: F64 = np.column_stack([np.array(numbers, dtype=np.float64).reshape(-1, 12), np.arange(len(numbers))])
    rows = sorted_rows(path, rows, frame=0, track_id=1)
    order = rows[:, 12].astype(np.int64)
    return TrajectoryFile(
        Trajectories(
            frame=rows[:, 0].astype(np.int64), track_id=rows[:, 1].astype(np.int64), timestamp_s=rows[:, 2],
            x_m=rows[:, 3], y_m=rows[:, 4], height_m=rows[:, 7], state=np.array(states, dtype=np.str_)[order],
            visible=np.ones(len(rows)), box_px=rows[:, 8:12], velocity_mps=rows[:, 5:7],
        )
    )  # fmt: skip


def _frames(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Line numbers, from 1, and the objects in them."""
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(iter(lambda: file.readline(LINE_MAX), ""), 1):
                if not line.strip():
                    continue
                try:
                    value = json.loads(line, parse_constant=_refuse)
                except (ValueError, RecursionError) as error:
                    if not line.endswith("\n") and len(line) < LINE_MAX and number > 1:
                        return
                    raise InputError(f"{path}: expected JSON in line {number}, found {error}") from error
                if not isinstance(value, dict):
                    raise InputError(f"{path}: expected an object in line {number}, found {type(value).__name__}")
                yield number, value
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected JSON lines, found {reason(error)}") from error


def _numbers(frame: dict[str, Any], person: dict[str, Any]) -> list[float]:
    box = person.get("box_px") or [None] * 4
    if len(box) != 4:
        raise ValueError(f"a box of {len(box)} numbers")
    values = [frame.get("timestamp_s"), *(person.get(name) for name in _VALUES), *box]
    return [float(frame["frame"]), float(person["id"]), *(math.nan if v is None else float(v) for v in values)]


def _state(state: object) -> str:
    if state not in STATES:
        raise ValueError(f"the state {str(state)[:40]!r}")
    return str(state)


def _person(table: Trajectories, row: int) -> dict[str, Any]:
    vx, vy = table.velocity_mps[row]
    values = (table.x_m[row], table.y_m[row], vx, vy, table.height_m[row])
    box = [_known(float(value)) for value in table.box_px[row]]
    return {
        "id": int(table.track_id[row]),
        "state": str(table.state[row]),
        **{name: _known(float(value)) for name, value in zip(_VALUES, values, strict=True)},
        "box_px": None if None in box else box,
    }


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"the constant {constant}")


def _found(error: Exception) -> str:
    return f"no {error}" if isinstance(error, KeyError) else str(error)
