"""``maps.h5``: the plan-view recording of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calib.errors import InputError
from calib.io import PART, sync, whole_file
from planview.engine.engine import Engine, FrameResult
from planview.maps.recording import MapsFrame, MapsRecording, MapsWriter


class MapsLog:
    """Writes the foreground points of every frame: a ``RunLog``.

    HDF5 cannot be read after a kill. So every ``mark`` ends a file of its own (``maps-1.h5``, ...); they become one
    when the log is closed.

    Args:
        position: of ``mark``, to resume from; what was written after it is dropped.
    Raises:
        InputError: an engine without disparity, or the files up to the position are missing.
        WorkError: the file cannot be written.
    """

    def __init__(self, engine: Engine, path: Path, position: Mapping[str, int] | None = None) -> None:
        if engine.stereo is None:
            raise InputError("expected a stereo pair or images with depth, found a camera without depth")
        self._engine, self._path = engine, path
        self._parts = 0 if position is None else position["parts"]
        kept = self._part_paths
        for missing in (part for part in kept if not part.is_file()):
            raise InputError(f"{missing}: expected the points before the checkpoint, found no file")
        for part in set(path.parent.glob(f"{path.stem}-[0-9]*.h5")) - set(kept) if position else ():
            part.unlink()
        self._writer: MapsWriter | None = self._new_writer(self._open_path)

    def frame(self, result: FrameResult) -> None:
        if result.depth is None:
            raise InputError("expected a recording with images, found recorded maps")
        self._writer = self._writer or self._new_writer(self._open_path)
        self._writer.add(MapsFrame.of(result.frame, result.timestamp_s, result.depth.disparity, result.views[0]))

    def mark(self) -> dict[str, int]:
        self._end_part()
        return {"parts": self._parts}

    def close(self) -> None:
        if self._parts == 0 and self._writer is not None:
            writer, self._writer = self._writer, None
            writer.close(self._engine.recording.skipped)
            sync(self._open_path)
            self._open_path.replace(self._path)
            return
        self._end_part()
        with whole_file(self._path) as whole:
            writer = self._new_writer(whole)
            for path in self._part_paths:
                for frame in MapsRecording(path):
                    writer.add(frame)
            writer.close(self._engine.recording.skipped)

    @property
    def _open_path(self) -> Path:
        return self._path.with_name(self._path.name + PART)

    @property
    def _part_paths(self) -> list[Path]:
        return [self._path.with_name(f"{self._path.stem}-{n}.h5") for n in range(1, self._parts + 1)]

    def _new_writer(self, path: Path) -> MapsWriter:
        stereo = self._engine.stereo
        assert stereo is not None
        return MapsWriter(path, stereo, self._engine.config.model_dump_json(), self._engine.recording.fps)

    def _end_part(self) -> None:
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        writer.close()
        sync(self._open_path)
        self._parts += 1
        self._open_path.replace(self._part_paths[-1])
