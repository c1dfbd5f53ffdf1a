"""Ray casting, light of lamps, sun and surroundings with shadows, and the surfaces that rays see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.libraries import import_open3d
from calib.types import F32, F64, I32, I64, Bool
from planview.synthetic.mesh import Mesh
from planview.synthetic.room import wall_frame
from planview.synthetic.scene import Keyframes, Light, Room, Scene
from planview.synthetic.texture import Palette, linear_colour

EPSILON_M = 2e-3
"""Shadow rays start this far off their surface."""

NEAR_M = 1.0
"""Lamps are no brighter nearer than this: they are panels, not points, and shine downwards."""

SUN_RAY_M = 60.0
"""Length of shadow rays towards the sun."""

CONTACT_M = 0.8
"""Contact shadows fall on surfaces that are nearer than this."""


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of rays; entries without a hit have infinite depth and zeros elsewhere.

    Attributes:
        depth: (N,) float32, ray parameter (metres of depth for rays with unit camera z).
        triangle: (N,) int32, -1 without a hit.
        u, v: (N,) float32 barycentric weights of the second and third vertex.
    """

    depth: F32
    triangle: I32
    u: F32
    v: F32

    @property
    def is_hit(self) -> Bool:
        return self.triangle >= 0

    def interpolate(self, mesh: Mesh, values: F32, chosen: np.ndarray[Any, Any]) -> F32:
        """Vertex values (V, C) at the chosen hits."""
        first, second, third = mesh.triangles[self.triangle[chosen]].T
        u = self.u[chosen, None]
        v = self.v[chosen, None]
        mixed = values[first] * (1 - u - v) + values[second] * u + values[third] * v
        return np.asarray(mixed, np.float32)


class Tracer:
    """A mesh that rays can be cast against."""

    def __init__(self, mesh: Mesh | None) -> None:
        o3d = import_open3d("rendering")

        self.mesh = mesh
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = None
        if mesh is not None:
            vertices = np.ascontiguousarray(mesh.vertices)
            triangles = np.ascontiguousarray(mesh.triangles.astype(np.uint32))
            self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
            self._scene.add_triangles(self._tensor(vertices), self._tensor(triangles))

    def cast(self, rays: F32) -> Hits:
        """First hits of rays (N, 6)."""
        if self._scene is None or len(rays) == 0:
            zero = np.zeros(len(rays), np.float32)
            far = np.full_like(zero, np.inf)
            nothing = np.full(len(rays), -1, np.int32)
            return Hits(far, nothing, zero, zero)
        answer = self._scene.cast_rays(self._tensor(np.ascontiguousarray(rays)), nthreads=1)
        depth = answer["t_hit"].numpy()
        u, v = answer["primitive_uvs"].numpy().T
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        triangle[~np.isfinite(depth)] = -1
        return Hits(depth, triangle.astype(np.int32), u, v)

    def blocks(self, origins: F32, to: F32) -> Bool:
        """(N,) mask of the origins (N, 3) with something between them and the ends of vectors ``to`` (N, 3)."""
        if self._scene is None or len(origins) == 0:
            return np.zeros(len(origins), np.bool_)
        rays = np.concatenate([origins, to], axis=1).astype(np.float32)
        hit = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=0.999, nthreads=1)
        return np.asarray(hit.numpy(), np.bool_)


def level_at(frames: Keyframes, t: float) -> float:
    """Keyframed value at a time."""
    times_s, values = zip(*frames, strict=True)
    return float(np.interp(t, times_s, values))


def ambient(normals: F32) -> F32:
    """(N,) hemisphere light: the ceiling is brighter than the floor."""
    return np.asarray(0.75 + 0.25 * normals[:, 2], np.float32)


def light_vectors(light: Light, points: F32, offset: F64) -> F32:
    """(N, 3) vectors from points to a sample of the light; offset (3,) in its unit ball."""
    if light.kind == "sun":
        towards = np.asarray(light.towards, np.float64)
        softness = np.tan(np.deg2rad(light.softness_deg))
        direction = -towards / np.linalg.norm(towards) + softness * offset
        return np.broadcast_to((direction * SUN_RAY_M).astype(np.float32), points.shape)
    centre = np.asarray(light.at_m, np.float64) + light.radius_m * offset
    return np.asarray(centre.astype(np.float32) - points, np.float32)


def irradiance(light: Light, room: Room, points: F32, normals: F32) -> F32:
    """(N,) light on surfaces without shadows, before dimming; grey."""
    to = light_vectors(light, points, np.zeros(3))
    distance = np.linalg.norm(to, axis=1)
    along_normal = np.einsum("ij,ij->i", to, normals)
    cosine = np.clip(along_normal / np.maximum(distance, 1e-6), 0, 1)
    if light.kind == "point":
        falloff = (2.0 / np.maximum(distance, NEAR_M)) ** 2
        return np.asarray(light.level * cosine * falloff, np.float32)
    result = light.level * cosine
    if light.window is not None:
        result = result * _through_window(light, room, points, to)
    return np.asarray(result, np.float32)


def _through_window(light: Light, room: Room, points: F32, to: F32) -> F32:
    """1 where the ray to the sun leaves through the window, with soft edges."""
    panel = room.panels[light.window or 0]
    corner, along, inward, _ = wall_frame(room, panel.wall)
    approach = to @ -inward
    distance = (points - corner) @ inward
    t = np.where(approach > 1e-6, distance / np.maximum(approach, 1e-6), np.nan)
    at = points + to * t[:, None] - corner
    across = at @ along - panel.from_m
    above = at[:, 2] - panel.bottom_m
    across_edge = np.minimum(across, panel.width_m - across)
    above_edge = np.minimum(above, panel.height_m - above)
    edge = np.minimum(across_edge, above_edge)
    return np.asarray(np.clip(np.nan_to_num(edge, nan=-1.0) / 0.03 + 0.5, 0, 1), np.float32)


def visibility(light: Light, tracers: list[Tracer], points: F32, normals: F32, samples: F64) -> F32:
    """(N,) share of the light's samples (S, 3) that nothing hides."""
    origins = points + EPSILON_M * normals
    seen = np.zeros(len(points), np.float32)
    for offset in samples:
        to = light_vectors(light, origins, offset)
        is_blocked = np.zeros(len(points), np.bool_)
        for tracer in tracers:
            is_blocked |= tracer.blocks(origins, to)
        seen += ~is_blocked
    return np.asarray(seen / len(samples), np.float32)


def ball_samples(n: int) -> F64:
    """(n, 3) fixed, evenly spread points of the unit ball's shell; one sample is its centre."""
    if n == 1:
        return np.zeros((1, 3))
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    angle = np.pi * (1 + 5**0.5) * k
    radius = np.sqrt(1 - z * z)
    return 0.8 * np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])


def hemisphere(n: int, turn: int) -> F32:
    """(n, 3) cosine-weighted directions about z, turned so that several sets fill the gaps."""
    k = np.arange(n) + 0.5
    radius = np.sqrt(k / n)
    angle = np.pi * (3 - 5**0.5) * (k * (turn + 1)) + 2.4 * turn
    height = np.sqrt(1 - radius * radius)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]).astype(np.float32)


def openness(tracer: Tracer, points: F32, normals: F32, directions: F32) -> F32:
    """(N,) share of directions about the normals in which nothing is within CONTACT_M: soft contact shadows."""
    x_axis = np.array([1, 0, 0], np.float32)
    z_axis = np.array([0, 0, 1], np.float32)
    is_upright = np.abs(normals[:, 2:]) >= 0.9
    side = np.cross(np.where(is_upright, x_axis, z_axis), normals)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    other = np.cross(normals, side)
    origins = points + EPSILON_M * normals
    seen = np.zeros(len(points), np.float32)
    for along_side, along_other, along_normal in directions:
        direction = along_side * side + along_other * other + along_normal * normals
        to = (CONTACT_M * direction).astype(np.float32)
        seen += ~tracer.blocks(origins, to)
    return np.asarray(seen / len(directions), np.float32)


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Shading inputs at hits; (N, 3) float32, the last two (N,).

    Attributes:
        points: room frame [m].
        normals: unit, facing the viewer.
        albedo: linear BGR.
        emission: factor of the albedo that shines by itself.
        gloss: share of mirrored light.
    """

    points: F32
    normals: F32
    albedo: F32
    emission: F32
    gloss: F32


def surfaces(hits: Hits, mesh: Mesh, rays: F32, palette: Palette, pixel_rad: float, chosen: I64) -> Surfaces:
    """Surfaces that the chosen rays hit; ``pixel_rad`` is the angle of a pixel."""
    direction = rays[chosen, 3:]
    depth = hits.depth[chosen]
    points = rays[chosen, :3] + direction * depth[:, None]
    normals = hits.interpolate(mesh, mesh.normals, chosen)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    length = np.linalg.norm(direction, axis=1)
    facing = np.einsum("ij,ij->i", normals, direction) / length
    normals[facing > 0] *= -1
    # Between the footprint across and along the view: textures stay visible on floors seen at a low angle.
    slant = np.sqrt(np.clip(np.abs(facing), 0.08, 1.0))
    footprint = depth * length * pixel_rad / slant
    material = mesh.material[hits.triangle[chosen]]
    local = hits.interpolate(mesh, mesh.local, chosen)
    return Surfaces(
        points=points.astype(np.float32),
        normals=normals,
        albedo=palette.albedo(material, local, footprint.astype(np.float32)),
        emission=palette.emission[material],
        gloss=palette.gloss[material],
    )


def mirror_rays(rays: F32, at: Surfaces) -> F32:
    """(N, 6) rays that leave glossy surfaces towards what they mirror."""
    direction = rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    along_normal = np.einsum("ij,ij->i", direction, at.normals)
    out = direction - 2 * along_normal[:, None] * at.normals
    origins = at.points + EPSILON_M * at.normals
    return np.concatenate([origins, out], axis=1).astype(np.float32)


class LightStack:
    """Radiance towards the camera per light source at nominal level; arrays (N, 3) float32 linear BGR.

    Attributes:
        glow: of surfaces that shine by themselves.
        ambient: under ambient light of level 1.
        lit: one per lamp.
    """

    def __init__(self, n: int, lamps: int) -> None:
        self.glow = np.zeros((n, 3), np.float32)
        self.ambient = np.zeros((n, 3), np.float32)
        self.lit = [np.zeros((n, 3), np.float32) for _ in range(lamps)]

    def add(self, index: I64, at: Surfaces, weight: F32, open_share: F32, lamps: list[F32]) -> None:
        """Add surfaces (N,) seen by pixels ``index``, each at most once: ``weight`` is their share of the pixel,
        ``open_share`` the ambient light and ``lamps`` the (N, 3) light of every lamp that reaches them."""
        albedo = at.albedo * weight[:, None]
        self.glow[index] += albedo * at.emission[:, None]
        self.ambient[index] += albedo * (ambient(at.normals) * open_share)[:, None]
        for lit, light in zip(self.lit, lamps, strict=True):
            lit[index] += albedo * light

    def radiance(self, scene: Scene, t: float, shares: list[F32 | None], open_share: F32 | None) -> F32:
        """(N, 3) at a time, with (N,) visibilities of lamps and ambient light past moving things."""
        lights = scene.lights
        ambient_level = np.float32(lights.ambient * level_at(lights.ambient_dim, t))
        total = self.glow + self.ambient * _pixel_levels(ambient_level, open_share)
        for lamp, lit, share in zip(lights.lamps, self.lit, shares, strict=True):
            level = np.float32(level_at(lamp.dim, t))
            if level > 0:
                total += lit * _pixel_levels(level, share)
        return np.asarray(total, np.float32)


def _pixel_levels(level: np.float32, share: F32 | None) -> np.float32 | F32:
    """A light's level, or (N, 1) levels by the share of it that reaches every pixel."""
    if share is None:
        return level
    return (level * share)[:, None]


class Shader:
    """Light on surfaces of a scene, past what does not move."""

    def __init__(self, scene: Scene, solid: Tracer, furniture: Tracer) -> None:
        self._scene = scene
        self._solid = solid
        self._furniture = furniture

    def lamps(self, at: Surfaces, samples: F64, moving: Tracer | None = None) -> list[F32]:
        """Per lamp (N, 3) light at nominal level; samples (S, 3) of the lamps' balls decide shadows."""
        result = []
        for lamp in self._scene.lights.lamps:
            light = irradiance(lamp, self._scene.room, at.points, at.normals)
            lit = np.flatnonzero(light > 1e-4)
            if lamp.shadows and len(lit):
                # The sun comes from outside: walls and ceiling do not shade it.
                blockers = [self._furniture if lamp.kind == "sun" else self._solid]
                if moving is not None:
                    blockers.append(moving)
                light[lit] *= visibility(lamp, blockers, at.points[lit], at.normals[lit], samples)
            result.append(np.asarray(light[:, None] * linear_colour(lamp.colour), np.float32))
        return result

    def open_share(self, at: Surfaces, turn: int) -> F32:
        """(N,) share of a few directions in which nothing is near; ``turn`` varies the directions."""
        return openness(self._solid, at.points, at.normals, hemisphere(4, turn))

    def colour(self, at: Surfaces, t: float, moving: Tracer) -> F32:
        """(N, 3) radiance of moving surfaces at a time."""
        lights = self._scene.lights
        level = np.float32(lights.ambient * level_at(lights.ambient_dim, t))
        total = (ambient(at.normals) * level)[:, None]
        for lamp, light in zip(lights.lamps, self.lamps(at, np.zeros((1, 3)), moving), strict=True):
            total = total + light * np.float32(level_at(lamp.dim, t))
        return np.asarray(at.albedo * (total + at.emission[:, None]), np.float32)
