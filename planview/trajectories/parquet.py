"""Parquet: the columns of ``tracks.csv``, with frame rate and walkable area as attributes (needs planview[table])."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.errors import InputError
from calib.types import F64
from planview.trajectories.file import TrajectoryFile, checked_area, checked_rate, refuse_many, replaced
from planview.trajectories.rows import sorted_rows
from planview.trajectories.table import STATES, TRACK_COLUMNS, Trajectories

if TYPE_CHECKING:
    from pandas import DataFrame

_REQUIRED = ("frame", "id", "x_m", "y_m")
_NUMBERS = tuple(name for name in TRACK_COLUMNS if name != "state")


def data_frame(file: TrajectoryFile) -> DataFrame:
    """A pandas DataFrame with the columns of ``tracks.csv``; ``attrs`` holds ``fps`` and ``walkable_wkt``.

    Raises:
        InputError: pandas is not installed.
    """
    frame = file.table.to_dataframe()
    frame.attrs.update(fps=file.fps, walkable_wkt=file.walkable_wkt)
    return frame


def write_parquet(path: Path, file: TrajectoryFile) -> None:
    """Write all rows.

    Raises:
        InputError: pandas or pyarrow is not installed.
        WorkError: the file cannot be written.
    """
    _pandas()
    frame = data_frame(file)
    with replaced(path) as part:
        frame.to_parquet(part, engine="pyarrow", index=False)


def read_parquet(path: Path) -> TrajectoryFile:
    """Read a table; a column that is missing is unknown.

    Raises:
        InputError: pandas or pyarrow is not installed, not a Parquet file, one of the columns frame, id, x_m, y_m is
            missing, or values of another kind.
    """
    pandas = _pandas()
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        with ParquetFile(path) as file:
            refuse_many(path, file.metadata.num_rows)
            names = [name for name in TRACK_COLUMNS if name in file.schema_arrow.names]
        missing = [name for name in _REQUIRED if name not in names]
        if missing:
            raise InputError(f"{path}: expected the column {missing[0]!r}, found {', '.join(names) or 'none of ours'}")
        frame = pandas.read_parquet(path, engine="pyarrow", columns=names)
        return _trajectories(path, frame)
    except (OSError, ValueError, TypeError, ArrowException) as error:
        raise InputError(f"{path}: expected trajectories in Parquet, found {' '.join(str(error).split())}") from error


def _trajectories(path: Path, frame: DataFrame) -> TrajectoryFile:
    unknown = np.full(len(frame), np.nan)
    numbers = {n: frame[n].to_numpy(dtype=np.float64, na_value=np.nan) if n in frame else unknown for n in _NUMBERS}
    rows: F64 = np.column_stack([*numbers.values(), np.arange(len(frame))])
    rows = sorted_rows(path, rows, frame=_NUMBERS.index("frame"), track_id=_NUMBERS.index("id"))
    column = dict(zip(_NUMBERS, rows.T[:-1], strict=True))
    state = frame["state"].to_numpy(dtype=np.str_) if "state" in frame else np.full(len(frame), "confirmed")
    foreign = set(np.unique(state)) - set(STATES)
    if foreign:
        raise InputError(f"{path}: expected a state of {', '.join(STATES)}, found {min(foreign)!r}")
    table = Trajectories(
        frame=column["frame"].astype(np.int64), track_id=column["id"].astype(np.int64),
        timestamp_s=column["timestamp_s"], x_m=column["x_m"], y_m=column["y_m"], height_m=column["height_m"],
        state=state[rows[:, -1].astype(np.int64)], visible=np.ones(len(rows)),
        box_px=np.column_stack([column[n] for n in ("left_px", "top_px", "width_px", "height_px")]),
        velocity_mps=np.column_stack([column["vx_mps"], column["vy_mps"]]),
    )  # fmt: skip
    fps, area = frame.attrs.get("fps"), frame.attrs.get("walkable_wkt")
    return TrajectoryFile(
        table,
        None if fps is None else checked_rate(path, fps),
        None if area is None else checked_area(str(area), str(path)),
    )


def _pandas() -> Any:
    try:
        import pandas
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise InputError("expected the packages pandas and pyarrow; install planview[table]") from error
    return pandas
