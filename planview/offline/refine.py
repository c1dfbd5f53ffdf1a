"""Tracks of a whole recording refined: exchanges undone, fragments joined, gaps filled, paths smoothed.

Fragments are joined by one assignment of ends to starts, after Huang, Wu, Nevatia 2008 ("Robust object tracking by
hierarchical association of detection responses", section 3.2): every end continues in one start or in none, at the
smallest sum of costs. An exchange of identity is noticed online some time after people part, and each id then jumps to
the other's place; here the time from their contact on belongs to the other one too (our choice).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from calib.errors import InputError
from calib.params import Params
from calib.types import F64, I64, Bool
from planview.tracking.kalman import FloorKalman
from planview.trajectories.table import Trajectories, concatenated, rows_by_id


class RefineParams(Params):
    """Offline refinement; values without a reference are our choice."""

    join_s: float = Field(3.0, ge=0, le=60)
    """Longest time between two fragments of one person [s]. Below Harville's 4 s (2002, section 4) of being gone: the
    longer the time, the more likely that another person came."""
    speed_max_mps: float = Field(2.5, gt=0, le=10)
    """Fastest mean speed between fragments, and over a gap that is filled [m/s]: a jog."""
    position_std_m: float = Field(0.05, gt=0, le=1)
    """Deviation of a position in the tracks [m]: about a cell of the plan-view map."""
    acceleration_std_mps2: float = Field(2.0, gt=0, le=20)
    """Random acceleration of the constant-velocity model [m/s^2], that of the template tracker."""
    speed_std_mps: float = Field(1.0, gt=0, le=10)
    """Deviation of the unknown velocity at the start of a track [m/s]."""
    drift_mps: float = Field(0.4, gt=0, le=5)
    """Growth of the deviation of a prediction over the time between fragments [m/s]: a person slows down or turns."""
    height_std_m: float = Field(0.06, gt=0, le=1)
    """Deviation of the median height of a fragment [m]: posture and depth noise."""
    cost_max: float = Field(9.0, gt=0, le=100)
    """Largest sum of squared normalised differences of a join: three deviations."""
    doubt_s: float = Field(15.0, ge=0, le=600)
    """How long before it was mended an exchange may have happened [s]: as long as the identity layer is in doubt."""
    contact_m: float = Field(0.6, gt=0, le=5)
    """Two people must have been this near for their ids to be exchanged [m]: bodies that touch, and their errors."""
    fill_s: float = Field(2.0, ge=0, le=60)
    """Longest gap that is filled [s]; beyond it the path is a guess and rows stay lost."""


CHANGE_COLUMNS = ("id", "first_frame", "last_frame", "kind", "reason", "value")


class Change(NamedTuple):
    """A row of refinement.csv.

    Attributes:
        track_id: the id after refinement.
        first_frame, last_frame: the frames that changed.
        kind: "begin" (tentative rows confirmed), "exchange" (a mended exchange of ids undone from its contact), "fill"
            (a gap interpolated), "join" (another id made one with this) or "smooth" (positions moved).
        reason: one clause with the numbers that decided it.
        value: frames confirmed, time that an exchange was moved back [s], frames filled, cost of the join, or root mean
            square movement [m].
    """

    track_id: int
    first_frame: int
    last_frame: int
    kind: Literal["begin", "exchange", "fill", "join", "smooth"]
    reason: str
    value: float


def changes_csv(changes: Iterable[Change]) -> str:
    """The text of refinement.csv."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CHANGE_COLUMNS)
    writer.writerows((*change[:5], f"{change.value:.4f}") for change in changes)
    return file.getvalue()


def smoothed(times_s: F64, xy_m: F64, measured: Bool, params: RefineParams) -> tuple[F64, F64]:
    """Positions and velocities from the measurements before and after (Rauch, Tung, Striebel 1965).

    Args:
        times_s: (N,) rising times [s].
        xy_m: (N, 2) positions [m]; used where measured.
        measured: (N,); the first must be.
    Returns:
        (N, 2) positions [m] and (N, 2) velocities [m/s].
    """
    filtered, predicted = _forward(times_s, xy_m, measured, params)
    states = np.array([[s.x_m, s.y_m, s.vx_mps, s.vy_mps] for s in filtered]).reshape(-1, 2, 2)
    for k in range(len(filtered) - 2, -1, -1):
        ahead = predicted[k + 1]
        gain = _gain(filtered[k], ahead, float(times_s[k + 1] - times_s[k]))
        states[k] += gain @ (states[k + 1] - [[ahead.x_m, ahead.y_m], [ahead.vx_mps, ahead.vy_mps]])
    return states[:, 0], states[:, 1]


def _forward(
    times_s: F64, xy_m: F64, measured: Bool, params: RefineParams
) -> tuple[list[FloorKalman], list[FloorKalman]]:
    """The filter after, and before, the measurement of every row."""
    state = FloorKalman.at(float(xy_m[0, 0]), float(xy_m[0, 1]), params.position_std_m, params.speed_std_mps)
    filtered, predicted = [state], [state]
    for k in range(1, len(times_s)):
        state = state.predicted(float(times_s[k] - times_s[k - 1]), params.acceleration_std_mps2)
        predicted.append(state)
        if measured[k]:
            state = state.updated(float(xy_m[k, 0]), float(xy_m[k, 1]), params.position_std_m)
        filtered.append(state)
    return filtered, predicted


def _gain(now: FloorKalman, ahead: FloorKalman, dt_s: float) -> F64:
    """(2, 2) P_k F^T P_{k+1|k}^-1 of position and velocity: the noise is isotropic, so that x stands for both axes."""
    now_cov = np.array([[now.c_xx, now.c_xu], [now.c_xu, now.c_uu]])
    ahead_cov = np.array([[ahead.c_xx, ahead.c_xu], [ahead.c_xu, ahead.c_uu]])
    transition = np.array([[1.0, dt_s], [0.0, 1.0]])
    return np.asarray(np.linalg.solve(ahead_cov, transition @ now_cov).T)


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
    for track, rows in rows_by_id(tracks.track_id):
        far = _apart(tracks, rows[1:], rows[:-1]) > _reach(tracks, rows[1:], rows[:-1], params)
        for k in np.flatnonzero(far):
            jumps.setdefault(int(tracks.frame[rows[k + 1]]), []).append((track, int(rows[k]), int(rows[k + 1])))
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


FragmentSimilarity = Callable[[int, int], float]
"""(id that ends, id that starts) -> likelihood 0..1 that both look like one person, relative to the best case."""


@dataclass(frozen=True, eq=False)
class End:
    """One end of a fragment: frame, time [s], (2,) position [m] and (2,) velocity [m/s]."""

    frame: int
    time_s: float
    xy_m: F64
    velocity_mps: F64


@dataclass(frozen=True, eq=False)
class Fragment:
    """A track from its first row to its last confirmed one; median height [m], NaN where unknown."""

    track_id: int
    start: End
    end: End
    height_m: float


@dataclass(frozen=True)
class Join:
    """``later`` continues ``earlier``, at a cost."""

    earlier: int
    later: int
    cost: float


def joins(
    fragments: Sequence[Fragment], params: RefineParams, similarity: FragmentSimilarity | None = None
) -> list[Join]:
    """The joins of the cheapest assignment; leaving an end alone costs ``cost_max``."""
    n = len(fragments)
    if n < 2:
        return []
    from scipy.optimize import linear_sum_assignment  # half a second and 60 MB, and one track needs none

    costs = np.array([[join_cost(a, b, params, similarity) for b in fragments] for a in fragments])
    allowed = costs < params.cost_max
    far = params.cost_max * (n + 1)
    alone = np.full((n, n), far)
    np.fill_diagonal(alone, params.cost_max)
    rows, cols = linear_sum_assignment(np.hstack([np.where(allowed, costs, far), alone]))
    return [
        Join(fragments[i].track_id, fragments[j].track_id, float(costs[i, j]))
        for i, j in zip(rows, cols, strict=True)
        if j < n and allowed[i, j]
    ]


def join_cost(a: Fragment, b: Fragment, params: RefineParams, similarity: FragmentSimilarity | None = None) -> float:
    """Squared normalised differences of prediction and height, minus twice the log similarity; infinite if impossible.

    The deviation of a prediction grows with the time between; a height that is unknown decides nothing.
    """
    gap_s = b.start.time_s - a.end.time_s
    if b.start.frame <= a.end.frame or not 0 < gap_s <= params.join_s:
        return math.inf
    way_m = float(np.hypot(*(b.start.xy_m - a.end.xy_m)))
    if way_m > params.speed_max_mps * gap_s + 2 * params.position_std_m:
        return math.inf
    apart_m = prediction_error_m(a.end, b.start)
    cost = (apart_m / (2 * params.position_std_m + params.drift_mps * gap_s)) ** 2
    if math.isfinite(a.height_m - b.height_m):
        cost += ((a.height_m - b.height_m) / (math.sqrt(2) * params.height_std_m)) ** 2
    if similarity is not None:
        alike = similarity(a.track_id, b.track_id)
        cost += -2 * math.log(alike) if alike > 0 else math.inf
    return cost


def prediction_error_m(end: End, start: End) -> float:
    """Mean distance of the two predictions at constant velocity, of the start from the end and of the end back [m]."""
    gap_s = start.time_s - end.time_s
    ahead = end.xy_m + gap_s * end.velocity_mps - start.xy_m
    back = start.xy_m - gap_s * start.velocity_mps - end.xy_m
    return float(np.hypot(*ahead) + np.hypot(*back)) / 2


@dataclass(frozen=True, eq=False)
class Refined:
    """The refined table and what was changed."""

    tracks: Trajectories
    changes: list[Change]


def refine(
    tracks: Trajectories, params: RefineParams | None = None, similarity: FragmentSimilarity | None = None
) -> Refined:
    """Refine the tracks of a finished recording.

    Tracks never confirmed stay as they are; so do predictions after the last confirmed row of a person. No row is
    added before the first row of a track.

    Args:
        tracks: as written online.
        similarity: compares the appearance of two fragments by their ids; None where none was stored.
    Raises:
        InputError: confirmed rows without floor positions.
    """
    params = params or RefineParams()
    confirmed = tracks.where(tracks.state == "confirmed")
    if not np.isfinite(confirmed.x_m + confirmed.y_m).all():
        raise InputError("expected floor positions in all confirmed rows to refine them, found rows without")
    tracks, exchanged = exchanges_undone(tracks, params)
    confirmed = tracks.where(tracks.state == "confirmed")
    clock = _Clock(tracks)
    ids = [int(i) for i in np.unique(confirmed.track_id)]
    own = {i: tracks.where(rows) for i, rows in rows_by_id(tracks.track_id)}
    fragments = [_fragment(own[i], clock, params) for i in ids]
    links = joins(fragments, params, similarity)
    changes, parts = exchanged, [tracks.where(~np.isin(tracks.track_id, ids))]
    for chain in _chains(ids, links):
        path = _joined([own[i] for i in chain])
        refined, made = _refined_path(path, clock, params)
        parts.append(refined)
        changes += made
    changes += _join_changes(links, _chains(ids, links), fragments)
    order = sorted(changes, key=lambda c: (c.first_frame, c.track_id, c.kind))
    return Refined(concatenated(parts), order)


class _Clock:
    """Frame to time [s]: as the rows say, straight in between; the frame number where no row has a time."""

    def __init__(self, tracks: Trajectories) -> None:
        known = np.isfinite(tracks.timestamp_s)
        self._frames, first = np.unique(tracks.frame[known], return_index=True)
        self._times = tracks.timestamp_s[known][first]

    def at(self, frame: I64) -> F64:
        if not len(self._frames):
            return frame.astype(np.float64)
        return np.interp(frame, self._frames, self._times)


def _fragment(own: Trajectories, clock: _Clock, params: RefineParams) -> Fragment:
    last = own.frame[own.state == "confirmed"].max()
    path = own.where(_measured(own) & (own.frame <= last))
    xy, times = _xy(path), clock.at(path.frame)
    position, velocity = smoothed(times, xy, np.ones(len(path), dtype=np.bool_), params)
    start, end = (End(int(path.frame[k]), float(times[k]), position[k], velocity[k]) for k in (0, -1))
    known = path.height_m[np.isfinite(path.height_m)]
    return Fragment(int(own.track_id[0]), start, end, float(np.median(known)) if len(known) else np.nan)


def _measured(own: Trajectories) -> Bool:
    return np.asarray((own.state != "lost") & np.isfinite(own.x_m + own.y_m))


def _xy(table: Trajectories) -> F64:
    return np.column_stack([table.x_m, table.y_m])


def _chains(ids: list[int], links: list[Join]) -> Iterator[list[int]]:
    """Ids of every person, in the order of time."""
    following = {link.earlier: link.later for link in links}
    for first in ids:
        if first not in following.values():
            chain = [first]
            while chain[-1] in following:
                chain.append(following[chain[-1]])
            yield chain


def _joined(parts: list[Trajectories]) -> Trajectories:
    """The rows of all parts under the first id; predictions of a part end where the next begins."""
    starts = [int(part.frame[_measured(part)][0]) for part in parts[1:]]
    kept = [part.where(part.frame < start) for part, start in zip(parts, starts, strict=False)] + [parts[-1]]
    together = concatenated(kept)
    return replace(together, track_id=np.full(len(together), parts[0].track_id[0]))


def _join_changes(links: list[Join], chains: Iterator[list[int]], fragments: list[Fragment]) -> Iterator[Change]:
    person = {track: chain[0] for chain in chains for track in chain}
    by_id = {fragment.track_id: fragment for fragment in fragments}
    for link in links:
        end, start = by_id[link.earlier].end, by_id[link.later].start
        reason = f"track {link.later} begins {start.time_s - end.time_s:.1f} s after the end of track {link.earlier}"
        yield Change(person[link.earlier], end.frame, start.frame, "join", reason, link.cost)


def _refined_path(path: Trajectories, clock: _Clock, params: RefineParams) -> tuple[Trajectories, list[Change]]:
    """The rows of one person, refined up to the last confirmed one; predictions after it follow unchanged."""
    last = path.frame[path.state == "confirmed"].max()
    rest, path = path.where(path.frame > last), path.where(path.frame <= last)
    measured = path.where(_measured(path))
    gaps = list(_gaps(measured, clock, params))
    filled = np.concatenate([np.empty(0, dtype=np.int64), *(np.arange(a + 1, b) for a, b in gaps)])
    old = path.where(~np.isin(path.frame, np.concatenate([measured.frame, filled])) & (path.frame >= measured.frame[0]))
    frames = np.unique(np.concatenate([measured.frame, filled, old.frame]))
    at_measured = np.isin(frames, measured.frame)
    rows = _interpolated(measured, frames, clock)
    xy, velocity = smoothed(clock.at(frames), _xy(rows), at_measured, params)
    state = np.where(np.isin(frames, old.frame), "lost", "confirmed")
    refined = replace(rows, x_m=xy[:, 0], y_m=xy[:, 1], velocity_mps=velocity, state=state)
    moved = np.hypot(*(xy - _xy(rows))[at_measured].T)
    return concatenated([refined, rest]), list(_path_changes(measured, gaps, moved))


def _gaps(measured: Trajectories, clock: _Clock, params: RefineParams) -> Iterator[tuple[int, int]]:
    """Measured frames around every gap that is filled: short, and passed at a plausible speed."""
    frames, times, xy = measured.frame, clock.at(measured.frame), _xy(measured)
    for k in np.flatnonzero(np.diff(frames) > 1):
        gap_s, way_m = times[k + 1] - times[k], np.hypot(*(xy[k + 1] - xy[k]))
        if gap_s <= params.fill_s and way_m <= params.speed_max_mps * gap_s + 2 * params.position_std_m:
            yield int(frames[k]), int(frames[k + 1])


def _interpolated(measured: Trajectories, frames: I64, clock: _Clock) -> Trajectories:
    """Rows at (N,) frames: columns straight between the measured ones, unknown where a neighbour is."""

    def column(values: F64) -> F64:
        return np.interp(frames, measured.frame, values)

    return Trajectories(
        frame=frames,
        track_id=np.full(len(frames), measured.track_id[0]),
        timestamp_s=clock.at(frames),
        x_m=column(measured.x_m),
        y_m=column(measured.y_m),
        height_m=column(measured.height_m),
        state=np.full(len(frames), "confirmed"),
        visible=np.ones(len(frames)),
        box_px=np.column_stack([column(values) for values in measured.box_px.T]),
        velocity_mps=np.zeros((len(frames), 2)),
    )


def _path_changes(measured: Trajectories, gaps: list[tuple[int, int]], moved_m: F64) -> Iterator[Change]:
    track = int(measured.track_id[0])
    tentative = measured.frame[measured.state == "tentative"]
    if len(tentative):
        reason = "the track is confirmed later"
        yield Change(track, int(tentative[0]), int(tentative[-1]), "begin", reason, float(len(tentative)))
    for a, b in gaps:
        yield Change(track, a + 1, b - 1, "fill", "interpolated between the rows around it", float(b - a - 1))
    rms_m = float(np.sqrt((moved_m**2).mean()))
    first, last = int(measured.frame[0]), int(measured.frame[-1])
    yield Change(track, first, last, "smooth", "root mean square movement of the measured rows [m]", rms_m)
