"""Articulated people, their postures over time, and the things that move or are carried.

Proportions after Drillis and Contini (in Winter, Biomechanics and Motor Control of Human Movement, table 4.1),
in fractions of the standing height: ankle 0.039, knee 0.285, hip 0.530, shoulder 0.818, chin 0.870.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.types import F64
from planview.synthetic.mesh import Mesh, dome_rings, join, limb_rings, rotation_z, sweep
from planview.synthetic.motion import ACTIONS, Handling, Motion, scripted_motion, step_length_m, wander
from planview.synthetic.room import furniture_mesh
from planview.synthetic.scene import Furniture, Scene, ScenePerson, Surface
from planview.synthetic.texture import Palette

HIP, KNEE, ANKLE, SHOULDER, NECK = 0.530, 0.285, 0.039, 0.812, 0.842
THIGH, SHIN, UPPER_ARM, FOREARM = HIP - KNEE, KNEE - ANKLE, 0.172, 0.150
PUSH_M, PUT_M = 0.72, 0.5
"""How far in front of a person's hips a thing is that is pushed, or put down after it was carried."""


@dataclass(frozen=True)
class Pose:
    """Joint angles [rad]; flexion forward is positive. Pairs are (left, right)."""

    lean: float = 0.0
    """Torso forward about the hips."""
    sway: float = 0.0
    """Torso to the left about the hips."""
    twist: float = 0.0
    """Shoulders against hips about the vertical."""
    nod: float = 0.0
    turn: float = 0.0
    hip: tuple[float, float] = (0.0, 0.0)
    spread: tuple[float, float] = (0.0, 0.0)
    """Thighs outwards."""
    knee: tuple[float, float] = (0.0, 0.0)
    foot: tuple[float, float] = (0.0, 0.0)
    """Pitch of the sole against the floor, toes up positive."""
    shoulder: tuple[float, float] = (0.0, 0.0)
    abduct: tuple[float, float] = (0.12, 0.12)
    elbow: tuple[float, float] = (0.15, 0.15)


@dataclass(frozen=True, eq=False)
class PosedBody:
    """A body in the room.

    Attributes:
        mesh: all parts, room frame; the lowest point touches the floor.
        head: (3,) centre of the head [m].
        top_m: highest point of head and hair above the floor [m].
        hands: (3,) point between the hands [m].
        chest: (3,) unit vector ahead of the chest.
    """

    mesh: Mesh
    head: F64
    top_m: float
    hands: F64
    chest: F64


class Body:
    """A person's rest parts, and ``pose`` that places them."""

    def __init__(self, person: ScenePerson, palette: Palette) -> None:
        self.height_m = person.height_m
        h, b = person.height_m, person.build
        shirt = palette.add(person.shirt)
        trousers = palette.add(person.trousers)
        skin = palette.add(Surface(colour=person.skin, scale_m=0.04, contrast=0.12))
        hair = palette.add(Surface(colour=person.hair, scale_m=0.02, contrast=0.35))
        shoes = palette.add(Surface(colour="#2a2624", scale_m=0.05, contrast=0.2))
        sleeve = shirt if person.sleeves == "long" else skin
        hips = [(-0.075, 0, 0, 0), (-0.06, 0.045, 0.06, 0), (-0.03, 0.063, 0.092, 0), (0.02, 0.063, 0.094, 0)]
        if person.skirt:
            hips = [(-0.26, 0, 0, 0), (-0.26, 0.088, 0.115, 0), (-0.1, 0.075, 0.105, 0), (0.02, 0.06, 0.09, 0)]
        self._parts = {
            "pelvis": sweep(_rings(h, [*hips, (0.03, 0, 0, 0)], b), trousers, 18),
            "torso": _torso(h, b, shirt, skin),
            "head": _head(h, person.hair_style, skin, hair),
            "arm": _limb(h, UPPER_ARM, (0.030, 0.027, 0.024, 0.021), b, shirt),
            "forearm": join([_limb(h, FOREARM, (0.021, 0.022, 0.018, 0.015), b, sleeve), _hand(h, skin)]),
            "thigh": _limb(h, THIGH, (0.050, 0.048, 0.042, 0.035), b, skin if person.skirt else trousers),
            "shin": _limb(h, SHIN, (0.034, 0.035, 0.028, 0.022), b, skin if person.skirt else trousers),
            "foot": _foot(h, shoes),
        }

    def pose(self, pose: Pose, x_m: float, y_m: float, heading_rad: float) -> PosedBody:
        """Place the body with its hips above (x, y) and its lowest point on the floor."""
        h = self.height_m
        placed: list[Mesh] = []
        eye, hips = np.eye(3), np.zeros(3)
        placed.append(self._parts["pelvis"].moved(eye, hips))
        chest = rotation_z(pose.twist) @ _ry(pose.lean) @ _rx(-pose.sway)
        placed.append(self._parts["torso"].moved(chest, hips))
        neck = chest @ np.array([0.0, 0.0, (NECK - HIP) * h])
        skull = chest @ rotation_z(pose.turn) @ _ry(pose.nod - 0.7 * pose.lean)
        head = self._parts["head"].moved(skull, neck)
        placed.append(head)
        hands = [self._arm(placed, pose, side, chest) for side in (0, 1)]
        for side in (0, 1):
            self._leg(placed, pose, side)
        mesh = join(placed)
        lift = -float(mesh.vertices[:, 2].min())
        turn, shift = rotation_z(heading_rad), np.array([x_m, y_m, lift])
        centre = skull @ np.array([0.0, 0.0, (0.935 - NECK) * h]) + neck
        return PosedBody(
            mesh.moved(turn, shift),
            turn @ centre + shift,
            float(head.vertices[:, 2].max()) + lift,
            turn @ np.mean(hands, axis=0) + shift,
            turn @ chest[:, 0],
        )

    def _arm(self, placed: list[Mesh], pose: Pose, side: int, chest: F64) -> F64:
        h, sign = self.height_m, 1.0 if side == 0 else -1.0
        joint = chest @ np.array([0.0, sign * 0.105 * h, (SHOULDER - HIP) * h])
        upper = chest @ _rx(sign * pose.abduct[side]) @ _ry(-pose.shoulder[side])
        placed.append(self._parts["arm"].moved(upper, joint))
        elbow = joint + upper @ np.array([0.0, 0.0, -UPPER_ARM * h])
        lower = upper @ _ry(-pose.elbow[side])
        placed.append(self._parts["forearm"].moved(lower, elbow))
        return np.asarray(elbow + lower @ np.array([0.0, 0.0, -(FOREARM + 0.04) * h]))

    def _leg(self, placed: list[Mesh], pose: Pose, side: int) -> None:
        h, sign = self.height_m, 1.0 if side == 0 else -1.0
        joint = np.array([0.0, sign * 0.05 * h, 0.0])
        upper = rotation_z(sign * pose.spread[side]) @ _rx(sign * 0.3 * pose.spread[side]) @ _ry(-pose.hip[side])
        placed.append(self._parts["thigh"].moved(upper, joint))
        knee = joint + upper @ np.array([0.0, 0.0, -THIGH * h])
        lower = upper @ _ry(pose.knee[side])
        placed.append(self._parts["shin"].moved(lower, knee))
        ankle = knee + lower @ np.array([0.0, 0.0, -SHIN * h])
        foot = rotation_z(sign * (pose.spread[side] + 0.1)) @ _ry(-pose.foot[side])
        placed.append(self._parts["foot"].moved(foot, ankle))


def _rx(a: float) -> F64:
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]], np.float64)


def _ry(a: float) -> F64:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float64)


def _rings(h: float, rows: list[tuple[float, float, float, float]], b: float) -> F64:
    """Rows z, half depth, half width, centre x in fractions of the height."""
    r = np.array(rows) * h
    return np.column_stack([r[:, 0], r[:, 1] * b, r[:, 2] * b, r[:, 3], np.zeros(len(r))])


def _torso(h: float, b: float, shirt: int, skin: int) -> Mesh:
    rows = [
        (-0.030, 0.0, 0.0, 0.0), (-0.030, 0.066, 0.098, 0.0), (0.03, 0.064, 0.094, 0.0), (0.08, 0.062, 0.088, 0.002),
        (0.14, 0.067, 0.097, 0.004), (0.20, 0.072, 0.108, 0.004), (0.245, 0.066, 0.117, 0.0),
        (0.275, 0.056, 0.115, -0.004), (0.295, 0.045, 0.095, -0.006), (0.312, 0.035, 0.055, -0.006),
        (0.318, 0.0, 0.0, -0.006),
    ]  # fmt: skip
    neck = sweep(
        _rings(h, [(0.30, 0.034, 0.034, -0.006), (0.345, 0.032, 0.031, 0.0), (0.36, 0.0, 0.0, 0.0)], 1.0), skin
    )
    return join([sweep(_rings(h, rows, b), shirt, 18), neck])


def _head(h: float, style: str, skin: int, hair: int) -> Mesh:
    """Head with hair; the origin is the top of the neck and the highest point (1 - NECK) h above it."""
    top = (1.0 - NECK) * h
    bare, low = style == "bald", top - 0.132 * h
    skull_top = top if bare else top - 0.004 * h
    parts = [sweep(dome_rings(low, skull_top, (0.056 * h, 0.044 * h), (0.004 * h, 0.0)), skin, 16)]
    nose = dome_rings(low + 0.045 * h, low + 0.065 * h, (0.010 * h, 0.008 * h), (0.060 * h, 0.0), 5)
    parts.append(sweep(nose, skin, 8))
    if not bare:
        parts.append(sweep(dome_rings(top - 0.105 * h, top, (0.053 * h, 0.048 * h), (-0.006 * h, 0.0)), hair, 16))
    if style == "long":
        parts.append(sweep(dome_rings(top - 0.20 * h, top - 0.02 * h, (0.028 * h, 0.05 * h), (-0.035 * h, 0)), hair))
    return join(parts)


def _limb(h: float, length: float, radii: tuple[float, ...], build: float, material: int) -> Mesh:
    width = build**0.7
    return sweep(limb_rings(length * h, [r * h * width for r in radii]), material, 12)


def _hand(h: float, skin: int) -> Mesh:
    rings = dome_rings(-(FOREARM + 0.085) * h, -(FOREARM - 0.01) * h, (0.024 * h, 0.013 * h), n=6)
    return sweep(rings, skin, 8)


def _foot(h: float, shoes: int) -> Mesh:
    """A shoe along +x whose sole is ANKLE h below the ankle."""
    profile = [
        (-0.045, 0.0, 0.0), (-0.043, 0.017, 0.018), (-0.02, 0.030, 0.025), (0.02, 0.030, 0.026),
        (0.06, 0.020, 0.030), (0.095, 0.014, 0.027), (0.108, 0.008, 0.015), (0.110, 0.0, 0.0),
    ]  # fmt: skip
    along, half_height, half_width = (np.array(profile) * h).T
    rings = np.column_stack([along, half_height, half_width, half_height - ANKLE * h, 0 * along])
    # Swept along z, then laid down along x: z -> x, x -> z, which turns the triangles inside out.
    flat = sweep(rings, shoes, 10).moved(np.eye(3)[::-1], np.zeros(3))
    return replace(flat, triangles=flat.triangles[:, ::-1].copy())


def pose_at(person_index: int, height_m: float, motion: Motion, t: float) -> tuple[Pose, float, float, float]:
    """Pose and hips (x, y, heading) at a time.

    Walking legs follow the gait phase with the hip amplitude that makes feet stay on the floor; standing
    people shift their weight and look around; actions blend in by their weights.
    """
    xy, heading, phase, speed, actions = motion.at(t)
    w = dict(zip(ACTIONS, actions, strict=True))
    still = float(np.clip(1.0 - speed / 0.35, 0.0, 1.0))
    going = min(1.0, speed / 0.35) * (1.0 - max(w["sit"], w["floor"], w["low"]))
    step = float(step_length_m(height_m, np.array([speed]))[0])
    swing = float(np.arcsin(np.clip(step / (2 * HIP * height_m), 0, 0.7))) * going
    # (6,) slow irregular numbers in about -1..1, different for each person.
    k = np.arange(6)
    a = np.sin(0.61 * t * (1 + 0.13 * k) + 2.1 * k + 5.3 * person_index)
    b = np.sin(1.37 * t * (1 - 0.07 * k) + 1.7 * k + 3.1 * person_index)
    idle = np.asarray(0.6 * a + 0.4 * b)
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
    for name, target in POSTURES.items():
        for joint, value in target.items():
            pose[joint] = pose[joint] + w[name] * (np.asarray(value) - pose[joint])
    joints = {name: (float(both[0]), float(both[1])) for name, both in pose.items() if name != "lean"}
    posed = Pose(
        lean=float(pose["lean"][0]),
        sway=0.03 * float(idle[1]) * still + 0.02 * going * float(np.sin(phase)),
        twist=0.12 * going * float(np.sin(phase + np.pi / 2)) * swing / 0.4,
        nod=0.08 + 0.06 * float(idle[2]),
        turn=0.5 * float(idle[3]) * still,
        **joints,
    )
    x_m, y_m = (float(v) for v in xy + 0.015 * still * idle[:2])
    return posed, x_m, y_m, heading + 0.06 * still * float(idle[2])


POSTURES: dict[str, dict[str, tuple[float, ...]]] = {
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
    "push": {"shoulder": (0.75, 0.75), "elbow": (0.55, 0.55), "lean": (0.15,), "abduct": (0.08, 0.08)},
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Actor:
    """A moving surface in one frame; ``person`` is 0 for things, else the id, with its posed body."""

    mesh: Mesh
    person: int = 0
    body: PosedBody | None = None


class Cast:
    """All actors of a scene over time."""

    def __init__(self, scene: Scene, palette: Palette) -> None:
        furniture = {f.name: f for f in scene.furniture if f.name}
        scripted = [scripted_motion(p, furniture, scene.duration_s) for p in scene.people]
        self.motions = wander(scene, scripted)
        self._bodies = [Body(p, palette) for p in scene.people]
        handled = {h.furniture for m in self.motions for h in m.handlings}
        self.is_moving = [bool(f.moves or f.name in handled) for f in scene.furniture]
        self._things = [
            (f, furniture_mesh(f, palette)) for f, moving in zip(scene.furniture, self.is_moving, strict=True) if moving
        ]

    def at(self, t: float) -> list[Actor]:
        """Actors that exist at a time [s], people first."""
        actors, bodies = [], {}
        for i, (motion, body) in enumerate(zip(self.motions, self._bodies, strict=True)):
            if motion.exists(t):
                bodies[i] = body.pose(*pose_at(i, body.height_m, motion, t))
                actors.append(Actor(bodies[i].mesh, i + 1, bodies[i]))
        for item, mesh in self._things:
            place, heading, z = self._place(item, t, bodies)
            actors.append(Actor(place_mesh(mesh, place, heading, z)))
        return actors

    def _place(self, item: Furniture, t: float, bodies: dict[int, PosedBody]) -> tuple[F64, float, float]:
        place, heading, z = furniture_at(item, t)
        past: list[tuple[Handling, int]] = sorted(
            ((h, i) for i, m in enumerate(self.motions) for h in m.handlings if h.furniture == item.name and item.name),
            key=lambda pair: pair[0].from_s,
        )
        for handling, i in past:
            if t < handling.from_s:
                break
            xy, facing, _, _, _ = self.motions[i].at(min(t, handling.until_s))
            ahead = np.array([np.cos(facing), np.sin(facing)])
            if handling.how == "push":
                place, heading = xy + PUSH_M * ahead, facing
            elif t < handling.until_s and i in bodies:
                hands = bodies[i].hands
                place, heading, z = hands[:2] - 0.03 * ahead, facing, float(hands[2]) - 0.12
            else:
                place, heading, z = xy + PUT_M * ahead, facing, handling.put_z_m
        return place, heading, z


def furniture_at(item: Furniture, t: float) -> tuple[F64, float, float]:
    """Place (2,), heading [rad] and base height of furniture that is not handled."""
    place, heading = np.asarray(item.at_m, np.float64), float(np.deg2rad(item.heading_deg))
    if item.moves:
        times = np.array([m.t_s for m in item.moves])
        xy = np.array([m.at_m for m in item.moves])
        angles = np.deg2rad([item.heading_deg if m.heading_deg is None else m.heading_deg for m in item.moves])
        place = np.array([np.interp(t, times, xy[:, 0]), np.interp(t, times, xy[:, 1])])
        heading = float(np.interp(t, times, angles))
    return place, heading, item.z_m


def place_mesh(mesh: Mesh, place: F64, heading: float, z: float) -> Mesh:
    """A mesh around its own origin, put into the room."""
    return mesh.moved(rotation_z(heading), (place[0], place[1], z))
