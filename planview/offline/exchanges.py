"""Exchanges of identity that were mended online, undone from the contact on in which they happened.

Online, an exchange is noticed some time after people part, and mended from then on: each id jumps to the other's
place. Offline the time between belongs to the other one too (our choice).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from calib.types import F64, I64
from planview.offline.changes import Change
from planview.offline.params import RefineParams
from planview.trajectories.table import Trajectories


def exchanges_undone(tracks: Trajectories, params: RefineParams) -> tuple[Trajectories, list[Change]]:
    """The tracks with mended exchanges moved back to the closest approach before them.

    Args:
        tracks: as written online; confirmed and lost rows have positions.
    Returns:
        The rows under their new ids, sorted by frame and id, and a change of kind "exchange" for each.
    """
    ids, changes = tracks.track_id.copy(), []
    for frame, one, other in _mended(tracks, params):
        contact = _contact(tracks, ids, frame, one, other, params)
        if contact is None:
            continue
        between = (tracks.frame > contact) & (tracks.frame < frame)
        was_one, was_other = between & (ids == one), between & (ids == other)
        ids[was_one], ids[was_other] = other, one
        late_s = float(_time(tracks, frame) - _time(tracks, contact))
        reason = f"exchanged with {other} since the contact {late_s:.1f} s before it was mended"
        changes.append(Change(one, contact + 1, frame - 1, "exchange", reason, late_s))
    order = np.lexsort((ids, tracks.frame))
    return replace(tracks, track_id=ids).where(order), changes


def _mended(tracks: Trajectories, params: RefineParams) -> Iterator[tuple[int, int, int]]:
    """(frame, id, id) of every frame in which two ids jump to each other's places."""
    jumps: dict[int, list[tuple[int, int, int]]] = {}
    for track in np.unique(tracks.track_id):
        rows = np.flatnonzero(tracks.track_id == track)
        far = _apart(tracks, rows[1:], rows[:-1]) > _reach(tracks, rows[1:], rows[:-1], params)
        for k in np.flatnonzero(far):
            jumps.setdefault(int(tracks.frame[rows[k + 1]]), []).append((int(track), int(rows[k]), int(rows[k + 1])))
    for frame in sorted(jumps):
        for (one, a, b), (other, c, d) in combinations(jumps[frame], 2):
            now, before = np.array([b, d]), np.array([c, a])
            if (_apart(tracks, now, before) <= _reach(tracks, now, before, params)).all():
                yield frame, one, other


def _contact(tracks: Trajectories, ids: I64, frame: int, one: int, other: int, params: RefineParams) -> int | None:
    """Where two ids were exchanged, within ``doubt_s`` before a frame; None where they never touched.

    That is the last frame in which one of the two was lost, since a person who is found again in contact is found in
    the wrong place; without one, where they were nearest.
    """
    recent = (tracks.frame < frame) & (tracks.timestamp_s >= _time(tracks, frame) - params.doubt_s)
    mine, theirs = np.flatnonzero(recent & (ids == one)), np.flatnonzero(recent & (ids == other))
    common, i, j = np.intersect1d(tracks.frame[mine], tracks.frame[theirs], return_indices=True)
    apart = _apart(tracks, mine[i], theirs[j])
    if not len(common) or apart.min() > params.contact_m:
        return None
    lost = (tracks.state[mine[i]] == "lost") | (tracks.state[theirs[j]] == "lost")
    if lost.any():
        return int(common[lost][-1])
    return int(common[len(apart) - 1 - int(np.argmin(apart[::-1]))])


def _apart(tracks: Trajectories, a: I64, b: I64) -> F64:
    return np.hypot(tracks.x_m[a] - tracks.x_m[b], tracks.y_m[a] - tracks.y_m[b])


def _reach(tracks: Trajectories, a: I64, b: I64, params: RefineParams) -> F64:
    """How far a person gets between two rows, and the error of both positions [m]."""
    return params.speed_max_mps * np.abs(tracks.timestamp_s[a] - tracks.timestamp_s[b]) + 2 * params.position_std_m


def _time(tracks: Trajectories, frame: int) -> float:
    return float(tracks.timestamp_s[np.searchsorted(tracks.frame, frame)])
