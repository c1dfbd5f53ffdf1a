"""Ids of a table stand for people, and in a second recording that counts from 1 again for other people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.types import F64, I64, Bool
from planview.trajectories.clock import USUAL_FPS, Clock
from planview.trajectories.ends import HIDDEN_S, PlacesByMoment, Steps, is_jump, track_numbers
from planview.trajectories.table import Trajectories, frame_times, judge_times, renumber

FORGOTTEN_S = 60.0
"""After nobody at all had a row for longer, ids that are used again are other people [s]: no tracker recognises people
after more than a minute."""
CLOSE_S = 1.0
"""Longest gap between rows of one id that still shows whether the same recording continues [s]."""
JUMPS_MAX = 0.1
"""Largest share of jumps among all steps. With more of them units or rate are wrong, and jumps are no evidence of
anything."""


def judge_ids(table: Trajectories) -> tuple[Trajectories, tuple[str, ...]]:
    """The table with times that run on and with other ids for other people, and what is odd about it, a sentence
    each."""
    frames, times_s = frame_times(table)
    set_back = frames[1:][np.diff(times_s) < 0]
    table, notes = judge_times(table)
    starts, doubtful = recording_starts(table, set_back)
    if len(doubtful):
        notes = *notes, f"ids are used again after an empty room, at frame {doubtful[0]}: is it another recording?"
    if len(starts):
        recording = np.searchsorted(starts, table.frame, side="right")
        track_id = renumber(table.track_id, recording)
        table = replace(table, track_id=track_id)
        where = ", ".join(map(str, starts[:5].tolist()))
        first = np.abs(track_id[recording > 0]).min()
        notes = *notes, f"another recording begins at frame {where}: its people get ids of their own, from {first} on"
    jumps = _jumps_note(table)
    return table, (*notes, jumps) if jumps else notes


def recording_starts(table: Trajectories, set_back: I64) -> tuple[I64, I64]:
    """(R,) frames at which another recording begins: ids are used on both sides, and nobody walks on; and (D,) those at
    which it may, since several people come back into an empty room.

    Args:
        set_back: frames at which times began again.
    """
    claimed = table.where(table.state == "confirmed")
    frames = np.unique(claimed.frame)
    clock = Clock(claimed, USUAL_FPS)
    steps = Steps(claimed, clock.at(claimed.frame))
    is_short = steps.gap_s <= CLOSE_S
    jumps = is_short & is_jump(steps.step_s, steps.moved_m)
    if not len(steps.first) or jumps.mean() > JUMPS_MAX:
        return frames[:0], frames[:0]
    jumping = _across(claimed, frames, steps, jumps)
    walking = _across(claimed, frames, steps, is_short & ~jumps)
    used_again = _across(claimed, frames, steps, np.ones_like(jumps))
    times_s = clock.at(frames)
    is_cut = np.diff(times_s, prepend=times_s[0]) > max(FORGOTTEN_S, 2 * clock.frame_s)  # frames may last longer
    is_cut[np.searchsorted(frames, set_back[set_back <= frames[-1]])] = True
    begins = is_cut & (used_again > 0) & (walking <= jumping)
    most_jump = (jumping > 1) & (jumping > walking)
    for place in np.flatnonzero(most_jump & ~begins).tolist():
        begins[place] = not _is_exchange(claimed, frames[place - 1 : place + 1], times_s[place - 1 : place + 1])
    return frames[begins], frames[~begins & (used_again > 2) & (jumping + walking == 0)]


def _across(table: Trajectories, frames: I64, steps: Steps, chosen: Bool) -> I64:
    """(F,) how many of the chosen steps lead from before each frame to it or beyond."""
    first = np.searchsorted(frames, table.frame[steps.first[chosen]])
    second = np.searchsorted(frames, table.frame[steps.second[chosen]])
    begun = np.bincount(first + 1, minlength=len(frames) + 1)
    done = np.bincount(second + 1, minlength=len(frames) + 1)
    return np.cumsum(begun - done)[: len(frames)]


def _is_exchange(table: Trajectories, frames: I64, times_s: F64) -> bool:
    """True if somebody walks on from every place of one frame to the next: then tracks have exchanged their people."""
    places = PlacesByMoment(table)
    before = np.flatnonzero((table.frame == frames[0]) & places.is_known)
    after = np.flatnonzero((table.frame == frames[1]) & places.is_known)
    away_m = places.apart_m(before[:, None], after)
    return bool((~is_jump(np.diff(times_s), away_m)).any(axis=1).all())


def _jumps_note(table: Trajectories) -> str:
    """The sentence on ids that jump, and no longer than people are hidden; empty where none does."""
    clock = Clock(table, USUAL_FPS)
    steps = Steps(table, clock.at(table.frame))
    jumps = np.flatnonzero(steps.ended & (steps.gap_s <= HIDDEN_S))
    if not 0 < len(jumps) <= JUMPS_MAX * len(steps.gap_s):
        return ""
    ids = np.unique(table.track_id[steps.second[jumps]])
    longest = jumps[np.argmax(steps.moved_m[jumps])]
    there = steps.second[longest]
    how = f"id {table.track_id[there]} by {steps.moved_m[longest]:.1f} m at frame {table.frame[there]}"
    others = f" and {len(ids) - 1} others" * (len(ids) > 1)
    return f"ids jump farther than anybody walks, {how}{others}: their tracks end there; are ids used again?"


def split_paths(table: Trajectories) -> tuple[Trajectories, str]:
    """The table with an id for each track, of which the first keeps its person's, and a sentence on the others."""
    numbers = track_numbers(table, Clock(table, USUAL_FPS).at(table.frame))
    first = np.unique(numbers, return_index=True)[1]
    ids = table.track_id[first]
    is_later = np.diff(ids, prepend=ids[:1] - 1) == 0
    if not is_later.any():
        return table, ""
    newest = max(0, int(ids.max()))
    ids[is_later] = newest + 1 + np.arange(is_later.sum())
    tracks = "1 track begins" if is_later.sum() == 1 else f"{is_later.sum()} tracks begin"
    note = f"{tracks} again later or elsewhere: the id is then another, from {newest + 1} on"
    return replace(table, track_id=ids[numbers]), note
