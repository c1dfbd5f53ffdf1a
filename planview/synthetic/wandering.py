"""Random walks that avoid people and furniture: ten times a second a wanderer picks the best of a fan of velocities.

Our choice: the sampled velocity obstacles of van den Berg et al. 2008 in their simplest form. It needs no tuning
per scene, and people give way, stop and pass as pedestrians do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64
from planview.synthetic.furniture import furniture_size
from planview.synthetic.motion import ACTIONS, TICK_HZ, TURNS, Motion, motion_from_ticks
from planview.synthetic.persons import Person, Wander
from planview.synthetic.room import wall_pieces
from planview.synthetic.scene import Scene
from planview.synthetic.setting import Furniture, Room, Wall

STEP_S = 0.1
PERSONAL_M = 0.62
"""Distance between body axes that walkers keep: a shoulder width and a hand."""
CLEARANCE_M = 0.35
"""Distance of a body's axis from furniture."""
HORIZON_S = 2.5
_TURNS = np.deg2rad([0, 18, -18, 40, -40, 70, -70, 110, -110, 180])
_SPEEDS = np.array([1.0, 0.6, 0.25])


@dataclass
class _Walker:
    """A wanderer while simulated; ``track`` holds positions at STEP_S from ``begin``."""

    person: Person
    wander: Wander
    begin: float
    place: F64
    rng: np.random.Generator
    velocity: F64 = field(default_factory=lambda: np.zeros(2))
    goal: F64 = field(default_factory=lambda: np.zeros(2))
    speed: float = 1.0
    rest_until: float = 0.0
    best_m: float = np.inf
    stuck_s: float = 0.0
    leaving: int = -1
    detour: bool = False
    gone_s: float = np.inf
    track: list[F64] = field(default_factory=list)


class Obstacles:
    """Footprints of standing furniture and of walls beside their openings, as oriented rectangles."""

    def __init__(self, room: Room, furniture: Sequence[Furniture]) -> None:
        low = [f for f in furniture if f.z_m < 1.8 and not f.moves]
        walls = [piece for side in get_args(Wall) for piece in wall_pieces(room, side)]
        middles = [(a + b) / 2 for a, b in walls]
        spans = [b - a for a, b in walls]
        self._centre = np.array([*(f.at_m for f in low), *middles], np.float64).reshape(-1, 2)
        self._angle = np.array([*(np.deg2rad(f.heading_deg) for f in low), *(np.arctan2(v[1], v[0]) for v in spans)])
        sizes = [*(furniture_size(f)[:2] for f in low), *((float(np.hypot(v[0], v[1])), 0.02) for v in spans)]
        self._half = np.array(sizes, np.float64).reshape(-1, 2) / 2

    def distance(self, points: F64) -> F64:
        """(N,) distance of points (N, 2) from the nearest footprint, 0 inside."""
        d = points[:, None, :] - self._centre
        c, s = np.cos(self._angle), np.sin(self._angle)
        local = np.stack([d[..., 0] * c + d[..., 1] * s, -d[..., 0] * s + d[..., 1] * c], -1)
        outside = np.maximum(np.abs(local) - self._half, 0.0)
        return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=1))


def wander(scene: Scene, scripted: Sequence[Motion]) -> list[Motion]:
    """Replace the motions of wanderers.

    Args:
        scene: the scene; its seed decides the walks.
        scripted: motion of each person's steps; a wanderer's walk begins when they end.
    Returns:
        one motion per person.
    """
    walkers = {
        i: _Walker(p, p.wander, begin, scripted[i].at(begin)[0], np.random.default_rng([scene.seed, i]))
        for i, p in enumerate(scene.people)
        for begin in (scripted[i].script_end_s,)
        if p.wander is not None
    }
    obstacles = Obstacles(scene.room, scene.furniture)
    for walker in walkers.values():
        _new_goal(walker, obstacles)
    for k in range(int((scene.duration_s + 1) / STEP_S) + 1):
        _advance(k * STEP_S, walkers, scripted, obstacles)
    return [
        _merged(scene.people[i], motion, walkers[i]) if i in walkers else motion for i, motion in enumerate(scripted)
    ]


def _advance(t: float, walkers: dict[int, _Walker], scripted: Sequence[Motion], obstacles: Obstacles) -> None:
    places, velocities, owners = [], [], []
    for i, motion in enumerate(scripted):
        walker = walkers.get(i)
        if walker is not None and t >= walker.begin:
            if t < walker.gone_s:
                places.append(walker.place)
                velocities.append(walker.velocity)
                owners.append(i)
        elif motion.exists(t):
            here = motion.at(t)[0]
            places.append(here)
            velocities.append((motion.at(t + 0.1)[0] - here) / 0.1)
            owners.append(i)
    where, how, who = np.array(places).reshape(-1, 2), np.array(velocities).reshape(-1, 2), np.array(owners)
    for i, walker in walkers.items():
        if walker.begin <= t < walker.gone_s:
            walker.track.append(walker.place.copy())
            others = who != i
            _step(walker, t, where[others], how[others], obstacles)


def _step(walker: _Walker, t: float, others: F64, moving: F64, obstacles: Obstacles) -> None:
    _think(walker, t, obstacles)
    to_goal = walker.goal - walker.place
    distance = float(np.linalg.norm(to_goal))
    speed = 0.0 if t < walker.rest_until else min(walker.speed, distance / 0.4)
    wanted = to_goal / max(distance, 1e-9) * speed
    angle = np.arctan2(to_goal[1], to_goal[0]) + _TURNS
    fan = max(speed, 0.4) * _SPEEDS[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    candidates = np.concatenate([wanted[None], np.zeros((1, 2)), fan.reshape(-1, 2)])
    cost = np.linalg.norm(candidates - wanted, axis=1) + 0.35 * np.linalg.norm(candidates - walker.velocity, axis=1)
    cost += _danger(walker.place, candidates, others, moving)
    for ahead in (0.25, 0.6, 1.0):
        gap = obstacles.distance(walker.place + ahead * candidates)
        cost += 6.0 * np.clip(CLEARANCE_M - gap, 0, CLEARANCE_M) / CLEARANCE_M / (0.5 + ahead)
    best = candidates[int(np.argmin(cost))]
    walker.velocity = 0.45 * walker.velocity + 0.55 * best
    walker.place = walker.place + walker.velocity * STEP_S


def _danger(place: F64, candidates: F64, others: F64, moving: F64) -> F64:
    """(C,) cost of coming within PERSONAL_M of another person within the horizon."""
    if len(others) == 0:
        return np.zeros(len(candidates))
    offset = others - place
    relative = moving[None] - candidates[:, None]
    square = np.maximum((relative**2).sum(-1), 1e-9)
    when = np.clip(-(offset * relative).sum(-1) / square, 0, HORIZON_S)
    closest = np.linalg.norm(offset + relative * when[..., None], axis=-1)
    soon = np.linalg.norm(offset + relative * 0.3, axis=-1)
    cost = np.clip(PERSONAL_M + 0.1 - closest, 0, None) / PERSONAL_M * 4.0 / (0.4 + when)
    cost += 15.0 * np.clip(PERSONAL_M - soon, 0, None) / PERSONAL_M
    return np.asarray(cost.sum(axis=1))


def _think(walker: _Walker, t: float, obstacles: Obstacles) -> None:
    """Choose the next goal: on arrival, when stuck, or when it is time to leave."""
    plan, exits = walker.wander, walker.wander.exit_m
    distance = float(np.linalg.norm(walker.goal - walker.place))
    if plan.until_s is not None and t >= plan.until_s and exits and walker.leaving < 0:
        walker.leaving, walker.rest_until = 0, t
        _aim(walker, exits[0])
    elif walker.leaving >= 0 and distance < 0.35:
        walker.leaving += not walker.detour
        if walker.leaving == len(exits):
            walker.gone_s = t
        else:
            _aim(walker, exits[walker.leaving])
    elif walker.leaving < 0 and distance < 0.3:
        walker.rest_until = t + walker.rng.uniform(*plan.pause_s)
        _new_goal(walker, obstacles)
    elif t >= walker.rest_until:
        walker.stuck_s = 0.0 if distance < walker.best_m - 0.05 else walker.stuck_s + STEP_S
        walker.best_m = min(walker.best_m, distance)
        if walker.stuck_s > 3.0 and walker.leaving < 0:
            _new_goal(walker, obstacles)
        elif walker.stuck_s > 1.5 and walker.leaving >= 0:
            _step_aside(walker)


def _aim(walker: _Walker, goal: ArrayLike, *, detour: bool = False) -> None:
    walker.goal, walker.detour = np.asarray(goal, np.float64), detour
    walker.best_m, walker.stuck_s = np.inf, 0.0


def _step_aside(walker: _Walker) -> None:
    """Around an obstacle in the way to the exit: a random place nearby first, then on."""
    if walker.detour:
        _aim(walker, walker.wander.exit_m[walker.leaving])
    else:
        _aim(walker, walker.place + walker.rng.uniform(-1.5, 1.5, 2), detour=True)


def _new_goal(walker: _Walker, obstacles: Obstacles) -> None:
    x0, y0, x1, y1 = walker.wander.area_m
    for _ in range(50):
        goal = walker.rng.uniform([x0, y0], [x1, y1])
        far = np.linalg.norm(goal - walker.place) > 0.35 * min(x1 - x0, y1 - y0)
        if far and obstacles.distance(goal[None])[0] > CLEARANCE_M + 0.1:
            break
    walker.speed = float(walker.rng.uniform(*walker.wander.speed_mps))
    _aim(walker, goal)


def _merged(person: Person, scripted: Motion, walker: _Walker) -> Motion:
    """Steps first, then the walk, as one motion."""
    n = max(1, round((walker.begin - scripted.first_s) * TICK_HZ))
    times = np.arange(len(walker.track) * int(TICK_HZ * STEP_S)) / TICK_HZ
    track = np.array(walker.track) if walker.track else walker.place[None]
    known = np.arange(len(track)) * STEP_S
    walk = np.column_stack([np.interp(times, known, track[:, c]) for c in (0, 1)])
    xy = np.concatenate([scripted.raw_xy[:n], walk])
    after = np.zeros((len(walk), len(ACTIONS)))
    after[:, TURNS] = scripted.raw_actions[n - 1, TURNS]
    actions = np.concatenate([scripted.raw_actions[:n], after])
    face = np.concatenate([scripted.raw_face[:n], np.full(len(walk), np.nan)])
    return motion_from_ticks(person, xy, face, actions, scripted.handlings, walker.gone_s)
