"""What would explain a bad score: the changes of a truth table that make it fit the tracks.

Axes, units, rates of the frames and forms of boxes are tried; a shift in time and an offset in the plane are not tried
but voted for, by pairs of rows that are near each other or move alike and by pairs of rows of one frame (as a Hough
transform does). Any other turn or scale is fitted to a track and a person.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from calib.types import F64, I64
from planview.trajectories.table import Trajectories, rows_by_id

GOOD, GAIN = 0.8, 0.2
"""Share of the truth's rows near a track from which nothing needs explaining, and which an explanation must come near
to and gain at the least (our choice)."""
CLOSE_M, CLOSE_BOX = 0.4, 0.3
"""Rows are near on the floor [m], and in the image [heights of the median box]."""
VOTERS, VOTED_ON = 300, 1500
"""Rows of the truth and of the tracks that vote, spread over the whole."""
SIMPLER = 0.03
"""Share of rows that one more change must gain (our choice)."""
CHANGES_MAX = 2
"""Changes tried together, besides a shift and an offset."""
MOVED_FRAMES = 20
"""Frames over which rows that move alike do so."""
FITTED_ROWS, FITTED_IDS, SPREAD_M = 20, 8, 1.0
"""Of a person and a track that are laid over each other: their common frames and how far they go [m] at the least, and
how many of the longest are tried."""
FITTED = 3
"""As many changes as a fit counts for: a turn, a scale and an offset."""
TURNED_DEG, SCALE = 1.0, 0.03
"""A turn and a scale that are none."""

Remade = Callable[[Trajectories], Trajectories]


class TruthChange(NamedTuple):
    """One change of the truth: a clause that says what it would mean, empty for none, and what it does."""

    clause: str
    of: Remade


def _axes(xx: int, xy: int, yx: int, yy: int) -> Remade:
    return lambda t: replace(t, x_m=xx * t.x_m + xy * t.y_m, y_m=yx * t.x_m + yy * t.y_m)


def _scaled(unit_m: float) -> Remade:
    return lambda t: replace(t, x_m=unit_m * t.x_m, y_m=unit_m * t.y_m)


def _boxes(of: Callable[[F64, F64], tuple[F64, F64]]) -> Remade:
    """A change of (N, 2) corners and (N, 2) sizes of boxes [px]."""
    return lambda t: replace(t, box_px=np.column_stack(of(t.box_px[:, :2], t.box_px[:, 2:])))


def _every(n: int) -> Remade:
    return lambda t: replace(t, frame=n * t.frame)


def _among(n: int) -> Remade:
    def kept(t: Trajectories) -> Trajectories:
        t = t.where(t.frame % n == 0)
        return replace(t, frame=t.frame // n)

    return kept


AS_IT_IS = TruthChange("", lambda t: t)
AXES: tuple[TruthChange, ...] = (
    AS_IT_IS,
    TruthChange("its x axis is mirrored", _axes(-1, 0, 0, 1)),
    TruthChange("its y axis is mirrored", _axes(1, 0, 0, -1)),
    TruthChange("it is turned by 180 degrees", _axes(-1, 0, 0, -1)),
    TruthChange("its axes x and y are exchanged", _axes(0, 1, 1, 0)),
    TruthChange("it is turned by 90 degrees", _axes(0, -1, 1, 0)),
    TruthChange("it is turned by -90 degrees", _axes(0, 1, -1, 0)),
    TruthChange("its axes are exchanged and mirrored", _axes(0, -1, -1, 0)),
)
UNITS: tuple[TruthChange, ...] = (
    AS_IT_IS,
    TruthChange("its unit is feet", _scaled(0.3048)),
    TruthChange("its unit is inches", _scaled(0.0254)),
    TruthChange("its unit is centimetres", _scaled(0.01)),
    TruthChange("its unit is millimetres", _scaled(0.001)),
    TruthChange("the unit of the tracks is centimetres", _scaled(100.0)),
)
BOXES: tuple[TruthChange, ...] = (
    AS_IT_IS,
    TruthChange("its boxes are given by their middle", _boxes(lambda middle, size: (middle - size / 2, size))),
    TruthChange("its boxes are given by two corners", _boxes(lambda first, second: (first, second - first))),
)
NUMBERS: tuple[TruthChange, ...] = (
    AS_IT_IS,
    *(TruthChange(f"only 1 of {n} frames of the tracks has a number in it", _every(n)) for n in (2, 3, 4, 5, 6)),
    *(TruthChange(f"it has {n} numbers for each frame of the tracks", _among(n)) for n in (2, 3)),
    TruthChange(
        "its columns of frames and ids are exchanged", lambda t: replace(t, frame=t.track_id, track_id=t.frame)
    ),
)


class _Rows(NamedTuple):
    """Frames, (N,) float64, and places in units of what counts as near, (N, 2)."""

    frame: F64
    at: F64

    @staticmethod
    def of(table: Trajectories, near: float | None) -> _Rows:
        """``near``: the side of a box that is near [px]; None for places on the floor."""
        if near is None:
            return _Rows(table.frame.astype(np.float64), np.column_stack([table.x_m, table.y_m]) / CLOSE_M)
        return _Rows(table.frame.astype(np.float64), (table.box_px[:, :2] + table.box_px[:, 2:] / 2) / near)

    def thinned(self, most: int) -> _Rows:
        chosen = np.unique(np.linspace(0, len(self.frame) - 1, most).astype(int)) if len(self.frame) else slice(0)
        return _Rows(self.frame[chosen], self.at[chosen])

    def moved(self, frames: float, offset: F64) -> _Rows:
        return _Rows(self.frame + frames, self.at + offset)

    @property
    def in_space(self) -> F64:
        """(N, 3) places at which rows of different frames are far from each other."""
        return np.column_stack([self.at, 10.0 * self.frame])


def explanation(truth: Trajectories, tracks: Trajectories, on_floor: bool) -> str:
    """A sentence on the change of the truth that makes it fit the tracks; empty where they fit already, or where no
    change explains it. Rows without what is compared are left out."""
    truth, tracks = _placed(truth, on_floor), _placed(tracks, on_floor)
    if len(truth) < 20 or len(tracks) < 20:
        return ""
    tried = _Tracks(tracks, on_floor)
    # Of every id alike: rows are sorted by frame, so that every n-th of them are all people's.
    thin = truth.where(np.arange(len(truth)) % max(1, len(truth) // VOTERS) == 0)
    now = tried.share(tried.rows_of(thin))
    if now >= GOOD:
        return ""
    best = _Explained(now, now)
    for clauses, changed in _changed(thin, on_floor):
        if best.share >= GOOD and len(clauses) > len(best.clauses):
            break  # more changes explain no more
        best = max([best, *tried.moves(clauses, changed)])
    if on_floor and best.score < 1.0 - FITTED * SIMPLER:
        best = max([best, *_fitted(truth, tracks, thin, tried)])
    if best.share < max(0.8 * GOOD, now + GAIN):
        return ""
    found = " and ".join(best.clauses)
    return f"{best.share:.0%} of the truth's rows are near a track, in place of {now:.0%}, if {found}"


def fit(truth: Trajectories, tracks: Trajectories, on_floor: bool) -> float:
    """The share of the truth's rows that are near a track, 0 to 1; 0 where nothing can be compared."""
    truth, tracks = _placed(truth, on_floor), _placed(tracks, on_floor)
    if not (len(truth) and len(tracks)):
        return 0.0
    tried = _Tracks(tracks, on_floor)
    return tried.share(tried.rows_of(truth))


def shift_between(truth: Trajectories, tracks: Trajectories, on_floor: bool) -> int:
    """Frames by which the tracks have to be moved to lie near the truth, by the votes of pairs of rows at one place; 0
    where there are none."""
    truth, tracks = _placed(truth, on_floor), _placed(tracks, on_floor)
    if not (len(truth) and len(tracks)):
        return 0
    tried = _Tracks(tracks, on_floor)
    return -voted_shift(tried.rows_of(truth).thinned(VOTERS), tried.voters)


class _Explained(NamedTuple):
    """Changes of the truth, the share of its rows that they bring near a track, and that less SIMPLER for each."""

    score: float
    share: float
    clauses: tuple[str, ...] = ()


class _Tracks:
    """The tracks that a truth is laid over."""

    def __init__(self, tracks: Trajectories, on_floor: bool) -> None:
        self._near = None if on_floor else CLOSE_BOX * float(np.median(tracks.box_px[:, 3]))
        rows = self.rows_of(tracks)
        self._space, self.voters = cKDTree(rows.in_space), rows.thinned(VOTED_ON)
        self._table, self._rows = tracks, rows
        self._covered, self._size = (rows.frame.min(), rows.frame.max()), np.ptp(rows.at, axis=0).max()

    @cached_property
    def _moving(self) -> _Rows:
        return movements(self._table, self._rows).thinned(VOTED_ON)

    def rows_of(self, table: Trajectories) -> _Rows:
        return _Rows.of(table, self._near)

    def share(self, rows: _Rows) -> float:
        """Share of the rows with a row of the tracks near, each of which serves one; of those in the frames that the
        tracks cover, unless these are few."""
        _, nearest = self._space.query(rows.in_space, distance_upper_bound=1.0)
        inside = int(np.count_nonzero((rows.frame >= self._covered[0]) & (rows.frame <= self._covered[1])))
        return len(np.unique(nearest[nearest < self._space.n])) / max(1, inside, len(rows.frame) // 3)

    def explained(self, clauses: Sequence[str], rows: _Rows, changes: int | None = None) -> _Explained:
        """``changes``: how many they are, where not one for each clause."""
        share = self.share(rows)
        return _Explained(share - SIMPLER * (len(clauses) if changes is None else changes), share, tuple(clauses))

    def moves(self, clauses: Sequence[str], changed: Trajectories) -> Iterator[_Explained]:
        """A changed truth as it is, and moved in time, in the plane and in both."""
        rows = self.rows_of(changed)
        extent = np.ptp(rows.at, axis=0).max() if len(rows.at) else 0.0
        if not self._size / 10 < extent < 10 * self._size:  # of another unit than the tracks
            return
        frames, offset = voted_shift(rows, self.voters), voted_offset(rows, self.voters)
        yield self.explained(clauses, rows)
        yield self.explained([*clauses, _late(frames)], rows.moved(frames, np.zeros(2)))
        yield self.explained([*clauses, self._away(offset)], rows.moved(0, offset))
        offset = voted_offset(rows.moved(voted_shift(movements(changed, rows), self._moving), np.zeros(2)), self.voters)
        frames = voted_shift(rows.moved(0, offset), self.voters)
        yield self.explained([*clauses, _late(frames), self._away(offset)], rows.moved(frames, offset))

    def _away(self, offset: F64) -> str:
        if self._near is not None:
            x, y = np.round(-self._near * offset).astype(int).tolist()
            return f"its boxes are {x:+d}, {y:+d} px from the tracks"
        x, y = (0.01 * np.round(-100 * CLOSE_M * offset).astype(int)).tolist()
        return f"it is {x:+.2f}, {y:+.2f} m from the tracks (align them)"


def _late(frames: int) -> str:
    return f"the tracks are moved by {-frames:+d} frames"


def _placed(table: Trajectories, on_floor: bool) -> Trajectories:
    needed = np.column_stack([table.x_m, table.y_m]) if on_floor else table.box_px
    return table.where(np.asarray(np.isfinite(needed).all(axis=1)))


def movements(table: Trajectories, rows: _Rows) -> _Rows:
    """Where people are MOVED_FRAMES later as seen from where they are; only of those who are seen so long."""
    moved = np.full((len(table), 2), np.nan)
    for _, own in rows_by_id(table.track_id):
        frame, later = rows.frame[own], rows.frame[own] + MOVED_FRAMES
        for axis, place in enumerate(rows.at[own].T):
            moved[own, axis] = np.interp(later, frame, place, right=np.nan) - place
    known = np.isfinite(moved).all(axis=1)
    return _Rows(rows.frame[known], moved[known])


def _fitted(truth: Trajectories, tracks: Trajectories, thin: Trajectories, tried: _Tracks) -> Iterator[_Explained]:
    """The truth turned, scaled and mirrored so that one of its people lies on a track: least squares, with places as
    complex numbers."""
    true, found, places = (t.x_m + 1j * t.y_m for t in (truth, tracks, thin))
    for person, track, is_mirrored in product(_longest(truth), _longest(tracks), (False, True)):
        _, i, j = np.intersect1d(truth.frame[person], tracks.frame[track], return_indices=True)
        source, target = true[person][i], found[track][j]
        if len(i) < FITTED_ROWS or abs(target - target[0]).max() < SPREAD_M or abs(source - source[0]).max() == 0:
            continue
        source, moved = (np.conj(source), np.conj(places)) if is_mirrored else (source, places)
        from_middle = source - source.mean()
        turn = np.vdot(from_middle, target) / np.vdot(from_middle, from_middle)
        moved = turn * (moved - source.mean()) + target.mean()
        scale, angle_deg = 1.0 / abs(turn), -math.degrees(cmath.phase(turn))
        is_scaled = abs(scale - 1.0) > SCALE
        turned = f"it is turned by {angle_deg:.0f} degrees{'' if is_mirrored or is_scaled else ' (align them)'}"
        clauses = ["it is mirrored"] if is_mirrored else []
        clauses += [turned] if abs(angle_deg) >= TURNED_DEG else []
        clauses += [f"its places are {scale:.3g} times as far apart"] if is_scaled else []
        if clauses:  # no more than an offset, which was voted for
            yield tried.explained(clauses, tried.rows_of(replace(thin, x_m=moved.real, y_m=moved.imag)), FITTED)


def _longest(table: Trajectories) -> list[I64]:
    rows = [rows for _, rows in rows_by_id(table.track_id)]
    return sorted(rows, key=len, reverse=True)[:FITTED_IDS]


def _changed(truth: Trajectories, on_floor: bool) -> Iterator[tuple[list[str], Trajectories]]:
    """The truth under every combination of few changes, with their clauses; fewer ones first."""
    families = (NUMBERS, AXES, UNITS) if on_floor else (NUMBERS, BOXES)
    combined = [[change for change in changes if change.clause] for changes in product(*families)]
    for changes in sorted(combined, key=len):
        if len(changes) <= CHANGES_MAX:
            changed = truth
            for change in changes:
                changed = change.of(changed)
            yield [change.clause for change in changes], changed


def voted_shift(truth: _Rows, tracks: _Rows) -> int:
    """Frames by which the tracks are later than the truth, by pairs of rows at about one place."""
    pairs = cKDTree(truth.at).sparse_distance_matrix(cKDTree(tracks.at), 0.5, output_type="coo_matrix")
    later = np.round(tracks.frame[pairs.col] - truth.frame[pairs.row]).astype(np.int64)
    if len(later) == 0:
        return 0
    votes = np.bincount(later - later.min(), (1.0 - 2.0 * pairs.data) ** 2)
    # Pairs of longer shifts are fewer, since both tables end.
    return int(np.convolve(votes, (0.25, 0.5, 1.0, 0.5, 0.25), "same").argmax() + later.min())


def voted_offset(truth: _Rows, tracks: _Rows) -> F64:
    """(2,) from the truth to the tracks, by pairs of rows of one frame [units of what is near]."""
    order = np.argsort(tracks.frame, kind="stable")
    frames = tracks.frame[order]
    low, high = np.searchsorted(frames, truth.frame - 0.5), np.searchsorted(frames, truth.frame + 0.5)
    counts = high - low
    if counts.sum() < 20:
        return np.zeros(2)
    row = np.repeat(np.arange(len(counts)), counts)
    column = order[np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(low, counts)]
    apart = tracks.at[column] - truth.at[row]
    voters = cKDTree(apart)
    most = apart[int(np.argmax(voters.query_ball_point(apart, 0.5, return_length=True)))]
    return np.asarray(np.median(apart[voters.query_ball_point(most, 0.5)], axis=0))
