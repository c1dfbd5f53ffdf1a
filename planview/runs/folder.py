"""The output folder of a run: files that are valid up to the last finished frame, whatever happens."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from calib.errors import InputError, WorkError
from planview.runs.info import RunInfo, read_run_info

PRODUCTS = (
    "tracks.csv", "tracks_online.csv", "refinement.csv", "events.csv", "decisions.csv", "counts.json",
    "run.json", "run.json.part", "run.rrd", "maps.h5", "report.html", "report.html.part",
)  # fmt: skip
"""Everything that a run may leave in its folder."""


def check_folder(folder: Path, overwrite: bool, recording: Path | None = None) -> None:
    """Whether results may go to a folder; to be asked before any work is done.

    Args:
        recording: the input, which must not be among the files that are replaced.

    Raises:
        InputError: the folder holds a finished run and ``overwrite`` is not set, or the input, or it is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder for the results, found a file")
    if recording is not None and recording.name in PRODUCTS and recording.resolve().parent == folder.resolve():
        raise InputError(f"{folder}: expected another folder than that of the input, found {recording} in it")
    if _holds_finished_run(folder) and not overwrite:
        raise InputError(f"{folder}: holds a finished run; choose another folder or add --overwrite")


def prepare_folder(folder: Path, overwrite: bool) -> None:
    """Make an empty place for a run; files that are not a run's are never touched.

    Raises:
        InputError: as ``check_folder``.
        WorkError: it cannot be made.
    """
    check_folder(folder, overwrite)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in PRODUCTS:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise WorkError(f"{folder}: cannot be written ({error.strerror})") from error


def _holds_finished_run(folder: Path) -> bool:
    """A run.json that cannot be read may be a finished run of another version: it counts as one."""
    try:
        return finished_run(folder) is not None
    except InputError:
        return True


def finished_run(folder: Path) -> RunInfo | None:
    """The run.json of a folder that holds a finished run, else None.

    Raises:
        InputError: there is a run.json that cannot be read.
    """
    path = folder / "run.json"
    if not path.is_file():
        return None
    info = read_run_info(path)
    return info if info.finished else None


class FrameFile:
    """A text file that grows by whole frames.

    A frame is written in one piece and pushed to the system; when that fails half-way (a full disk), what was written
    of it is cut off again.
    """

    def __init__(self, path: Path, write_header: Callable[[IO[str]], None]) -> None:
        self.path = path
        self._guarded(lambda: self._open(path))
        try:
            self.add(write_header)
        except WorkError:
            self.close()
            raise

    def _open(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        self._size = 0

    def add(self, write: Callable[[IO[str]], None]) -> None:
        """Append what ``write`` writes.

        Raises:
            WorkError: the disk is full or the file cannot be written; the file ends with the last whole frame.
        """
        text = io.StringIO()
        write(text)
        data = text.getvalue().encode()
        if data:
            self._guarded(lambda: self._append(data))

    def _append(self, data: bytes) -> None:
        try:
            written = 0
            while written < len(data):
                written += os.write(self._descriptor, data[written:])
        except BaseException:
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise
        self._size += len(data)

    def _guarded(self, action: Callable[[], None]) -> None:
        try:
            action()
        except OSError as error:
            raise WorkError(f"{self.path}: cannot be written ({error.strerror}); earlier frames are kept") from error

    def close(self) -> None:
        os.close(self._descriptor)
