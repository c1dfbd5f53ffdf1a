"""Whether a drawn scene could be: nobody walks through anybody or anything, and people are in view."""

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
"""Smallest share of the frames with somebody in view."""


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
    return reason or _through_things(places, scene) or _out_of_view(places, stage)


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
        return "there is nobody in view for half of the time"
    alone = in_view.any(axis=1)
    return "" if alone.all() else f"person {int(np.argmin(alone)) + 1} is never in view"
