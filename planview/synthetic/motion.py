"""Places and actions of people over time: steps of the scene, and random walks, as sampled tracks.

For random walks, ten times a second a wanderer picks the best of a fan of velocities, the sampled velocity
obstacles of van den Berg et al. 2008 in their simplest form. It needs no tuning per scene, and people give way, stop
and pass as pedestrians do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from calib.types import F64
from planview.synthetic.room import Obstacles, furniture_size
from planview.synthetic.scene import (
    Bend,
    Crouch,
    Furniture,
    Reach,
    Scene,
    ScenePerson,
    Sit,
    Stand,
    StandUntil,
    Walk,
    Wander,
)

TICK_HZ = 60.0
ACTIONS = ("sit", "floor", "reach", "bend", "carry", "push", "low", "crouch")
"""Postures, each with a weight from 0 to 1."""
HIPS_BACK_M = 0.32
SIT_DOWN_S = 0.7
"""Way of the hips back, and time that it takes, when somebody sits down on a chair."""
LOW_SEAT_M = 0.4
"""Benches and boxes lower than this are sat on with raised knees."""
WALK_STEP_S = 0.1
"""Time between two decisions of a wanderer [s]."""
PERSONAL_M = 0.62
"""Distance between body axes that walkers keep: a shoulder width and a hand."""
CLEARANCE_M = 0.35
"""Distance of a body's axis from furniture."""
_FAN_TURNS = np.deg2rad([0, 18, -18, 40, -40, 70, -70, 110, -110, 180])
_FAN_SPEEDS = np.array([1.0, 0.6, 0.25])


@dataclass(frozen=True, eq=False)
class Handling:
    """A thing that goes with a person between two times and then stays where it was put."""

    furniture: str
    how: str
    from_s: float
    until_s: float
    put_z_m: float


@dataclass(frozen=True, eq=False)
class Motion:
    """A person's movement at TICK_HZ; arrays (T,) over time unless noted.

    Attributes:
        first_s, last_s: the person exists from first to last (exclusive; infinite when it stays).
        xy: (T, 2) hips on the floor [m].
        heading: [rad], unwrapped.
        phase: gait phase [rad], 0 when the left leg is foremost.
        speed: [m/s].
        actions: (T, len(ACTIONS)) weights 0..1.
        handlings: things carried and pushed.
        raw_xy, raw_face, raw_actions: the ticks before smoothing, for continuing them.
        script_end_s: when the steps are done.
    """

    first_s: float
    last_s: float
    xy: F64
    heading: F64
    phase: F64
    speed: F64
    actions: F64
    handlings: tuple[Handling, ...]
    raw_xy: F64
    raw_face: F64
    raw_actions: F64
    script_end_s: float = 0.0

    def exists(self, t: float) -> bool:
        return self.first_s <= t < self.last_s

    def places(self, times: F64) -> F64:
        """(N, 2) hips at times (N,) [s]; NaN while the person does not exist."""
        ticks = self.first_s + np.arange(len(self.xy)) / TICK_HZ
        xy = _interpolate(times, ticks, self.xy)
        xy[(times < self.first_s) | (times >= self.last_s)] = np.nan
        return xy

    def at(self, t: float) -> tuple[F64, float, float, float, F64]:
        """Hips (2,), heading, phase, speed and action weights at a time [s]."""
        tick = np.clip((t - self.first_s) * TICK_HZ, 0, len(self.xy) - 1)
        before = min(int(tick), len(self.xy) - 2)
        share = tick - before

        def mix(values: F64) -> F64:
            return np.asarray((1 - share) * values[before] + share * values[before + 1])

        heading = float(mix(self.heading))
        phase = float(mix(self.phase))
        speed = float(mix(self.speed))
        return mix(self.xy), heading, phase, speed, mix(self.actions)


def _interpolate(times: F64, known_times: F64, xy: F64) -> F64:
    """(N, 2) places at times, linear between those that are given."""
    axes = [np.interp(times, known_times, axis) for axis in xy.T]
    return np.column_stack(axes)


class _Script:
    """Ticks collected while reading a person's steps."""

    def __init__(self, person: ScenePerson) -> None:
        self.t0 = person.enter_s
        self.xy: list[F64] = [np.array([person.start_m])]
        self.face: list[F64] = [np.array([np.deg2rad(person.face_deg)])]
        self.actions: list[F64] = [np.zeros((1, len(ACTIONS)))]
        self.handlings: list[Handling] = []

    @property
    def now_s(self) -> float:
        return self.t0 + sum(map(len, self.xy)) / TICK_HZ

    @property
    def place(self) -> F64:
        return np.asarray(self.xy[-1][-1])

    def add(self, xy: F64, face: float, **weights: float) -> None:
        """Ticks at positions; a face of NaN follows the movement."""
        self.xy.append(xy)
        self.face.append(np.full(len(xy), face))
        row = [weights.get(name, 0.0) for name in ACTIONS]
        self.actions.append(np.tile(row, (len(xy), 1)))

    def walk(self, point: ArrayLike, speed_mps: float, face: float = np.nan, **weights: float) -> None:
        """Straight to a point; a face of NaN follows the movement."""
        way = np.asarray(point, np.float64) - self.place
        length_m = float(np.linalg.norm(way))
        n = max(1, round(length_m / speed_mps * TICK_HZ))
        shares = np.linspace(1 / n, 1, n)
        self.add(self.place + way * shares[:, None], face, **weights)

    def stay(self, seconds: float, face: float, **weights: float) -> None:
        n = max(1, round(seconds * TICK_HZ))
        self.add(np.tile(self.place, (n, 1)), face, **weights)


def scripted_motion(person: ScenePerson, furniture: dict[str, Furniture], end_s: float) -> Motion:
    """The motion of a person's steps; afterwards it stands until the end, or is gone."""
    script = _Script(person)
    for step in person.steps:
        face = np.nan
        if step.face_deg is not None:
            face = float(np.deg2rad(step.face_deg))
        match step:
            case Walk():
                _walk(script, step, face)
            case Stand(stand_s=seconds):
                script.stay(seconds, face)
            case StandUntil(until_s=time_s):
                script.stay(max(time_s - script.now_s, 1 / TICK_HZ), face)
            case Reach(reach_s=seconds):
                script.stay(seconds, face, reach=1.0)
            case Bend(bend_s=seconds):
                script.stay(seconds, face, bend=1.0)
            case Crouch(crouch_s=seconds):
                script.stay(seconds, face, crouch=1.0)
            case Sit(sit_s=seconds, on=str(chair)):
                _sit(script, seconds, furniture[chair], face)
            case Sit(sit_s=seconds):
                script.stay(seconds, face, floor=1.0)
    done = script.now_s
    if done < end_s + 1:
        script.stay(end_s + 1 - done, np.nan)
    xy = np.concatenate(script.xy)
    facing = np.concatenate(script.face)
    actions = np.concatenate(script.actions)
    last_s = done if person.leaves else np.inf
    motion = motion_from_ticks(person, xy, facing, actions, tuple(script.handlings), last_s)
    return replace(motion, script_end_s=done)


def motion_from_ticks(
    person: ScenePerson, xy: F64, face: F64, actions: F64, handlings: tuple[Handling, ...] = (), last_s: float = np.inf
) -> Motion:
    """Smooth a raw tick track: corners rounded, starts and stops gradual, heading along the way."""
    even_xy = gaussian_filter1d(xy, 0.22 * TICK_HZ, axis=0, mode="nearest")
    velocity = np.zeros_like(xy)
    if len(xy) > 1:
        velocity = np.gradient(even_xy, axis=0) * TICK_HZ
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    along = np.arctan2(velocity[:, 1], velocity[:, 0])
    # Along the movement while moving, else as the step has it, else unchanged; turned smoothly the short way.
    current = float(np.deg2rad(person.face_deg))
    # Whoever walks backwards or sideways does not turn round while setting out and stopping; a seat is a place, and no
    # way to it: a jump, faster than anybody walks.
    ways_m = np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=1)
    aside = 1.0 * ((ways_m > 0) & (ways_m < 7.0 / TICK_HZ) & np.isfinite(face))
    faces_aside = gaussian_filter1d(aside, 0.22 * TICK_HZ) > 0.02
    desired = np.where((speed > 0.25) & ~faces_aside, along, face)
    headings = np.empty_like(desired)
    for i, value in enumerate(desired):
        if np.isfinite(value):
            current += float(np.angle(np.exp(1j * (value - current))))
        headings[i] = current
    step_m = step_length_m(person.height_m, speed)
    return Motion(
        first_s=person.enter_s,
        last_s=last_s,
        xy=even_xy,
        heading=np.asarray(gaussian_filter1d(headings, 0.18 * TICK_HZ, mode="nearest")),
        phase=np.cumsum(np.pi * speed / step_m / TICK_HZ),
        speed=speed,
        actions=gaussian_filter1d(actions, 0.25 * TICK_HZ, axis=0, mode="nearest"),
        handlings=handlings,
        raw_xy=xy,
        raw_face=face,
        raw_actions=actions,
    )


def step_length_m(height_m: float, speed_mps: F64) -> F64:
    """Length of a step: 0.41 body heights at 1.35 m/s, growing with the root of the speed."""
    relative = np.maximum(speed_mps, 0.15) / 1.35
    return 0.41 * height_m * np.sqrt(relative)


def _walk(script: _Script, step: Walk, face: float) -> None:
    begin = script.now_s
    carries = float(step.carry is not None)
    pushes = float(step.push is not None)
    for point in step.go:
        script.walk(point, step.speed_mps, face, carry=carries, push=pushes)
    if step.push is not None:
        script.handlings.append(Handling(step.push, "push", begin, script.now_s, step.put_z_m))
    if step.carry is not None:
        script.handlings.append(Handling(step.carry, "carry", begin, script.now_s, step.put_z_m))


def _sit(script: _Script, seconds: float, chair: Furniture, face: float) -> None:
    """Step back onto a chair, sit and stand up."""
    front = face
    if np.isnan(front):
        front = float(np.deg2rad(chair.heading_deg))
    seat = np.asarray(chair.at_m, np.float64)
    ahead = np.array([np.cos(front), np.sin(front)])
    before = seat + HIPS_BACK_M * ahead
    script.walk(before, 0.8)
    script.stay(SIT_DOWN_S, front)
    _, _, height_m = furniture_size(chair)
    is_low = chair.kind in ("bench", "box") and height_m < LOW_SEAT_M
    posture = "low" if is_low else "sit"
    sitting_ticks = max(1, round(seconds * TICK_HZ))
    rising_ticks = round(SIT_DOWN_S * TICK_HZ)
    script.add(np.tile(seat, (sitting_ticks, 1)), front, **{posture: 1.0})
    script.add(np.tile(before, (rising_ticks, 1)), front)


@dataclass
class _Walker:
    """A wanderer while simulated; ``track`` holds positions at WALK_STEP_S from ``begin``."""

    person: ScenePerson
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


def wander(scene: Scene, scripted: Sequence[Motion]) -> list[Motion]:
    """The motions of all people, of which wanderers walk on when the steps of ``scripted`` end; the seed of the scene
    decides their walks."""
    walkers = {}
    for i, person in enumerate(scene.people):
        if person.wander is not None:
            begin_s = scripted[i].script_end_s
            place, *_ = scripted[i].at(begin_s)
            rng = np.random.default_rng([scene.seed, i])
            walkers[i] = _Walker(person, person.wander, begin_s, place, rng)
    obstacles = Obstacles(scene.room, scene.furniture)
    for walker in walkers.values():
        _new_goal(walker, obstacles)
    n_steps = int((scene.duration_s + 1) / WALK_STEP_S) + 1
    for k in range(n_steps):
        _advance(k * WALK_STEP_S, walkers, scripted, obstacles)
    motions = list(scripted)
    for i, walker in walkers.items():
        motions[i] = _join_walk(scripted[i], walker)
    return motions


def _advance(t: float, walkers: dict[int, _Walker], scripted: Sequence[Motion], obstacles: Obstacles) -> None:
    places = []
    velocities = []
    owners = []
    for i, motion in enumerate(scripted):
        walker = walkers.get(i)
        if walker is not None and t >= walker.begin:
            if t < walker.gone_s:
                places.append(walker.place)
                velocities.append(walker.velocity)
                owners.append(i)
        elif motion.exists(t):
            here, *_ = motion.at(t)
            there, *_ = motion.at(t + 0.1)
            places.append(here)
            velocities.append((there - here) / 0.1)
            owners.append(i)
    where = np.array(places).reshape(-1, 2)
    moving = np.array(velocities).reshape(-1, 2)
    for i, walker in walkers.items():
        if walker.begin <= t < walker.gone_s:
            walker.track.append(walker.place.copy())
            is_other = np.array(owners) != i
            _step(walker, t, where[is_other], moving[is_other], obstacles)


def _step(walker: _Walker, t: float, others: F64, moving: F64, obstacles: Obstacles) -> None:
    _think(walker, t, obstacles)
    to_goal = walker.goal - walker.place
    distance = float(np.linalg.norm(to_goal))
    speed = 0.0
    if t >= walker.rest_until:
        speed = min(walker.speed, distance / 0.4)
    desired = to_goal / max(distance, 1e-9) * speed
    angle = np.arctan2(to_goal[1], to_goal[0]) + _FAN_TURNS
    directions = np.stack([np.cos(angle), np.sin(angle)], -1)
    speeds = max(speed, 0.4) * _FAN_SPEEDS[:, None, None]
    fan = (speeds * directions).reshape(-1, 2)
    stop = np.zeros(2)
    candidates = np.vstack([desired, stop, fan])
    cost = np.linalg.norm(candidates - desired, axis=1)
    cost += 0.35 * np.linalg.norm(candidates - walker.velocity, axis=1)
    cost += _danger(walker.place, candidates, others, moving)
    for ahead_s in (0.25, 0.6, 1.0):
        gap_m = obstacles.distance(walker.place + ahead_s * candidates)
        lacking_m = np.clip(CLEARANCE_M - gap_m, 0, CLEARANCE_M)
        cost += 6.0 * lacking_m / CLEARANCE_M / (0.5 + ahead_s)
    best = candidates[int(np.argmin(cost))]
    walker.velocity = 0.45 * walker.velocity + 0.55 * best
    walker.place = walker.place + walker.velocity * WALK_STEP_S


def _danger(place: F64, candidates: F64, others: F64, moving: F64) -> F64:
    """(C,) cost of coming within PERSONAL_M of another person within the horizon."""
    if len(others) == 0:
        return np.zeros(len(candidates))
    offset = others - place
    relative = moving[None] - candidates[:, None]
    square = np.maximum((relative**2).sum(-1), 1e-9)
    nearing = -(offset * relative).sum(-1)
    # At most 2.5 s ahead.
    when_s = np.clip(nearing / square, 0, 2.5)
    closest_m = np.linalg.norm(offset + relative * when_s[..., None], axis=-1)
    soon_m = np.linalg.norm(offset + relative * 0.3, axis=-1)
    too_close_m = np.clip(PERSONAL_M + 0.1 - closest_m, 0, None)
    too_soon_m = np.clip(PERSONAL_M - soon_m, 0, None)
    cost = too_close_m / PERSONAL_M * 4.0 / (0.4 + when_s)
    cost += 15.0 * too_soon_m / PERSONAL_M
    return np.asarray(cost.sum(axis=1))


def _think(walker: _Walker, t: float, obstacles: Obstacles) -> None:
    """Choose the next goal: on arrival, when stuck, or when it is time to leave."""
    plan = walker.wander
    exits = plan.exit_m
    distance = float(np.linalg.norm(walker.goal - walker.place))
    is_time = plan.until_s is not None and t >= plan.until_s
    if is_time and exits and walker.leaving < 0:
        walker.leaving = 0
        walker.rest_until = t
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
        walker.stuck_s += WALK_STEP_S
        if distance < walker.best_m - 0.05:
            walker.stuck_s = 0.0
        walker.best_m = min(walker.best_m, distance)
        if walker.stuck_s > 3.0 and walker.leaving < 0:
            _new_goal(walker, obstacles)
        elif walker.stuck_s > 1.5 and walker.leaving >= 0:
            # Around an obstacle in the way to the exit: a random place nearby first, then on.
            if walker.detour:
                _aim(walker, exits[walker.leaving])
            else:
                nearby = walker.place + walker.rng.uniform(-1.5, 1.5, 2)
                _aim(walker, nearby, detour=True)


def _aim(walker: _Walker, goal: ArrayLike, *, detour: bool = False) -> None:
    walker.goal = np.asarray(goal, np.float64)
    walker.detour = detour
    walker.best_m = np.inf
    walker.stuck_s = 0.0


def _new_goal(walker: _Walker, obstacles: Obstacles) -> None:
    x0, y0, x1, y1 = walker.wander.area_m
    far_m = 0.35 * min(x1 - x0, y1 - y0)
    for _ in range(50):
        goal = walker.rng.uniform([x0, y0], [x1, y1])
        distance_m = np.linalg.norm(goal - walker.place)
        gap_m = float(obstacles.distance(goal[None])[0])
        if distance_m > far_m and gap_m > CLEARANCE_M + 0.1:
            break
    walker.speed = float(walker.rng.uniform(*walker.wander.speed_mps))
    _aim(walker, goal)


def _join_walk(scripted: Motion, walker: _Walker) -> Motion:
    """Steps first, then the walk, as one motion."""
    steps_s = walker.begin - scripted.first_s
    n_steps = max(1, round(steps_s * TICK_HZ))
    n_walk = len(walker.track) * int(TICK_HZ * WALK_STEP_S)
    track = np.array(walker.track or [walker.place])
    track_s = np.arange(len(track), dtype=np.float64) * WALK_STEP_S
    walk_s = np.arange(n_walk) / TICK_HZ
    walk = _interpolate(walk_s, track_s, track)
    along_the_way = np.full(n_walk, np.nan)
    upright = np.zeros((n_walk, len(ACTIONS)))
    xy = np.concatenate([scripted.raw_xy[:n_steps], walk])
    face = np.concatenate([scripted.raw_face[:n_steps], along_the_way])
    actions = np.concatenate([scripted.raw_actions[:n_steps], upright])
    return motion_from_ticks(walker.person, xy, face, actions, scripted.handlings, walker.gone_s)
