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
from planview.trajectories.table import Trajectories, concatenate, rows_by_id

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


def smooth(times_s: F64, xy_m: F64, measured: Bool) -> tuple[F64, F64]:
    """(N, 2) positions [m] and velocities [m/s] at (N,) rising times [s] from (N, 2) positions where measured, the
    first among them, before and after (Rauch, Tung, Striebel 1965)."""
    x_m, y_m = xy_m.T.tolist()
    state = FloorKalman.at(x_m[0], y_m[0], POSITION_STD_M)
    # After, and before, the measurement of every row.
    filtered = [state]
    predicted = [state]
    steps_s = np.diff(times_s).tolist()
    for row, step_s in enumerate(steps_s, start=1):
        state = state.predict(step_s, body.ACCELERATION_MPS2)
        predicted.append(state)
        if measured[row]:
            state = state.update(x_m[row], y_m[row], POSITION_STD_M)
        filtered.append(state)
    states = np.array([state.mean for state in filtered])
    for row in range(len(filtered) - 2, -1, -1):
        later = predicted[row + 1]
        motion = np.eye(4)
        motion[[0, 1], [2, 3]] = steps_s[row]
        gain = np.linalg.solve(later.covariance, motion @ filtered[row].covariance).T
        states[row] += gain @ (states[row + 1] - later.mean)
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
    people = list[Trajectories]()
    parts = list[Trajectories]()
    for _, rows in rows_by_id(tracks.track_id):
        track = tracks.where(rows)
        is_person = (track.state == "confirmed").any()
        (people if is_person else parts).append(track)
    people.sort(key=lambda track: int(track.frame[0]))
    chains, changes = _join_tracks(people)
    for chain in chains:
        path, change = _smoothed_path(chain)
        parts.append(path)
        changes.append(change)
    refined = concatenate(parts) if parts else tracks
    if untimed:
        refined = replace(refined, timestamp_s=np.full(len(refined), np.nan))
    return Refined(refined, sorted(changes, key=lambda c: (c.first_frame, c.track_id, c.kind)))


def _join_tracks(tracks: Sequence[Trajectories]) -> tuple[list[Trajectories], list[Change]]:
    """One table per person, under the first id, from tracks of one id each by rising first frame: of the joins whose
    log-odds sum to most, those by which the tracker recognises people (it saw clothes as well and took the later track
    for a stranger)."""
    former_of = _former_tracks(tracks)
    person_of = list[int]()  # place of the person's first track
    chains: dict[int, list[Trajectories]] = {}
    changes = list[Change]()
    for place, track in enumerate(tracks):
        if place not in former_of:
            person_of.append(place)
            chains[place] = [track]
            continue
        former, log_odds = former_of[place]
        person = person_of[former]
        person_of.append(person)
        before = chains[person][-1]
        # Predictions end where somebody was seen again.
        chains[person][-1] = before.where(before.frame < track.frame[0])
        chains[person].append(track)
        changes.append(_join_change(int(tracks[person].track_id[0]), before, track, log_odds))
    people = list[Trajectories]()
    for chain in chains.values():
        path = concatenate(chain)
        people.append(replace(path, track_id=np.full(len(path), chain[0].track_id[0])))
    return people, changes


def _former_tracks(tracks: Sequence[Trajectories]) -> dict[int, tuple[int, float]]:
    """The place of the track that each track continues, and the log-odds, for those that continue one."""
    from scipy.optimize import linear_sum_assignment  # half a second

    odds = np.empty((len(tracks), len(tracks)))
    for before, former in enumerate(tracks):
        for after, later in enumerate(tracks):
            odds[before, after] = _log_odds(former, later)
    ends, starts = linear_sum_assignment(np.maximum(odds, 0.0), maximize=True)
    former_of: dict[int, tuple[int, float]] = {}
    for before, after in zip(ends.tolist(), starts.tolist(), strict=True):
        if odds[before, after] > KNOWN_LOG_ODDS:
            former_of[after] = before, float(odds[before, after])
    return former_of


def _join_change(person: int, before: Trajectories, after: Trajectories, log_odds: float) -> Change:
    """The row of refinement.csv of two tracks that were joined."""
    last = _last_confirmed(before)
    gap_s = after.timestamp_s[0] - before.timestamp_s[last]
    reason = f"track {after.track_id[0]} begins {gap_s:.1f} s after the end of track {before.track_id[0]}"
    return Change(person, int(before.frame[last]), int(after.frame[0]), "join", reason, log_odds)


def _log_odds(before: Trajectories, after: Trajectories) -> float:
    """Log-odds that a later track is the person of an earlier one, who walked on out of sight, rather than a stranger,
    by place and height.

    Negative where it begins before the end of the other, or out of a walker's reach. A height that is unknown decides
    nothing.
    """
    end = _last_confirmed(before)
    start = int(np.flatnonzero(_is_seen(after))[0])
    gone_s = float(after.timestamp_s[start] - before.timestamp_s[end])
    dx = float(after.x_m[start] - before.x_m[end])
    dy = float(after.y_m[start] - before.y_m[end])
    if after.frame[0] <= before.frame[end] or not body.is_within_reach(gone_s, math.hypot(dx, dy)):
        return -1.0
    ahead_x, ahead_y = (body.walking_on_s(gone_s) * np.nan_to_num(before.velocity_mps[end])).tolist()
    away_m = math.hypot(dx - ahead_x, dy - ahead_y)
    place = body.log_odds_same_place(gone_s, away_m, math.inf, JOINT.floor_m2)  # without clothes a door is anybody's
    tall_m = _median_height(before)
    height_m = _median_height(after)
    if math.isnan(tall_m + height_m):
        return place
    return place + body.log_odds_same_height(height_m, 0.0, tall_m, math.sqrt(2) * MEDIAN_HEIGHT_STD_M, JOINT.low_share)


def _median_height(table: Trajectories) -> float:
    """Median height of the confirmed rows [m]; NaN where none is known."""
    heights_m = table.height_m[(table.state == "confirmed") & np.isfinite(table.height_m)]
    return float(np.median(heights_m)) if len(heights_m) else math.nan


def _last_confirmed(table: Trajectories) -> int:
    """The last confirmed row."""
    return int(np.flatnonzero(table.state == "confirmed")[-1])


def _is_seen(table: Trajectories) -> Bool:
    """(N,) True for rows with a place that was seen, not predicted."""
    return np.asarray((table.state != "lost") & np.isfinite(table.x_m + table.y_m))


def _smoothed_path(path: Trajectories) -> tuple[Trajectories, Change]:
    """The rows of one person, smoothed from the first measured to the last confirmed one, each track by itself."""
    is_measured = _is_seen(path)
    last = _last_confirmed(path)
    before_m = np.column_stack([path.x_m, path.y_m])
    after_m = before_m.copy()
    velocity = path.velocity_mps.copy()
    for _, rows in rows_by_id(track_numbers(path, path.timestamp_s)):
        starts = rows[is_measured[rows] & (rows <= last)]
        if not len(starts):
            continue
        within = rows[(rows >= starts[0]) & (rows <= last)]
        after_m[within], velocity[within] = smooth(path.timestamp_s[within], before_m[within], is_measured[within])
    first = int(np.flatnonzero(is_measured)[0])
    counted = np.flatnonzero(is_measured[: last + 1])
    moved_m = np.hypot(*(after_m - before_m)[counted].T)
    change = Change(
        int(path.track_id[0]), int(path.frame[first]), int(path.frame[last]), "smooth",
        "root mean square movement of the measured rows [m]", float(np.sqrt((moved_m**2).mean())),
    )  # fmt: skip
    return replace(path, x_m=after_m[:, 0], y_m=after_m[:, 1], velocity_mps=velocity), change
