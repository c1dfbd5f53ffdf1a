"""Triangle meshes of simple solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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

    def moved(self, rotation: F64, translation: ArrayLike) -> Mesh:
        """The same surface elsewhere; textures stay on it."""
        r = rotation.astype(np.float32)
        t = np.asarray(translation, np.float32)
        return Mesh(self.vertices @ r.T + t, self.normals @ r.T, self.local, self.triangles, self.material)


def rotation_z(angle: float) -> F64:
    """(3, 3) rotation about the vertical [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float64)


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.local for m in meshes]),
        np.concatenate([m.triangles + np.int32(o) for m, o in zip(meshes, offsets, strict=True)]),
        np.concatenate([m.material for m in meshes]),
    )


def quad(corner: ArrayLike, along: ArrayLike, up: ArrayLike, material: int) -> Mesh:
    """A rectangle facing ``along`` x ``up``; local x and y run along its sides from the corner."""
    c, a, b = (np.asarray(v, np.float64) for v in (corner, along, up))
    normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
    length, height = np.linalg.norm(a), np.linalg.norm(b)
    return Mesh(
        np.array([c, c + a, c + a + b, c + b], np.float32),
        np.tile(normal.astype(np.float32), (4, 1)),
        np.array([[0, 0, 0], [length, 0, 0], [length, height, 0], [0, height, 0]], np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        np.full(2, material, np.int32),
    )


def box(low: ArrayLike, high: ArrayLike, material: int) -> Mesh:
    """An axis-aligned box; each face has local coordinates of its own."""
    x0, y0, z0 = (float(v) for v in np.asarray(low))
    x1, y1, z1 = (float(v) for v in np.asarray(high))
    dx, dy, dz = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    ndx, ndy = (x0 - x1, 0, 0), (0, y0 - y1, 0)
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


def sweep(rings: ArrayLike, material: int, segments: int = 14) -> Mesh:
    """A solid from (R, 5) elliptic rings stacked along z, each z, half size in x and in y, centre x and y [m]; z is
    strictly monotonic except at ends, where half sizes of 0 make poles. ``segments``: vertices per ring."""
    r = np.asarray(rings, np.float64)
    if r[0, 0] > r[-1, 0]:
        r = r[::-1]
    angle = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    x = r[:, 3, None] + r[:, 1, None] * np.cos(angle)
    y = r[:, 4, None] + r[:, 2, None] * np.sin(angle)
    z = np.broadcast_to(r[:, :1], x.shape)
    vertices = np.stack([x, y, z], -1).reshape(-1, 3)
    ring, seg = np.meshgrid(np.arange(len(r) - 1), np.arange(segments), indexing="ij")
    a = ring * segments + seg
    b = ring * segments + (seg + 1) % segments
    c, d = a + segments, b + segments
    triangles = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    return smooth(vertices, triangles, material)


def smooth(vertices: F64, triangles: I64, material: int) -> Mesh:
    """A mesh with averaged normals; its local coordinates are its vertices."""
    v = vertices.astype(np.float64)
    face = np.cross(v[triangles[:, 1]] - v[triangles[:, 0]], v[triangles[:, 2]] - v[triangles[:, 0]])
    normals = np.zeros_like(v)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # The ring of a pole has one position and as many vertices as segments: share their normal.
    normals = np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    v32 = v.astype(np.float32)
    return Mesh(
        v32, normals.astype(np.float32), v32, triangles.astype(np.int32), np.full(len(triangles), material, np.int32)
    )


def dome_rings(
    z_low: float, z_high: float, half: tuple[float, float], centre: tuple[float, float] = (0.0, 0.0), n: int = 9
) -> F64:
    """Rings of an ellipsoid from pole to pole, for ``sweep``."""
    t = np.linspace(-np.pi / 2, np.pi / 2, n)
    z = (z_low + z_high) / 2 + (z_high - z_low) / 2 * np.sin(t)
    s = np.cos(t)
    s[0] = s[-1] = 0.0
    return np.column_stack([z, half[0] * s, half[1] * s, np.full(n, centre[0]), np.full(n, centre[1])])


def limb_rings(length: float, radii: Sequence[float]) -> F64:
    """Rings of a limb hanging from the origin along -z with rounded ends, for ``sweep``: ``length`` between the joint
    centres, ``radii`` at equal steps from the upper to the lower [m]."""
    z = np.linspace(0.0, -length, len(radii))
    top, bottom = radii[0], radii[-1]
    rows = [(top, 0.0), (0.87 * top, 0.5 * top), (0.5 * top, 0.87 * top), *zip(z.tolist(), radii, strict=True)]
    rows += [(-length - 0.5 * bottom, 0.87 * bottom), (-length - 0.87 * bottom, 0.5 * bottom), (-length - bottom, 0.0)]
    along, half = np.array(rows).T
    return np.column_stack([along, half, half, 0 * half, 0 * half])
