"""The room (floor, walls with openings, ceiling, panels) and furniture: meshes, and what stands in the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import get_args

import numpy as np

from calib.types import F64
from planview.synthetic.mesh import Mesh, box, dome_rings, join, limb_rings, quad, rotation_z, sweep
from planview.synthetic.scene import Furniture, FurnitureKind, Opening, Room, Surface, Wall
from planview.synthetic.texture import Palette

Size = tuple[float, float, float]
Builder = Callable[[Size, int, int], list[Mesh]]

WOOD = Surface(texture="wood", colour="#a07a50", scale_m=0.15, contrast=0.1)
DARK = Surface(colour="#303238", scale_m=0.03, contrast=0.25)


def room_mesh(room: Room, palette: Palette) -> Mesh:
    """Everything that bounds the room, corridors behind its openings included."""
    sx, sy, sz = room.size_m
    floor, ceiling, wall = palette.add(room.floor), palette.add(room.ceiling), palette.add(room.walls)
    parts = [quad((0, 0, 0), (sx, 0, 0), (0, sy, 0), floor), quad((0, sy, sz), (sx, 0, 0), (0, -sy, 0), ceiling)]
    for side in get_args(Wall):
        parts += [_rectangle(room, side, a, b, 0.0, sz, wall) for a, b in _spans(room, side)]
    for o in room.openings:
        if o.height_m < sz:
            parts.append(_rectangle(room, o.wall, o.from_m, o.from_m + o.width_m, o.height_m, sz, wall))
        parts += _corridor(room, o, floor, wall, ceiling)
    for p in room.panels:
        material = palette.add(p.surface, emission=0.9 if p.kind == "window" else 0.0)
        right, top = p.from_m + p.width_m, p.bottom_m + p.height_m
        parts.append(_rectangle(room, p.wall, p.from_m, right, p.bottom_m, top, material, proud_m=0.015))
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


def _spans(room: Room, wall: Wall) -> list[tuple[float, float]]:
    """Where along a wall there is no opening."""
    at, spans = 0.0, []
    for o in sorted((o for o in room.openings if o.wall == wall), key=lambda o: o.from_m):
        spans.append((at, o.from_m))
        at = o.from_m + o.width_m
    return [(a, b) for a, b in [*spans, (at, wall_frame(room, wall)[3])] if b > a]


def wall_pieces(room: Room, wall: Wall) -> list[tuple[F64, F64]]:
    """Ends (2,) on the floor of the pieces of a wall around its openings."""
    corner, along, _, _ = wall_frame(room, wall)
    return [((corner + a * along)[:2], (corner + b * along)[:2]) for a, b in _spans(room, wall)]


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


def _corridor(room: Room, o: Opening, floor: int, wall: int, ceiling: int) -> list[Mesh]:
    """Floor, sides, end and ceiling of the space behind an opening, wider than it."""
    corner, along, inward, _ = wall_frame(room, o.wall)
    up = np.array([0, 0, room.size_m[2]])
    side = 1.5
    start = corner + along * (o.from_m - side)
    # Depth of the corridor behind an opening.
    span, out = along * (o.width_m + 2 * side), -inward * 3.5
    faces_up = np.cross(span, out)[2] >= 0
    ground = quad(start, span, out, floor) if faces_up else quad(start + span, -span, out, floor)
    return [
        Mesh(ground.vertices, ground.normals, ground.vertices, ground.triangles, ground.material),
        quad(start + out, span, up, wall),
        quad(start, out, up, wall),
        quad(start + span, out, up, wall),
        quad(start + up, span, out, ceiling),
    ]


def furniture_mesh(item: Furniture, palette: Palette) -> Mesh:
    """A piece of furniture around its own origin."""
    size, surface, build = _KINDS[item.kind]
    main = palette.add(item.surface or surface)
    return join(build(item.size_m or size, main, palette.add(DARK)))


def furniture_size(item: Furniture) -> Size:
    """Length, depth and height of a piece [m]."""
    return item.size_m or _KINDS[item.kind][0]


def _table(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    return [box((-x, -y, z - 0.03), (x, y, z), main), *_legs(x - 0.05, y - 0.05, z - 0.03, 0.025, dark)]


def _legs(x: float, y: float, top: float, half: float, dark: int) -> list[Mesh]:
    """Four square legs whose axes are at (+-x, +-y)."""
    at = [(cx, cy) for cx in (-x, x) for cy in (-y, y)]
    return [box((cx - half, cy - half, 0), (cx + half, cy + half, top), dark) for cx, cy in at]


def _chair(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, seat = s[0] / 2, s[1] / 2, 0.46
    back = box((-x - 0.02, -y, seat + 0.12), (-x + 0.02, y, s[2]), main)
    posts = [box((-x - 0.015, cy - 0.015, seat), (-x + 0.015, cy + 0.015, s[2]), dark) for cy in (-y + 0.03, y - 0.03)]
    return [box((-x, -y, seat - 0.04), (x, y, seat), main), back, *posts, *_legs(x - 0.02, y - 0.02, seat, 0.018, dark)]


def _office_chair(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, seat = s[0] / 2, s[1] / 2, 0.46
    column = sweep([(0.08, 0.03, 0.03, 0, 0), (seat - 0.05, 0.03, 0.03, 0, 0)], dark, 8)
    arms = []
    for k in range(5):
        arm = sweep(limb_rings(0.28, (0.025, 0.018)), dark, 6)
        angle = 2 * np.pi * k / 5
        flat = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64)
        turn = rotation_z(angle)
        arms.append(arm.moved(turn @ flat, (0.0, 0.0, 0.07)))
        arms.append(sweep(dome_rings(0.0, 0.06, (0.03, 0.03), (0.0, 0.0), 6), dark, 6).moved(
            np.eye(3), turn @ np.array([0.28, 0.0, 0.0])))  # fmt: skip
    back = sweep([(seat + 0.10, 0.0, 0.0, -x, 0), (seat + 0.10, 0.03, y * 0.8, -x, 0), (seat + 0.3, 0.035, y, -x, 0),
                  (s[2] - 0.08, 0.03, y * 0.9, -x - 0.03, 0), (s[2], 0.02, y * 0.6, -x - 0.04, 0),
                  (s[2], 0.0, 0.0, -x - 0.04, 0)], main, 16)  # fmt: skip
    cushion = sweep([(seat - 0.06, 0.0, 0.0, 0, 0), (seat - 0.06, x * 0.9, y * 0.9, 0, 0), (seat - 0.02, x, y, 0, 0),
                     (seat, x * 0.9, y * 0.9, 0, 0), (seat, 0.0, 0.0, 0, 0)], main, 18)  # fmt: skip
    post = box((-x - 0.03, -0.03, seat - 0.06), (-x, 0.03, seat + 0.3), dark)
    return [column, *arms, back, cushion, post]


def _block(s: Size, main: int, _dark: int) -> list[Mesh]:
    return [box((-s[0] / 2, -s[1] / 2, 0), (s[0] / 2, s[1] / 2, s[2]), main)]


def _partition(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    return [
        box((-x, -y, 0.08), (x, y, z - 0.03), main),
        box((-x - 0.005, -y - 0.01, z - 0.03), (x + 0.005, y + 0.01, z), dark),
        box((-x, -y * 0.8, 0), (-x + 0.04, y * 0.8, 0.1), dark),
        box((x - 0.04, -y * 0.8, 0), (x, y * 0.8, 0.1), dark),
    ]


def _shelf(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    parts = [box((-x, -y, 0), (x - 0.06, y, z), main)]
    for k in range(int(z / 0.33) + 1):
        parts.append(box((-x, -y, min(k * 0.33, z - 0.02)), (x, y, min(k * 0.33 + 0.02, z)), dark))
    return [*parts, box((-x, -y - 0.02, 0), (x, -y, z), dark), box((-x, y, 0), (x, y + 0.02, z), dark)]


def _plant(s: Size, main: int, dark: int) -> list[Mesh]:
    pot = sweep([(0, 0.0, 0.0, 0, 0), (0, 0.13, 0.13, 0, 0), (0.3, 0.18, 0.18, 0, 0), (0.3, 0.0, 0.0, 0, 0)], dark, 14)
    rng = np.random.default_rng(7)
    leaves = []
    for _ in range(22):
        tilt, turn, length = rng.uniform(0.2, 1.1), rng.uniform(0, 2 * np.pi), rng.uniform(0.6, 1.0) * (s[2] - 0.3)
        leaf = sweep(dome_rings(0, length, (0.006, 0.055), n=6), main, 6)
        c, n = np.cos(tilt), np.sin(tilt)
        lean = np.array([[c, 0, n], [0, 1, 0], [-n, 0, c]])
        leaves.append(leaf.moved(rotation_z(turn) @ lean, (0, 0, 0.28)))
    return [pot, *leaves]


def _sofa(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    return [box((-x, -y, 0.06), (x, y, 0.44), main), box((-x, -y, 0.44), (-x + 0.22, y, z), main),
            box((-x, -y, 0.44), (x, -y + 0.18, 0.62), main), box((-x, y - 0.18, 0.44), (x, y, 0.62), main),
            box((-x + 0.05, -y + 0.05, 0), (x - 0.05, y - 0.05, 0.06), dark)]  # fmt: skip


def _column(s: Size, main: int, _dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    return [sweep([(0, 0.0, 0.0, 0, 0), (0, x, y, 0, 0), (z, x, y, 0, 0), (z, 0.0, 0.0, 0, 0)], main, 24)]


def _bench(s: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = s[0] / 2, s[1] / 2, s[2]
    feet = [box((-x + 0.03, cy - 0.03, 0), (x - 0.03, cy + 0.03, z - 0.05), dark) for cy in (-y * 0.7, y * 0.7)]
    return [box((-x, -y, z - 0.05), (x, y, z), main), *feet]


_KINDS: dict[FurnitureKind, tuple[Size, Surface, Builder]] = {
    "table": ((1.6, 0.8, 0.74), WOOD, _table),
    "chair": ((0.44, 0.44, 0.92), WOOD, _chair),
    "office_chair": ((0.46, 0.48, 0.98), Surface(colour="#2c4a70", scale_m=0.04, contrast=0.3), _office_chair),
    "partition": ((0.06, 1.6, 1.35), Surface(texture="carpet", colour="#7c8a94", contrast=0.4), _partition),
    "box": ((0.4, 0.3, 0.3), Surface(colour="#b08850", scale_m=0.12, contrast=0.2), _block),
    "shelf": ((0.35, 1.2, 1.98), Surface(texture="books", colour="#a05038", colour2="#304860", scale_m=0.05), _shelf),
    "plant": ((0.5, 0.5, 1.3), Surface(colour="#3c7a34", scale_m=0.08, contrast=0.4), _plant),
    "sofa": ((0.85, 1.8, 0.82), Surface(texture="carpet", colour="#6a5a7a", contrast=0.4), _sofa),
    "column": ((0.5, 0.5, 3.0), Surface(texture="concrete", colour="#b0aca4", contrast=0.15), _column),
    "bench": ((0.45, 1.8, 0.45), WOOD, _bench),
    "door": ((0.05, 0.95, 2.05), Surface(colour="#8a6a48", texture="wood", scale_m=0.3), _block),
    "bag": ((0.25, 0.45, 0.32), Surface(colour="#2a3c34", scale_m=0.05, contrast=0.3), _block),
}


class Obstacles:
    """Footprints of standing furniture and of walls around their openings, as oriented rectangles."""

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
