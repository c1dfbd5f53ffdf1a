"""Whether a drawn scene could be: no person walks through another, people are in view and do what they came for."""

from __future__ import annotations

import numpy as np

from calib.types import F64
from planview.synthetic.motion import scripted_motion
from planview.synthetic.scene import Scene
from planview.synthetic.stage import Stage
from planview.synthetic.wandering import Obstacles, wander

GAP_M = 0.38
"""Smallest distance between two body axes: shoulders turned, touching."""
STEP_S = 0.1
MIN_IN_VIEW = 0.5
"""Smallest share of the frames with a person in view."""
MIN_HIDDEN = 3
"""People hide each other at least so many times where a challenge covers occlusion by people."""
HIDDEN_M = 0.25
"""A person is hidden whose axis is so near to the line of sight to another one's: half a shoulder width [m]."""
LEAVE_S = 4.0
"""People who carry or push things are on their way out at the end, at most so long from the end of their steps [s]."""


def implausible(scene: Scene, stage: Stage) -> str:
    """Why a scene cannot be; empty when it can."""
    furniture = {f.name: f for f in scene.furniture if f.name}
    scripted = [scripted_motion(p, furniture, scene.duration_s) for p in scene.people]
    times = np.arange(0.0, scene.duration_s, STEP_S)
    walks = any(p.wander for p in scene.people)
    places = [m.places(times) for m in scripted]
    reason = _gaps(places, scene, wandering=walks)
    if walks and not reason:
        places = [m.places(times) for m in wander(scene, scripted)]
        reason = _gaps(places, scene, wandering=False)
    late = _cut_off([m.script_end_s for m in scripted], scene)
    return reason or late or _through_things(places, scene) or _out_of_view(places, stage) or _apart(places, stage)


def _cut_off(ends_s: list[float], scene: Scene) -> str:
    """Things are put down and taken within the recording."""
    for i, (person, end_s) in enumerate(zip(scene.people, ends_s, strict=True)):
        if any(s.carry or s.push for s in person.steps) and end_s > scene.duration_s + LEAVE_S:
            return f"person {i + 1} is not done with a thing at the end"
    return ""


def _apart(places: list[F64], stage: Stage) -> str:
    """Whether people hide each other too seldom for what the challenge covers."""
    if "occlusion by people" not in stage.challenge.covers:
        return ""
    n = sum(_times_hidden(a, b, stage) for i, a in enumerate(places) for b in places[:i])
    return "" if n >= MIN_HIDDEN else f"people hide each other {n} times only"


def _times_hidden(one: F64, other: F64, stage: Stage) -> int:
    """How many times two people in view, (T, 2) each, come into one line of sight."""
    in_view = stage.in_view(np.nan_to_num(one, nan=-1e3)) & stage.in_view(np.nan_to_num(other, nan=-1e3))
    a, b = one[in_view] - stage.camera_xy, other[in_view] - stage.camera_xy
    aside = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / np.maximum(*(np.linalg.norm(v, axis=1) for v in (a, b)))
    hidden = np.zeros(len(one), np.bool_)
    hidden[in_view] = aside < HIDDEN_M
    return int((hidden[1:] & ~hidden[:-1]).sum()) + int(hidden[0])


def _gaps(places: list[F64], scene: Scene, *, wandering: bool) -> str:
    for i in range(len(places)):
        for j in range(i):
            if wandering and (scene.people[i].wander or scene.people[j].wander):
                continue
            gap = np.linalg.norm(places[i] - places[j], axis=1)
            if (gap < GAP_M).any():
                return f"people {j + 1} and {i + 1} walk through each other"
    return ""


def _through_things(places: list[F64], scene: Scene) -> str:
    """Seats and handled things are meant to be near."""
    touched = {s.on or s.push or s.carry for p in scene.people for s in p.steps}
    solid = [f for f in scene.furniture if f.name not in touched]
    obstacles = Obstacles(scene.room, solid)
    for i, place in enumerate(places):
        known = place[np.isfinite(place[:, 0])]
        if len(known) and obstacles.distance(known).min() < 0.2:
            return f"person {i + 1} walks through a wall or furniture"
    return ""


def _out_of_view(places: list[F64], stage: Stage) -> str:
    in_view = np.array([stage.in_view(np.nan_to_num(p, nan=-1e3)) for p in places])
    if in_view.any(axis=0).mean() < MIN_IN_VIEW:
        return "no person is in view for half of the time"
    alone = in_view.any(axis=1)
    return "" if alone.all() else f"person {int(np.argmin(alone)) + 1} is never in view"
