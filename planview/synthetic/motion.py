"""Where people are and what they do over time: steps of the scene become sampled tracks and poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calib.types import F64
from planview.synthetic.body import HIP, Pose
from planview.synthetic.persons import Person, Step
from planview.synthetic.setting import Furniture

TICK_HZ = 60.0
ACTIONS = ("sit", "floor", "reach", "bend", "carry", "push")
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
    script.add(np.tile(np.asarray(chair.at_m, np.float64), (max(1, round(seconds * TICK_HZ)), 1)), front, sit=1.0)
    script.add(np.tile(ahead, (round(0.7 * TICK_HZ), 1)), front)


def pose_at(person_index: int, height_m: float, motion: Motion, t: float) -> tuple[Pose, float, float, float]:
    """Pose and hips (x, y, heading) at a time.

    Walking legs follow the gait phase with the hip amplitude that makes feet stay on the floor; standing
    people shift their weight and look around; actions blend in by their weights.
    """
    xy, heading, phase, speed, actions = motion.at(t)
    w = dict(zip(ACTIONS, actions, strict=True))
    still = float(np.clip(1.0 - speed / 0.35, 0.0, 1.0))
    going = min(1.0, speed / 0.35) * (1.0 - max(w["sit"], w["floor"]))
    step = float(step_length_m(height_m, np.array([speed]))[0])
    swing = float(np.arcsin(np.clip(step / (2 * HIP * height_m), 0, 0.7))) * going
    idle = _fidget(person_index, t)
    sides = np.array([phase, phase + np.pi])
    forward = np.cos(sides)
    lifting = np.maximum(0.0, -np.sin(sides + 0.6)) ** 1.3
    hip = 0.06 * going + swing * forward
    knee = 0.06 * going + 2.3 * swing * lifting
    foot = swing * (0.7 * np.maximum(0, forward) ** 4 - 1.5 * np.maximum(0, np.cos(sides - np.pi - 0.25)) ** 4)
    shoulder = -0.8 * swing * forward + 0.04
    elbow = np.full(2, 0.2 + 0.25 * going) + 0.25 * going * np.maximum(0, -forward)
    pose = {
        "lean": np.array([0.04 * going + 0.02 * idle[0] * still]),
        "hip": hip, "knee": knee, "foot": foot, "shoulder": shoulder + 0.1 * still * idle[4:6], "elbow": elbow,
        "spread": np.full(2, 0.02), "abduct": np.full(2, 0.12),
    }  # fmt: skip
    for name, target in _ACTION_POSES.items():
        for joint, value in target.items():
            pose[joint] = pose[joint] + w[name] * (np.asarray(value) - pose[joint])
    return (
        Pose(
            lean=float(pose["lean"][0]),
            sway=0.03 * float(idle[1]) * still + 0.02 * going * float(np.sin(phase)),
            twist=0.12 * going * float(np.sin(phase + np.pi / 2)) * swing / 0.4,
            nod=0.08 + 0.06 * float(idle[2]),
            turn=0.5 * float(idle[3]) * still,
            **{name: _pair(pose[name]) for name in ("hip", "spread", "knee", "foot", "shoulder", "abduct", "elbow")},
        ),
        float(xy[0] + 0.015 * still * idle[0]),
        float(xy[1] + 0.015 * still * idle[1]),
        heading + 0.06 * still * float(idle[2]),
    )


_ACTION_POSES: dict[str, dict[str, tuple[float, ...]]] = {
    "sit": {"hip": (1.5, 1.5), "knee": (1.5, 1.5), "lean": (0.08,), "shoulder": (0.35, 0.35), "elbow": (1.0, 1.0),
            "foot": (0.0, 0.0), "spread": (0.12, 0.12)},
    "floor": {"hip": (1.55, 1.55), "knee": (2.2, 2.2), "spread": (0.7, 0.7), "lean": (0.15,),
              "shoulder": (0.5, 0.5), "elbow": (0.8, 0.8), "foot": (-0.2, -0.2)},
    "reach": {"shoulder": (0.2, 2.7), "elbow": (0.2, 0.15), "lean": (-0.05,)},
    "bend": {"lean": (1.15,), "hip": (0.25, 0.25), "knee": (0.5, 0.5), "shoulder": (0.9, 0.9), "elbow": (0.3, 0.3)},
    "carry": {"shoulder": (0.12, 0.12), "elbow": (1.25, 1.25), "abduct": (0.05, 0.05)},
    "push": {"shoulder": (0.75, 0.75), "elbow": (0.55, 0.55), "lean": (0.15,), "abduct": (0.08, 0.08)},
}  # fmt: skip


def _pair(values: F64) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _fidget(index: int, t: float) -> F64:
    """(6,) slow irregular numbers in about -1..1, different for each person."""
    k = np.arange(6)
    a = np.sin(0.61 * t * (1 + 0.13 * k) + 2.1 * k + 5.3 * index)
    b = np.sin(1.37 * t * (1 - 0.07 * k) + 1.7 * k + 3.1 * index)
    return np.asarray(0.6 * a + 0.4 * b)
