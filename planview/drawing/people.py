"""People at a moment, as every picture shows them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from calib.types import F64, I32, U8
from planview.drawing.style import Rgb
from planview.trajectories.state import SURE_FACING, TrackState
from planview.trajectories.table import Trajectories, row_states

ARROW_M = 0.5
"""From a person to the tip of the arrow that shows where it faces [m]: beyond the shoulders."""
AXIS_M = 0.35
"""From a person to the ends of a line without a head [m]."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Confirmed and lost people at a frame, its time (NaN where unknown), (N, 2) places of the last seconds by id [m],
    the newest last, and the true people."""

    frame: int
    time_s: float
    people: list[TrackState]
    trails: dict[int, F64] = field(default_factory=dict)
    truth: list[TrackState] = field(default_factory=list)


def snapshot_at(tracks: Trajectories, frame: int, trail_frames: int = 0, truth: Trajectories | None = None) -> Snapshot:
    """A frame of tables that are sorted by frame, with trails of ``trail_frames``."""
    start, stop = rows_between(tracks, frame, frame + 1)
    trail_start, _ = rows_between(tracks, frame - trail_frames, frame)
    people = [person for person in row_states(tracks, slice(start, stop)) if person.state != "tentative"]
    xy = np.column_stack([tracks.x_m[trail_start:stop], tracks.y_m[trail_start:stop]])
    ids = tracks.track_id[trail_start:stop]
    trails = {person.track_id: xy[ids == person.track_id] for person in people}
    time_s = float("nan")
    if stop > start:
        time_s = float(tracks.timestamp_s[start])
    true_people = []
    if truth is not None:
        true_people = row_states(truth, slice(*rows_between(truth, frame, frame + 1)))
    return Snapshot(frame, time_s, people, trails, true_people)


def rows_between(table: Trajectories, first_frame: int, end_frame: int) -> tuple[int, int]:
    """First row, and the row after the last, of frames from ``first_frame`` until before ``end_frame``."""
    start, stop = np.searchsorted(table.frame, [first_frame, end_frame])
    return int(start), int(stop)


def faces_surely(person: TrackState) -> bool:
    """True if front and back are certain enough for an arrow, as they are in a table without confidence (NaN)."""
    return not person.facing_confidence < SURE_FACING


def facing_line(person: TrackState) -> F64 | None:
    """(2, 2) places on the floor [m]: the person's and ARROW_M ahead of the chest, or where front and back may be
    confused AXIS_M behind and ahead; None where one is unknown."""
    angle = math.radians(person.facing_deg)
    ahead = np.array([math.cos(angle), math.sin(angle)])
    at_m = np.array([person.x_m, person.y_m])
    if faces_surely(person):
        ends = np.stack([at_m, at_m + ARROW_M * ahead])
    else:
        ends = np.stack([at_m - AXIS_M * ahead, at_m + AXIS_M * ahead])
    if not np.isfinite(ends).all():
        return None
    return ends


def paint_facing(picture: U8, person: TrackState, ends: I32, colour: Rgb, width: int) -> None:
    """Draw the (2, 2) ends of a ``facing_line`` [px]: an arrow, or a line without a head."""
    start, tip = ends.tolist()
    tip_share = 0.35 if faces_surely(person) else 0.0
    cv2.arrowedLine(picture, start, tip, colour, width, cv2.LINE_AA, tipLength=tip_share)
