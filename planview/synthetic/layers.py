"""One camera's image of a scene: the room rendered once, moving things composited by depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import F32, I32, I64
from planview.synthetic.camera import CameraView
from planview.synthetic.light import (
    Hits,
    LightStack,
    Shader,
    Surfaces,
    Tracer,
    ball_samples,
    hemisphere,
    mirrored,
    openness,
    surfaces,
    visibility,
)
from planview.synthetic.mesh import Mesh, join
from planview.synthetic.people import Actor
from planview.synthetic.scene import Light, Scene
from planview.synthetic.texture import Palette

STATIC_SAMPLES = 3
"""Rays per pixel and direction for what does not move."""
SHADOW_STEP = 2
"""Shadows of moving things on the room are traced on every second pixel and interpolated."""
PENUMBRA = 13
"""Widest soft rim of a shadow, in those second pixels."""
CONTACT_STEP = 4
"""Their soft contact shadows on every fourth."""

Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Layer:
    """One rendered frame of one camera, before the sensor.

    Attributes:
        linear: (H, W, 3) float32 linear BGR.
        depth: (H, W) float32 [m] of the pixel centres; inf where nothing is.
        owner: (H, W) int32, index into the frame's actors plus one; 0 for the room.
        alone: per actor, the number of pixels it covers when nothing hides it.
        boxes: per actor, left, top, width, height of that silhouette [px]; NaN when out of view.
    """

    linear: F32
    depth: F32
    owner: I32
    alone: list[int]
    boxes: list[Box]


class ViewRenderer:
    """Renders frames of one view."""

    def __init__(self, scene: Scene, view: CameraView, static: Mesh, furniture: Mesh | None, palette: Palette) -> None:
        """``furniture`` is the part of ``static`` that shades the sun."""
        self._scene, self._view, self._palette, self._static = scene, view, palette, static
        self._solid = Tracer(static)
        self._shader = Shader(scene, self._solid, Tracer(furniture))
        self._rays = view.rays()
        steps = view.ray_steps(self._rays)
        n, lamps = view.width * view.height, len(scene.lights.lamps)
        self._room, self._mirror = LightStack(n, lamps), LightStack(n, lamps)
        s, index = STATIC_SAMPLES, np.arange(n)
        share = np.float32(1 / (s * s))
        for k in range(s * s):
            # One of the rays of every pixel, with its own sample of every lamp.
            right, down = (k % s + 0.5) / s - 0.5, (k // s + 0.5) / s - 0.5
            rays = self._rays + np.float32(right) * steps[0] + np.float32(down) * steps[1]
            hit, at = self._see(rays, 1 / (self._view.focal_px * s))
            self._add(self._room, index[hit], at, np.full(len(hit), share, np.float32), k)
            glossy = np.flatnonzero(at.gloss > 0)
            if len(glossy):
                onward = mirrored(rays[hit], at)[glossy]
                hit2, at2 = self._see(onward, 1 / self._view.focal_px)
                self._add(self._mirror, index[hit][glossy][hit2], at2, share * at.gloss[glossy][hit2], k)
        self._keep_centres()

    def _see(self, rays: F32, pixel_rad: float) -> tuple[I64, Surfaces]:
        hits = self._solid.cast(rays)
        hit = np.flatnonzero(hits.found)
        return hit, surfaces(hits, self._static, rays, self._palette, pixel_rad, hit)

    def _add(self, stack: LightStack, index: I64, at: Surfaces, weight: F32, k: int) -> None:
        lamps = self._shader.lamps(at, ball_samples(STATIC_SAMPLES**2)[k : k + 1])
        stack.add(index, at, weight, self._shader.open_share(at, k), lamps)

    def _keep_centres(self) -> None:
        """What compositing, shadows and mirroring need to know of the pixel centres."""
        self._depth = self._solid.cast(self._rays).depth
        hit, at = self._see(self._rays, 1 / self._view.focal_px)
        n = len(self._rays)
        self._points, self._normals = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32)
        self._points[hit], self._normals[hit] = at.points, at.normals
        glossy = np.flatnonzero(at.gloss > 0)
        self._glossy, self._gloss = hit[glossy], at.gloss[glossy]
        self._onward = mirrored(self._rays[hit], at)[glossy]
        self._onward_depth = self._solid.cast(self._onward).depth

    def room_mean(self) -> float:
        """Mean linear level of the empty room at the start, for the automatic exposure."""
        return float(self._room.radiance(self._scene, 0.0, [None] * len(self._scene.lights.lamps), None).mean())

    def render(self, actors: list[Actor], t: float) -> Layer:
        """The frame at a time [s]."""
        moving = Tracer(join([a.mesh for a in actors]) if actors else None)
        linear = self._lit_room(t, moving)
        depth, owner, found = self._composited(actors)
        for k, (index, hits) in enumerate(found):
            mine = np.flatnonzero(owner[index] == k + 1)
            if len(mine):
                rays, pixel = self._rays[index], 1 / self._view.focal_px
                at = surfaces(hits, actors[k].mesh, rays, self._palette, pixel, mine)
                linear[index[mine]] = self._shader.colour(at, t, moving)
        shape = (self._view.height, self._view.width)
        alone = [int(hits.found.sum()) for _, hits in found]
        boxes = [self._box(index[hits.found]) for index, hits in found]
        return Layer(linear.reshape(*shape, 3), depth.reshape(shape), owner.reshape(shape), alone, boxes)

    def owner(self, actors: list[Actor]) -> I32:
        """(H, W) int32 ``Layer.owner`` of a frame, without its light."""
        return self._composited(actors)[1].reshape(self._view.height, self._view.width)

    def _composited(self, actors: list[Actor]) -> tuple[F32, I32, list[tuple[I64, Hits]]]:
        """(N,) depth and owner of every pixel, and where each actor may be with its hits there."""
        depth, owner = self._depth.copy(), np.zeros(len(self._depth), np.int32)
        found = [self._cast_actor(actor) for actor in actors]
        for k, (index, hits) in enumerate(found):
            nearer = np.flatnonzero(hits.depth < depth[index])
            depth[index[nearer]] = hits.depth[nearer]
            owner[index[nearer]] = k + 1
        return depth, owner, found

    def _lit_room(self, t: float, moving: Tracer) -> F32:
        lamps, open_share = self._scene.lights.lamps, None
        shares: list[F32 | None] = [None] * len(lamps)
        if moving.mesh is not None:
            shares = [
                self._shadow(lamp, lit, moving) if lamp.shadows else None
                for lamp, lit in zip(lamps, self._room.lit, strict=True)
            ]
            # (N,) share of ambient light that moving things leave.
            index = self._coarse(CONTACT_STEP)
            reach = 0.8
            low, high = moving.mesh.vertices.min(axis=0) - reach, moving.mesh.vertices.max(axis=0) + reach
            points = self._points[index]
            near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
            seen = np.ones(len(index), np.float32)
            seen[near] = openness(moving, points[near], self._normals[index[near]], hemisphere(8, 0))
            open_share = self._enlarge(seen, CONTACT_STEP)
        linear = self._room.radiance(self._scene, t, shares, open_share)
        if len(self._glossy):
            linear += self._mirrored(t, moving)
        return linear

    def _mirrored(self, t: float, moving: Tracer) -> F32:
        """Light mirrored by glossy floors, moving things included."""
        image = self._mirror.radiance(self._scene, t, [None] * len(self._scene.lights.lamps), None)
        if moving.mesh is not None:
            hits = moving.cast(self._onward)
            mine = np.flatnonzero(hits.depth < self._onward_depth)
            if len(mine):
                at = surfaces(hits, moving.mesh, self._onward, self._palette, 1 / self._view.focal_px, mine)
                colour = self._shader.colour(at, t, moving)
                image[self._glossy[mine]] = colour * self._gloss[mine, None]
        h, w = self._view.height, self._view.width
        # Floors are never perfect mirrors.
        blurred = cv2.GaussianBlur(image.reshape(h, w, 3), (0, 0), 1.2)
        return np.asarray(blurred.reshape(-1, 3), np.float32)

    def _shadow(self, lamp: Light, lit: F32, moving: Tracer) -> F32:
        """(N,) visibility of a lamp past moving things."""
        index = self._coarse(SHADOW_STEP)
        lit_up = lit[index].max(axis=1) > 1e-3
        seen = np.ones(len(index), np.float32)
        seen[lit_up] = self._seen(lamp, index[lit_up], 1, moving)
        # Only the rims of shadows need more than the lamp's centre.
        shape = -(-self._view.height // SHADOW_STEP), -(-self._view.width // SHADOW_STEP)
        hard, kernel = seen.reshape(shape), np.ones((PENUMBRA, PENUMBRA), np.uint8)
        rim = (cv2.dilate(hard, kernel) != cv2.erode(hard, kernel)).ravel() & lit_up
        seen[rim] = self._seen(lamp, index[rim], 6, moving)
        return self._enlarge(seen, SHADOW_STEP)

    def _seen(self, lamp: Light, pixels: I64, samples: int, moving: Tracer) -> F32:
        return visibility(lamp, [moving], self._points[pixels], self._normals[pixels], ball_samples(samples))

    def _coarse(self, step: int) -> I64:
        """Pixels of every step-th row and column."""
        rows, cols = np.arange(0, self._view.height, step), np.arange(0, self._view.width, step)
        return np.asarray((rows[:, None] * self._view.width + cols).ravel(), np.int64)

    def _enlarge(self, values: F32, step: int) -> F32:
        """Values of every step-th pixel for all, linear between."""
        h, w = self._view.height, self._view.width
        small = values.reshape(-(-h // step), -(-w // step))
        to_full = np.array([[step, 0, 0], [0, step, 0]], np.float64)
        full = cv2.warpAffine(small, to_full, (w, h), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(full, np.float32).ravel()

    def _cast_actor(self, actor: Actor) -> tuple[I64, Hits]:
        """Pixels that may show an actor, and its hits there."""
        (left, top), (right, bottom) = _bounds(self._view, actor.mesh)
        rows, cols = np.arange(top, bottom), np.arange(left, right)
        index = np.asarray((rows[:, None] * self._view.width + cols).ravel(), np.int64)
        return index, Tracer(actor.mesh).cast(self._rays[index])

    def _box(self, pixels: I64) -> Box:
        if len(pixels) == 0:
            return (np.nan, np.nan, np.nan, np.nan)
        places = np.stack(np.divmod(pixels, self._view.width))
        (top, left), (height, width) = places.min(axis=1).tolist(), (np.ptp(places, axis=1) + 1).tolist()
        return float(left), float(top), float(width), float(height)


def _bounds(view: CameraView, mesh: Mesh) -> tuple[tuple[int, int], tuple[int, int]]:
    """Pixels (from inclusive, to exclusive) around a mesh; the whole image when it reaches behind the camera."""
    local = view.room_SE3_camera.inverse() @ mesh.vertices.astype(np.float64)
    if (local[:, 2] < 0.05).all():
        return (0, 0), (0, 0)
    uv, size = view.project(local), (view.width, view.height)
    if (local[:, 2] < 0.3).any() or not np.isfinite(uv).all():
        return (0, 0), size
    low, high = np.clip([np.floor(uv.min(axis=0)) - 1, np.ceil(uv.max(axis=0)) + 2], 0, size).astype(int).tolist()
    return (low[0], low[1]), (high[0], high[1])
