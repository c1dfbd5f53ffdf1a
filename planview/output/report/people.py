"""The table of people."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.types import F64, I64
from planview.counting.totals import Clock
from planview.trajectories.table import Trajectories

STEP_S = 0.5
"""Places so far apart make a way, so that noise does not add up [s] (our choice)."""


class PersonRow(NamedTuple):
    """A person, ready to print: times [s], way [m], mean speed [m/s], median height [m]; empty where unknown."""

    track_id: int
    first: str
    last: str
    observed: str
    way: str
    speed: str
    height: str


def people_rows(tracks: Trajectories, clock: Clock, ids: I64) -> list[PersonRow]:
    """Of confirmed people, whose rows are gathered at once.

    Args:
        ids: (P,) ascending.
    """
    rows = np.flatnonzero((tracks.state == "confirmed") & np.isin(tracks.track_id, ids))
    rows = rows[np.argsort(tracks.track_id[rows], kind="stable")]
    cuts = np.searchsorted(tracks.track_id[rows], ids[1:])
    return [_row(tracks.where(mine), clock) for mine in np.split(rows, cuts) if len(mine)]


def _row(person: Trajectories, clock: Clock) -> PersonRow:
    when = clock.at(person.frame)
    way = _way_m(np.column_stack([person.x_m, person.y_m]), when)
    span = float(when[-1] - when[0])
    known = person.height_m[np.isfinite(person.height_m)]
    return PersonRow(
        int(person.track_id[0]),
        f"{when[0]:.1f}",
        f"{when[-1]:.1f}",
        f"{len(person) * clock.frame_s:.1f}",
        f"{way:.1f}" if np.isfinite(way) else "",
        f"{way / span:.2f}" if span > 0 and np.isfinite(way) else "",
        f"{np.median(known):.2f}" if len(known) else "",
    )


def _way_m(xy: F64, times: F64) -> float:
    """Length of a way from places STEP_S apart [m]."""
    ticks = np.floor((times - times[0]) / STEP_S)
    picked = xy[np.concatenate([[True], np.diff(ticks) > 0])]
    return float(np.hypot(*np.diff(picked, axis=0).T).sum())
