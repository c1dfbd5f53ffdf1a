"""Tracks of a whole recording refined: fragments of one person joined, paths smoothed.

Joins are the most likely explanation of all tracks at once: a flow of people through tracks that end and begin (Zhang,
Li, Nevatia 2008, "Global data association for multi-object tracking using network flows"), which for whole tracks is an
assignment of ends to beginnings. What a join is worth is the log-odds of the same walker against a stranger.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from calib.types import F64, Bool
from planview.tracking import body
from planview.tracking.explain.identity import KNOWN_LOG_ODDS
from planview.tracking.joint.ranges import JointParams
from planview.tracking.kalman import FloorKalman
from planview.trajectories.clock import USUAL_FPS, Clock
from planview.trajectories.ends import track_numbers
from planview.trajectories.table import Trajectories, concatenated, rows_by_id

POSITION_STD_M = 0.05
"""Deviation of a position in the tracks [m]: about a cell of the plan-view map."""
MEDIAN_HEIGHT_STD_M = 0.06
"""Deviation of the median height of a track [m]: posture and depth noise."""
JOINT = JointParams()  # its floor and share of low people are taken


class Change(NamedTuple):
    """A row of refinement.csv: the id after refinement, the frames that changed, "join" (another id made one with this)
    or "smooth" (positions moved), the reason, and the log-odds of the join or root mean square movement [m]."""

    track_id: int
    first_frame: int
    last_frame: int
    kind: Literal["join", "smooth"]
    reason: str
    value: float


def changes_csv(changes: Iterable[Change]) -> str:
    """The text of refinement.csv."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(("id", *Change._fields[1:]))
    writer.writerows((*change[:5], f"{change.value:.4f}") for change in changes)
    return file.getvalue()


def smoothed(times_s: F64, xy_m: F64, measured: Bool) -> tuple[F64, F64]:
    """(N, 2) positions [m] and velocities [m/s] at (N,) rising times [s] from (N, 2) positions where measured, the
    first among them, before and after (Rauch, Tung, Striebel 1965)."""
    state = FloorKalman.at(float(xy_m[0, 0]), float(xy_m[0, 1]), POSITION_STD_M)
    filtered, predicted = [state], [state]  # after, and before, the measurement of every row
    for k in range(1, len(times_s)):
        state = state.predict(float(times_s[k] - times_s[k - 1]), body.ACCELERATION_MPS2)
        predicted.append(state)
        if measured[k]:
            state = state.update(float(xy_m[k, 0]), float(xy_m[k, 1]), POSITION_STD_M)
        filtered.append(state)
    states = np.array([s.mean for s in filtered])
    for k in range(len(filtered) - 2, -1, -1):
        ahead, step = predicted[k + 1], np.eye(4)
        step[[0, 1], [2, 3]] = times_s[k + 1] - times_s[k]
        gain = np.linalg.solve(ahead.covariance, step @ filtered[k].covariance).T
        states[k] += gain @ (states[k + 1] - ahead.mean)
    return states[:, :2], states[:, 2:]


class Refined(NamedTuple):
    """The refined table and what was changed."""

    tracks: Trajectories
    changes: list[Change]


def refine(tracks: Trajectories) -> Refined:
    """Refine the tracks of a finished recording.

    No row is added and no state changes: only ids of joined tracks and positions up to the last confirmed row of a
    person. Predictions of a track end where the one that continues it begins. Tracks never confirmed stay as they are,
    and nobody is smoothed across the end of a track. Where no row has a time, there are 30 frames per second. Raises
    InputError: confirmed rows without floor positions.
    """
    confirmed = tracks.where(tracks.state == "confirmed")
    if not np.isfinite(confirmed.x_m + confirmed.y_m).all():
        raise InputError("expected floor positions in all confirmed rows to refine them, found rows without")
    untimed = not np.isfinite(tracks.timestamp_s).any()
    tracks = replace(tracks, timestamp_s=Clock(tracks, USUAL_FPS).at(tracks.frame))
    own = {i: tracks.where(rows) for i, rows in rows_by_id(tracks.track_id)}
    known = [table for table in own.values() if (table.state == "confirmed").any()]
    known.sort(key=lambda table: int(table.frame[0]))
    chains, changes = _joined(known)
    parts = [table for table in own.values() if (table.state != "confirmed").all()]
    for chain in chains:
        path, change = _smoothed_path(chain)
        parts.append(path)
        changes.append(change)
    refined = concatenated(parts) if parts else tracks
    if untimed:
        refined = replace(refined, timestamp_s=np.full(len(refined), np.nan))
    return Refined(refined, sorted(changes, key=lambda c: (c.first_frame, c.track_id, c.kind)))


def _joined(tracks: Sequence[Trajectories]) -> tuple[list[Trajectories], list[Change]]:
    """One table per person, under the first id, from tracks of one id each by rising first frame: of the joins whose
    log-odds sum to most, those by which the tracker recognises people (it saw clothes as well and took the later track
    for a stranger)."""
    from scipy.optimize import linear_sum_assignment  # half a second

    odds = np.array([[_log_odds(a, b) for b in tracks] for a in tracks]).reshape(len(tracks), len(tracks))
    ends, starts = linear_sum_assignment(np.maximum(odds, 0.0), maximize=True)
    former = {int(j): int(i) for i, j in zip(ends, starts, strict=True) if odds[i, j] > KNOWN_LOG_ODDS}
    chains: dict[int, list[Trajectories]] = {}
    changes: list[Change] = []
    first = list(range(len(tracks)))
    for j, track in enumerate(tracks):
        if j in former:
            i = former[j]
            first[j] = first[i]
            before = chains[first[j]][-1]
            chains[first[j]][-1] = before.where(before.frame < track.frame[0])
            last = int(np.flatnonzero(before.state == "confirmed")[-1])
            gap_s = track.timestamp_s[0] - before.timestamp_s[last]
            reason = f"track {track.track_id[0]} begins {gap_s:.1f} s after the end of track {before.track_id[0]}"
            person, frames = int(tracks[first[j]].track_id[0]), (int(before.frame[last]), int(track.frame[0]))
            changes.append(Change(person, *frames, "join", reason, float(odds[i, j])))
        chains.setdefault(first[j], []).append(track)
    people = [concatenated(chain) for chain in chains.values()]
    ids = [chain[0].track_id[0] for chain in chains.values()]
    return [replace(p, track_id=np.full(len(p), i)) for p, i in zip(people, ids, strict=True)], changes


def _log_odds(a: Trajectories, b: Trajectories) -> float:
    """Of track b being the person of track a, who walked on out of sight, rather than a stranger: by place and height.

    Negative where b begins before the end of a, or out of a walker's reach. A height that is unknown decides nothing.
    """
    end, start = int(np.flatnonzero(a.state == "confirmed")[-1]), int(np.flatnonzero(_measured(b))[0])
    gone_s = float(b.timestamp_s[start] - a.timestamp_s[end])
    away_m = math.hypot(b.x_m[start] - a.x_m[end], b.y_m[start] - a.y_m[end])
    if b.frame[0] <= a.frame[end] or not body.is_within_reach(gone_s, away_m):
        return -1.0
    ahead_m = body.walking_on_s(gone_s) * np.nan_to_num(a.velocity_mps[end])
    away_m = math.hypot(b.x_m[start] - a.x_m[end] - ahead_m[0], b.y_m[start] - a.y_m[end] - ahead_m[1])
    place = body.log_odds_same_place(gone_s, away_m, math.inf, JOINT.floor_m2)  # without clothes a door is anybody's
    heights = [table.height_m[(table.state == "confirmed") & np.isfinite(table.height_m)] for table in (a, b)]
    if not len(heights[0]) or not len(heights[1]):
        return place
    tall_m, height_m = (float(np.median(own)) for own in heights)
    return place + body.log_odds_same_height(height_m, 0.0, tall_m, math.sqrt(2) * MEDIAN_HEIGHT_STD_M, JOINT.low_share)


def _measured(own: Trajectories) -> Bool:
    return np.asarray((own.state != "lost") & np.isfinite(own.x_m + own.y_m))


def _smoothed_path(path: Trajectories) -> tuple[Trajectories, Change]:
    """The rows of one person, smoothed from the first measured to the last confirmed one, each track by itself."""
    is_measured = _measured(path)
    last = int(np.flatnonzero(path.state == "confirmed")[-1])
    before_m = np.column_stack([path.x_m, path.y_m])
    after_m = before_m.copy()
    velocity = path.velocity_mps.copy()
    for _, rows in rows_by_id(track_numbers(path, path.timestamp_s)):
        starts = rows[is_measured[rows] & (rows <= last)]
        if not len(starts):
            continue
        within = rows[(rows >= starts[0]) & (rows <= last)]
        places_m, velocities = smoothed(path.timestamp_s[within], before_m[within], is_measured[within])
        after_m[within] = places_m
        velocity[within] = velocities
    first = int(np.flatnonzero(is_measured)[0])
    counted = np.flatnonzero(is_measured[: last + 1])
    moved_m = np.hypot(*(after_m - before_m)[counted].T)
    change = Change(
        int(path.track_id[0]), int(path.frame[first]), int(path.frame[last]), "smooth",
        "root mean square movement of the measured rows [m]", float(np.sqrt((moved_m**2).mean())),
    )  # fmt: skip
    return replace(path, x_m=after_m[:, 0], y_m=after_m[:, 1], velocity_mps=velocity), change
