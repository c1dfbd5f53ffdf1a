"""One camera's image of a scene: the room rendered once, moving things composited by depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calib.types import F32, I32, I64
from planview.synthetic.camera import CameraView
from planview.synthetic.light import (
    CONTACT_M,
    Hits,
    LightStack,
    Shader,
    Surfaces,
    Tracer,
    ball_samples,
    hemisphere,
    mirror_rays,
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
        self._scene = scene
        self._view = view
        self._palette = palette
        self._static = static
        self._solid = Tracer(static)
        self._shader = Shader(scene, self._solid, Tracer(furniture))
        self._rays = view.rays()
        self._pixel_rad = 1 / view.focal_px
        n = len(self._rays)
        lamps = len(scene.lights.lamps)
        self._unshaded: list[F32 | None] = [None] * lamps
        self._room = LightStack(n, lamps)
        self._mirror = LightStack(n, lamps)
        to_right, to_below = view.ray_steps(self._rays)
        for k in range(STATIC_SAMPLES**2):
            # One of the rays of every pixel, with its own sample of every lamp.
            down, right = divmod(k, STATIC_SAMPLES)
            right_px = np.float32((right + 0.5) / STATIC_SAMPLES - 0.5)
            down_px = np.float32((down + 0.5) / STATIC_SAMPLES - 0.5)
            self._render_static(self._rays + right_px * to_right + down_px * to_below, k)
        self._keep_centres()

    def _render_static(self, rays: F32, k: int) -> None:
        """Add what the k-th ray of every pixel sees, and what glossy floors mirror there."""
        share = np.float32(1 / STATIC_SAMPLES**2)
        hit, at = self._see(rays, 1 / (self._view.focal_px * STATIC_SAMPLES))
        self._add(self._room, hit, at, np.full(len(hit), share, np.float32), k)
        glossy = np.flatnonzero(at.gloss > 0)
        if len(glossy) == 0:
            return
        onward = mirror_rays(rays[hit], at)[glossy]
        mirror_hit, mirror_at = self._see(onward, self._pixel_rad)
        weight = share * at.gloss[glossy][mirror_hit]
        self._add(self._mirror, hit[glossy][mirror_hit], mirror_at, weight, k)

    def _see(self, rays: F32, pixel_rad: float) -> tuple[I64, Surfaces]:
        hits = self._solid.cast(rays)
        hit = np.flatnonzero(hits.is_hit)
        return hit, surfaces(hits, self._static, rays, self._palette, pixel_rad, hit)

    def _add(self, stack: LightStack, index: I64, at: Surfaces, weight: F32, k: int) -> None:
        lamps = self._shader.lamps(at, ball_samples(STATIC_SAMPLES**2)[k : k + 1])
        stack.add(index, at, weight, self._shader.open_share(at, k), lamps)

    def _keep_centres(self) -> None:
        """Store what compositing, shadows and mirroring need of the pixel centres."""
        self._depth = self._solid.cast(self._rays).depth
        hit, at = self._see(self._rays, self._pixel_rad)
        self._points = np.zeros((len(self._rays), 3), np.float32)
        self._normals = np.zeros_like(self._points)
        self._points[hit] = at.points
        self._normals[hit] = at.normals
        glossy = np.flatnonzero(at.gloss > 0)
        self._glossy = hit[glossy]
        self._gloss = at.gloss[glossy]
        self._onward = mirror_rays(self._rays[hit], at)[glossy]
        self._onward_depth = self._solid.cast(self._onward).depth

    def room_mean(self) -> float:
        """Mean linear level of the empty room at the start, for the automatic exposure."""
        return float(self._room.radiance(self._scene, 0.0, self._unshaded, None).mean())

    def render(self, actors: list[Actor], t: float) -> Layer:
        """The frame at a time [s]."""
        meshes = [actor.mesh for actor in actors]
        moving = Tracer(join(meshes) if meshes else None)
        linear = self._light_room(t, moving)
        depth, owner, silhouettes = self._composite(actors)
        alone = []
        boxes = []
        for k, (index, hits) in enumerate(silhouettes):
            alone.append(int(hits.is_hit.sum()))
            boxes.append(self._box(index[hits.is_hit]))
            shown = np.flatnonzero(owner[index] == k + 1)
            if len(shown):
                at = surfaces(hits, actors[k].mesh, self._rays[index], self._palette, self._pixel_rad, shown)
                linear[index[shown]] = self._shader.colour(at, t, moving)
        shape = (self._view.height, self._view.width)
        image = linear.reshape(*shape, 3)
        return Layer(image, depth.reshape(shape), owner.reshape(shape), alone, boxes)

    def owner(self, actors: list[Actor]) -> I32:
        """(H, W) int32 ``Layer.owner`` of a frame, without its light."""
        _, owner, _ = self._composite(actors)
        return owner.reshape(self._view.height, self._view.width)

    def _composite(self, actors: list[Actor]) -> tuple[F32, I32, list[tuple[I64, Hits]]]:
        """(N,) depth and owner of every pixel, and where each actor may be with its hits there."""
        depth = self._depth.copy()
        owner = np.zeros(len(self._depth), np.int32)
        silhouettes = [self._cast_actor(actor) for actor in actors]
        for k, (index, hits) in enumerate(silhouettes):
            nearer = np.flatnonzero(hits.depth < depth[index])
            depth[index[nearer]] = hits.depth[nearer]
            owner[index[nearer]] = k + 1
        return depth, owner, silhouettes

    def _light_room(self, t: float, moving: Tracer) -> F32:
        """(N, 3) linear BGR of the room without the moving things, but with their shadows and mirror images."""
        open_share = None
        shares = list(self._unshaded)
        if moving.mesh is not None:
            open_share = self._contact_shadow(moving, moving.mesh)
            for k, lamp in enumerate(self._scene.lights.lamps):
                if lamp.shadows:
                    shares[k] = self._shadow(lamp, self._room.lit[k], moving)
        linear = self._room.radiance(self._scene, t, shares, open_share)
        if len(self._glossy):
            linear += self._mirror_image(t, moving)
        return linear

    def _contact_shadow(self, moving: Tracer, mesh: Mesh) -> F32:
        """(N,) share of ambient light that moving things leave."""
        index = self._coarse(CONTACT_STEP)
        low = mesh.vertices.min(axis=0) - CONTACT_M
        high = mesh.vertices.max(axis=0) + CONTACT_M
        points = self._points[index]
        is_near = ((points > low) & (points < high)).all(axis=1)
        near = np.flatnonzero(is_near)
        seen = np.ones(len(index), np.float32)
        seen[near] = openness(moving, points[near], self._normals[index[near]], hemisphere(8, 0))
        return self._enlarge(seen, CONTACT_STEP)

    def _mirror_image(self, t: float, moving: Tracer) -> F32:
        """Light mirrored by glossy floors, moving things included."""
        image = self._mirror.radiance(self._scene, t, self._unshaded, None)
        if moving.mesh is not None:
            hits = moving.cast(self._onward)
            shown = np.flatnonzero(hits.depth < self._onward_depth)
            if len(shown):
                at = surfaces(hits, moving.mesh, self._onward, self._palette, self._pixel_rad, shown)
                colour = self._shader.colour(at, t, moving)
                image[self._glossy[shown]] = colour * self._gloss[shown, None]
        # Floors are never perfect mirrors.
        blurred = cv2.GaussianBlur(image.reshape(self._view.height, self._view.width, 3), (0, 0), 1.2)
        return np.asarray(blurred.reshape(-1, 3), np.float32)

    def _shadow(self, lamp: Light, lit: F32, moving: Tracer) -> F32:
        """(N,) visibility of a lamp past moving things."""
        index = self._coarse(SHADOW_STEP)
        is_lit = lit[index].max(axis=1) > 1e-3
        seen = np.ones(len(index), np.float32)
        seen[is_lit] = self._visibility(lamp, index[is_lit], 1, moving)
        # Only the rims of shadows need more than the lamp's centre.
        hard = seen.reshape(self._coarse_shape(SHADOW_STEP))
        kernel = np.ones((PENUMBRA, PENUMBRA), np.uint8)
        changes = cv2.dilate(hard, kernel) != cv2.erode(hard, kernel)
        is_rim = changes.ravel() & is_lit
        seen[is_rim] = self._visibility(lamp, index[is_rim], 6, moving)
        return self._enlarge(seen, SHADOW_STEP)

    def _visibility(self, lamp: Light, pixels: I64, samples: int, moving: Tracer) -> F32:
        return visibility(lamp, [moving], self._points[pixels], self._normals[pixels], ball_samples(samples))

    def _coarse(self, step: int) -> I64:
        """Pixels of every step-th row and column."""
        rows = np.arange(0, self._view.height, step)
        columns = np.arange(0, self._view.width, step)
        return self._pixels(rows, columns)

    def _coarse_shape(self, step: int) -> tuple[int, int]:
        """Numbers of every step-th row and column."""
        return -(-self._view.height // step), -(-self._view.width // step)

    def _pixels(self, rows: I64, columns: I64) -> I64:
        """Index of every pixel of rows and columns."""
        return (rows[:, None] * self._view.width + columns).ravel()

    def _enlarge(self, values: F32, step: int) -> F32:
        """Values of every step-th pixel for all, linear between."""
        small = values.reshape(self._coarse_shape(step))
        to_full = np.array([[step, 0, 0], [0, step, 0]], np.float64)
        size = self._view.width, self._view.height
        full = cv2.warpAffine(small, to_full, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(full, np.float32).ravel()

    def _cast_actor(self, actor: Actor) -> tuple[I64, Hits]:
        """Pixels that may show an actor, and its hits there."""
        (left, top), (right, bottom) = _bounds(self._view, actor.mesh)
        index = self._pixels(np.arange(top, bottom), np.arange(left, right))
        return index, Tracer(actor.mesh).cast(self._rays[index])

    def _box(self, pixels: I64) -> Box:
        if len(pixels) == 0:
            return (np.nan, np.nan, np.nan, np.nan)
        rows, columns = np.divmod(pixels, self._view.width)
        width = np.ptp(columns) + 1
        height = np.ptp(rows) + 1
        return float(columns.min()), float(rows.min()), float(width), float(height)


def _bounds(view: CameraView, mesh: Mesh) -> tuple[tuple[int, int], tuple[int, int]]:
    """Pixels (from inclusive, to exclusive) around a mesh; the whole image when it reaches behind the camera."""
    local = view.room_SE3_camera.inverse() @ mesh.vertices.astype(np.float64)
    if (local[:, 2] < 0.05).all():
        return (0, 0), (0, 0)
    size = view.width, view.height
    pixels = view.project(local)
    if (local[:, 2] < 0.3).any() or not np.isfinite(pixels).all():
        return (0, 0), size
    low = np.floor(pixels.min(axis=0)) - 1
    high = np.ceil(pixels.max(axis=0)) + 2
    left, top = np.clip(low, 0, size).astype(int).tolist()
    right, bottom = np.clip(high, 0, size).astype(int).tolist()
    return (left, top), (right, bottom)
