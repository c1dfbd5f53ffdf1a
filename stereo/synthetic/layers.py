"""One camera's image of a scene: the room rendered once, moving things composited by depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import F32, I32, Bool
from stereo.synthetic.actors import Actor
from stereo.synthetic.lighting import ambient, ball_samples, colour_of, irradiance, level_at, visibility
from stereo.synthetic.scene import Scene
from stereo.synthetic.shapes import Mesh, join
from stereo.synthetic.texture import Palette
from stereo.synthetic.tracing import Hits, Tracer
from stereo.synthetic.view import View

STATIC_SAMPLES = 3
"""Rays per pixel and direction for what does not move."""
SHADOW_SAMPLES = 4
SHADOW_STEP = 2
"""Shadows of moving things on the room are traced on every second pixel and interpolated."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Shading inputs at hits: points, unit normals facing the viewer, albedo, emission; (N, 3), (N,) for the last."""

    points: F32
    normals: F32
    albedo: F32
    emission: F32


def surfaces(hits: Hits, mesh: Mesh, rays: F32, palette: Palette, focal_px: float, chosen: I32) -> Surfaces:
    """What the chosen rays hit."""
    direction, depth = rays[chosen, 3:], hits.depth[chosen]
    points = rays[chosen, :3] + direction * depth[:, None]
    normals = hits.interpolate(mesh, mesh.normals, chosen)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    length = np.linalg.norm(direction, axis=1)
    facing = np.einsum("ij,ij->i", normals, direction) / length
    normals[facing > 0] *= -1
    footprint = depth * length / focal_px / np.sqrt(np.clip(np.abs(facing), 0.08, 1.0))
    material = mesh.material[hits.triangle[chosen]]
    albedo = palette.albedo(material, hits.interpolate(mesh, mesh.local, chosen), footprint.astype(np.float32))
    emission = np.array([m.emission for m in palette.materials], np.float32)[material]
    return Surfaces(points.astype(np.float32), normals, albedo, emission)


@dataclass(frozen=True, eq=False)
class Layer:
    """One rendered frame of one camera, before the sensor.

    Attributes:
        linear: (H, W, 3) float32 linear BGR.
        depth: (H, W) float32 [m] of the pixel centres; inf where nothing is.
        owner: (H, W) int32, index into the frame's actors plus one; 0 for the room.
        alone: per actor, the number of pixels it covers when nothing hides it.
        boxes: per actor, (left, top, width, height) of that alone silhouette [px], NaN when out of view.
    """

    linear: F32
    depth: F32
    owner: I32
    alone: list[int]
    boxes: list[tuple[float, float, float, float]]


class ViewRenderer:
    """Renders frames of one view."""

    def __init__(self, scene: Scene, view: View, static: Mesh, shades: Mesh | None, palette: Palette) -> None:
        """``shades`` is the furniture alone, which also shades the sun."""
        self._scene, self._view, self._palette, self._static = scene, view, palette, static
        self._solid, self._furniture = Tracer(static), Tracer(shades)
        self._rays = view.rays(view.pixels())
        self._lamps = scene.lights.lamps
        self._render_static()

    def _blockers(self, index: int) -> list[Tracer]:
        return [self._furniture if self._lamps[index].kind == "sun" else self._solid]

    def _render_static(self) -> None:
        n, s = self._view.width * self._view.height, STATIC_SAMPLES
        self._glow, self._ambient = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        self._lit = [np.zeros((n, 3), np.float32) for _ in self._lamps]
        samples = ball_samples(s * s)
        for k in range(s * s):
            offset = ((k % s + 0.5) / s - 0.5, (k // s + 0.5) / s - 0.5)
            rays = self._view.rays(self._view.pixels(offset))
            hits = self._solid.cast(rays)
            chosen = np.flatnonzero(hits.found)
            at = surfaces(hits, self._static, rays, self._palette, self._view.focal_px * s, chosen)
            share = np.float32(1 / (s * s))
            self._glow[chosen] += share * at.albedo * at.emission[:, None]
            self._ambient[chosen] += share * at.albedo * ambient(at.normals)[:, None]
            for i, lamp in enumerate(self._lamps):
                light = irradiance(lamp, self._scene.room, at.points, at.normals)
                lit = np.flatnonzero(light > 1e-4)
                if lamp.shadows:
                    light[lit] *= visibility(
                        lamp, self._blockers(i), at.points[lit], at.normals[lit], samples[k : k + 1]
                    )
                self._lit[i][chosen] += share * at.albedo * light[:, None] * colour_of(lamp)
        self._keep_centres()

    def _keep_centres(self) -> None:
        """Depth, points and normals of the pixel centres, for compositing and shadows."""
        hits = self._solid.cast(self._rays)
        self._depth = hits.depth
        found = np.flatnonzero(hits.found)
        self._points = np.zeros((len(hits.depth), 3), np.float32)
        self._normals = np.zeros_like(self._points)
        at = surfaces(hits, self._static, self._rays, self._palette, self._view.focal_px, found)
        self._points[found], self._normals[found] = at.points, at.normals

    def static_mean(self) -> float:
        """Mean linear level of the empty room at the start, for the automatic exposure."""
        return float(self._room(0.0, Tracer(None)).mean())

    def _room(self, t: float, moving: Tracer) -> F32:
        lights = self._scene.lights
        linear = self._glow + self._ambient * np.float32(lights.ambient * level_at(lights.ambient_dim, t))
        for lamp, lit in zip(self._lamps, self._lit, strict=True):
            dim = np.float32(level_at(lamp.dim, t))
            if dim == 0:
                continue
            if lamp.shadows and moving.mesh is not None:
                linear += lit * (dim * self._shade(lamp, lit, moving))[:, None]
            else:
                linear += lit * dim
        return np.asarray(linear, np.float32)

    def _shade(self, lamp: object, lit: F32, moving: Tracer) -> F32:
        """(N,) visibility of a lamp past moving things, for every pixel of the room."""
        h, w, step = self._view.height, self._view.width, SHADOW_STEP
        rows, cols = np.arange(0, h, step), np.arange(0, w, step)
        index = (rows[:, None] * w + cols).ravel()
        chosen = np.flatnonzero(lit[index].max(axis=1) > 1e-3)
        seen = np.ones(len(index), np.float32)
        pick = index[chosen]
        seen[chosen] = visibility(
            lamp,
            [moving],
            self._points[pick],
            self._normals[pick],
            ball_samples(SHADOW_SAMPLES),  # type: ignore[arg-type]
        )
        small = seen.reshape(len(rows), len(cols))
        grid_u = (np.arange(w, dtype=np.float32) / step)[None, :].repeat(h, 0)
        grid_v = (np.arange(h, dtype=np.float32) / step)[:, None].repeat(w, 1)
        full = cv2.remap(small, grid_u, grid_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(full, np.float32).ravel()

    def render(self, actors: list[Actor], t: float) -> Layer:
        """The frame at a time [s]."""
        moving = Tracer(join([a.mesh for a in actors]) if actors else None)
        linear = self._room(t, moving)
        depth, owner = self._depth.copy(), np.zeros(len(self._depth), np.int32)
        alone, boxes, found = [], [], []
        for k, actor in enumerate(actors):
            index, hits = self._cast_actor(actor)
            covered = hits.found
            alone.append(int(covered.sum()))
            boxes.append(self._box(index[covered]))
            nearer = np.flatnonzero(hits.depth < depth[index])
            depth[index[nearer]] = hits.depth[nearer]
            owner[index[nearer]] = k + 1
            found.append((index, hits))
        for k, (index, hits) in enumerate(found):
            mine = np.flatnonzero(owner[index] == k + 1)
            if len(mine):
                linear[index[mine]] = self._shade_actor(actors[k].mesh, index, hits, mine, moving, t)
        shape = (self._view.height, self._view.width)
        return Layer(linear.reshape(*shape, 3), depth.reshape(shape), owner.reshape(shape), alone, boxes)

    def _cast_actor(self, actor: Actor) -> tuple[I32, Hits]:
        """Pixels that may show an actor, and its hits there."""
        w, h = self._view.width, self._view.height
        low, high = _bounds(self._view, actor.mesh, w, h)
        cols, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])
        index = (rows[:, None] * w + cols).ravel().astype(np.int32)
        return index, Tracer(actor.mesh).cast(self._rays[index])

    def _box(self, pixels: I32) -> tuple[float, float, float, float]:
        if len(pixels) == 0:
            return (np.nan,) * 4
        rows, cols = np.divmod(pixels, self._view.width)
        left, top = int(cols.min()), int(rows.min())
        return float(left), float(top), float(cols.max() - left + 1), float(rows.max() - top + 1)

    def _shade_actor(self, mesh: Mesh, index: I32, hits: Hits, mine: Bool | I32, moving: Tracer, t: float) -> F32:
        rays = self._rays[index]
        at = surfaces(hits, mesh, rays, self._palette, self._view.focal_px, np.asarray(mine, np.int32))
        lights = self._scene.lights
        total = (ambient(at.normals) * lights.ambient * level_at(lights.ambient_dim, t))[:, None].repeat(3, 1)
        for i, lamp in enumerate(self._lamps):
            light = irradiance(lamp, self._scene.room, at.points, at.normals) * level_at(lamp.dim, t)
            lit = np.flatnonzero(light > 1e-3)
            if lamp.shadows:
                blockers = [*self._blockers(i), moving]
                light[lit] *= visibility(lamp, blockers, at.points[lit], at.normals[lit], ball_samples(1))
            total = total + light[:, None] * colour_of(lamp)
        return np.asarray(at.albedo * total, np.float32)


def _bounds(view: View, mesh: Mesh, width: int, height: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Pixels (from inclusive, to exclusive) around a mesh; the whole image when it reaches behind the camera."""
    local = view.room_SE3_camera.inverse() @ mesh.vertices.astype(np.float64)
    if (local[:, 2] < 0.05).all():
        return (0, 0), (0, 0)
    uv = view.project(local)
    if (local[:, 2] < 0.3).any() or not np.isfinite(uv).all():
        return (0, 0), (width, height)
    low = np.clip(np.floor(uv.min(axis=0)) - 1, 0, [width, height])
    high = np.clip(np.ceil(uv.max(axis=0)) + 2, 0, [width, height])
    return (int(low[0]), int(low[1])), (int(high[0]), int(high[1]))
