"""What would explain a bad score: the changes of a truth table that make it fit the tracks.

Axes, units, rates of the frames and forms of boxes are tried; a shift in time and an offset in the plane are not tried
but voted for, by pairs of rows that are near each other and by pairs of rows of one frame (as a Hough transform does).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from calib.types import F64
from planview.trajectories.table import Trajectories

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
"""Changes tried together, besides a shift or an offset."""

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
    """A sentence on the change of the truth that makes it fit the tracks, rows that have what is compared; empty where
    they fit already, or where no change explains it."""
    near = None if on_floor else CLOSE_BOX * float(np.median(tracks.box_px[:, 3])) if len(tracks) else 1.0
    followed = _Rows.of(tracks, near)
    if len(truth) < 20 or len(tracks) < 20:
        return ""
    # Of every id alike: rows are sorted by frame, so that every n-th of them are all people's.
    thin = truth.where(np.arange(len(truth)) % max(1, len(truth) // VOTERS) == 0)
    space, voted_on = cKDTree(followed.in_space), followed.thinned(VOTED_ON)
    covered = float(followed.frame.min()), float(followed.frame.max())
    now = _share(space, _Rows.of(thin, near), covered)
    if now >= GOOD:
        return ""
    best, found, size = (now, now), "", np.ptp(followed.at, axis=0).max()
    for clauses, changed in _changed(thin, on_floor):
        if best[1] >= GOOD and len(clauses) > found.count(" and ") + 1:
            break  # more changes explain no more
        rows = _Rows.of(changed, near)
        extent = np.ptp(rows.at, axis=0).max() if len(rows.at) else 0.0
        if not size / 10 < extent < 10 * size:  # of another unit than the tracks
            continue
        frames, offset = voted_shift(rows, voted_on), voted_offset(rows, voted_on)
        for clause, moved in (
            ("", rows),
            (f"the tracks are moved by {-frames:+d} frames", rows.moved(frames, np.zeros(2))),
            (_beside(offset, near), rows.moved(0, offset)),
        ):
            known = [*clauses, clause] if clause else clauses
            share = _share(space, moved, covered)
            if known and share - SIMPLER * len(known) > best[0]:
                best, found = (share - SIMPLER * len(known), share), " and ".join(known)
    if best[1] < max(0.8 * GOOD, now + GAIN):
        return ""
    return f"{best[1]:.0%} of the truth's rows are near a track, in place of {now:.0%}, if {found}"


def shift_between(truth: Trajectories, tracks: Trajectories, on_floor: bool) -> int:
    """Frames by which the tracks have to be moved to lie near the truth, by the votes of pairs of rows at one place; 0
    where there are none."""
    if not (len(truth) and len(tracks)):
        return 0
    near = None if on_floor else CLOSE_BOX * float(np.median(tracks.box_px[:, 3]))
    return -voted_shift(_Rows.of(truth, near).thinned(VOTERS), _Rows.of(tracks, near).thinned(VOTED_ON))


def _beside(offset: F64, near: float | None) -> str:
    if near is not None:
        x, y = np.round(-near * offset).astype(int).tolist()
        return f"its boxes lie {x:+d}, {y:+d} px beside the tracks"
    x, y = (0.01 * np.round(-100 * CLOSE_M * offset).astype(int)).tolist()
    return f"it lies {x:+.2f}, {y:+.2f} m beside the tracks (align them)"


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


def _share(space: cKDTree, rows: _Rows, covered: tuple[float, float]) -> float:
    """Share of the rows with a row of the tracks near, each of which serves one; of those in the frames that the tracks
    cover, unless these are few."""
    _, nearest = space.query(rows.in_space, distance_upper_bound=1.0)
    inside = int(np.count_nonzero((rows.frame >= covered[0]) & (rows.frame <= covered[1])))
    return len(np.unique(nearest[nearest < space.n])) / max(1, inside, len(rows.frame) // 3)


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
    """(2,) by which the tracks lie beside the truth, by pairs of rows of one frame [units of what is near]."""
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
