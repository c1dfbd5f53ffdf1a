"""HDF5 files of the Pedestrian Dynamics Data Archive (Juelich).

Dataset ``trajectory`` with the fields id, frame, x, y, z [m] and the attribute ``fps``; the root attribute
``wkt_geometry`` is the walkable area.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError
from calib.types import F64, AnyArray
from planview.trajectories.file import TrajectoryFile, checked_area, checked_rate, refuse_many, replaced
from planview.trajectories.rows import sorted_rows
from planview.trajectories.table import positions_table

FILE_VERSION = "1.0.0"
_FIELDS = ("id", "frame", "x", "y")
_ROW = np.dtype([("id", "<i8"), ("frame", "<i8"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])


def read_ped_data_archive(path: Path) -> TrajectoryFile:
    """Read a file of the archive; a z of 0 or less, or none, is no height.

    Raises:
        InputError: another HDF5 file, damaged, without its frame rate, or too large.
    """
    import h5py  # a tenth of a second, and only these files need it

    try:
        with h5py.File(path, "r") as file:
            trajectory = file.get("trajectory")
            if not isinstance(trajectory, h5py.Dataset):
                raise InputError(
                    f"{path}: expected the dataset 'trajectory', found {', '.join(file)[:200] or 'nothing'}"
                )
            table = _numbers(path, trajectory)
            fps = checked_rate(path, trajectory.attrs.get("fps"))
            area = file.attrs.get("wkt_geometry")
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        text = " ".join(str(error).split())
        raise InputError(f"{path}: expected an HDF5 file of the Ped Data Archive, found {text}") from error
    table = sorted_rows(path, table, frame=1, track_id=0)
    track_id, frame = table[:, :2].astype(np.int64).T
    rows = positions_table(frame, track_id, table[:, 2:4], np.where(table[:, 4] > 0, table[:, 4], np.nan))
    return TrajectoryFile(rows, fps, checked_area(_text(area), str(path)) if area is not None else None)


def write_ped_data_archive(path: Path, file: TrajectoryFile) -> None:
    """Write rows with known positions by id, then frame.

    Raises:
        WorkError: the file cannot be written.
    """
    import h5py

    table = file.table
    order = np.lexsort((table.frame, table.track_id))
    rows = np.empty(len(table), dtype=_ROW)
    columns = (table.track_id, table.frame, table.x_m, table.y_m, table.height_m)
    for name, column in zip(_ROW.names or (), columns, strict=True):
        rows[name] = column[order]
    with replaced(path) as part, h5py.File(part, "w") as out:
        out.attrs.update(file_version=FILE_VERSION, wkt_geometry=file.walkable_wkt or "", source="planview")
        dataset = out.create_dataset("trajectory", data=rows, compression="gzip" if len(rows) else None)
        dataset.attrs.update(
            fps=file.fps, id="unique identifier for pedestrian", frame="frame number",
            x="pedestrian x-coordinate (meter [m])", y="pedestrian y-coordinate (meter [m])",
            z="pedestrian z-coordinate (meter [m])",
        )  # fmt: skip


def _numbers(path: Path, dataset: Any) -> F64:
    """(N, 5) id, frame, x, y, z."""
    names = dataset.dtype.names or ()
    if set(_FIELDS) - set(names) or dataset.ndim != 1:
        raise InputError(f"{path}: expected a list with the fields id, frame, x, y, found {', '.join(names) or 'none'}")
    refuse_many(path, len(dataset))
    rows: AnyArray = dataset[:]
    height = rows["z"] if "z" in names else np.full(len(rows), np.nan)
    return np.column_stack([*(rows[name] for name in _FIELDS), height]).astype(np.float64)


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
