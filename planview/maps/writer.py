"""Writes plan-view recordings; ``planview.maps.recording`` documents and reads them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from calib.errors import WorkError
from calib.io import reason
from planview.maps.colour import CODES
from planview.maps.recording import APPEARANCE, BLOCK_FRAMES, COLUMNS, FORMAT, VERSION, MapsFrame
from planview.maps.rig import FloorRig
from stereo.recording import Skipped

SPARE_BYTES = 4 << 20
"""Room on the disk beyond what is about to be written: a chunk of every column, and the tables at the end [bytes]."""


class MapsWriter:
    """Writes a plan-view recording; ``close`` it, or it cannot be read.

    Args:
        path: the file to make.
        view: the rig, its floor and the grid of the maps.
        config: JSON of the configuration that made the points.
        fps: nominal frames per second.
    Raises:
        WorkError: the file cannot be written.
    """

    def __init__(self, path: Path, view: FloorRig, config: str, fps: float) -> None:
        self._path = path
        self._block: list[MapsFrame] = []
        self._end = self._unmatched_end = 0
        with _writing(path):
            with path.open("wb") as file:
                _reserve(file.fileno(), SPARE_BYTES)
            self._file = h5py.File(path, "w")
            _reserve(self._file.id.get_vfd_handle(), SPARE_BYTES)
            self._file.attrs.update(format=FORMAT, version=VERSION, config=config, fps=fps)
            _write_view(self._file, view)
            for name, kind in COLUMNS.items():
                self._column(name, kind)
            size = view.shape[0] * view.shape[1]
            self._file.create_dataset(
                "background/disparity", (0, size), np.float32, maxshape=(None, size), chunks=(1, size),
                compression="gzip", compression_opts=4, shuffle=True,
            )  # fmt: skip

    def add(self, frame: MapsFrame) -> None:
        """Append a frame.

        Raises:
            WorkError: the disk is full.
        """
        self._block.append(frame)
        if len(self._block) == BLOCK_FRAMES:
            self._flush()

    def close(self, skipped: Sequence[Skipped] = ()) -> None:
        """Write what is left, and the frames passed over.

        Raises:
            WorkError: the disk is full.
        """
        try:
            self._flush()
            with _writing(self._path):
                self._file["skipped/index"] = np.array([frame.index for frame in skipped], dtype=np.int64)
                self._file["skipped/why"] = np.array([frame.why for frame in skipped], dtype=h5py.string_dtype())
        finally:
            with _writing(self._path):
                self._file.flush()
                size = self._file.id.get_filesize()
                self._file.close()
                if self._path.stat().st_size > size:  # room that was not needed
                    os.truncate(self._path, size)

    def _flush(self) -> None:
        block, self._block = self._block, []
        if not block:
            return
        ends = self._end + np.cumsum([len(frame.pixels) for frame in block])
        self._end = int(ends[-1])
        unmatched_ends = self._unmatched_end + np.cumsum([len(frame.unmatched) for frame in block])
        self._unmatched_end = int(unmatched_ends[-1])
        backgrounds = {f.index: f.background.reshape(-1) for f in block if f.background is not None}
        columns: dict[str, Any] = {
            "unmatched/pixel": np.concatenate([frame.unmatched for frame in block]),
            "frames/unmatched_end": unmatched_ends,
            "background/frame": list(backgrounds),
            "points/pixel": np.concatenate([frame.pixels for frame in block]),
            "points/disparity": np.concatenate([frame.disparities for frame in block]),
            "frames/index": [frame.index for frame in block],
            "frames/timestamp_s": [frame.timestamp_s for frame in block],
            "frames/end": ends,
        }
        if backgrounds:
            columns["background/disparity"] = np.stack(list(backgrounds.values()))
        codes = [frame.colours for frame in block if frame.colours is not None]
        if codes and any(frame.colours is None and len(frame.pixels) for frame in block):
            raise ValueError("expected colours in all frames or in none")
        with _writing(self._path):
            needed = sum(np.asarray(values).nbytes for values in columns.values()) + sum(len(c) for c in codes)
            _reserve(self._file.id.get_vfd_handle(), self._file.id.get_filesize() + needed + SPARE_BYTES)
            if codes:
                if APPEARANCE not in self._file:
                    self._column(APPEARANCE, np.uint8).attrs["codes"] = CODES
                columns[APPEARANCE] = np.concatenate(codes)
            for name, values in columns.items():
                column = self._file[name]
                start = len(column)
                column.resize(start + len(values), axis=0)
                column[start:] = values

    def _column(self, name: str, kind: Any) -> Any:
        # Values compressed together.
        return self._file.create_dataset(
            name, (0,), kind, maxshape=(None,), chunks=(32768,), compression="gzip", compression_opts=4, shuffle=True
        )


def _write_view(file: Any, view: FloorRig) -> None:
    floor, rig = view.floor, asdict(view.geometry) | asdict(view.disparities)
    rig |= {"reduction": view.reduction, "calibration": view.calibration}
    rig |= {"vertical_residual_px": view.vertical_residual_px, "correction": view.correction}
    if view.sensor is not None:
        rig["sensor"] = view.sensor
    file.create_group("rig").attrs.update(rig)
    file.create_group("floor").attrs.update(
        world_SE3_left=floor.world_SE3_left.matrix, inlier_fraction=floor.inlier_fraction,
        residual_m=floor.residual_m, source=view.floor_source,
    )  # fmt: skip
    if floor.extent_m is not None:
        file["floor"].attrs["extent_m"] = floor.extent_m
    file.create_group("grid").attrs.update(asdict(view.grid))


def _reserve(descriptor: int, size: int) -> None:
    """Take room for a file of so many bytes: HDF5 ends the process when the disk is full while it writes.

    Raises:
        OSError: there is no room.
    """
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, size)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error
