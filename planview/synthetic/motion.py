"""Where people are and what they do over time: steps of the scene become sampled tracks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calib.types import F64
from planview.synthetic.furniture import furniture_size
from planview.synthetic.persons import Person, Step
from planview.synthetic.setting import Furniture

TICK_HZ = 60.0
ACTIONS = ("sit", "floor", "reach", "bend", "carry", "push", "low", "crouch", "turns")
"""Weights of postures from 0 to 1; ``turns`` is the number of cartwheels turned so far."""
TURNS = ACTIONS.index("turns")
LOW_SEAT_M = 0.4
"""Benches and boxes lower than this are sat on with raised knees."""
CARTWHEEL_MPS = 1.3
"""Speed of the hips during a cartwheel (our choice: 2 m, about an arm span and a stride, in 1.5 s)."""
SEAT_BACK_M = 0.32
"""How far the hips move back when sitting down on a chair."""


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
    """A person's movement at TICK_HZ; arrays (T,) over time unless said.

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
        xy = np.column_stack([np.interp(times, ticks, self.xy[:, c]) for c in (0, 1)])
        xy[(times < self.first_s) | (times >= self.last_s)] = np.nan
        return xy

    def at(self, t: float) -> tuple[F64, float, float, float, F64]:
        """Hips (2,), heading, phase, speed and action weights at a time [s]."""
        u = np.clip((t - self.first_s) * TICK_HZ, 0, len(self.xy) - 1)
        i = min(int(u), len(self.xy) - 2)
        w = u - i

        def mix(a: F64) -> F64:
            return np.asarray((1 - w) * a[i] + w * a[i + 1])

        return mix(self.xy), float(mix(self.heading)), float(mix(self.phase)), float(mix(self.speed)), mix(self.actions)


class _Script:
    """Ticks collected while reading a person's steps."""

    def __init__(self, person: Person) -> None:
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
        weights.setdefault("turns", float(self.actions[-1][-1, TURNS]))
        self.xy.append(xy)
        self.face.append(np.full(len(xy), face))
        row = [weights.get(name, 0.0) for name in ACTIONS]
        self.actions.append(np.tile(row, (len(xy), 1)))

    def stay(self, seconds: float, face: float, **weights: float) -> None:
        n = max(1, round(seconds * TICK_HZ))
        self.add(np.tile(self.place, (n, 1)), face, **weights)


def scripted_motion(person: Person, furniture: dict[str, Furniture], end_s: float) -> Motion:
    """The motion of a person's steps; afterwards it stands until the end, or is gone."""
    script = _Script(person)
    for step in person.steps:
        _play(script, step, furniture)
    done = script.now_s
    if done < end_s + 1:
        script.stay(end_s + 1 - done, np.nan)
    motion = motion_from_ticks(
        person,
        np.concatenate(script.xy),
        np.concatenate(script.face),
        np.concatenate(script.actions),
        tuple(script.handlings),
        done if person.leaves else np.inf,
    )
    return replace(motion, script_end_s=done)


def motion_from_ticks(
    person: Person, xy: F64, face: F64, actions: F64, handlings: tuple[Handling, ...] = (), last_s: float = np.inf
) -> Motion:
    """Smooth a raw tick track: corners rounded, starts and stops gradual, heading along the way."""
    raw_xy = xy
    xy = gaussian_filter1d(raw_xy, 0.22 * TICK_HZ, axis=0, mode="nearest")
    velocity = np.gradient(xy, axis=0) * TICK_HZ if len(xy) > 1 else np.zeros_like(xy)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    along = np.arctan2(velocity[:, 1], velocity[:, 0])
    heading = _headings(face, along, speed, float(np.deg2rad(person.face_deg)))
    step_m = step_length_m(person.height_m, speed)
    phase = np.cumsum(np.pi * speed / step_m / TICK_HZ)
    weights = gaussian_filter1d(actions, 0.25 * TICK_HZ, axis=0, mode="nearest")
    return Motion(person.enter_s, last_s, xy, heading, phase, speed, weights, handlings, raw_xy, face, actions)


def step_length_m(height_m: float, speed_mps: F64) -> F64:
    """Length of a step: 0.41 body heights at 1.35 m/s, growing with the root of the speed."""
    return np.asarray(0.41 * height_m * np.sqrt(np.maximum(speed_mps, 0.15) / 1.35))


def _headings(face: F64, along: F64, speed: F64, first: float) -> F64:
    """Along the movement while moving, else as told, else unchanged; turned smoothly the short way."""
    wanted = np.where(speed > 0.25, along, face)
    held = np.empty_like(wanted)
    current = first
    for i, value in enumerate(wanted):
        if np.isfinite(value):
            current += float(np.angle(np.exp(1j * (value - current))))
        held[i] = current
    return np.asarray(gaussian_filter1d(held, 0.18 * TICK_HZ, mode="nearest"))


def _play(script: _Script, step: Step, furniture: dict[str, Furniture]) -> None:
    face = np.nan if step.face_deg is None else float(np.deg2rad(step.face_deg))
    if step.go is not None:
        _walk(script, step)
    elif step.until_s is not None:
        script.stay(max(step.until_s - script.now_s, 1 / TICK_HZ), face)
    elif step.stand_s is not None:
        script.stay(step.stand_s, face)
    elif step.reach_s is not None:
        script.stay(step.reach_s, face, reach=1.0)
    elif step.bend_s is not None:
        script.stay(step.bend_s, face, bend=1.0)
    elif step.crouch_s is not None:
        script.stay(step.crouch_s, face, crouch=1.0)
    elif step.cartwheel is not None:
        _turn_cartwheel(script, step.cartwheel)
    elif step.sit_s is not None:
        _sit(script, step, furniture, face)


def _walk(script: _Script, step: Step) -> None:
    begin = script.now_s
    for point in step.go or []:
        target = np.asarray(point, np.float64)
        n = max(1, round(float(np.linalg.norm(target - script.place)) / step.speed_mps * TICK_HZ))
        track = script.place + (target - script.place) * np.linspace(1 / n, 1, n)[:, None]
        script.add(track, np.nan, carry=float(step.carry is not None), push=float(step.push is not None))
    for name, how in ((step.push, "push"), (step.carry, "carry")):
        if name is not None:
            script.handlings.append(Handling(name, how, begin, script.now_s, step.put_z_m))


def _turn_cartwheel(script: _Script, point: tuple[float, float]) -> None:
    """One turn about the forward axis while the hips travel to the left, to a point."""
    start, way = script.place, np.asarray(point, np.float64) - script.place
    face = float(np.arctan2(way[1], way[0])) - np.pi / 2
    script.stay(0.8, face)
    n = max(2, round(float(np.linalg.norm(way)) / CARTWHEEL_MPS * TICK_HZ))
    turned = float(script.actions[-1][-1, TURNS])
    for k in range(1, n + 1):
        script.add((start + way * k / n)[None], face, turns=turned + k / n)
    script.stay(0.8, face)


def _sit(script: _Script, step: Step, furniture: dict[str, Furniture], face: float) -> None:
    seconds = step.sit_s or 0.0
    if step.on is None:
        script.stay(seconds, face, floor=1.0)
        return
    chair = furniture[step.on]
    front = float(np.deg2rad(chair.heading_deg)) if not np.isfinite(face) else face
    ahead = np.asarray(chair.at_m) + SEAT_BACK_M * np.array([np.cos(front), np.sin(front)])
    n = max(1, round(float(np.linalg.norm(ahead - script.place)) / 0.8 * TICK_HZ))
    before = script.place
    script.add(before + (ahead - before) * np.linspace(1 / n, 1, n)[:, None], np.nan)
    script.stay(0.7, front)
    low = chair.kind in ("bench", "box") and furniture_size(chair)[2] < LOW_SEAT_M
    seat = np.tile(np.asarray(chair.at_m, np.float64), (max(1, round(seconds * TICK_HZ)), 1))
    script.add(seat, front, sit=float(not low), low=float(low))
    script.add(np.tile(ahead, (round(0.7 * TICK_HZ), 1)), front)
