"""Who is there when: bars over time, and a row of figures per person."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from calib.types import F64, I64
from planview.counting.totals import Clock
from planview.drawing.style import ERRORS, as_hex, person_hex
from planview.evaluation.significant import SignificantError
from planview.trajectories.state import State
from planview.trajectories.table import Trajectories


def people_rows(tracks: Trajectories, clock: Clock, ids: I64) -> list[dict[str, Any]]:
    """Of confirmed people, (P,) ids ascending: times [s], way [m], mean speed [m/s], median height [m]; empty where
    unknown."""
    rows = np.flatnonzero((tracks.state == "confirmed") & np.isin(tracks.track_id, ids))
    rows = rows[np.argsort(tracks.track_id[rows], kind="stable")]
    cuts = np.searchsorted(tracks.track_id[rows], ids[1:])
    return [_row(tracks.where(mine), clock) for mine in np.split(rows, cuts) if len(mine)]


def _row(person: Trajectories, clock: Clock) -> dict[str, Any]:
    when = clock.at(person.frame)
    # From places half a second apart, so that noise does not add up (our choice).
    picked = np.concatenate([[True], np.diff(np.floor((when - when[0]) / 0.5)) > 0])
    way = float(np.hypot(np.diff(person.x_m[picked]), np.diff(person.y_m[picked])).sum())
    span = float(when[-1] - when[0])
    known = person.height_m[np.isfinite(person.height_m)]
    return {
        "track_id": int(person.track_id[0]),
        "first": f"{when[0]:.1f}",
        "last": f"{when[-1]:.1f}",
        "observed": f"{len(person) * clock.frame_s:.1f}",
        "way": f"{way:.1f}" if np.isfinite(way) else "",
        "speed": f"{way / span:.2f}" if span > 0 and np.isfinite(way) else "",
        "height": f"{np.median(known):.2f}" if len(known) else "",
    }


UNHELD = -1
_STATES: tuple[State, ...] = ("confirmed", "lost", "tentative")


class Bar(NamedTuple):
    """A stretch of time; left and width in percent of the run."""

    left: float
    width: float
    colour: str
    title: str
    faint: bool = False


class TimelineRow(NamedTuple):
    """Bars, and marks of errors, of one person."""

    name: str
    link: str
    bars: list[Bar]
    marks: list[Bar]


class Timelines(NamedTuple):
    """Rows of tracks and of true people, the labels of the time axis, and how many rows were left out."""

    tracks: list[TimelineRow]
    truth: list[TimelineRow]
    ticks: list[tuple[float, str]]
    more: int


class Stretches(NamedTuple):
    """Runs of rows of one person with one value in consecutive frames, columns of equal length."""

    person: I64
    value: I64
    first: I64
    last: I64


def stretches(person: I64, frame: I64, value: I64) -> Stretches:
    """Stretches by person, then time, of (N,) rows, each (person, frame) once."""
    order = np.lexsort((frame, person))
    p, f, v = person[order], frame[order], value[order]
    new = np.ones(len(p), dtype=np.bool_)
    new[1:] = (np.diff(p) != 0) | (np.diff(f) != 1) | (np.diff(v) != 0)
    starts = np.flatnonzero(new)
    stops = np.append(starts[1:], len(p)) - 1
    return Stretches(p[starts], v[starts], f[starts], f[stops[: len(starts)]])


def timelines(
    tracks: Trajectories, truth: Trajectories | None, clock: Clock, n_frames: int, errors: Sequence[SignificantError]
) -> Timelines:
    """Bars of the people tracked longest and of all true people, in the order of their first frames."""
    span = clock.span(max(1, n_frames))

    def percent(frames: I64) -> F64:
        return np.asarray(100.0 * (clock.at(frames) - span.start_s) / max(span.duration_s, 1e-9))

    states = np.searchsorted(_STATES, tracks.state)
    shown = tracks.state != "tentative"
    found = stretches(tracks.track_id[shown], tracks.frame[shown], states[shown])
    rows, more = _rows(found, clock, percent, is_truth=False, errors=errors)
    true_rows: list[TimelineRow] = []
    if truth is not None and len(truth):
        held = stretches(truth.track_id, truth.frame, held_by(tracks, truth))
        true_rows, _ = _rows(held, clock, percent, is_truth=True, errors=errors)
    return Timelines(rows, true_rows, _ticks(span.start_s, span.duration_s), more)


def held_by(tracks: Trajectories, truth: Trajectories) -> I64:
    """(N,) id of the confirmed track matched to every row of the truth, UNHELD where there is none."""
    from planview.evaluation.metrics import clear_scores  # brings scipy
    from planview.evaluation.sequence import build_sequence, floor_similarity

    claimed = tracks.where((tracks.state == "confirmed") & np.isfinite(tracks.x_m))
    matches = clear_scores(build_sequence(truth, claimed, floor_similarity(0.5))).matches
    holder = np.full(len(truth), UNHELD, dtype=np.int64)
    holder[matches[:, 0]] = claimed.track_id[matches[:, 1]]
    return holder


def _rows(
    found: Stretches, clock: Clock, percent: Callable[[I64], F64], *, is_truth: bool, errors: Sequence[SignificantError]
) -> tuple[list[TimelineRow], int]:
    people, first = np.unique(found.person, return_index=True)
    length = np.bincount(np.searchsorted(people, found.person), found.last - found.first + 1, len(people))
    # Rows of each kind.
    longest = np.argsort(-length, kind="stable")[:60]
    ordered = people[longest][np.argsort(found.first[first[longest]], kind="stable")]
    left, right = percent(found.first), percent(found.last + 1)
    begin, end = clock.at(found.first), clock.at(found.last + 1)
    rows = []
    for person in ordered.tolist():
        bars = []
        for i in np.flatnonzero(found.person == person).tolist():
            value = int(found.value[i])
            if is_truth:
                what = "no track" if value == UNHELD else f"track {value}"
            else:
                what = "observed" if _STATES[value] == "confirmed" else "only predicted"
            text = f"{begin[i]:.1f} to {end[i]:.1f} s: {what}"
            colour = "" if is_truth and value == UNHELD else person_hex(value if is_truth else person)
            bars.append(Bar(float(left[i]), float(right[i] - left[i]), colour, text, not is_truth and value == 1))
        marks = [
            Bar(float(percent(np.array([e.frame]))[0]), 0.0, as_hex(ERRORS[e.kind]), f"{e.kind}: {e.note}")
            for e in errors
            if (e.truth_id == person if is_truth else e.truth_id is None and e.track_id == person)
        ]
        rows.append(
            TimelineRow(f"P{person}" if is_truth else str(person), "" if is_truth else f"person-{person}", bars, marks)
        )
    return rows, len(people) - len(ordered)


def _ticks(start_s: float, duration_s: float) -> list[tuple[float, str]]:
    """About six round times: (percent, text)."""
    step = next(s for base in range(-2, 12) for s in (1 * 10.0**base, 2 * 10.0**base, 5 * 10.0**base)
                if duration_s / s <= 7)  # fmt: skip
    times = np.arange(np.ceil(start_s / step) * step + 0.0, start_s + duration_s + 1e-9, step)
    return [(100.0 * (t - start_s) / max(duration_s, 1e-9), f"{t:g} s") for t in times.tolist()]
