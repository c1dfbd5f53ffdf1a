"""Text formats of other programs: PeTrack and PedPy, JSON lines, and Vadere, Pathfinder, crowdit and Viswalk."""

from __future__ import annotations

import json
import math
import re
import warnings
from itertools import takewhile
from pathlib import Path
from typing import IO, Any, NamedTuple, NoReturn

import numpy as np

from calib.errors import InputError
from calib.io import expecting, require_file
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, checked_rate, replaced
from planview.trajectories.table import NUMBER_COLUMNS, STATES, Trajectories, row_states, table_of

METRES = {"m": 1.0, "cm": 0.01}
_RATE = re.compile(r"framerate\s*[:=]?\s*([^\s,;]+)", re.IGNORECASE)
_CENTIMETRES = re.compile(r"x\s*[/\[(]\s*cm\b|\bin\s+cm\b", re.IGNORECASE)
_METRES = re.compile(r"x\s*[/\[(]\s*m\b|\bin\s+(m\b|met)", re.IGNORECASE)
LINE_MAX = 10_000_000
"""Most characters of a line: a frame of 50,000 people."""
_VALUES = ("x_m", "y_m", "vx_mps", "vy_mps", "height_m")


def read_petrack(path: Path) -> TrajectoryFile:
    """Read a text file whose comments give the unit and, usually, the frame rate; without comments it is one of the
    laboratory experiments of Juelich: centimetres at 16 frames per second. A z of 0 or less, or none, is no height.
    Raises InputError: no unit in the comments, fewer than 4 columns, or values that are not numbers."""
    rate, scale = _comments(path)
    with expecting(path, "rows of id frame x y z", OSError, ValueError), warnings.catch_warnings():
        # A file with nothing but comments is an empty table.
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")
        table = np.loadtxt(path, ndmin=2, dtype=np.float64, encoding="utf-8-sig")
    table = table if len(table) else np.empty((0, 5))
    if table.shape[1] < 4:
        raise InputError(f"{path}: expected the columns id frame x y z, found {table.shape[1]} columns")
    columns = {"id": table[:, 0], "frame": table[:, 1], "x_m": scale * table[:, 2], "y_m": scale * table[:, 3]}
    if table.shape[1] > 4:
        columns["height_m"] = np.where(table[:, 4] > 0, scale * table[:, 4], np.nan)
    return TrajectoryFile(table_of(columns, path), rate)


def write_petrack(path: Path, file: TrajectoryFile, unit: str = "m") -> None:
    """Write rows with known positions by id, then frame, to 0.1 mm in a unit, "m" or "cm"; an unknown height is
    ``nan``. Raises WorkError: the file cannot be written."""
    table = file.table
    order = np.lexsort((table.frame, table.track_id))
    values = np.column_stack([table.x_m, table.y_m, table.height_m])[order] / METRES[unit]
    rows: F64 = np.column_stack([table.track_id[order], table.frame[order], values])
    digits = "%.4f" if unit == "m" else "%.2f"
    header = f"# framerate: {file.fps:g} fps\n# id frame x/{unit} y/{unit} z/{unit}"
    with replaced(path) as part:
        np.savetxt(part, rows, ["%d", "%d", digits, digits, digits], header=header, comments="")


def _comments(path: Path) -> tuple[float | None, float]:
    """Frames per second (None without a comment) and metres per unit."""
    with (
        expecting(path, "rows of id frame x y z", OSError, UnicodeDecodeError),
        path.open(encoding="utf-8-sig") as file,
    ):
        lines = [line for line, _ in zip(file, range(1000), strict=False)]
    text = "".join(takewhile(lambda line: line.startswith("#") or not line.strip(), lines))
    if not text.strip():
        return 16.0, METRES["cm"]
    rate = _RATE.search(text)
    if _CENTIMETRES.search(text):
        scale = METRES["cm"]
    elif _METRES.search(text):
        scale = METRES["m"]
    else:
        raise InputError(f"{path}: expected a comment with the unit (x/m or x/cm) before the rows, found none")
    return (checked_rate(path, rate.group(1)) if rate else None), scale


def stream_jsonl(out: IO[str], table: Trajectories) -> None:
    """Write a line per frame that has rows."""
    frames, first = np.unique(table.frame, return_index=True)
    for frame, start, end in zip(frames.tolist(), first.tolist(), [*first[1:].tolist(), len(table)], strict=True):
        time = _known(float(table.timestamp_s[start]))
        people = [
            {
                "id": person.track_id, "state": person.state,
                **{name: _known(getattr(person, name)) for name in _VALUES},
                "box_px": None if any(map(math.isnan, person.box_px)) else person.box_px,
                "facing_deg": _known(person.facing_deg),
            }
            for person in row_states(table, slice(start, end))
        ]  # fmt: skip
        out.write(json.dumps({"frame": frame, "timestamp_s": time, "people": people}) + "\n")


def read_jsonl(path: Path) -> TrajectoryFile:
    """Read a stream; a last line that is cut short (the writer was interrupted) is left out. Raises InputError:
    unreadable, or a line that is not a frame with people."""
    numbers: list[list[float]] = []
    states: list[str] = []
    with expecting(path, "JSON lines", OSError, UnicodeDecodeError), path.open(encoding="utf-8") as file:
        for line, text in enumerate(iter(lambda: file.readline(LINE_MAX), ""), 1):
            try:
                frame = json.loads(text, parse_constant=_refuse) if text.strip() else {"people": ()}
            except (ValueError, RecursionError) as error:
                if not text.endswith("\n") and len(text) < LINE_MAX and line > 1:
                    break
                raise InputError(f"{path}: expected JSON in line {line}, found {error}") from error
            try:
                for person in frame["people"]:
                    numbers.append(_numbers(frame, person))
                    states.append(person.get("state", "confirmed"))
                    if states[-1] not in STATES:
                        raise ValueError(f"the state {str(states[-1])[:40]!r}")
            except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
                found = f"no {error}" if isinstance(error, KeyError) else error
                raise InputError(f"{path}: expected a frame with people in line {line}, found {found}") from error
    table: F64 = np.array(numbers, dtype=np.float64).reshape(-1, len(NUMBER_COLUMNS))
    columns = dict(zip(NUMBER_COLUMNS, table.T, strict=True))
    return TrajectoryFile(table_of({**columns, "state": np.array(states, dtype=np.str_)}, path))


def _numbers(frame: dict[str, Any], person: dict[str, Any]) -> list[float]:
    """The NUMBER_COLUMNS of one person."""
    box = person.get("box_px") or [None] * 4
    if len(box) != 4:
        raise ValueError(f"a box of {len(box)} numbers")
    values = (*(person.get(name) for name in _VALUES), *box, person.get("facing_deg"))
    cells = (frame["frame"], frame.get("timestamp_s"), person["id"], *values)
    return [math.nan if cell is None else float(cell) for cell in cells]


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"the constant {constant}")


RATE_HZ = 10.0
"""Frames per second of positions whose times are uneven, between which they are interpolated."""


class Simulation(NamedTuple):
    """A program's table: columns of id, time [s], x and y [m], what separates cells, and what begins comments."""

    name: str
    columns: tuple[str, str, str, str]
    separator: str
    comment: str | None = None


SIMULATIONS = (
    Simulation("Vadere", ("pedestrianId", "simTime", "startX", "startY"), " ", "#"),
    Simulation("Pathfinder", ("id", "t", "x", "y"), ","),
    Simulation("crowdit", ("pedID", "time", "posX", "posY"), ","),
    Simulation("Viswalk", ("NO", "SIMSEC", "COORDCENTX", "COORDCENTY"), ";", "*"),
)


def simulation_of(text: str) -> tuple[Simulation, int] | None:
    """The program whose columns one of the first lines of a file names, and the number of that line, from 0."""
    lines = enumerate(text.splitlines()[:50])
    found = ((s, n) for n, line in lines for s in SIMULATIONS if {*s.columns} <= {*_names(line, s.separator)})
    return next(found, None)


def _names(line: str, separator: str) -> list[str]:
    """Names of columns without what Vadere adds behind ("-PID1") and Viswalk before ("$PEDESTRIAN:")."""
    cells = (cell.strip().strip('"') for cell in line.split(separator))
    return [cell.removeprefix("$PEDESTRIAN:").partition("-PID")[0] for cell in cells]


def read_simulation(path: Path, simulation: Simulation, header: int) -> TrajectoryFile:
    """Read a table whose columns line ``header``, from 0, names; the time between its rows gives the frames, and where
    it is uneven (Vadere writes footsteps), the positions are interpolated. Raises InputError: unreadable, values that
    are not numbers, or only one time."""
    import pandas  # half a second

    require_file(path, f"trajectories of {simulation.name}")
    with expecting(path, f"trajectories of {simulation.name}", OSError, ValueError, AttributeError, StopIteration):
        with path.open(encoding="utf-8-sig") as file:
            names = _names([next(file) for _ in range(header + 1)][-1], simulation.separator)
        cells = pandas.read_csv(
            path, sep=simulation.separator, comment=simulation.comment, skiprows=header + 1, names=names,
            usecols=simulation.columns, index_col=False, dtype="str", encoding="utf-8-sig", skip_blank_lines=True,
        )[list(simulation.columns)]  # fmt: skip
        if len(cells) and cells.iloc[0, 1].strip(" []()").isalpha():  # Pathfinder's line of units
            cells = cells.iloc[1:]
        track_id, time_s, x, y = (np.asarray(cells[name].astype(np.float64)) for name in simulation.columns)
    rows = np.column_stack([track_id, time_s, x, y])[np.lexsort((time_s, track_id))]
    steps = np.diff(rows[:, 1])[np.diff(rows[:, 0]) == 0]
    if not (np.isfinite(rows).all() and (steps > 0).any()):
        raise InputError(f"{path}: expected people at several times, found none")
    period_s, note = float(np.median(steps[steps > 0])), ""
    frames = rows[:, 1] / period_s
    if (np.abs(frames - np.round(frames)) > 0.1).any():
        note = f"times are uneven: positions are interpolated to {RATE_HZ:g} frames per second"
        period_s, rows = 1 / RATE_HZ, np.concatenate([_even(rows[rows[:, 0] == i]) for i in np.unique(rows[:, 0])])
        frames = rows[:, 1] / period_s
    columns = {"id": rows[:, 0], "frame": np.round(frames), "x_m": rows[:, 2], "y_m": rows[:, 3]}
    return TrajectoryFile(table_of(columns, path), 1 / period_s, note=note)


def _even(rows: F64) -> F64:
    """(M, 4) rows of one person at even times, from (N, 4) id, time, x and y by time."""
    frames = np.arange(np.ceil(rows[0, 1] * RATE_HZ - 1e-9), np.floor(rows[-1, 1] * RATE_HZ + 1e-9) + 1)
    times = frames / RATE_HZ
    x, y = (np.interp(times, rows[:, 1], rows[:, axis]) for axis in (2, 3))
    return np.column_stack([np.full(len(times), rows[0, 0]), times, x, y])
