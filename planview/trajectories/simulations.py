"""Tables of pedestrian simulations: Vadere, Pathfinder, crowdit and Viswalk."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import reason, require_file
from calib.types import F64
from planview.trajectories.file import TrajectoryFile
from planview.trajectories.table import table_of

RATE_HZ = 10.0
"""Frames per second of positions whose times are uneven, between which they are interpolated (our choice)."""


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
    return [cell.strip().removeprefix("$PEDESTRIAN:").partition("-PID")[0] for cell in line.split(separator)]


def read_simulation(path: Path, simulation: Simulation, header: int) -> TrajectoryFile:
    """Read a table whose columns line ``header``, from 0, names; the time between its rows gives the frames, and where
    it is uneven (Vadere writes footsteps), the positions are interpolated. Raises InputError: unreadable, values that
    are not numbers, or only one time."""
    import pandas  # half a second

    require_file(path, f"trajectories of {simulation.name}")
    try:
        with path.open(encoding="utf-8-sig") as file:
            names = _names([next(file) for _ in range(header + 1)][-1], simulation.separator)
        cells = pandas.read_csv(
            path, sep=simulation.separator, comment=simulation.comment, skiprows=header + 1, names=names,
            usecols=simulation.columns, index_col=False, dtype="str", encoding="utf-8-sig", skip_blank_lines=True,
        )[list(simulation.columns)]  # fmt: skip
        if len(cells) and cells.iloc[0, 1].strip(" []()").isalpha():  # Pathfinder's line of units
            cells = cells.iloc[1:]
        track_id, time_s, x, y = (np.asarray(cells[name].astype(np.float64)) for name in simulation.columns)
    except (OSError, ValueError, AttributeError, StopIteration) as error:
        raise InputError(f"{path}: expected trajectories of {simulation.name}, found {reason(error)}") from error
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
