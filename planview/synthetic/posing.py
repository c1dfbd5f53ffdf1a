"""Postures of people over time: joint angles from the gait, idle movements and actions."""

from __future__ import annotations

import numpy as np

from calib.types import F64
from planview.synthetic.body import HIP, Pose
from planview.synthetic.motion import ACTIONS, Motion, step_length_m


def pose_at(person_index: int, height_m: float, motion: Motion, t: float) -> tuple[Pose, float, float, float]:
    """Pose and hips (x, y, heading) at a time.

    Walking legs follow the gait phase with the hip amplitude that makes feet stay on the floor; standing
    people shift their weight and look around; actions blend in by their weights.
    """
    xy, heading, phase, speed, actions = motion.at(t)
    w = dict(zip(ACTIONS, actions, strict=True))
    still = float(np.clip(1.0 - speed / 0.35, 0.0, 1.0))
    turned = w["turns"] % 1.0
    wheel = float(np.clip(2.5 * np.sin(np.pi * turned), 0.0, 1.0))
    still *= 1.0 - wheel
    going = min(1.0, speed / 0.35) * (1.0 - max(w["sit"], w["floor"], w["low"], wheel))
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
        weight = wheel if name == "turns" else w[name]
        for joint, value in target.items():
            pose[joint] = pose[joint] + weight * (np.asarray(value) - pose[joint])
    return (
        Pose(
            lean=float(pose["lean"][0]),
            sway=0.03 * float(idle[1]) * still + 0.02 * going * float(np.sin(phase)),
            twist=0.12 * going * float(np.sin(phase + np.pi / 2)) * swing / 0.4,
            nod=0.08 + 0.06 * float(idle[2]),
            turn=0.5 * float(idle[3]) * still,
            wheel=2 * np.pi * turned,
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
    "low": {"hip": (1.97, 1.97), "knee": (1.97, 1.97), "lean": (0.12,), "shoulder": (0.5, 0.5), "elbow": (0.8, 0.8),
            "foot": (0.0, 0.0), "spread": (0.15, 0.15)},
    "crouch": {"hip": (2.15, 2.15), "knee": (2.55, 2.55), "lean": (0.45,), "shoulder": (0.8, 0.8),
               "elbow": (0.7, 0.7), "foot": (-0.35, -0.35), "spread": (0.25, 0.25)},
    "turns": {"shoulder": (0.0, 0.0), "elbow": (0.05, 0.05), "abduct": (2.6, 2.6), "hip": (0.0, 0.0),
              "knee": (0.05, 0.05), "lean": (0.0,)},
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
