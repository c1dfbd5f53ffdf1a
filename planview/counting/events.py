"""``events.csv``: crossings of tripwires, entries to and exits from zones, with their times."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal, cast, get_args

from calib.errors import InputError
from calib.io import expecting, reason, require_file

EventKind = Literal["crossing", "entry", "exit"]
Direction = Literal["left_to_right", "right_to_left", ""]

EVENT_COLUMNS = ("frame", "timestamp_s", "rule", "kind", "id", "direction")


def way_words(direction: str, inward: object) -> str:
    """A crossing in words: "in" or "out" where the rule defines it, else as seen from the line's first point to its
    second."""
    if inward:
        return "in" if direction == inward else "out"
    return "to its right" if direction == "left_to_right" else "to its left"


@dataclass(frozen=True)
class Event:
    """A row of events.csv: a crossing of a tripwire, or an entry to or exit from a zone."""

    frame: int
    """First frame at or after the moment."""
    timestamp_s: float
    """The moment, interpolated between frames [s]."""
    rule: str
    kind: EventKind
    track_id: int
    direction: Direction = ""
    """The way of a crossing, looking along the line from its first to its second point; empty for zones."""


def write_event_header(file: IO[str]) -> None:
    csv.writer(file, lineterminator="\n").writerow(EVENT_COLUMNS)


def write_event_rows(file: IO[str], events: Iterable[Event]) -> None:
    """Append events in the order given."""
    writer = csv.writer(file, lineterminator="\n")
    for event in events:
        time_text = f"{event.timestamp_s:.4f}"
        writer.writerow((event.frame, time_text, event.rule, event.kind, event.track_id, event.direction))


def read_events(path: Path) -> list[Event]:
    """Read events.csv. Raises InputError: unreadable, columns missing, or a value that does not belong."""
    require_file(path, "an events file")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in EVENT_COLUMNS if name not in (reader.fieldnames or [])]
            if missing:
                raise InputError(f"{path}: expected events with the column {missing[0]!r}, found {reader.fieldnames}")
            return [_event(row, f"{path}: line {line}") for line, row in enumerate(reader, start=2)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected an events file, found {reason(error)}") from error


def _event(row: dict[str, str], where: str) -> Event:
    try:
        frame = int(row["frame"])
        moment = float(row["timestamp_s"])
        track_id = int(row["id"])
    except (ValueError, TypeError):
        raise InputError(
            f"{where}: expected numbers for frame, timestamp_s and id, found {list(row.values())}"
        ) from None
    if row["kind"] not in get_args(EventKind) or row["direction"] not in get_args(Direction):
        raise InputError(f"{where}: expected a known kind and direction, found {row['kind']!r}, {row['direction']!r}")
    return Event(frame, moment, row["rule"], cast(EventKind, row["kind"]), track_id, cast(Direction, row["direction"]))


def is_events(path: Path) -> bool:
    """True if a file holds events, not positions. Raises InputError: it cannot be read."""
    require_file(path, "truth or events")
    with expecting(path, "truth or events", OSError), path.open("rb") as file:
        return b"rule" in file.readline(10_000).strip().split(b",")
