"""Meshes of the room: floor, walls with openings, ceiling, panels."""

from __future__ import annotations

import numpy as np

from calib.types import F64
from planview.synthetic.setting import Opening, Panel, Room, Wall
from planview.synthetic.shapes import Mesh, join, quad
from planview.synthetic.texture import Palette

CORRIDOR_M = 3.5
"""Depth of the corridor behind an opening."""


def room_mesh(room: Room, palette: Palette) -> Mesh:
    """Everything that bounds the room, corridors behind its openings included."""
    sx, sy, sz = room.size_m
    floor, ceiling, wall = palette.add(room.floor), palette.add(room.ceiling), palette.add(room.walls)
    parts = [quad((0, 0, 0), (sx, 0, 0), (0, sy, 0), floor), quad((0, sy, sz), (sx, 0, 0), (0, -sy, 0), ceiling)]
    for side in ("south", "north", "west", "east"):
        openings = sorted((o for o in room.openings if o.wall == side), key=lambda o: o.from_m)
        parts += _wall(room, side, openings, wall)
        parts += [m for o in openings for m in _corridor(room, o, floor, wall, ceiling)]
    parts += [_panel(room, p, palette) for p in room.panels]
    return join(parts)


def wall_frame(room: Room, wall: Wall) -> tuple[F64, F64, F64, float]:
    """Lower corner, direction along, direction into the room, and length of a wall."""
    sx, sy, _ = room.size_m
    x, y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    return {
        "south": (np.zeros(3), x, y, sx),
        "north": (np.array([0, sy, 0.0]), x, -y, sx),
        "west": (np.zeros(3), y, x, sy),
        "east": (np.array([sx, 0.0, 0]), y, -x, sy),
    }[wall]


def wall_pieces(room: Room, wall: Wall) -> list[tuple[F64, F64]]:
    """Ends (2,) on the floor of the pieces of a wall beside its openings."""
    corner, along, _, length = wall_frame(room, wall)
    at, pieces = 0.0, []
    for o in sorted((o for o in room.openings if o.wall == wall), key=lambda o: o.from_m):
        pieces.append((at, o.from_m))
        at = o.from_m + o.width_m
    pieces.append((at, length))
    return [((corner + a * along)[:2], (corner + b * along)[:2]) for a, b in pieces if b > a]


def _rectangle(room: Room, wall: Wall, low: float, high: float, bottom: float, top: float, material: int,
               proud_m: float = 0.0) -> Mesh:  # fmt: skip
    """A piece of a wall facing the room."""
    corner, along, inward, _ = wall_frame(room, wall)
    up = np.array([0, 0, top - bottom])
    start = corner + along * low + inward * proud_m + np.array([0, 0, bottom])
    span = along * (high - low)
    if np.dot(np.cross(along, [0, 0, 1.0]), inward) < 0:
        start, span = start + span, -span
    return quad(start, span, up, material)


def _wall(room: Room, wall: Wall, openings: list[Opening], material: int) -> list[Mesh]:
    length, top = wall_frame(room, wall)[3], room.size_m[2]
    pieces, at = [], 0.0
    for o in openings:
        if o.from_m > at:
            pieces.append(_rectangle(room, wall, at, o.from_m, 0.0, top, material))
        if o.height_m < top:
            pieces.append(_rectangle(room, wall, o.from_m, o.from_m + o.width_m, o.height_m, top, material))
        at = o.from_m + o.width_m
    if at < length:
        pieces.append(_rectangle(room, wall, at, length, 0.0, top, material))
    return pieces


def _corridor(room: Room, o: Opening, floor: int, wall: int, ceiling: int) -> list[Mesh]:
    """Floor, sides, end and ceiling of the space behind an opening, wider than it."""
    corner, along, inward, _ = wall_frame(room, o.wall)
    up = np.array([0, 0, room.size_m[2]])
    side = 1.5
    start = corner + along * (o.from_m - side)
    span, out = along * (o.width_m + 2 * side), -inward * CORRIDOR_M
    return [
        _upwards(start, span, out, floor),
        quad(start + out, span, up, wall),
        quad(start, out, up, wall),
        quad(start + span, out, up, wall),
        quad(start + up, span, out, ceiling),
    ]


def _upwards(corner: F64, a: F64, b: F64, material: int) -> Mesh:
    if np.cross(a, b)[2] < 0:
        corner, a = corner + a, -a
    mesh = quad(corner, a, b, material)
    return Mesh(mesh.vertices, mesh.normals, mesh.vertices, mesh.triangles, mesh.material)


def _panel(room: Room, p: Panel, palette: Palette) -> Mesh:
    window = p.kind == "window"
    material = palette.add(p.surface, emission=0.9 if window else 0.0)
    return _rectangle(
        room, p.wall, p.from_m, p.from_m + p.width_m, p.bottom_m, p.bottom_m + p.height_m, material, proud_m=0.015
    )
