"""The room (floor, walls with openings, ceiling, panels) and furniture: meshes, and what stands in the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64
from planview.synthetic.mesh import (
    Mesh,
    box,
    dome_rings,
    join,
    limb_rings,
    quad,
    rotation_y,
    rotation_z,
    sweep,
    upright_box,
    with_flat_ends,
)
from planview.synthetic.scene import Furniture, FurnitureKind, Opening, Room, Surface, Wall
from planview.synthetic.texture import Palette

Size = tuple[float, float, float]
Builder = Callable[[Size, int, int], list[Mesh]]

WOOD = Surface(texture="wood", colour="#a07a50", scale_m=0.15, contrast=0.1)
DARK = Surface(colour="#303238", scale_m=0.03, contrast=0.25)


def room_mesh(room: Room, palette: Palette) -> Mesh:
    """Everything that bounds the room, corridors behind its openings included."""
    size_x, size_y, size_z = room.size_m
    floor = palette.add(room.floor)
    ceiling = palette.add(room.ceiling)
    wall = palette.add(room.walls)
    parts = [
        quad((0, 0, 0), (size_x, 0, 0), (0, size_y, 0), floor),
        quad((0, size_y, size_z), (size_x, 0, 0), (0, -size_y, 0), ceiling),
    ]
    for side in get_args(Wall):
        for begin, end in _spans(room, side):
            parts.append(_rectangle(room, side, begin, end, 0.0, size_z, wall))
    for opening in room.openings:
        if opening.height_m < size_z:
            end = opening.from_m + opening.width_m
            parts.append(_rectangle(room, opening.wall, opening.from_m, end, opening.height_m, size_z, wall))
        parts += _corridor(room, opening, floor, wall, ceiling)
    for panel in room.panels:
        material = palette.add(panel.surface, emission=0.9 if panel.kind == "window" else 0.0)
        end = panel.from_m + panel.width_m
        top = panel.bottom_m + panel.height_m
        parts.append(_rectangle(room, panel.wall, panel.from_m, end, panel.bottom_m, top, material, proud_m=0.015))
    return join(parts)


def wall_frame(room: Room, wall: Wall) -> tuple[F64, F64, F64, float]:
    """Lower corner, direction along, direction into the room, and length of a wall."""
    size_x, size_y, _ = room.size_m
    x = np.array([1.0, 0, 0])
    y = np.array([0, 1.0, 0])
    match wall:
        case "south":
            return np.zeros(3), x, y, size_x
        case "north":
            return size_y * y, x, -y, size_x
        case "west":
            return np.zeros(3), y, x, size_y
        case "east":
            return size_x * x, y, -x, size_y


def _spans(room: Room, wall: Wall) -> list[tuple[float, float]]:
    """Begin and end of the pieces of a wall between its openings."""
    openings = [opening for opening in room.openings if opening.wall == wall]
    openings.sort(key=lambda opening: opening.from_m)
    begin = 0.0
    spans = []
    for opening in openings:
        spans.append((begin, opening.from_m))
        begin = opening.from_m + opening.width_m
    spans.append((begin, wall_frame(room, wall)[3]))
    return [(begin, end) for begin, end in spans if end > begin]


def wall_pieces(room: Room, wall: Wall) -> list[tuple[F64, F64]]:
    """Ends (2,) on the floor of the pieces of a wall around its openings."""
    corner, along, _, _ = wall_frame(room, wall)
    pieces = []
    for begin, end in _spans(room, wall):
        first = corner + begin * along
        last = corner + end * along
        pieces.append((first[:2], last[:2]))
    return pieces


def _rectangle(
    room: Room, wall: Wall, low: float, high: float, bottom: float, top: float, material: int, proud_m: float = 0.0
) -> Mesh:
    """A piece of a wall facing the room."""
    corner, along, inward, _ = wall_frame(room, wall)
    up = np.array([0, 0, top - bottom])
    start = corner + along * low + inward * proud_m + np.array([0, 0, bottom])
    span = along * (high - low)
    faces_out = np.dot(np.cross(along, [0, 0, 1.0]), inward) < 0
    if faces_out:
        start = start + span
        span = -span
    return quad(start, span, up, material)


CORRIDOR_SIDE_M = 1.5
CORRIDOR_DEPTH_M = 3.5
"""A corridor is wider than its opening by this on each side, and this deep."""


def _corridor(room: Room, opening: Opening, floor: int, wall: int, ceiling: int) -> list[Mesh]:
    """Floor, sides, end and ceiling of the space behind an opening, wider than it."""
    corner, along, inward, _ = wall_frame(room, opening.wall)
    up = np.array([0, 0, room.size_m[2]])
    start = corner + along * (opening.from_m - CORRIDOR_SIDE_M)
    span = along * (opening.width_m + 2 * CORRIDOR_SIDE_M)
    out = -inward * CORRIDOR_DEPTH_M
    ground = quad(start, span, out, floor)
    if np.cross(span, out)[2] < 0:
        ground = quad(start + span, -span, out, floor)
    return [
        replace(ground, local=ground.vertices),
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


def _half(size: Size) -> Size:
    """Half the length, half the depth and the whole height, to build around the origin."""
    length, depth, height = size
    return length / 2, depth / 2, height


def _table(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    top = upright_box(x, y, z - 0.03, z, main)
    return [top, *_legs(x - 0.05, y - 0.05, z - 0.03, 0.025, dark)]


def _legs(x: float, y: float, top: float, half: float, dark: int) -> list[Mesh]:
    """Four square legs whose axes are at (+-x, +-y)."""
    axes = [(-x, -y), (-x, y), (x, -y), (x, y)]
    return [upright_box(half, half, 0, top, dark, axis) for axis in axes]


SEAT_M = 0.46
"""Height of a seat."""


def _chair(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    seat = upright_box(x, y, SEAT_M - 0.04, SEAT_M, main)
    back = upright_box(0.02, y, SEAT_M + 0.12, z, main, (-x, 0.0))
    posts = [upright_box(0.015, 0.015, SEAT_M, z, dark, (-x, axis_y)) for axis_y in (-y + 0.03, y - 0.03)]
    return [seat, back, *posts, *_legs(x - 0.02, y - 0.02, SEAT_M, 0.018, dark)]


def _office_chair(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    column = sweep([(0.08, 0.03, 0.03, 0, 0), (SEAT_M - 0.05, 0.03, 0.03, 0, 0)], dark, 8)
    back_rows = [
        (SEAT_M + 0.10, 0.03, y * 0.8, -x),
        (SEAT_M + 0.3, 0.035, y, -x),
        (z - 0.08, 0.03, y * 0.9, -x - 0.03),
        (z, 0.02, y * 0.6, -x - 0.04),
    ]
    cushion_rows = [(SEAT_M - 0.06, x * 0.9, y * 0.9), (SEAT_M - 0.02, x, y), (SEAT_M, x * 0.9, y * 0.9)]
    back = sweep(with_flat_ends(back_rows), main, 16)
    cushion = sweep(with_flat_ends(cushion_rows), main, 18)
    post = box((-x - 0.03, -0.03, SEAT_M - 0.06), (-x, 0.03, SEAT_M + 0.3), dark)
    return [column, *_star_base(dark), back, cushion, post]


def _star_base(dark: int) -> list[Mesh]:
    """Five arms with a castor each."""
    flat = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64)
    arm = sweep(limb_rings(0.28, (0.025, 0.018)), dark, 6)
    castor = sweep(dome_rings(0.0, 0.06, (0.03, 0.03), n=6), dark, 6)
    parts = []
    for k in range(5):
        turn = rotation_z(2 * np.pi * k / 5)
        parts.append(arm.at(turn @ flat, (0.0, 0.0, 0.07)))
        parts.append(castor.at(np.eye(3), turn @ np.array([0.28, 0.0, 0.0])))
    return parts


def _block(size: Size, main: int, _dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    return [upright_box(x, y, 0, z, main)]


def _partition(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    foot_y = y * 0.8
    return [
        upright_box(x, y, 0.08, z - 0.03, main),
        upright_box(x + 0.005, y + 0.01, z - 0.03, z, dark),
        box((-x, -foot_y, 0), (-x + 0.04, foot_y, 0.1), dark),
        box((x - 0.04, -foot_y, 0), (x, foot_y, 0.1), dark),
    ]


BOARD_STEP_M = 0.33
"""Height between two boards of a shelf."""


def _shelf(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    parts = [box((-x, -y, 0), (x - 0.06, y, z), main)]
    for k in range(int(z / BOARD_STEP_M) + 1):
        height = k * BOARD_STEP_M
        bottom = min(height, z - 0.02)
        top = min(height + 0.02, z)
        parts.append(upright_box(x, y, bottom, top, dark))
    parts.append(box((-x, -y - 0.02, 0), (x, -y, z), dark))
    parts.append(box((-x, y, 0), (x, y + 0.02, z), dark))
    return parts


def _plant(size: Size, main: int, dark: int) -> list[Mesh]:
    pot = sweep(with_flat_ends([(0, 0.13, 0.13), (0.3, 0.18, 0.18)]), dark, 14)
    parts = [pot]
    rng = np.random.default_rng(7)
    for _ in range(22):
        tilt = rng.uniform(0.2, 1.1)
        turn = rng.uniform(0, 2 * np.pi)
        length = rng.uniform(0.6, 1.0) * (size[2] - 0.3)
        leaf = sweep(dome_rings(0, length, (0.006, 0.055), n=6), main, 6)
        parts.append(leaf.at(rotation_z(turn) @ rotation_y(tilt), (0, 0, 0.28)))
    return parts


def _sofa(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    seat = upright_box(x, y, 0.06, 0.44, main)
    back = box((-x, -y, 0.44), (-x + 0.22, y, z), main)
    right_arm = box((-x, -y, 0.44), (x, -y + 0.18, 0.62), main)
    left_arm = box((-x, y - 0.18, 0.44), (x, y, 0.62), main)
    base = upright_box(x - 0.05, y - 0.05, 0, 0.06, dark)
    return [seat, back, right_arm, left_arm, base]


def _column(size: Size, main: int, _dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    return [sweep(with_flat_ends([(0, x, y), (z, x, y)]), main, 24)]


def _bench(size: Size, main: int, dark: int) -> list[Mesh]:
    x, y, z = _half(size)
    seat = upright_box(x, y, z - 0.05, z, main)
    feet = [upright_box(x - 0.03, 0.03, 0, z - 0.05, dark, (0.0, foot_y)) for foot_y in (-y * 0.7, y * 0.7)]
    return [seat, *feet]


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
        centres: list[ArrayLike] = []
        angles: list[float] = []
        sizes: list[tuple[float, float]] = []
        for item in furniture:
            if item.z_m >= 1.8 or item.moves:
                continue
            length_m, depth_m, _ = furniture_size(item)
            centres.append(item.at_m)
            angles.append(float(np.deg2rad(item.heading_deg)))
            sizes.append((length_m, depth_m))
        for side in get_args(Wall):
            for first, last in wall_pieces(room, side):
                along = last - first
                centres.append((first + last) / 2)
                angles.append(float(np.arctan2(along[1], along[0])))
                sizes.append((float(np.hypot(along[0], along[1])), 0.02))
        self._centre = np.array(centres, np.float64).reshape(-1, 2)
        self._angle = np.array(angles)
        self._half = np.array(sizes, np.float64).reshape(-1, 2) / 2

    def distance(self, points: F64) -> F64:
        """(N,) distance of points (N, 2) from the nearest footprint, 0 inside."""
        away = points[:, None, :] - self._centre
        cosine = np.cos(self._angle)
        sine = np.sin(self._angle)
        along = away[..., 0] * cosine + away[..., 1] * sine
        across = -away[..., 0] * sine + away[..., 1] * cosine
        outside = np.maximum(np.abs(np.stack([along, across], -1)) - self._half, 0.0)
        return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=1))
