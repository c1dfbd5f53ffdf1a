"""The ledger of a person: why the tracker did what it did, from decisions.csv."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.io import reason
from calib.types import F64
from planview.tracking.base import ScoreTerms

TERMS = ScoreTerms._fields
SCORES_MAX = 240
"""Points of a person's curve of scores."""
EVENTS_MAX = 80
"""Decisions listed per person; decisions.csv has them all."""


class Decided(NamedTuple):
    """A row of decisions.csv that is not a plain match."""

    frame: str
    time_s: str
    kind: str
    reason: str


class Curve(NamedTuple):
    """A term of the score over time: points of a polygon on top of the terms before, in a box of 100 x 100."""

    name: str
    points: str


class Ledger(NamedTuple):
    """A person's decisions.

    Attributes:
        events: everything but matches.
        more: events left out.
        scores: the matches in one sentence.
        curves: the stacked terms of the scores.
        score_max: top of the curves.
    """

    events: list[Decided]
    more: int
    scores: str
    curves: list[Curve]
    score_max: float


class _PersonDecisions:
    """Rows of one person while reading."""

    def __init__(self) -> None:
        self.events: list[Decided] = []
        self.matches: list[tuple[float, ...]] = []


def read_ledger(path: Path, people: set[int]) -> dict[int, Ledger]:
    """The ledgers of some people; empty where there is no decisions.csv.

    Raises:
        InputError: not a table of decisions.
    """
    if not path.is_file():
        return {}
    found: dict[int, _PersonDecisions] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            columns = {name: i for i, name in enumerate(next(reader, []))}
            missing = [name for name in ("frame", "timestamp_s", "id", "kind", "reason") if name not in columns]
            if missing:
                raise InputError(f"{path}: expected decisions with the column {missing[0]!r}, found {list(columns)}")
            for row in reader:
                _take(row, columns, people, found)
    except (OSError, UnicodeDecodeError, csv.Error, ValueError, IndexError) as error:
        raise InputError(f"{path}: expected a table of decisions, found {reason(error)}") from error
    return {person: _ledger(rows) for person, rows in found.items()}


def _take(row: list[str], columns: dict[str, int], people: set[int], found: dict[int, _PersonDecisions]) -> None:
    person = int(row[columns["id"]])
    if person not in people:
        return
    mine = found.setdefault(person, _PersonDecisions())
    if row[columns["kind"]] == "matched":
        values = [row[columns[name]] if name in columns else "" for name in ("frame", "value", *TERMS)]
        mine.matches.append(tuple(float(value or "nan") for value in values))
    else:
        frame, time_s, kind, reason = (row[columns[name]] for name in ("frame", "timestamp_s", "kind", "reason"))
        mine.events.append(Decided(frame, f"{float(time_s):.2f}", kind, reason))


def _ledger(rows: _PersonDecisions) -> Ledger:
    matches = np.array(rows.matches, dtype=np.float64).reshape(-1, 2 + len(TERMS))
    known = matches[np.isfinite(matches[:, 1])]
    events = [*rows.events[: EVENTS_MAX - 10], *rows.events[-10:]] if len(rows.events) > EVENTS_MAX else rows.events
    more = len(rows.events) - len(events)
    if not len(known):
        return Ledger(events, more, f"matched in {len(matches)} frames" if len(matches) else "", [], 0.0)
    top = float(known[:, 1].max())
    return Ledger(events, more, _sentence(known), _curves(known, max(top, 1e-9)), top)


def _sentence(matches: F64) -> str:
    worst = matches[np.argmax(matches[:, 1])]
    text = (
        f"matched in {len(matches)} frames, {matches[0, 0]:.0f} to {matches[-1, 0]:.0f}; median score "
        f"{np.median(matches[:, 1]):.2f}, worst {worst[1]:.2f} in frame {worst[0]:.0f}"
    )
    if np.isfinite(worst[2:]).all():
        text += " (" + ", ".join(f"{name} {value:.2f}" for name, value in zip(TERMS, worst[2:], strict=True)) + ")"
    return text


def _curves(matches: F64, top: float) -> list[Curve]:
    """Stacked terms; of many matches the worst of every stretch."""
    if not np.isfinite(matches[:, 2:]).all() or len(matches) < 2:
        return []
    bins = np.array_split(np.arange(len(matches)), min(len(matches), SCORES_MAX))
    picked = matches[[int(part[np.argmax(matches[part, 1])]) for part in bins]]
    span = max(1.0, picked[-1, 0] - picked[0, 0])
    x = 100.0 * (picked[:, 0] - picked[0, 0]) / span
    upper = np.vstack([np.zeros(len(picked)), np.cumsum(picked[:, 2:], axis=1).T])
    y = 100.0 - 100.0 * np.clip(upper / top, 0.0, 1.0)
    curves = []
    for n, name in enumerate(TERMS):
        around = [*zip(x, y[n + 1], strict=True), *zip(x[::-1], y[n][::-1], strict=True)]
        curves.append(Curve(name, " ".join(f"{a:.1f},{b:.1f}" for a, b in around)))
    return curves
