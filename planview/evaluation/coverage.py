"""The part that a truth covers, in time, in place and of each person: rows of tracks outside of it are not judged.

A track that follows a person and continues where the truth has no row of that person shows that the truth ends there,
and not the person.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from calib.types import F64, I64, Bool
from planview.evaluation.places import Places, near_unit, nearest_rows, places_of, share_near
from planview.trajectories.table import Trajectories, ordinal, rows_by_id

GOES_ON_S = 1.0
"""A track that continues for longer after the last row of a truth shows that the truth ends before the recording [s]:
nobody is followed for that long after leaving (our choice)."""
OUTSIDE = 0.1
"""Share of the rows that must lie outside of the truth's places: tracks end a little after people leave."""
MOSTLY = 0.5
"""Share of the rows outside that must be of tracks that follow people of the truth inside: others may be false. And
share of the truth's rows that must be near a track."""


class Coverage(NamedTuple):
    """(N,) rows of tracks that a truth covers, and why it does not cover the others, a clause each."""

    judged: Bool
    limits: tuple[str, ...]


def coverage(truth: Trajectories, tracks: Trajectories, on_floor: bool, frame_s: float) -> Coverage:
    """The rows of the tracks that a truth covers; both tables have only rows with places."""
    covers_all = Coverage(np.ones(len(tracks), dtype=np.bool_), ())
    if not (len(truth) and len(tracks)):
        return covers_all
    unit = near_unit(tracks, on_floor)
    places = places_of(tracks, on_floor, unit)
    true_places = places_of(truth, on_floor, unit)
    if share_near(true_places, places) < MOSTLY:  # of other places or times: nobody is followed
        return covers_all
    nearest = nearest_rows(places, true_places)
    gap = _gaps(truth, tracks, nearest)
    goes_on = (nearest < 0) & (gap > 0)
    limits = []
    outside = np.zeros(len(tracks), dtype=np.bool_)
    usual = usual_step(truth)
    if usual > 1:
        outside |= goes_on & (gap < np.percentile(_steps(truth), 95))
        limits.append(f"each person has rows in about every {ordinal(usual)} frame only (keyframes)")
    first = truth.frame[0]
    last = truth.frame[-1]
    hull = shapely.convex_hull(shapely.MultiPoint(_middles(true_places)))
    is_beside = ~outside & (nearest < 0) & _is_outside(hull, places)
    is_far = is_beside & _is_outside(hull.buffer(1.0), places)
    counted = ~outside & (tracks.frame >= first) & (tracks.frame <= last)
    leaving = np.count_nonzero(counted & is_far & goes_on)
    if leaving > OUTSIDE * np.count_nonzero(counted) and leaving > MOSTLY * np.count_nonzero(counted & is_far):
        outside |= is_far | (is_beside & goes_on)
        limits.append("its places are a part of the floor only" if on_floor else "its boxes are in a part of the image")
    before = (tracks.frame < first, f"it begins with frame {first}")
    after = (tracks.frame > last, f"it ends with frame {last}")
    for is_beyond, limit in (before, after):
        _, rows = np.unique(tracks.track_id[is_beyond & ~outside & goes_on], return_counts=True)
        if rows.max(initial=0) * frame_s > GOES_ON_S:
            outside |= is_beyond
            limits.append(limit)
    return Coverage(~outside, tuple(limits))


def usual_step(truth: Trajectories) -> int:
    """Frames from row to row of a person, usually: above 1 where only keyframes have rows."""
    steps = _steps(truth)
    return int(np.median(steps)) if len(steps) else 1


def _steps(truth: Trajectories) -> I64:
    """Frames from row to row of each person."""
    steps = [np.diff(truth.frame[rows]) for _, rows in rows_by_id(truth.track_id)]
    return np.concatenate([np.empty(0, np.int64), *steps])


def _is_outside(area: shapely.Geometry, places: Places) -> Bool:
    """(N,) mask of the places outside of an area."""
    return np.asarray(~shapely.intersects_xy(area, *_middles(places).T))


def _middles(places: Places) -> F64:
    """(N, 2) places, of boxes their middles."""
    return np.asarray(places.at.reshape(len(places), -1, 2).mean(axis=1))


def _gaps(truth: Trajectories, tracks: Trajectories, nearest: I64) -> I64:
    """(N,) frames from each row of the tracks to the nearest row of the person whom its track follows: whom it was near
    in the frame that is next in time; 0 of tracks that were near nobody. ``nearest``: row of the truth, or -1."""
    gap = np.zeros(len(tracks), dtype=np.int64)
    rows_of = dict(rows_by_id(truth.track_id))
    for _, rows in rows_by_id(tracks.track_id):
        near = rows[nearest[rows] >= 0]
        if not len(near):
            continue
        frames = tracks.frame[rows]
        closest = near[_closest(tracks.frame[near], frames)]
        people = truth.track_id[nearest[closest]]
        for person in np.unique(people).tolist():
            seen = truth.frame[rows_of[person]]
            is_followed = people == person
            followed = frames[is_followed]
            gap[rows[is_followed]] = np.abs(seen[_closest(seen, followed)] - followed)
    return gap


def _closest(numbers: I64, wanted: I64) -> I64:
    """Indices of the numbers, ascending, that are closest to the given ones."""
    return np.searchsorted((numbers[:-1] + numbers[1:]) / 2, wanted)
