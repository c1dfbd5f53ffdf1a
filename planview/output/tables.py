"""The tables of a run, which grow frame by frame: tracks.csv, and events.csv and decisions.csv where asked for."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO

from planview.counting.events import Event, write_event_header, write_event_rows
from planview.engine.engine import FrameResult
from planview.output.frame_file import FilePosition, FrameFile
from planview.tracking.base import Decision, ScoreTerms
from planview.trajectories.table import write_header, write_rows

DECISION_COLUMNS = ("frame", "timestamp_s", "id", "kind", "reason", "value", *ScoreTerms._fields)
"""The last four: the terms of a match score, empty where the value is none."""


class RunTables:
    """Writes the rows of every frame.

    Args:
        events, decisions: whether these tables are written.
        positions: by file name, to go on from; what was written after them is dropped.
    """

    def __init__(
        self, folder: Path, events: bool, decisions: bool, positions: Mapping[str, FilePosition] | None = None
    ) -> None:
        self._files: dict[str, FrameFile] = {}
        headers: dict[str, Callable[[IO[str]], None]] = {"tracks.csv": write_header}
        headers |= {"events.csv": write_event_header} if events else {}
        headers |= {"decisions.csv": _decision_header} if decisions else {}
        for name, header in headers.items():
            self._files[name] = FrameFile(folder / name, header, positions[name] if positions else None)

    def add(self, result: FrameResult, events: Sequence[Event]) -> None:
        """Append one frame's rows."""
        frame, moment = result.frame, result.timestamp_s
        self._files["tracks.csv"].add(lambda file: write_rows(file, frame, moment, result.tracks))
        if "events.csv" in self._files:
            self._files["events.csv"].add(lambda file: write_event_rows(file, events))
        if "decisions.csv" in self._files:
            self._files["decisions.csv"].add(lambda file: _decision_rows(file, frame, moment, result.decisions))

    def mark(self) -> dict[str, FilePosition]:
        """Bring all rows to the disk; where every file ends."""
        return {name: file.mark() for name, file in self._files.items()}

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()


def _decision_header(file: IO[str]) -> None:
    csv.writer(file, lineterminator="\n").writerow(DECISION_COLUMNS)


def _decision_rows(file: IO[str], frame: int, timestamp_s: float, decisions: tuple[Decision, ...]) -> None:
    csv.writer(file, lineterminator="\n").writerows(
        (frame, f"{timestamp_s:.4f}", d.track_id, d.kind, d.reason, *map(_number, (d.value, *d.terms)))
        for d in decisions
    )


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4f}"
