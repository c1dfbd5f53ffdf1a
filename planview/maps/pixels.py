"""What one camera saw at every analysis pixel: background, a surface at a distance, or a surface without depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.pose import SE3
from calib.types import F32, F64, I32, U8
from planview.maps.builder import FloorPoints
from planview.maps.colour import CHROMA_CELLS
from stereo.depth import RectifiedGeometry

BACKGROUND_SEEN, SURFACE, NO_DEPTH = 0, 1, 2
"""Kinds of pixels: the background is seen, foreground with depth, foreground without."""
COLOURED = np.arange(256) % CHROMA_CELLS**2 != CHROMA_CELLS**2 // 2
"""(256,) bool, by code: not grey."""

RENEW_S = 30.0
"""Time after which moved furniture has become background (``ForegroundParams.learning_rate``) [s]."""


@dataclass(frozen=True, eq=False)
class PixelRays:
    """The rays of a camera's analysis pixels in the world.

    Attributes:
        centre_m: (3,) float64, the camera's centre [m].
        direction: (H, W, 3) float32 unit vectors away from the camera.
        stretch: (H, W) float32, range along the ray over depth.
        matched_m: (H, W) float32, range along the ray from which on the right camera sees the ray, too; 0 where depth
            does not come from a pair [m].
        projection: (3, 4) float64, world points to analysis pixels.
        pixel_sr: 1 / (fu fv), area of a pixel's surface over squared depth.
        depth_std_per_m2: growth of the depth's deviation with squared depth [1/m].
        disparity_metre: disparity of one metre [px m].
        distortion_k: K of r' = r + K r^2 [1/px] from ``projection`` to pixels.
    """

    centre_m: F64
    direction: F32
    stretch: F32
    matched_m: F32
    projection: F64
    pixel_sr: float
    depth_std_per_m2: float
    disparity_metre: float
    distortion_k: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the analysed image."""
        return self.stretch.shape[0], self.stretch.shape[1]

    @property
    def key(self) -> tuple[float, ...]:
        """Tells cameras apart."""
        return tuple(self.centre_m.tolist())

    @cached_property
    def level(self) -> F32:
        """(H, W, 3) float32: horizontal unit vector below each ray, and the ray's depression [rad]."""
        flat = np.hypot(self.direction[..., 0], self.direction[..., 1])[..., None]
        along = np.where(flat > 1e-6, self.direction[..., :2] / np.maximum(flat, 1e-6), (1.0, 0.0))
        return np.concatenate([along, np.arctan2(-self.direction[..., 2:], flat)], axis=-1).astype(np.float32)

    @staticmethod
    def of(geometry: RectifiedGeometry, world_SE3_left: SE3, shape: tuple[int, int], reduction: int) -> PixelRays:
        """The rays of every ``reduction``-th pixel of a rectified image."""
        rows, cols = np.mgrid[: shape[0], : shape[1]] * float(reduction)
        rays = geometry.rays(np.stack([cols, rows], axis=-1)) @ world_SE3_left.rotation.T
        stretch = np.linalg.norm(rays, axis=-1)
        scale = np.diag([1.0 / reduction, 1.0 / reduction, 1.0])
        pair = geometry.depth_std_min_m == 0.0
        matched = stretch * geometry.disparity_metre / np.maximum(cols, 0.5) if pair else np.zeros(shape)
        return PixelRays(
            np.asarray(world_SE3_left.translation, dtype=np.float64),
            np.ascontiguousarray(rays / stretch[..., None], dtype=np.float32),
            np.asarray(stretch, dtype=np.float32),
            np.asarray(matched, dtype=np.float32),
            scale @ geometry.matrix @ world_SE3_left.inverse().matrix[:3],
            reduction**2 / (geometry.focal_u_px * geometry.focal_v_px),
            geometry.depth_std_per_m2,
            geometry.disparity_metre,
        )


@dataclass(frozen=True, eq=False)
class SeenPixels:
    """One frame of one camera.

    Attributes:
        rays: of the camera.
        kind: (H, W) uint8 of BACKGROUND_SEEN, SURFACE and NO_DEPTH.
        range_m: (H, W) float32 along the ray: the surface's, or the background's where that is seen; 0 unknown.
        colour: (H, W) uint8 colour codes (``planview.maps.colour``); None where all is grey:
            light alone tells no clothes apart.
        renewed: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
    """

    rays: PixelRays
    kind: U8
    range_m: F32
    colour: U8 | None
    renewed: F32 | None = None


class KeptBackground:
    """How far the background is, looked at anew every RENEW_S: furniture that hides people seldom moves.

    Attributes:
        range_m: (H, W) float32 along the rays [m], 0 where unknown; None before the first look.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the background."""
        self.range_m: F32 | None = None
        self._looked_s = -math.inf

    def due(self, timestamp_s: float) -> bool:
        """Whether it is to be looked at again."""
        return timestamp_s - self._looked_s >= RENEW_S

    def renew(self, disparity: F32, rays: PixelRays, timestamp_s: float) -> None:
        """Keep what the background looks like now: (H, W) float32 [px], NaN where unknown."""
        self._looked_s, far = timestamp_s, np.zeros(rays.shape, np.float32)
        np.divide(np.float32(rays.disparity_metre) * rays.stretch, disparity, out=far, where=disparity > 0)
        self.range_m = far


def seen_pixels(
    rays: PixelRays, points: FloorPoints, unmatched: I32 | None, background_m: F32 | None, lowest_m: float,
    renewed: F32 | None = None,
) -> SeenPixels:  # fmt: skip
    """Classify the pixels of one frame.

    Foreground as low as the floor shows that nobody is in the way, as the background does.

    Args:
        points: foreground points of the frame; their pixels index an image of the rays' shape.
        unmatched: (K,) int32 pixels of foreground without depth; None where they are not known.
        background_m: (H, W) float32, how far the background is along the rays [m]; None or 0 where it is not known.
        lowest_m: height from which people have surface [m].
        renewed: see ``SeenPixels``.
    """
    n = rays.stretch.size
    kind = np.zeros(n, np.uint8)
    if unmatched is not None:
        kind[unmatched] = NO_DEPTH
    kind[points.pixels] = np.where(points.xyz[:, 2] >= lowest_m, SURFACE, BACKGROUND_SEEN)
    range_m = np.zeros(n, np.float32)
    if background_m is not None:
        np.multiply(background_m.reshape(-1), kind == BACKGROUND_SEEN, out=range_m)
    range_m[points.pixels] = np.linalg.norm(points.xyz - rays.centre_m.astype(np.float32), axis=1)
    colour = None
    if points.colours is not None and COLOURED[points.colours].any():
        colour = np.zeros(n, np.uint8)
        colour[points.pixels] = points.colours
    shape = rays.shape
    return SeenPixels(
        rays, kind.reshape(shape), range_m.reshape(shape), None if colour is None else colour.reshape(shape),
        renewed,
    )  # fmt: skip


def unmatched_pixels(mask: U8, points: FloorPoints) -> I32:
    """(K,) int32 pixels of foreground that are no point."""
    flat = mask.reshape(-1) > 0
    flat[points.pixels] = False
    return np.asarray(np.flatnonzero(flat), dtype=np.int32)
