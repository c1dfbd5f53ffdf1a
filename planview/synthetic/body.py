"""An articulated human body: rest parts from body proportions, posed by joint angles.

Proportions after Drillis and Contini (in Winter, Biomechanics and Motor Control of Human Movement, table 4.1),
in fractions of the standing height: ankle 0.039, knee 0.285, hip 0.530, shoulder 0.818, chin 0.870.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F64
from planview.synthetic.persons import Person
from planview.synthetic.setting import Surface
from planview.synthetic.shapes import Mesh, dome_rings, join, limb_rings, sweep
from planview.synthetic.texture import Palette

HIP, KNEE, ANKLE, SHOULDER, NECK = 0.530, 0.285, 0.039, 0.812, 0.842
THIGH, SHIN, UPPER_ARM, FOREARM = HIP - KNEE, KNEE - ANKLE, 0.172, 0.150


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
    wheel: float = 0.0
    """The whole body about its forward axis, to its left: a cartwheel, with the legs opened half-way through."""


@dataclass(frozen=True, eq=False)
class PosedBody:
    """A body in the room.

    Attributes:
        mesh: all parts, room frame; the lowest point touches the floor.
        head: (3,) centre of the head [m].
        top_m: highest point of head and hair above the floor [m].
        hands: (3,) point between the hands [m].
    """

    mesh: Mesh
    head: F64
    top_m: float
    hands: F64


class Body:
    """A person's rest parts, and ``pose`` that places them."""

    def __init__(self, person: Person, palette: Palette) -> None:
        self.height_m = person.height_m
        h, b = person.height_m, person.build
        shirt = palette.add(person.shirt)
        trousers = palette.add(person.trousers)
        skin = palette.add(Surface(colour=person.skin, scale_m=0.04, contrast=0.12))
        hair = palette.add(Surface(colour=person.hair, scale_m=0.02, contrast=0.35))
        shoes = palette.add(Surface(colour="#2a2624", scale_m=0.05, contrast=0.2))
        sleeve = shirt if person.sleeves == "long" else skin
        self._parts = {
            "pelvis": _pelvis(h, b, trousers, skirt=person.skirt),
            "torso": _torso(h, b, shirt, skin),
            "head": _head(h, person.hair_style, skin, hair),
            "arm": join([_limb(h, UPPER_ARM, (0.030, 0.027, 0.024, 0.021), b, shirt)]),
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
        chest = _rz(pose.twist) @ _ry(pose.lean) @ _rx(-pose.sway)
        placed.append(self._parts["torso"].moved(chest, hips))
        neck = chest @ np.array([0.0, 0.0, (NECK - HIP) * h])
        skull = chest @ _rz(pose.turn) @ _ry(pose.nod - 0.7 * pose.lean)
        head = self._parts["head"].moved(skull, neck)
        placed.append(head)
        hands = [self._arm(placed, pose, side, chest) for side in (0, 1)]
        for side in (0, 1):
            self._leg(placed, pose, side)
        mesh = join(placed)
        if pose.wheel:
            roll = _rx(-pose.wheel)
            mesh, head = mesh.moved(roll, np.zeros(3)), head.moved(roll, np.zeros(3))
            skull, neck, hands = roll @ skull, roll @ neck, [roll @ hand for hand in hands]
        lift = -float(mesh.vertices[:, 2].min())
        turn, shift = _rz(heading_rad), np.array([x_m, y_m, lift])
        centre = skull @ np.array([0.0, 0.0, (0.935 - NECK) * h]) + neck
        return PosedBody(
            mesh.moved(turn, shift),
            turn @ centre + shift,
            float(head.vertices[:, 2].max()) + lift,
            turn @ np.mean(hands, axis=0) + shift,
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
        opened = 0.3 * pose.spread[side] + 0.6 * abs(np.sin(pose.wheel / 2))
        upper = _rz(sign * pose.spread[side]) @ _rx(sign * opened) @ _ry(-pose.hip[side])
        placed.append(self._parts["thigh"].moved(upper, joint))
        knee = joint + upper @ np.array([0.0, 0.0, -THIGH * h])
        lower = upper @ _ry(pose.knee[side])
        placed.append(self._parts["shin"].moved(lower, knee))
        ankle = knee + lower @ np.array([0.0, 0.0, -SHIN * h])
        foot = _rz(sign * (pose.spread[side] + 0.1)) @ _ry(-pose.foot[side])
        placed.append(self._parts["foot"].moved(foot, ankle))


def _rx(a: float) -> F64:
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]], np.float64)


def _ry(a: float) -> F64:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], np.float64)


def _rz(a: float) -> F64:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float64)


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


def _pelvis(h: float, b: float, trousers: int, *, skirt: bool) -> Mesh:
    rows = [(-0.075, 0.0, 0.0, 0.0), (-0.06, 0.045, 0.06, 0.0), (-0.03, 0.063, 0.092, 0.0), (0.02, 0.063, 0.094, 0.0)]
    if skirt:
        rows = [(-0.26, 0.0, 0.0, 0.0), (-0.26, 0.088, 0.115, 0.0), (-0.1, 0.075, 0.105, 0.0), (0.02, 0.06, 0.09, 0.0)]
    rows.append((0.03, 0.0, 0.0, 0.0))
    return sweep(_rings(h, rows, b), trousers, 18)


def _head(h: float, style: str, skin: int, hair: int) -> Mesh:
    """Head with hair; the origin is the top of the neck and the highest point (1 - NECK) h above it."""
    top = (1.0 - NECK) * h
    bare = style == "bald"
    skull_top = top if bare else top - 0.004 * h
    low = top - 0.132 * h
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
    rows = np.array(profile) * h
    # Swept along z, then laid down along x: z -> x, x -> z.
    sole = -ANKLE * h
    rings = np.column_stack([rows[:, 0], rows[:, 1], rows[:, 2], sole + rows[:, 1], np.zeros(len(rows))])
    upright = sweep(rings, shoes, 10)
    swap = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]], np.float64)
    flat = upright.moved(swap, np.zeros(3))
    return Mesh(flat.vertices, flat.normals, flat.local, flat.triangles[:, ::-1].copy(), flat.material)
