"""Articulated people, their postures over time, and the things that move or are carried.

Proportions after Drillis and Contini (in Winter, Biomechanics and Motor Control of Human Movement, table 4.1),
in fractions of the standing height: ankle 0.039, knee 0.285, hip 0.530, shoulder 0.818, chin 0.870.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.types import F64
from planview.synthetic.mesh import Mesh, dome_rings, join, limb_rings, rotation_x, rotation_y, rotation_z, sweep
from planview.synthetic.motion import ACTIONS, Handling, Motion, scripted_motion, step_length_m, wander
from planview.synthetic.room import furniture_mesh
from planview.synthetic.scene import Furniture, Scene, ScenePerson, Surface
from planview.synthetic.texture import Palette

HIP = 0.530
KNEE = 0.285
ANKLE = 0.039
SHOULDER = 0.812
NECK = 0.842
"""Heights of joints, in fractions of the standing height."""
THIGH = HIP - KNEE
SHIN = KNEE - ANKLE
UPPER_ARM = 0.172
FOREARM = 0.150
"""Lengths of limbs, in the same."""
PUSH_M = 0.72
PUT_M = 0.5
"""Distance in front of a person's hips of a thing that is pushed, or put down after it was carried."""


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
        height = person.height_m
        build = person.build
        shirt = palette.add(person.shirt)
        trousers = palette.add(person.trousers)
        skin = palette.add(Surface(colour=person.skin, scale_m=0.04, contrast=0.12))
        hair = palette.add(Surface(colour=person.hair, scale_m=0.02, contrast=0.35))
        shoes = palette.add(Surface(colour="#2a2624", scale_m=0.05, contrast=0.2))
        sleeve = shirt if person.sleeves == "long" else skin
        hips = SKIRT if person.skirt else HIPS
        legs = skin if person.skirt else trousers
        forearm = _limb(height, FOREARM, (0.021, 0.022, 0.018, 0.015), build, sleeve)
        self._parts = {
            "pelvis": sweep(_rings(height, hips, build), trousers, 18),
            "torso": _torso(height, build, shirt, skin),
            "head": _head(height, person.hair_style, skin, hair),
            "arm": _limb(height, UPPER_ARM, (0.030, 0.027, 0.024, 0.021), build, shirt),
            "forearm": join([forearm, _hand(height, skin)]),
            "thigh": _limb(height, THIGH, (0.050, 0.048, 0.042, 0.035), build, legs),
            "shin": _limb(height, SHIN, (0.034, 0.035, 0.028, 0.022), build, legs),
            "foot": _foot(height, shoes),
        }

    def pose(self, pose: Pose, x_m: float, y_m: float, heading_rad: float) -> PosedBody:
        """Place the body with its hips above (x, y) and its lowest point on the floor."""
        hips = np.zeros(3)
        chest = rotation_z(pose.twist) @ rotation_y(pose.lean) @ rotation_x(-pose.sway)
        neck = chest @ self._up(NECK - HIP)
        skull = chest @ rotation_z(pose.turn) @ rotation_y(pose.nod - 0.7 * pose.lean)
        head = self._parts["head"].at(skull, neck)
        pelvis = self._parts["pelvis"].at(np.eye(3), hips)
        torso = self._parts["torso"].at(chest, hips)
        parts = [pelvis, torso, head]
        hands = []
        for side in (0, 1):
            arm, hand = self._arm(pose, side, chest)
            parts += arm
            hands.append(hand)
        for side in (0, 1):
            parts += self._leg(pose, side)
        mesh = join(parts)
        lift = -float(mesh.vertices[:, 2].min())
        turn = rotation_z(heading_rad)
        shift = np.array([x_m, y_m, lift])
        centre = skull @ self._up(0.935 - NECK) + neck
        return PosedBody(
            mesh=mesh.at(turn, shift),
            head=turn @ centre + shift,
            top_m=float(head.vertices[:, 2].max()) + lift,
            hands=turn @ np.mean(hands, axis=0) + shift,
            chest=turn @ chest[:, 0],
        )

    def _up(self, share: float) -> F64:
        """(3,) vector upwards by a fraction of the height."""
        return np.array([0.0, 0.0, share * self.height_m])

    def _arm(self, pose: Pose, side: int, chest: F64) -> tuple[list[Mesh], F64]:
        """The parts of an arm, and its hand (3,)."""
        sign = SIGNS[side]
        out = np.array([0.0, sign * 0.105 * self.height_m, 0.0])
        shoulder = chest @ (out + self._up(SHOULDER - HIP))
        upper = chest @ rotation_x(sign * pose.abduct[side]) @ rotation_y(-pose.shoulder[side])
        elbow = shoulder + upper @ self._up(-UPPER_ARM)
        lower = upper @ rotation_y(-pose.elbow[side])
        hand = elbow + lower @ self._up(-(FOREARM + 0.04))
        parts = [self._parts["arm"].at(upper, shoulder), self._parts["forearm"].at(lower, elbow)]
        return parts, hand

    def _leg(self, pose: Pose, side: int) -> list[Mesh]:
        """The parts of a leg."""
        sign = SIGNS[side]
        spread = pose.spread[side]
        hip = np.array([0.0, sign * 0.05 * self.height_m, 0.0])
        upper = rotation_z(sign * spread) @ rotation_x(sign * 0.3 * spread) @ rotation_y(-pose.hip[side])
        knee = hip + upper @ self._up(-THIGH)
        lower = upper @ rotation_y(pose.knee[side])
        ankle = knee + lower @ self._up(-SHIN)
        foot = rotation_z(sign * (spread + 0.1)) @ rotation_y(-pose.foot[side])
        return [
            self._parts["thigh"].at(upper, hip),
            self._parts["shin"].at(lower, knee),
            self._parts["foot"].at(foot, ankle),
        ]


SIGNS = (1.0, -1.0)
"""Signs of y on the left and on the right."""
Rings = tuple[tuple[float, float, float, float], ...]
"""Rows z, half depth, half width, centre x in fractions of the height."""
HIPS: Rings = (
    (-0.075, 0, 0, 0), (-0.06, 0.045, 0.06, 0), (-0.03, 0.063, 0.092, 0), (0.02, 0.063, 0.094, 0), (0.03, 0, 0, 0),
)  # fmt: skip
SKIRT: Rings = (
    (-0.26, 0, 0, 0), (-0.26, 0.088, 0.115, 0), (-0.1, 0.075, 0.105, 0), (0.02, 0.06, 0.09, 0), (0.03, 0, 0, 0),
)  # fmt: skip
TORSO: Rings = (
    (-0.030, 0.0, 0.0, 0.0), (-0.030, 0.066, 0.098, 0.0), (0.03, 0.064, 0.094, 0.0), (0.08, 0.062, 0.088, 0.002),
    (0.14, 0.067, 0.097, 0.004), (0.20, 0.072, 0.108, 0.004), (0.245, 0.066, 0.117, 0.0),
    (0.275, 0.056, 0.115, -0.004), (0.295, 0.045, 0.095, -0.006), (0.312, 0.035, 0.055, -0.006),
    (0.318, 0.0, 0.0, -0.006),
)  # fmt: skip
NECK_RINGS: Rings = ((0.30, 0.034, 0.034, -0.006), (0.345, 0.032, 0.031, 0.0), (0.36, 0.0, 0.0, 0.0))
SHOE = (
    (-0.045, 0.0, 0.0), (-0.043, 0.017, 0.018), (-0.02, 0.030, 0.025), (0.02, 0.030, 0.026),
    (0.06, 0.020, 0.030), (0.095, 0.014, 0.027), (0.108, 0.008, 0.015), (0.110, 0.0, 0.0),
)  # fmt: skip
"""Rows along, half height and half width in fractions of the body's height."""


def _rings(height: float, rows: Rings, build: float) -> F64:
    """Rings for ``sweep``, wider by the build."""
    z, depth, width, centre = np.array(rows).T * height
    return np.column_stack([z, depth * build, width * build, centre, np.zeros(len(rows))])


def _torso(height: float, build: float, shirt: int, skin: int) -> Mesh:
    chest = sweep(_rings(height, TORSO, build), shirt, 18)
    neck = sweep(_rings(height, NECK_RINGS, 1.0), skin)
    return join([chest, neck])


def _head(height: float, style: str, skin: int, hair: int) -> Mesh:
    """Head with hair; the origin is the top of the neck and the highest point (1 - NECK) h above it."""
    top = (1.0 - NECK) * height
    low = top - 0.132 * height

    def dome(bottom: float, end: float, depth: float, width: float, ahead: float, n: int = 9) -> F64:
        """Rings of an ellipsoid, its half sizes and its centre in fractions of the height."""
        half = (depth * height, width * height)
        return dome_rings(bottom, end, half, (ahead * height, 0.0), n)

    skull_top = top
    parts = []
    if style != "bald":
        skull_top -= 0.004 * height
        crown = dome(top - 0.105 * height, top, 0.053, 0.048, -0.006)
        parts.append(sweep(crown, hair, 16))
    if style == "long":
        back = dome(top - 0.20 * height, top - 0.02 * height, 0.028, 0.05, -0.035)
        parts.append(sweep(back, hair))
    skull = dome(low, skull_top, 0.056, 0.044, 0.004)
    nose = dome(low + 0.045 * height, low + 0.065 * height, 0.010, 0.008, 0.060, n=5)
    return join([sweep(skull, skin, 16), sweep(nose, skin, 8), *parts])


def _limb(height: float, length: float, radii: tuple[float, ...], build: float, material: int) -> Mesh:
    width = build**0.7
    radii_m = [radius * height * width for radius in radii]
    return sweep(limb_rings(length * height, radii_m), material, 12)


def _hand(height: float, skin: int) -> Mesh:
    low = -(FOREARM + 0.085) * height
    high = -(FOREARM - 0.01) * height
    half = (0.024 * height, 0.013 * height)
    return sweep(dome_rings(low, high, half, n=6), skin, 8)


def _foot(height: float, shoes: int) -> Mesh:
    """A shoe along +x whose sole is ANKLE h below the ankle."""
    along, half_height, half_width = (np.array(SHOE) * height).T
    rings = np.column_stack([along, half_height, half_width, half_height - ANKLE * height, 0 * along])
    # Swept along z, then laid down along x: z -> x, x -> z, which turns the triangles inside out.
    flat = sweep(rings, shoes, 10).at(np.eye(3)[::-1], np.zeros(3))
    return replace(flat, triangles=flat.triangles[:, ::-1].copy())


def pose_at(person_index: int, height_m: float, motion: Motion, t: float) -> tuple[Pose, float, float, float]:
    """Pose and hips (x, y, heading) at a time.

    Walking legs follow the gait phase with the hip amplitude that makes feet stay on the floor; standing
    people shift their weight and look around; actions blend in by their weights.
    """
    xy, heading, phase, speed, actions = motion.at(t)
    weights = dict(zip(ACTIONS, actions, strict=True))
    still = float(np.clip(1.0 - speed / 0.35, 0.0, 1.0))
    going = min(1.0, speed / 0.35) * (1.0 - max(weights["sit"], weights["floor"], weights["low"]))
    idle = _idle(person_index, t)
    step_m = float(step_length_m(height_m, np.array([speed]))[0])
    half_angle = float(np.arcsin(np.clip(step_m / (2 * HIP * height_m), 0, 0.7)))
    swing = half_angle * going
    sides = np.array([phase, phase + np.pi])
    forward = np.cos(sides)
    lifting = np.maximum(0.0, -np.sin(sides + 0.6)) ** 1.3
    heel = np.maximum(0, forward) ** 4
    toe = np.maximum(0, np.cos(sides - np.pi - 0.25)) ** 4
    pose = {
        "lean": np.array([0.04 * going + 0.02 * idle[0] * still]),
        "hip": 0.06 * going + swing * forward,
        "knee": 0.06 * going + 2.3 * swing * lifting,
        "foot": swing * (0.7 * heel - 1.5 * toe),
        "shoulder": -0.8 * swing * forward + 0.04 + 0.1 * still * idle[4:6],
        "elbow": np.full(2, 0.2 + 0.25 * going) + 0.25 * going * np.maximum(0, -forward),
        "spread": np.full(2, 0.02),
        "abduct": np.full(2, 0.12),
    }
    for name, target in POSTURES.items():
        for joint, value in target.items():
            pose[joint] = pose[joint] + weights[name] * (np.asarray(value) - pose[joint])
    (lean,) = pose.pop("lean").tolist()
    joints = {name: (float(left), float(right)) for name, (left, right) in pose.items()}
    posed = Pose(
        lean=lean,
        sway=0.03 * float(idle[1]) * still + 0.02 * going * float(np.sin(phase)),
        twist=0.12 * going * float(np.sin(phase + np.pi / 2)) * swing / 0.4,
        nod=0.08 + 0.06 * float(idle[2]),
        turn=0.5 * float(idle[3]) * still,
        **joints,
    )
    x_m, y_m = (xy + 0.015 * still * idle[:2]).tolist()
    heading += 0.06 * still * float(idle[2])
    return posed, x_m, y_m, heading


def _idle(person_index: int, t: float) -> F64:
    """(6,) slow irregular numbers in about -1..1, different for each person."""
    k = np.arange(6)
    slow_rad = 0.61 * t * (1 + 0.13 * k) + 2.1 * k + 5.3 * person_index
    fast_rad = 1.37 * t * (1 - 0.07 * k) + 1.7 * k + 3.1 * person_index
    return 0.6 * np.sin(slow_rad) + 0.4 * np.sin(fast_rad)


POSTURES: dict[str, dict[str, float | tuple[float, float]]] = {
    "sit": {"hip": 1.5, "knee": 1.5, "lean": 0.08, "shoulder": 0.35, "elbow": 1.0, "foot": 0.0, "spread": 0.12},
    "floor": {
        "hip": 1.55, "knee": 2.2, "spread": 0.7, "lean": 0.15, "shoulder": 0.5, "elbow": 0.8, "foot": -0.2,
    },
    "reach": {"shoulder": (0.2, 2.7), "elbow": (0.2, 0.15), "lean": -0.05},
    "bend": {"lean": 1.15, "hip": 0.25, "knee": 0.5, "shoulder": 0.9, "elbow": 0.3},
    "carry": {"shoulder": 0.12, "elbow": 1.25, "abduct": 0.05},
    "low": {"hip": 1.97, "knee": 1.97, "lean": 0.12, "shoulder": 0.5, "elbow": 0.8, "foot": 0.0, "spread": 0.15},
    "crouch": {
        "hip": 2.15, "knee": 2.55, "lean": 0.45, "shoulder": 0.8, "elbow": 0.7, "foot": -0.35, "spread": 0.25,
    },
    "push": {"shoulder": 0.75, "elbow": 0.55, "lean": 0.15, "abduct": 0.08},
}  # fmt: skip
"""Joint angles of each posture [rad], one for both sides where they are alike."""


@dataclass(frozen=True, eq=False)
class Actor:
    """A moving surface in one frame; ``person`` is 0 for things, else the id, with its posed body."""

    mesh: Mesh
    person: int = 0
    body: PosedBody | None = None


class Cast:
    """All actors of a scene over time."""

    def __init__(self, scene: Scene, palette: Palette) -> None:
        furniture = {item.name: item for item in scene.furniture if item.name}
        scripted = [scripted_motion(person, furniture, scene.duration_s) for person in scene.people]
        self.motions = wander(scene, scripted)
        self._bodies = [Body(person, palette) for person in scene.people]
        self._handlings: dict[str, list[tuple[Handling, int]]] = {}
        for i, motion in enumerate(self.motions):
            for handling in motion.handlings:
                self._handlings.setdefault(handling.furniture, []).append((handling, i))
        for handlings in self._handlings.values():
            handlings.sort(key=lambda pair: pair[0].from_s)
        self.is_moving = [bool(item.moves or item.name in self._handlings) for item in scene.furniture]
        self._things = []
        for item, moves in zip(scene.furniture, self.is_moving, strict=True):
            if moves:
                self._things.append((item, furniture_mesh(item, palette)))

    def at(self, t: float) -> list[Actor]:
        """Actors that exist at a time [s], people first."""
        actors = []
        bodies: dict[int, PosedBody] = {}
        for i, (motion, body) in enumerate(zip(self.motions, self._bodies, strict=True)):
            if motion.exists(t):
                bodies[i] = body.pose(*pose_at(i, body.height_m, motion, t))
                actors.append(Actor(bodies[i].mesh, i + 1, bodies[i]))
        for item, mesh in self._things:
            place, heading, z = self._place(item, t, bodies)
            actors.append(Actor(place_mesh(mesh, place, heading, z)))
        return actors

    def _place(self, item: Furniture, t: float, bodies: dict[int, PosedBody]) -> tuple[F64, float, float]:
        """Place (2,), heading [rad] and base height of a thing that somebody may have moved."""
        place, heading, z = furniture_at(item, t)
        for handling, i in self._handlings.get(item.name, ()):
            if t < handling.from_s:
                break
            xy, heading, *_ = self.motions[i].at(min(t, handling.until_s))
            ahead = np.array([np.cos(heading), np.sin(heading)])
            if handling.how == "push":
                place = xy + PUSH_M * ahead
            elif t < handling.until_s and i in bodies:
                hands = bodies[i].hands
                place = hands[:2] - 0.03 * ahead
                z = float(hands[2]) - 0.12
            else:
                place = xy + PUT_M * ahead
                z = handling.put_z_m
        return place, heading, z


def furniture_at(item: Furniture, t: float) -> tuple[F64, float, float]:
    """Place (2,), heading [rad] and base height of furniture that is not handled."""
    if not item.moves:
        place = np.array(item.at_m, np.float64)
        return place, math.radians(item.heading_deg), item.z_m
    times_s = []
    places = []
    headings_deg = []
    for move in item.moves:
        times_s.append(move.t_s)
        places.append(move.at_m)
        headings_deg.append(item.heading_deg if move.heading_deg is None else move.heading_deg)
    x, y = np.array(places).T
    place = np.array([np.interp(t, times_s, x), np.interp(t, times_s, y)])
    heading = float(np.interp(t, times_s, np.deg2rad(headings_deg)))
    return place, heading, item.z_m


def place_mesh(mesh: Mesh, place: F64, heading: float, z: float) -> Mesh:
    """A mesh around its own origin, put into the room."""
    return mesh.at(rotation_z(heading), (place[0], place[1], z))
