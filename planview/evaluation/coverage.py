"""What a truth covers, in time, in place and of each person: rows of tracks outside of it are not judged.

A track that follows a person and goes on where the truth has no row of that person shows that the truth ends there, and
not the person.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from calib.types import F64, I64, Bool
from planview.evaluation.places import Places, near_unit, nearest_rows, places_of, share_near
from planview.trajectories.table import Trajectories, ordinal, rows_by_id

GOES_ON_S = 1.0
"""A track that goes on for longer after the last row of a truth shows that the truth ends before the recording [s]:
nobody is followed so long after leaving (our choice)."""
OUTSIDE = 0.1
"""Share of the rows that must go on outside of the truth's places: tracks end a little after people leave."""
MOSTLY = 0.5
"""Share of the rows outside that must be of tracks that follow people of the truth inside: others may be false. And
share of the truth's rows that must be near a track."""


class Coverage(NamedTuple):
    """(N,) rows of tracks that a truth covers, and why it does not cover the others, a clause each."""

    judged: Bool
    limits: tuple[str, ...]


class _Followed(NamedTuple):
    """Of each row of the tracks, (N,).

    Attributes:
        goes_on: it is near nobody, and its track follows a person who has no row in this frame.
        gap: frames to that person's nearest row.
    """

    goes_on: Bool
    gap: I64


def coverage(truth: Trajectories, tracks: Trajectories, on_floor: bool, frame_s: float) -> Coverage:
    """The rows of the tracks that a truth covers; both tables have only rows with places."""
    everything = np.ones(len(tracks), dtype=np.bool_)
    if not (len(truth) and len(tracks)):
        return Coverage(everything, ())
    unit = near_unit(tracks, on_floor)
    places = places_of(tracks, on_floor, unit)
    true_places = places_of(truth, on_floor, unit)
    nearest = nearest_rows(places, true_places)
    if share_near(true_places, places) < MOSTLY:  # of other places or times: nobody is followed
        return Coverage(everything, ())
    followed = _followed(truth, tracks, nearest)
    limits = []
    outside = np.zeros(len(tracks), dtype=np.bool_)
    usual = usual_step(truth)
    if usual > 1:
        outside |= followed.goes_on & (followed.gap < np.percentile(_steps(truth), 95))
        limits.append(f"each person has rows in about every {ordinal(usual)} frame only (keyframes)")
    ends = _ends(truth, tracks)
    hull = shapely.convex_hull(shapely.MultiPoint(_middles(true_places)))
    beside = ~outside & (nearest < 0) & _is_outside(hull, places)
    far = beside & _is_outside(hull.buffer(1.0), places)
    counted = ~(outside | ends[0][0] | ends[1][0])
    leaving = np.count_nonzero(counted & far & followed.goes_on)
    if leaving > OUTSIDE * np.count_nonzero(counted) and leaving > MOSTLY * np.count_nonzero(counted & far):
        outside |= far | (beside & followed.goes_on)
        limits.append("its places are a part of the floor only" if on_floor else "its boxes are in a part of the image")
    for beyond, limit in ends:
        _, rows = np.unique(tracks.track_id[beyond & ~outside & followed.goes_on], return_counts=True)
        if rows.max(initial=0) * frame_s > GOES_ON_S:
            outside |= beyond
            limits.append(limit)
    return Coverage(~outside, tuple(limits))


def _ends(truth: Trajectories, tracks: Trajectories) -> tuple[tuple[Bool, str], tuple[Bool, str]]:
    """Rows of the tracks before the first and after the last frame with truth, each with what they would show."""
    first = truth.frame[0]
    last = truth.frame[-1]
    return (
        (np.asarray(tracks.frame < first), f"it begins with frame {first}"),
        (np.asarray(tracks.frame > last), f"it ends with frame {last}"),
    )


def usual_step(truth: Trajectories) -> int:
    """Frames from row to row of a person, usually: above 1 where only keyframes have rows."""
    steps = _steps(truth)
    return int(np.median(steps)) if len(steps) else 1


def _steps(truth: Trajectories) -> I64:
    """Frames from row to row of each person."""
    steps = [np.diff(truth.frame[rows]) for _, rows in rows_by_id(truth.track_id)]
    return np.concatenate([np.empty(0, np.int64), *steps])


def _is_outside(area: shapely.Geometry, places: Places) -> Bool:
    """(N,) whether places lie outside of an area."""
    return np.asarray(~shapely.intersects_xy(area, *_middles(places).T))


def _middles(places: Places) -> F64:
    """(N, 2) places, of boxes their middles."""
    return np.asarray(places.at.reshape(len(places), -1, 2).mean(axis=1))


def _followed(truth: Trajectories, tracks: Trajectories, nearest: I64) -> _Followed:
    """Whom each track follows: the person whom it was near in the frame that is next in time."""
    person = np.full(len(tracks), -1)
    index = np.unique(truth.track_id, return_inverse=True)[1]
    for _, rows in rows_by_id(tracks.track_id):
        near = rows[nearest[rows] >= 0]
        if len(near):
            closest = near[_closest(tracks.frame[near], tracks.frame[rows])]
            person[rows] = index[nearest[closest]]
    # One number for each person and frame, so that people are as far from each other as the recording is long.
    first = min(truth.frame[0], tracks.frame[0])
    span = 2 * (max(truth.frame[-1], tracks.frame[-1]) - first + 1)
    known = np.sort(index * span + truth.frame)
    asked = person * span + tracks.frame
    gap = np.abs(known[_closest(known, asked)] - asked)
    return _Followed((nearest < 0) & (person >= 0) & (gap > 0), gap)


def _closest(known: I64, asked: I64) -> I64:
    """Indices of the known numbers, ascending, that are closest to those asked for."""
    return np.searchsorted((known[:-1] + known[1:]) / 2, asked)
