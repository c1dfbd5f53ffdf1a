"""What rays see: surfaces at hits, and the room's light per source so that lamps can be dimmed later."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.types import F32, F64, I64
from planview.synthetic.lighting import ambient, colour_of, hemisphere, irradiance, level_at, openness, visibility
from planview.synthetic.scene import Scene
from planview.synthetic.shapes import Mesh
from planview.synthetic.texture import Palette
from planview.synthetic.tracing import EPSILON_M, Hits, Tracer


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
    """What the chosen rays hit; ``pixel_rad`` is the angle of a pixel."""
    direction, depth = rays[chosen, 3:], hits.depth[chosen]
    points = rays[chosen, :3] + direction * depth[:, None]
    normals = hits.interpolate(mesh, mesh.normals, chosen)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    length = np.linalg.norm(direction, axis=1)
    facing = np.einsum("ij,ij->i", normals, direction) / length
    normals[facing > 0] *= -1
    # Between the footprint across and along the view: textures stay visible on floors seen at a low angle.
    footprint = depth * length * pixel_rad / np.sqrt(np.clip(np.abs(facing), 0.08, 1.0))
    material = mesh.material[hits.triangle[chosen]]
    albedo = palette.albedo(material, hits.interpolate(mesh, mesh.local, chosen), footprint.astype(np.float32))
    return Surfaces(points.astype(np.float32), normals, albedo, palette.emission[material], palette.gloss[material])


def mirrored(rays: F32, at: Surfaces) -> F32:
    """(N, 6) rays that leave glossy surfaces towards what they mirror."""
    direction = rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    out = direction - 2 * np.einsum("ij,ij->i", direction, at.normals)[:, None] * at.normals
    return np.concatenate([at.points + EPSILON_M * at.normals, out], axis=1).astype(np.float32)


class LightStack:
    """Radiance towards the camera per light source at nominal level; arrays (N, 3) float32 linear BGR.

    Attributes:
        glow: of surfaces that shine by themselves.
        ambient: under ambient light of level 1.
        lit: one per lamp.
    """

    def __init__(self, n: int, lamps: int) -> None:
        self.glow, self.ambient = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        self.lit = [np.zeros((n, 3), np.float32) for _ in range(lamps)]

    def add(self, index: I64, at: Surfaces, weight: F32, open_share: F32, lamps: list[F32]) -> None:
        """Add surfaces seen by pixels ``index`` (each at most once).

        Args:
            index: (N,) pixels.
            at: (N,) surfaces.
            weight: (N,) share of the pixel.
            open_share: (N,) ambient light that reaches the surface.
            lamps: per lamp (N, 3) light that reaches it.
        """
        albedo = at.albedo * weight[:, None]
        self.glow[index] += albedo * at.emission[:, None]
        self.ambient[index] += albedo * (ambient(at.normals) * open_share)[:, None]
        for own, light in zip(self.lit, lamps, strict=True):
            own[index] += albedo * light

    def radiance(self, scene: Scene, t: float, shares: list[F32 | None], open_share: F32 | None) -> F32:
        """(N, 3) at a time, with (N,) visibilities of lamps and ambient light past moving things."""
        lights = scene.lights
        level = np.float32(lights.ambient * level_at(lights.ambient_dim, t))
        total = self.glow + self.ambient * (level if open_share is None else (level * open_share)[:, None])
        for lamp, lit, share in zip(lights.lamps, self.lit, shares, strict=True):
            dim = np.float32(level_at(lamp.dim, t))
            if dim > 0:
                total += lit * (dim if share is None else (dim * share)[:, None])
        return np.asarray(total, np.float32)


class Shader:
    """Light on surfaces of a scene, past what does not move."""

    def __init__(self, scene: Scene, solid: Tracer, furniture: Tracer) -> None:
        self._scene, self._solid, self._furniture = scene, solid, furniture

    def lamps(self, at: Surfaces, samples: F64, moving: Tracer | None = None) -> list[F32]:
        """Per lamp (N, 3) light at nominal level; samples (S, 3) of the lamps' balls decide shadows."""
        result = []
        for lamp in self._scene.lights.lamps:
            light = irradiance(lamp, self._scene.room, at.points, at.normals)
            lit = np.flatnonzero(light > 1e-4)
            if lamp.shadows and len(lit):
                # The sun comes from outside: walls and ceiling do not shade it.
                blockers = [self._furniture if lamp.kind == "sun" else self._solid]
                blockers += [moving] if moving is not None else []
                light[lit] *= visibility(lamp, blockers, at.points[lit], at.normals[lit], samples)
            result.append(np.asarray(light[:, None] * colour_of(lamp), np.float32))
        return result

    def open_share(self, at: Surfaces, turn: int) -> F32:
        """(N,) share of a few directions in which nothing is near; ``turn`` varies the directions."""
        return openness(self._solid, at.points, at.normals, hemisphere(4, turn))

    def colour(self, at: Surfaces, t: float, moving: Tracer) -> F32:
        """(N, 3) radiance of moving surfaces at a time."""
        lights = self._scene.lights
        total = (ambient(at.normals) * np.float32(lights.ambient * level_at(lights.ambient_dim, t)))[:, None]
        for lamp, light in zip(lights.lamps, self.lamps(at, np.zeros((1, 3)), moving), strict=True):
            total = total + light * np.float32(level_at(lamp.dim, t))
        return np.asarray(at.albedo * (total + at.emission[:, None]), np.float32)
