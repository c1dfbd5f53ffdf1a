"""Edits of tracks, a line of text each, so that a list of them can be read, kept and applied again.

``join A B``, ``split ID FRAME``, ``delete ID [FIRST LAST]``, ``rename ID NEW``, ``shorter SECONDS``,
``join-gaps SECONDS METRES``, ``region WKT``, ``ignore WKT``.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64, Bool
from planview.trajectories.file import Region, warn_of
from planview.trajectories.table import Trajectories, frame_period_s, rows_by_id

HELP = {
    "join": "join A B: track B becomes part of track A",
    "split": "split ID FRAME: from the frame on a track of a new id",
    "delete": "delete ID, or delete ID FIRST LAST: a track, or its rows of these frames",
    "rename": "rename ID NEW: another id, which no track has",
    "shorter": "shorter SECONDS: delete tracks that were confirmed for less",
    "join-gaps": "join-gaps SECONDS METRES: join tracks that begin within this time and distance of another one's end",
    "region": "region POLYGON ((x y, ...)): delete rows outside",
    "ignore": "ignore POLYGON ((x y, ...)): delete rows inside",
}
"""Kinds of edits, and how each is written."""


def edit_line(kind: str, edit: Sequence[float] | float | str) -> str:
    """An edit from its numbers, or from words such as 3:7 or 5@120."""
    numbers = re.split("[:@]", edit) if isinstance(edit, str) else np.ravel(edit).tolist()
    return " ".join(map(str, [kind, *numbers]))


def edited(table: Trajectories, lines: Sequence[str]) -> Trajectories:
    """The tracks, sorted by frame, then id, after edits in order; a new id is one above all ids so far, those that
    edits took away included. Raises InputError: a line that is not an edit, a track that is not there, or two rows of
    one frame that would get one id."""
    newest = int(table.track_id.max(initial=0))
    for line in lines:
        table = _apply(table, line, newest)
        newest = max(newest, int(table.track_id.max(initial=0)))
    return table


def _apply(table: Trajectories, line: str, newest: int) -> Trajectories:
    kind, *words = line.split() or [""]
    try:
        if kind in ("region", "ignore"):
            region = Region(line.partition(" ")[2], f"{kind}:")
            warn_of(region.doubt(table))
            held = region.contains(table)
            return table.where(held if kind == "region" else ~held)
        if kind in ("shorter", "join-gaps"):
            values = list(map(float, words))
            if not all(0 <= value < 1e6 for value in values):
                raise ValueError
            return _delete_shorter(table, *values) if kind == "shorter" else _join_gaps(table, *values)
        track_id, *numbers = map(int, words)
        return _BY_ID[kind](table, track_id, newest, *numbers)
    except (KeyError, ValueError, TypeError):
        raise InputError(f"{line!r}: expected {HELP.get(kind, 'one of ' + ', '.join(HELP))}") from None
    except InputError as error:
        raise InputError(f"{line!r}: {error}") from error


def _join(table: Trajectories, kept: int, _: int, other: int) -> Trajectories:
    _own(table, kept)
    if kept < 1:
        raise InputError(f"track {kept} was never confirmed, so it is nobody to join with")
    return _set_id(table, _own(table, other), kept)


def _split(table: Trajectories, track_id: int, newest: int, frame: int) -> Trajectories:
    own = _own(table, track_id)
    rest = own & (table.frame >= frame)
    if not rest.any() or (rest == own).all():
        frames = table.frame[own]
        raise InputError(f"the track can be split from frame {frames.min() + 1} to {frames.max()}, not at {frame}")
    return _set_id(table, rest, newest + 1)


def _delete(table: Trajectories, track_id: int, _: int, *span: int) -> Trajectories:
    gone = _own(table, track_id)
    if span:
        first, last = span
        gone &= (table.frame >= first) & (table.frame <= last)
        if not gone.any():
            raise InputError(f"track {track_id} has no rows in frames {first} to {last}")
    return table.where(~gone)


def _rename(table: Trajectories, old: int, _: int, new: int) -> Trajectories:
    if new < 1 or (table.track_id == new).any():
        raise InputError(f"the new id is from 1 and not in use: {new} is not (join puts two tracks together)")
    return _set_id(table, _own(table, old), new)


_BY_ID: dict[str, Callable[..., Trajectories]] = {
    "join": _join, "split": _split, "delete": _delete, "rename": _rename,
}  # fmt: skip


def _delete_shorter(table: Trajectories, seconds: float) -> Trajectories:
    """Keep the tracks that were confirmed for at least ``seconds``; all of them for 0."""
    frame_s = frame_period_s(table, 1 / 30)
    ids, frames = np.unique(table.track_id[table.state == "confirmed"], return_counts=True)
    long = ids[frames * frame_s >= seconds]
    return table.where(np.isin(table.track_id, long) | (seconds <= 0))


def _join_gaps(table: Trajectories, seconds: float, metres: float) -> Trajectories:
    """Nearest first; a track is continued by one other at most, and continues one other at most."""
    tracks = _people(table)
    starts = [track.first_frame for track in tracks]
    frames = seconds / frame_period_s(table, 1 / 30) + 1e-9
    pairs: list[tuple[float, int, int]] = []
    for before, former in enumerate(tracks):
        first = bisect_right(starts, former.last_frame)
        end = bisect_right(starts, former.last_frame + frames)
        for after in range(first, end):
            away_m = math.dist(former.last_m, tracks[after].first_m)
            if away_m <= metres:
                pairs.append((away_m, before, after))
    continued: set[int] = set()
    former_of: dict[int, int] = {}
    for _, before, after in sorted(pairs):
        if before not in continued and after not in former_of:
            continued.add(before)
            former_of[after] = before
    new_id: dict[int, int] = {}
    for place, track in enumerate(tracks):
        former_id = tracks[former_of[place]].track_id if place in former_of else track.track_id
        new_id[track.track_id] = new_id.get(former_id, former_id)
    ids = [new_id.get(track_id, track_id) for track_id in table.track_id.tolist()]
    return _with_ids(table, np.array(ids, dtype=np.int64))


class _Ends(NamedTuple):
    """First and last frame of a track, and the places [m] where it was first and last seen."""

    track_id: int
    first_frame: int
    last_frame: int
    first_m: F64
    last_m: F64


def _people(table: Trajectories) -> list[_Ends]:
    """The tracks with a place on the floor that were ever confirmed, by first frame; others are nobody's flickers."""
    confirmed = set(table.track_id[table.state == "confirmed"])
    places = np.column_stack([table.x_m, table.y_m])
    people = []
    for track_id, rows in rows_by_id(table.track_id):
        seen = places[rows]
        seen = seen[np.isfinite(seen).all(axis=1)]
        if track_id in confirmed and len(seen):
            first, last = table.frame[rows[[0, -1]]].tolist()
            people.append(_Ends(track_id, first, last, seen[0], seen[-1]))
    return sorted(people, key=lambda track: track.first_frame)


def _own(table: Trajectories, track_id: int) -> Bool:
    own = table.track_id == track_id
    if not own.any():
        raise InputError(f"no track has the id {track_id}")
    return np.asarray(own)


def _set_id(table: Trajectories, rows: Bool, track_id: int) -> Trajectories:
    """The table with an id in some rows."""
    both = np.intersect1d(table.frame[rows], table.frame[~rows & (table.track_id == track_id)])
    if len(both):
        raise InputError(f"both tracks are in frame {both[0]} (and {len(both) - 1} others), so they are two people")
    return _with_ids(table, np.where(rows, track_id, table.track_id))


def _with_ids(table: Trajectories, track_id: I64) -> Trajectories:
    return replace(table, track_id=track_id).where(np.lexsort((track_id, table.frame)))
