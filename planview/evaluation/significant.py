"""The four significant errors of Harville 2002, section 5 (lost, missed, swapped, tracking a non-person), and a fifth:
an id that passes to another person.

The paper names them without numbers. The durations here are our choice, argued at each parameter; all are on frames in
which the person counts (visible enough), so that being hidden is no loss. ``grouped_events`` and
``poisson_upper`` give confidence limits of small counts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from calib.types import I64, Bool
from planview.trajectories.ends import HIDDEN_S, has_ended

ErrorKind = Literal["lost", "missed", "swapped", "transferred", "false_track"]
UNMATCHED = -1
PREDICTED = -2
"""Values of ``PersonHistory.track_id`` in place of ids."""
LOST_S = 1.0
"""A person tracked before is lost when visible but held by no track for longer, at a stretch [s]. At
walking pace a person covers more than the gate, so that a track resumed later is resumed by luck or by identity
logic."""
MISSED_S = 2.0
"""A person visible for this long in a visit, and never tracked, is missed [s]. People that only cut a
corner of the view are gone before a tracker that asks for consecutive detections (the paper's does) may confirm."""
FALSE_TRACK_S = 1.0
"""A confirmed track that matches no person for this long in all, between matches of PERSIST_S, tracks a non-person
[s]. One second of doubt is what the real overhead recording is allowed, too."""
PREDICTED_S = 1.0
"""A lost track predicted beyond the gate from the person whom it followed for longer, at a stretch, is a false
track [s]: the paper reports predictions, too. Equal to FALSE_TRACK_S."""
PERSIST_S = 0.5
"""An identity held for less is a flicker between people that touch: it neither makes nor ends an error [s]. Longer than
two people need to pass within arm's length, shorter than any use made of an identity."""
EXCHANGE_S = HIDDEN_S
"""Two people taking each other's identities within this time are one swap [s]."""
EVENT_S = 2.0
"""Errors that begin within this time of an event's first one, and concern its people or tracks, belong to it [s].
One bad moment of people in contact costs several errors and is over by then."""


@dataclass(frozen=True)
class SignificantError:
    """One error: ``frame`` where it begins; ids are None where there is none; ``duration_s`` None where it lasts."""

    kind: ErrorKind
    frame: int
    truth_id: int | None
    track_id: int | None
    duration_s: float | None
    note: str

    @property
    def concerns(self) -> tuple[str, ...]:
        """Person and track, as far as there are any."""
        named = (("person", self.truth_id), ("track", self.track_id))
        return tuple(f"{what} {number}" for what, number in named if number is not None)

    @property
    def who(self) -> str:
        """Person and track in words."""
        return ", ".join(self.concerns)


@dataclass(frozen=True, eq=False)
class PersonHistory:
    """The frames in which a person counts, and the tracks matched there.

    Attributes:
        truth_id: the person.
        frame: (N,) int64, rising.
        track_id: (N,) int64 id of the matched track, PREDICTED (a prediction is within the gate) or UNMATCHED.
    """

    truth_id: int
    frame: I64
    track_id: I64


@dataclass(frozen=True, eq=False)
class TrackHistory:
    """The confirmed rows of one track: ``stray`` (N,) bool where it matches no person, not even a hidden one."""

    track_id: int
    frame: I64
    stray: Bool


@dataclass(frozen=True, eq=False)
class PredictionHistory:
    """The predicted (lost) rows of one track.

    Attributes:
        truth_id: (N,) whom the track followed before.
        off: (N,) bool, whether that person is in the truth, beyond the gate.
    """

    track_id: int
    frame: I64
    truth_id: I64
    off: Bool


def significant_errors(
    people: list[PersonHistory],
    tracks: list[TrackHistory],
    frame_s: float,
    predictions: Sequence[PredictionHistory] = (),
) -> list[SignificantError]:
    """All significant errors by frame, of histories of every person of the truth, of every track that was ever
    confirmed and of every one that was ever lost; a track is false once, for its confirmed or its predicted rows."""
    visits: list[PersonHistory] = []
    errors: list[SignificantError] = []
    for person in people:
        visits += split_visits(person, frame_s)
    for visit in visits:
        errors += _visit_errors(visit, frame_s)
    errors += _identity_errors(visits, frame_s)
    errors += _transfers(visits, frame_s)
    false_tracks = set()
    for track in tracks:
        for error in _stray_errors(track, frame_s):
            false_tracks.add(error.track_id)
            errors.append(error)
    for prediction in predictions:
        if prediction.track_id not in false_tracks:
            errors += _prediction_errors(prediction, frame_s)
    return sorted(errors, key=lambda error: (error.frame, error.kind, error.truth_id or 0, error.track_id or 0))


def grouped_events(errors: Sequence[SignificantError], within_frames: float) -> list[list[SignificantError]]:
    """Errors, by frame, that belong together: those that begin within some frames of an event's first error and
    concern a person or a track of it."""
    events: list[list[SignificantError]] = []
    for error in errors:
        for event in reversed(events):
            if error.frame - event[0].frame <= within_frames and any({*e.concerns} & {*error.concerns} for e in event):
                event.append(error)
                break
        else:
            events.append([error])
    return events


def poisson_upper(count: int) -> float:
    """The largest mean of a Poisson distribution that gives at most this many events with a probability of at least
    0.05: chi2.ppf(0.95, 2 count + 2) / 2 (Garwood 1936, one-sided)."""
    if not count:
        return math.log(20)
    from scipy.special import gammaincinv  # a tenth of a second

    return float(gammaincinv(count + 1, 0.95))


def split_visits(person: PersonHistory, frame_s: float) -> list[PersonHistory]:
    """The history cut where the person did not count for longer than people are hidden; then a new id is right."""
    cuts = np.flatnonzero(has_ended(np.diff(person.frame) * frame_s)) + 1
    frames = np.split(person.frame, cuts)
    ids = np.split(person.track_id, cuts)
    return [PersonHistory(person.truth_id, f, i) for f, i in zip(frames, ids, strict=True) if len(f)]


def strict_identity_changes(people: list[PersonHistory], frame_s: float) -> int:
    """Every change of a person's identity over the whole recording, however long the person was away.

    Stricter than the paper's count: a new id after ``HIDDEN_S`` counts, and an exchange counts for both people.
    A person whose first id was another person's before counts, too. Identities held for less than ``PERSIST_S`` are
    left out; CLEAR's switches count these.
    """
    changes = sum(max(0, len(_persistent(person, PERSIST_S / frame_s)) - 1) for person in people)
    return changes + len([*_transfers(people, frame_s)])


def _visit_errors(visit: PersonHistory, frame_s: float) -> Iterator[SignificantError]:
    tracked = visit.track_id != UNMATCHED
    matched_s = np.count_nonzero(tracked & (visit.track_id != PREDICTED)) * frame_s
    if matched_s < min(PERSIST_S, MISSED_S):
        visible_s = len(visit.frame) * frame_s
        if visible_s >= MISSED_S:
            extent = f"tracked for only {matched_s:.1f} s of it" if matched_s else "never tracked"
            note = f"visible for {visible_s:.1f} s and {extent}"
            yield SignificantError("missed", int(visit.frame[0]), visit.truth_id, None, visible_s, note)
        return
    for start, stop in _losses(tracked, PERSIST_S / frame_s, LOST_S / frame_s):
        alone_s = (stop - start) * frame_s
        before = visit.track_id[:start][visit.track_id[:start] > 0]
        track = int(before[-1]) if len(before) else None
        note = f"visible but without a track for {alone_s:.1f} s at a stretch"
        yield SignificantError("lost", int(visit.frame[start]), visit.truth_id, track, alone_s, note)


def _losses(tracked: Bool, min_frames: float, max_alone: float) -> Iterator[tuple[int, int]]:
    """(start, stop) of continuous stretches without a track, longer than ``max_alone`` frames, after the first track.

    Of several between which the person is tracked for less than ``min_frames`` frames the first stands for all.
    """
    for start, stop in runs(~_without_blips(tracked, min_frames)):
        stretches = [(start + a, start + b) for a, b in runs(~tracked[start:stop]) if b - a > max_alone]
        if start > 0 and stretches:
            yield stretches[0]


def _without_blips(held: Bool, min_frames: float) -> Bool:
    """Held, but for stretches shorter than ``min_frames`` frames in the middle of being alone."""
    steady = held.copy()
    for start, stop in runs(held):
        if stop - start < min_frames and start > 0 and stop < len(held):
            steady[start:stop] = False
    return steady


_Change = tuple[int, int, int, int, float]
"""Frame, person, old and new persistent identity, and the time at a stretch without any between them [s]."""


def _identity_errors(visits: list[PersonHistory], frame_s: float) -> Iterator[SignificantError]:
    stretches = [(visit, _persistent(visit, PERSIST_S / frame_s)) for visit in visits]
    first_held: dict[int, list[tuple[int, int]]] = {}
    for visit, held in stretches:
        for track, start, _ in held:
            first_held.setdefault(track, []).append((int(visit.frame[start]), visit.truth_id))
    changes = [change for visit, held in stretches for change in _changes(visit, held, frame_s)]
    reported: list[_Change] = []
    for change in sorted(changes, key=lambda c: c[0]):
        at, person, old, new, alone_s = change
        owners = {p for frame, p in first_held[new] if frame < at and p != person}
        if not owners:
            if alone_s <= LOST_S:  # longer is reported as lost already
                yield SignificantError("lost", at, person, old, alone_s, f"went on as a new track {new}")
        elif not any(
            (old, new) == (back, gone) and person != other and abs(at - then) <= EXCHANGE_S / frame_s
            for then, other, gone, back, _ in reported
        ):
            reported.append(change)
            note = f"took over track {new} of person {', '.join(map(str, sorted(owners)))}"
            yield SignificantError("swapped", at, person, new, None, note)


def _transfers(visits: Sequence[PersonHistory], frame_s: float) -> Iterator[SignificantError]:
    """Visits that begin with a track which only others held before: to whoever uses the id they are one person."""
    stretches = [(visit, held) for visit in visits for held in _persistent(visit, PERSIST_S / frame_s)]
    holders: dict[int, list[int]] = {}
    begun: set[int] = set()
    for visit, (track, start, _) in sorted(stretches, key=lambda s: int(s[0].frame[s[1][1]])):
        before = holders.setdefault(track, [])
        if before and visit.truth_id not in before and id(visit) not in begun:  # later in a visit it is a swap
            note = f"began with track {track} of person {before[-1]}"
            yield SignificantError("transferred", int(visit.frame[start]), visit.truth_id, track, None, note)
        before.append(visit.truth_id)
        begun.add(id(visit))


def _persistent(visit: PersonHistory, min_frames: float) -> list[tuple[int, int, int]]:
    """(track id, start, stop) of every identity held for at least ``min_frames`` frames, gaps included.

    Matches with the same track count together unless another persistent identity comes between.
    """
    rows = np.flatnonzero(visit.track_id > 0)
    ids = visit.track_id[rows]
    ends = np.flatnonzero(np.diff(ids, prepend=0, append=0)).tolist()
    parts = [(int(ids[a]), int(rows[a]), int(rows[b - 1]) + 1, b - a) for a, b in pairwise(ends)]
    joined: list[tuple[int, int, int]] = []
    for track, start, stop, count in parts:
        if count < min_frames:
            continue
        if joined and joined[-1][0] == track:
            joined[-1] = (track, joined[-1][1], stop)
        else:
            joined.append((track, start, stop))
    return joined


def _changes(visit: PersonHistory, held: list[tuple[int, int, int]], frame_s: float) -> Iterator[_Change]:
    for (old, _, stop), (new, start, _) in pairwise(held):
        alone = max((b - a for a, b in runs(visit.track_id[stop:start] == UNMATCHED)), default=0)
        yield int(visit.frame[start]), visit.truth_id, old, new, alone * frame_s


def _stray_errors(track: TrackHistory, frame_s: float) -> Iterator[SignificantError]:
    """The part of a track with the most stray frames, where matches shorter than PERSIST_S do not divide it."""
    parts = runs(~_without_blips(~track.stray, PERSIST_S / frame_s))
    start, stop = max(parts, key=lambda part: np.count_nonzero(track.stray[slice(*part)]), default=(0, 0))
    n_stray = int(np.count_nonzero(track.stray[start:stop]))
    stray_s = n_stray * frame_s
    if stray_s >= FALSE_TRACK_S:
        within = f" of {(stop - start) * frame_s:.1f} s" if n_stray < stop - start else ""
        note = f"on no person for {stray_s:.1f} s{within}"
        yield SignificantError("false_track", int(track.frame[start]), None, track.track_id, stray_s, note)


def _prediction_errors(predicted: PredictionHistory, frame_s: float) -> Iterator[SignificantError]:
    """The longest stretch of frames in which a track is predicted where its person is not."""
    rows = np.flatnonzero(predicted.off)
    stretches = np.split(rows, np.flatnonzero(np.diff(predicted.frame[rows]) > 1) + 1)
    longest = max(stretches, key=len)
    off_s = len(longest) * frame_s
    if off_s > PREDICTED_S:
        frame = int(predicted.frame[longest[0]])
        person = int(predicted.truth_id[longest[0]])
        note = f"predicted away from person {person} for {off_s:.1f} s"
        yield SignificantError("false_track", frame, person, predicted.track_id, off_s, note)


def runs(mask: Bool) -> list[tuple[int, int]]:
    """(start, stop) of every stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
