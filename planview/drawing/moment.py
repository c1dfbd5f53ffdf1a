"""What is drawn of one frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.types import F64
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, row_states


@dataclass(frozen=True, eq=False)
class Rule:
    """A tripwire or zone: (N, 2) points on the floor [m], or in the image [px]."""

    name: str
    is_line: bool
    on_floor: bool
    points: F64


@dataclass(frozen=True, eq=False)
class Moment:
    """People at one frame.

    Attributes:
        frame: of the recording.
        time_s: of the frame [s]; NaN where unknown.
        people: in the frame.
        trails: by id, (N, 2) places on the floor of the last seconds [m], the newest last.
        truth: the true people of the frame.
    """

    frame: int
    time_s: float
    people: list[TrackState]
    trails: dict[int, F64] = field(default_factory=dict)
    truth: list[TrackState] = field(default_factory=list)


def moment_at(tracks: Trajectories, frame: int, trail_frames: int = 0, truth: Trajectories | None = None) -> Moment:
    """A frame of tables that are sorted by frame; only the rows of the trail are looked at.

    Args:
        trail_frames: length of the trails [frames].
    """
    first, start, stop = np.searchsorted(tracks.frame, [frame - trail_frames, frame, frame + 1]).tolist()
    people = row_states(tracks, slice(start, stop))
    ids = tracks.track_id[first:stop]
    xy = np.column_stack([tracks.x_m[first:stop], tracks.y_m[first:stop]])
    trails = {person.track_id: xy[ids == person.track_id] for person in people}
    time_s = float(tracks.timestamp_s[start]) if stop > start else float("nan")
    true = row_states(truth, slice(*np.searchsorted(truth.frame, [frame, frame + 1]).tolist())) if truth else []
    return Moment(frame, time_s, people, trails, true)


def rules_of(counts: dict[str, object]) -> list[Rule]:
    """The rules in the ``rules`` object of counts.json."""
    rules = []
    for name, rule in counts.items():
        points = rule.get("points") if isinstance(rule, dict) else None
        if isinstance(rule, dict) and points:
            on_floor = rule.get("plane") == "floor"
            rules.append(Rule(name, rule.get("kind") == "tripwire", on_floor, np.array(points, dtype=np.float64)))
    return rules
