"""Triangle meshes of simple solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from calib.types import F32, F64, I32, I64


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with what shading needs; counter-clockwise from outside.

    Attributes:
        vertices: (V, 3) float32 [m].
        normals: (V, 3) float32, unit.
        local: (V, 3) float32 [m], coordinates fixed to the surface, for textures.
        triangles: (T, 3) int32.
        material: (T,) int32, index into the scene's materials.
    """

    vertices: F32
    normals: F32
    local: F32
    triangles: I32
    material: I32

    def at(self, rotation: F64, translation: ArrayLike) -> Mesh:
        """The same surface elsewhere; textures stay on it."""
        turn = rotation.astype(np.float32).T
        shift = np.asarray(translation, np.float32)
        return replace(self, vertices=self.vertices @ turn + shift, normals=self.normals @ turn)


def rotation_x(angle: float) -> F64:
    """(3, 3) rotation about x [rad]."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]], np.float64)


def rotation_y(angle: float) -> F64:
    """(3, 3) rotation about y [rad]."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], np.float64)


def rotation_z(angle: float) -> F64:
    """(3, 3) rotation about the vertical [rad]."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]], np.float64)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several."""
    triangles = []
    offset = 0
    for mesh in meshes:
        triangles.append(mesh.triangles + np.int32(offset))
        offset += len(mesh.vertices)
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.local for mesh in meshes]),
        np.concatenate(triangles),
        np.concatenate([mesh.material for mesh in meshes]),
    )


def quad(corner: ArrayLike, along: ArrayLike, up: ArrayLike, material: int) -> Mesh:
    """A rectangle facing ``along`` x ``up``; local x and y run along its sides from the corner."""
    start = np.asarray(corner, np.float64)
    side = np.asarray(along, np.float64)
    rise = np.asarray(up, np.float64)
    normal = np.cross(side, rise)
    normal = normal / np.linalg.norm(normal)
    length = np.linalg.norm(side)
    height = np.linalg.norm(rise)
    local = [(0, 0, 0), (length, 0, 0), (length, height, 0), (0, height, 0)]
    return Mesh(
        vertices=np.array([start, start + side, start + side + rise, start + rise], np.float32),
        normals=np.tile(normal.astype(np.float32), (4, 1)),
        local=np.array(local, np.float32),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        material=np.full(2, material, np.int32),
    )


def box(low: ArrayLike, high: ArrayLike, material: int) -> Mesh:
    """An axis-aligned box; each face has local coordinates of its own."""
    x0, y0, z0 = map(float, np.asarray(low))
    x1, y1, z1 = map(float, np.asarray(high))
    dx = (x1 - x0, 0, 0)
    dy = (0, y1 - y0, 0)
    dz = (0, 0, z1 - z0)
    ndx = (x0 - x1, 0, 0)
    ndy = (0, y0 - y1, 0)
    return join(
        [
            quad((x0, y0, z1), dx, dy, material),
            quad((x0, y1, z0), dx, ndy, material),
            quad((x0, y0, z0), dx, dz, material),
            quad((x1, y1, z0), ndx, dz, material),
            quad((x0, y1, z0), ndy, dz, material),
            quad((x1, y0, z0), dy, dz, material),
        ]
    )


def upright_box(
    half_x: float, half_y: float, bottom: float, top: float, material: int, centre: tuple[float, float] = (0.0, 0.0)
) -> Mesh:
    """A box about a vertical axis, from its half sizes along x and y and the heights of its ends."""
    x, y = centre
    return box((x - half_x, y - half_y, bottom), (x + half_x, y + half_y, top), material)


def with_flat_ends(rows: ArrayLike) -> F64:
    """Rings for ``sweep`` with flat ends, from (R, 3) z and half sizes along x and y, or (R, 4) with a centre x."""
    inner = np.asarray(rows, np.float64)
    rings = np.zeros((len(inner) + 2, 5))
    rings[1:-1, : inner.shape[1]] = inner
    rings[0] = rings[1]
    rings[-1] = rings[-2]
    rings[[0, -1], 1:3] = 0.0
    return rings


def sweep(rings: ArrayLike, material: int, segments: int = 14) -> Mesh:
    """A solid from (R, 5) elliptic rings stacked along z, each z, half size in x and in y, centre x and y [m]; z is
    strictly monotonic except at ends, where half sizes of 0 make poles. ``segments``: vertices per ring."""
    rows = np.asarray(rings, np.float64)
    if rows[0, 0] > rows[-1, 0]:
        rows = rows[::-1]
    z, half_x, half_y, centre_x, centre_y = rows.T[:, :, None]
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    x = centre_x + half_x * np.cos(angle)
    y = centre_y + half_y * np.sin(angle)
    vertices = np.stack([x, y, np.broadcast_to(z, x.shape)], -1)
    ring, segment = np.meshgrid(np.arange(len(rows) - 1), np.arange(segments), indexing="ij")
    below = ring * segments + segment
    below_next = ring * segments + (segment + 1) % segments
    above = below + segments
    above_next = below_next + segments
    lower = np.stack([below, below_next, above_next], -1)
    upper = np.stack([below, above_next, above], -1)
    triangles = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    return smooth(vertices.reshape(-1, 3), triangles, material)


def smooth(vertices: F64, triangles: I64, material: int) -> Mesh:
    """A mesh with averaged normals; its local coordinates are its vertices."""
    first, second, third = vertices[triangles.T]
    face = np.cross(second - first, third - first)
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # The ring of a pole has one position and as many vertices as segments: share their normal.
    normals = np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    rounded = vertices.astype(np.float32)
    materials = np.full(len(triangles), material, np.int32)
    return Mesh(rounded, normals.astype(np.float32), rounded, triangles.astype(np.int32), materials)


def dome_rings(
    z_low: float, z_high: float, half: tuple[float, float], centre: tuple[float, float] = (0.0, 0.0), n: int = 9
) -> F64:
    """Rings of an ellipsoid from pole to pole, for ``sweep``."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, n)
    middle = (z_low + z_high) / 2
    share = np.cos(latitude)
    share[[0, -1]] = 0.0
    rings = np.empty((n, 5))
    rings[:, 0] = middle + (z_high - z_low) / 2 * np.sin(latitude)
    rings[:, 1:3] = np.outer(share, half)
    rings[:, 3:] = centre
    return rings


def limb_rings(length: float, radii: Sequence[float]) -> F64:
    """Rings of a limb hanging from the origin along -z with rounded ends, for ``sweep``: ``length`` between the joint
    centres, ``radii`` at equal steps from the upper to the lower [m]."""
    top = radii[0]
    bottom = radii[-1]
    upper_end = [(top, 0.0), (0.87 * top, 0.5 * top), (0.5 * top, 0.87 * top)]
    along = np.linspace(0.0, -length, len(radii)).tolist()
    middle = list(zip(along, radii, strict=True))
    lower_end = [
        (-length - 0.5 * bottom, 0.87 * bottom),
        (-length - 0.87 * bottom, 0.5 * bottom),
        (-length - bottom, 0.0),
    ]
    z, half = np.array([*upper_end, *middle, *lower_end]).T
    return np.column_stack([z, half, half, 0 * half, 0 * half])
