"""The tables of a run and its plan-view recording, written frame by frame and valid whenever the run ends."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from calib.errors import InputError, WorkError
from calib.io import PART, expecting, sync, whole_file
from planview.counting.events import Event, write_event_header, write_event_rows
from planview.engine.engine import Engine, FrameResult
from planview.maps.recording import MapsRecording, MapsWriter, RecordedPoints, RecordedViews
from planview.output.folder import writing
from planview.tracking.base import ScoreTerms
from planview.trajectories.table import write_header, write_rows
from stereo.recording import Frame, Skipped

KEPT_NOTE = "; earlier frames are kept"


class FrameFile:
    """A text file that grows by whole frames: one that is written in part (a full disk) is cut off again.

    Args:
        write_header: of a new file.
        size: of ``mark``, to resume from [bytes]; what was written after it is dropped.
    Raises:
        WorkError: the file cannot be written, here and in the methods.
    """

    def __init__(self, path: Path, write_header: Callable[[IO[str]], object], size: int | None = None) -> None:
        self.path = path
        self._size = size or 0
        with writing(path):
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o644)
            self._cut()
            self._digest = hashlib.blake2b(path.read_bytes(), digest_size=16)
        if size is None:
            try:
                self.add(write_header)
            except WorkError:
                self.close()
                raise

    def _cut(self) -> None:
        os.ftruncate(self._descriptor, self._size)
        os.lseek(self._descriptor, self._size, os.SEEK_SET)

    def mark(self) -> tuple[int, str]:
        """Bring everything to the disk; size [bytes] and digest of what was written (see ``is_as_marked``)."""
        with writing(self.path, KEPT_NOTE):
            os.fsync(self._descriptor)
        return self._size, self._digest.hexdigest()

    def add(self, write: Callable[[IO[str]], object]) -> None:
        """Append what ``write`` writes."""
        text = io.StringIO()
        write(text)
        data = text.getvalue().encode()
        with writing(self.path, KEPT_NOTE):
            try:
                rest = data
                while rest:
                    written = os.write(self._descriptor, rest)
                    rest = rest[written:]
            except BaseException:
                self._cut()
                raise
        self._size += len(data)
        self._digest.update(data)

    def close(self) -> None:
        os.close(self._descriptor)


def is_as_marked(path: Path, size: int, digest: str) -> bool:
    """True where a file begins with what a ``FrameFile`` had written at its mark."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return hashlib.blake2b(file.read(size), digest_size=16).hexdigest() == digest


DECISION_COLUMNS = ("frame", "timestamp_s", "id", "kind", "reason", "value", *ScoreTerms._fields)
"""The last four: the terms of a match score, empty where the value is none."""


@contextmanager
def reading_decisions(path: Path) -> Iterator[csv.DictReader[str]]:
    """The rows of decisions.csv. Raises InputError: unreadable, columns missing, or in the block a bad number."""
    errors = (OSError, UnicodeDecodeError, csv.Error, ValueError, TypeError)
    with expecting(path, "a table of decisions", *errors), path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        columns = list(reader.fieldnames or ())
        missing = [name for name in ("frame", "timestamp_s", "id", "kind", "reason") if name not in columns]
        if missing:
            found = ",".join(columns)[:80]
            raise InputError(f"{path}: expected decisions with the column {missing[0]!r}, found {found!r}")
        yield reader


class RunTables:
    """The tables of a run; ``events``: with those of rules; ``marks``: by file name, to resume from."""

    def __init__(self, folder: Path, events: bool, marks: Mapping[str, tuple[int, str]] | None = None) -> None:
        headers: dict[str, Callable[[IO[str]], object]] = {
            "tracks.csv": write_header,
            "decisions.csv": lambda file: file.write(",".join(DECISION_COLUMNS) + "\n"),
        }
        if events:
            headers["events.csv"] = write_event_header
        self._files: dict[str, FrameFile] = {}
        for name, header in headers.items():
            size = None if marks is None else marks[name][0]
            self._files[name] = FrameFile(folder / name, header, size)

    def add(self, result: FrameResult, events: Sequence[Event]) -> None:
        """Append the rows of a frame."""
        tracks = self._files["tracks.csv"]
        tracks.add(lambda file: write_rows(file, result.frame, result.timestamp_s, result.tracks))
        if "events.csv" in self._files:
            self._files["events.csv"].add(lambda file: write_event_rows(file, events))
        rows = []
        for decision in result.decisions:
            numbers = (decision.value, *decision.terms)
            texts = ["" if math.isnan(number) else f"{number:.4f}" for number in numbers]
            begin = [result.frame, f"{result.timestamp_s:.4f}", decision.track_id, decision.kind, decision.reason]
            rows.append(begin + texts)
        self._files["decisions.csv"].add(lambda file: csv.writer(file, lineterminator="\n").writerows(rows))

    def mark(self) -> dict[str, tuple[int, str]]:
        return {name: file.mark() for name, file in self._files.items()}

    def close(self) -> None:
        for file in self._files.values():
            file.close()


def refuse_unrecorded(engine: Engine) -> None:
    """Raises InputError: the views of an engine's sensors cannot be recorded as plan-view maps."""
    if len(engine.sensors) > 1:
        raise InputError("maps.h5 holds the view of one sensor, and the recording has several sensors", argument="maps")
    if not engine.sensors[0].records:
        found = "recorded maps" if engine.rigs else "a camera without depth"
        raise InputError(f"expected a stereo pair or images with depth, found {found}", argument="maps")


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
        refuse_unrecorded(engine)
        self._recording = engine.recording
        self._path = path
        self._open_path = path.with_name(path.name + PART)
        sensor = RecordedViews(engine.rigs[engine.sensors[0].name], engine.config.model_dump_json())
        self._new_writer = partial(MapsWriter, sensor=sensor, fps=engine.recording.fps)
        self._parts = 0
        if position is not None:
            self._resume(position["parts"])
        self._writer: MapsWriter | None = self._new_writer(self._open_path)

    def _resume(self, parts: int) -> None:
        """Continue after so many files, and remove those that were written after them."""
        self._parts = parts
        kept = self._part_paths
        for part in kept:
            if not part.is_file():
                raise InputError(f"{part}: expected the points before the checkpoint, found no file")
        for part in self._path.parent.glob(f"{self._path.stem}-[0-9]*.h5"):
            if part not in kept:
                part.unlink()

    def frame(self, result: FrameResult) -> None:
        if self._writer is None:
            self._writer = self._new_writer(self._open_path)
        points = RecordedPoints.of(result.views[0])
        self._writer.add(Frame(result.frame, result.timestamp_s, (points,)))

    def mark(self) -> dict[str, int]:
        self._end_part()
        return {"parts": self._parts}

    def close(self) -> None:
        if self._parts == 0:
            self._end(self._path, self._recording.skipped)
            return
        self._end_part()
        with whole_file(self._path) as whole:
            writer = self._new_writer(whole)
            for path in self._part_paths:
                for frame in MapsRecording(path):
                    writer.add(frame)
            writer.close(self._recording.skipped)

    @property
    def _part_paths(self) -> list[Path]:
        return [self._path.with_name(f"{self._path.stem}-{n}.h5") for n in range(1, self._parts + 1)]

    def _end_part(self) -> None:
        if self._writer is not None:
            self._parts += 1
            self._end(self._part_paths[-1])

    def _end(self, path: Path, skipped: Sequence[Skipped] = ()) -> None:
        """Give the file under way its name."""
        writer = self._writer
        self._writer = None
        if writer is not None:
            writer.close(skipped)
            sync(self._open_path)
            self._open_path.replace(path)
