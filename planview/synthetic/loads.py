"""What people of a scene carry, push or sit in: one table of parts, which count as the person's silhouette.

Sizes are those of things in shops: a removal box, a school bag, a pram with a carry
cot, a wheelchair of 0.4 m seat width, and a child of two years on the arm.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from calib.types import F64
from planview.synthetic.mesh import Mesh, box, dome_rings, join, sweep
from planview.synthetic.scene import LoadKind, Surface
from planview.synthetic.texture import Palette

Holder = Literal["chest", "hands", "right_hand", "floor"]
"""What a part moves with: the chest (origin between the hips, leaning with it), a point between the hands, the right
hand, or the floor below the hips; x is ahead of the person and y to the left."""
CLOTH, PALE = Surface(colour="#4c3a52", scale_m=0.04, contrast=0.25), Surface(colour="#cfc6b4", scale_m=0.05)
CARD = Surface(colour="#b08a5a", scale_m=0.15, contrast=0.25)
METAL = Surface(colour="#55585c", scale_m=0.1, contrast=0.2)
SKIN = Surface(colour="#d0a080", scale_m=0.04, contrast=0.12)


class Piece(NamedTuple):
    """A solid [m]: a ``box`` of two corners, a ``wheel`` of radius, width and centre, or a stack of elliptic ``rings``
    (rows of ``mesh.sweep``)."""

    holder: Holder
    surface: Surface
    kind: Literal["box", "wheel", "rings"]
    rows: F64 | tuple[tuple[float, ...], ...]

    def mesh(self, material: int) -> Mesh:
        """Around the origin of its holder."""
        rows = np.asarray(self.rows, np.float64)
        if self.kind == "box":
            return box(rows[0], rows[1], material)
        if self.kind == "rings":
            return sweep(rows, material, 16)
        (radius, width, _), centre = rows
        disc = [(-width / 2, 0, 0, 0, 0), (-width / 2, radius, radius, 0, 0)]
        disc += [(width / 2, radius, radius, 0, 0), (width / 2, 0, 0, 0, 0)]
        upright = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64)
        return sweep(np.array(disc), material, 20).moved(upright, centre)


class Load(NamedTuple):
    """The posture in which it is held (``people.POSTURES``), and its parts."""

    posture: str | None
    parts: tuple[Piece, ...]


def _wheels(radius: float, width: float, x_m: float, half_track_m: float) -> tuple[Piece, ...]:
    """A wheel on either side."""
    centres = [(x_m, side * half_track_m, radius) for side in (-1, 1)]
    return tuple(Piece("floor", METAL, "wheel", ((radius, width, 0.0), centre)) for centre in centres)


LOADS: dict[LoadKind, Load] = {
    "box": Load("carry", (Piece("hands", CARD, "box", ((-0.17, -0.21, -0.12), (0.17, 0.21, 0.2))),)),
    "backpack": Load(None, (Piece("chest", CLOTH, "rings", (
        (0.05, 0, 0, -0.19, 0), (0.05, 0.08, 0.14, -0.19, 0), (0.12, 0.1, 0.16, -0.2, 0), (0.4, 0.1, 0.16, -0.2, 0),
        (0.5, 0.07, 0.13, -0.18, 0), (0.52, 0, 0, -0.18, 0),
    )),)),
    "pram": Load("push", (
        Piece("floor", METAL, "box", ((0.56, -0.24, 1.02), (0.6, 0.24, 1.06))),
        Piece("floor", METAL, "rings", (
            (0.12, 0, 0, 1.25, 0), (0.12, 0.015, 0.2, 1.25, 0), (1.02, 0.015, 0.24, 0.58, 0), (1.03, 0, 0, 0.58, 0),
        )),
        Piece("floor", CLOTH, "box", ((0.75, -0.2, 0.45), (1.45, 0.2, 0.72))),
        Piece("floor", CLOTH, "rings", dome_rings(0.6, 1.0, (0.24, 0.2), (1.2, 0.0))),
        *_wheels(0.12, 0.04, 0.85, 0.25), *_wheels(0.12, 0.04, 1.35, 0.25),
    )),
    "wheelchair": Load("sit", (
        Piece("floor", CLOTH, "box", ((-0.22, -0.2, 0.34), (0.24, 0.2, 0.38))),
        Piece("floor", CLOTH, "box", ((-0.27, -0.2, 0.38), (-0.23, 0.2, 0.92))),
        Piece("floor", METAL, "box", ((-0.2, 0.22, 0.6), (0.2, 0.27, 0.63))),
        Piece("floor", METAL, "box", ((-0.2, -0.27, 0.6), (0.2, -0.22, 0.63))),
        Piece("floor", METAL, "box", ((0.42, -0.17, 0.02), (0.6, 0.17, 0.04))),
        *_wheels(0.3, 0.03, -0.1, 0.3), *_wheels(0.09, 0.03, 0.38, 0.2),
    )),
    "child": Load("carry", (
        Piece("chest", PALE, "rings", dome_rings(0.1, 0.46, (0.08, 0.1), (0.19, 0.1))),
        Piece("chest", SKIN, "rings", dome_rings(0.44, 0.64, (0.09, 0.075), (0.19, 0.1))),
        Piece("chest", CLOTH, "rings", dome_rings(-0.15, 0.22, (0.05, 0.05), (0.22, 0.02))),
        Piece("chest", CLOTH, "rings", dome_rings(-0.15, 0.22, (0.05, 0.05), (0.22, 0.18))),
    )),
}  # fmt: skip


class HeldLoad:
    """A load in the colours of a scene, that ``placed`` puts where its holders are."""

    def __init__(self, kind: LoadKind, palette: Palette) -> None:
        meshes: dict[Holder, list[Mesh]] = {}
        for part in LOADS[kind].parts:
            meshes.setdefault(part.holder, []).append(part.mesh(palette.add(part.surface)))
        self.posture = LOADS[kind].posture
        self._meshes = {holder: join(parts) for holder, parts in meshes.items()}

    def placed(self, chest: F64, hips: F64, hands: list[F64]) -> list[Mesh]:
        """Its parts in the frame of the body, x ahead, whose lowest point is the floor: with the (3, 3) rotation of the
        chest, its origin above the floor (3,), and the left and right hand (3,) [m]."""
        eye, floor = np.eye(3), np.zeros(3)
        holders = {"chest": (chest, hips), "hands": (eye, np.mean(hands, axis=0)), "right_hand": (eye, hands[1]),
                   "floor": (eye, floor)}  # fmt: skip
        return [mesh.moved(*holders[holder]) for holder, mesh in self._meshes.items()]
