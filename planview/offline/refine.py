"""A whole recording refined: joined fragments, early beginnings, filled gaps, smoothed paths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.errors import InputError
from calib.types import F64, I64, Bool
from planview.offline.changes import Change
from planview.offline.exchanges import exchanges_undone
from planview.offline.joining import End, Fragment, FragmentSimilarity, Join, joins
from planview.offline.params import RefineParams
from planview.offline.smoothing import smoothed
from planview.trajectories.table import Trajectories, concatenated


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
    own = {i: tracks.where(tracks.track_id == i) for i in ids}
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
    filled = _frames_between(gaps)
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


def _frames_between(gaps: list[tuple[int, int]]) -> I64:
    return np.concatenate([np.empty(0, dtype=np.int64), *(np.arange(a + 1, b) for a, b in gaps)])


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
