"""The tables of a run, written frame by frame and valid whenever the run ends."""

from __future__ import annotations

import csv
import io
import math
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from calib.errors import InputError, WorkError
from calib.io import reason
from planview.counting.events import Event, write_event_header, write_event_rows
from planview.engine.engine import FrameResult
from planview.tracking.base import ScoreTerms
from planview.trajectories.table import write_header, write_rows


class FilePosition(NamedTuple):
    """Where a file ends, and the checksum (CRC-32) of what it holds up to there."""

    size: int
    checksum: int


def holds(path: Path, position: FilePosition) -> bool:
    """Whether a file begins with what was written up to a position."""
    checksum, left = 0, position.size
    try:
        with path.open("rb") as file:
            while left and (data := file.read(min(left, 2**20))):
                checksum, left = zlib.crc32(data, checksum), left - len(data)
    except OSError:
        return False
    return left == 0 and checksum == position.checksum


class FrameFile:
    """A text file that grows by whole frames.

    A frame is written in one piece and pushed to the system; when that fails half-way (a full disk), what was written
    of it is cut off again.

    Args:
        write_header: of a new file.
        position: of ``mark``, to go on from; what was written after it is dropped.
    Raises:
        InputError: the file does not hold what was written up to the position.
        WorkError: the disk is full or the file cannot be written.
    """

    def __init__(
        self, path: Path, write_header: Callable[[IO[str]], object], position: FilePosition | None = None
    ) -> None:
        self.path = path
        if position is not None:
            self._guarded(lambda: self._reopen(position))
            return
        self._guarded(self._open)
        try:
            self.add(write_header)
        except WorkError:
            self.close()
            raise

    def _open(self) -> None:
        self._descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        self._position = FilePosition(0, 0)

    def _reopen(self, position: FilePosition) -> None:
        if not holds(self.path, position):
            raise InputError(f"{self.path}: expected the rows written before the checkpoint, found others")
        self._descriptor = os.open(self.path, os.O_WRONLY)
        self._position = position
        os.ftruncate(self._descriptor, position.size)
        os.lseek(self._descriptor, position.size, os.SEEK_SET)

    def mark(self) -> FilePosition:
        """Bring everything to the disk; where the file ends.

        Raises:
            WorkError: the disk is full.
        """
        self._guarded(lambda: os.fsync(self._descriptor))
        return self._position

    def add(self, write: Callable[[IO[str]], object]) -> None:
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
            os.ftruncate(self._descriptor, self._position.size)
            os.lseek(self._descriptor, self._position.size, os.SEEK_SET)
            raise
        self._position = FilePosition(self._position.size + len(data), zlib.crc32(data, self._position.checksum))

    def _guarded(self, action: Callable[[], None]) -> None:
        try:
            action()
        except OSError as error:
            raise WorkError(f"{self.path}: cannot be written ({reason(error)}); earlier frames are kept") from error

    def close(self) -> None:
        os.close(self._descriptor)


DECISION_COLUMNS = ("frame", "timestamp_s", "id", "kind", "reason", "value", *ScoreTerms._fields)
"""The last four: the terms of a match score, empty where the value is none."""


@contextmanager
def reading_decisions(path: Path) -> Iterator[csv.DictReader[str]]:
    """The rows of decisions.csv, to be taken apart in the block.

    Raises:
        InputError: unreadable, columns missing, or the block met a value that is no number.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            columns = list(reader.fieldnames or ())
            missing = [name for name in ("frame", "timestamp_s", "id", "kind", "reason") if name not in columns]
            if missing:
                found = ",".join(columns)[:80]
                raise InputError(f"{path}: expected decisions with the column {missing[0]!r}, found {found!r}")
            yield reader
    except (OSError, UnicodeDecodeError, csv.Error, ValueError, TypeError) as error:
        raise InputError(f"{path}: expected a table of decisions, found {reason(error)}") from error


class RunTables:
    """Writes the rows of every frame.

    Args:
        events: whether there are rules, whose events are written.
        positions: by file name, to go on from; what was written after them is dropped.
    """

    def __init__(self, folder: Path, events: bool, positions: Mapping[str, FilePosition] | None = None) -> None:
        self._files: dict[str, FrameFile] = {}
        headers: dict[str, Callable[[IO[str]], object]] = {
            "tracks.csv": write_header,
            "decisions.csv": lambda file: file.write(",".join(DECISION_COLUMNS) + "\n"),
        }
        headers |= {"events.csv": write_event_header} if events else {}
        for name, header in headers.items():
            self._files[name] = FrameFile(folder / name, header, positions[name] if positions else None)

    def add(self, result: FrameResult, events: Sequence[Event]) -> None:
        """Append one frame's rows."""
        frame, moment = result.frame, result.timestamp_s
        self._files["tracks.csv"].add(lambda file: write_rows(file, frame, moment, result.tracks))
        if "events.csv" in self._files:
            self._files["events.csv"].add(lambda file: write_event_rows(file, events))
        rows = [
            [frame, f"{moment:.4f}", d.track_id, d.kind, d.reason]
            + ["" if math.isnan(value) else f"{value:.4f}" for value in (d.value, *d.terms)]
            for d in result.decisions
        ]
        self._files["decisions.csv"].add(lambda file: csv.writer(file, lineterminator="\n").writerows(rows))

    def mark(self) -> dict[str, FilePosition]:
        """Bring all rows to the disk; where every file ends."""
        return {name: file.mark() for name, file in self._files.items()}

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()
