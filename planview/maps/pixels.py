"""What one camera saw at every analysis pixel: background, a surface at a distance, or a surface without depth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.floor_camera import FloorCamera
from calib.pose import SE3
from calib.types import F32, F64, U8
from planview.foreground.gain import Exposure
from planview.maps.builder import NO_POINTS, REFERENCE, FloorPoints, MapBuilder, MapParams
from planview.maps.colour import CHROMA_CELLS
from stereo.depth import RectifiedGeometry

BACKGROUND_SEEN, SURFACE, NO_DEPTH, UNKNOWN = 0, 1, 2, 3
"""Kinds of pixels: the background is seen, foreground with depth, foreground without, and pixels that show nothing:
no evidence for or against anybody."""
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
        disparity_metre: disparity of one metre [px m].
        distortion_k: K of r' = r + K r^2 [1/px] from ``projection`` to pixels.
    """

    centre_m: F64
    direction: F32
    stretch: F32
    matched_m: F32
    projection: F64
    pixel_sr: float
    disparity_metre: float
    distortion_k: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the analysed image."""
        return self.stretch.shape[0], self.stretch.shape[1]

    @property
    def key(self) -> tuple[float, ...]:
        """Distinguishes cameras."""
        return tuple(self.centre_m.tolist())

    @cached_property
    def level(self) -> F32:
        """(H, W, 3) float32: horizontal unit vector below each ray, and the ray's depression [rad]."""
        flat = np.hypot(self.direction[..., 0], self.direction[..., 1])[..., None]
        along = np.where(flat > 1e-6, self.direction[..., :2] / np.maximum(flat, 1e-6), (1.0, 0.0))
        return np.concatenate([along, np.arctan2(-self.direction[..., 2:], flat)], axis=-1).astype(np.float32)

    @staticmethod
    def of(camera: FloorCamera, pair: RectifiedGeometry | None = None, step: int = 1) -> PixelRays:
        """The rays of every pixel of a camera; pixels that see nothing look up.

        Args:
            pair: that measures depth, of ``step`` x ``step`` pixels a pixel of the camera; None for masks alone.
        """
        width, height = camera.size
        rows, cols = np.mgrid[:height, :width].astype(np.float64)
        rays, projection = camera.rays(np.stack([cols, rows], axis=-1)), camera.projection
        length = np.linalg.norm(rays, axis=-1)
        unit = np.nan_to_num(rays / length[..., None])
        unit[(unit == 0).all(axis=-1)] = 0.0, 0.0, 1.0
        # Far from the axis of a wide lens depth vanishes.
        stretch = 1.0 / np.maximum(unit @ projection[2, :3], 0.05)
        disparity_metre = 1.0 if pair is None else pair.disparity_metre
        matched = np.zeros(stretch.shape)
        if pair is not None and pair.depth_std_min_m == 0.0:
            matched = stretch * disparity_metre / np.maximum(cols * step + 0.5 * (step - 1), 0.5)
        return PixelRays(
            camera.centre_m, np.ascontiguousarray(unit, dtype=np.float32), np.asarray(stretch, dtype=np.float32),
            np.asarray(matched, dtype=np.float32), projection, camera.pixel_sr, disparity_metre, camera.distortion_k,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SeenPixels:
    """What each pixel of one camera shows in a frame, in the world.

    Attributes:
        rays: of the camera.
        kind: (H, W) uint8 of BACKGROUND_SEEN, SURFACE, NO_DEPTH and UNKNOWN.
        range_m: (H, W) float32 along the ray: the surface's, or the background's where that is seen; 0 unknown.
        colour: (H, W) uint8 colour codes (``planview.maps.colour``); None where all is grey:
            light alone does not distinguish clothes.
        points: foreground points in the world; their pixels index the images above.
        renewed: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
    """

    rays: PixelRays
    kind: U8
    range_m: F32
    colour: U8 | None
    points: FloorPoints = NO_POINTS
    renewed: F32 | None = None

    @staticmethod
    def unknown(rays: PixelRays) -> SeenPixels:
        """What a camera sees in a frame that shows nothing."""
        kind = np.full(rays.shape, UNKNOWN, np.uint8)
        return SeenPixels(rays, kind, np.zeros(rays.shape, np.float32), None)


class KeptBackground:
    """How far the background is, measured again every RENEW_S: furniture that hides people rarely moves.

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


class Cloud(MapBuilder):
    """Disparity and foreground of one rig to what its pixels show, in the world.

    Attributes:
        rays: of the analysed image's pixels.
        background: how far away it is.
    """

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3, params: MapParams, reduction: int) -> None:
        """Prepare; arguments and errors are those of ``MapBuilder``."""
        super().__init__(geometry, world_SE3_left, params, reduction)
        self.rays = PixelRays.of(geometry.above(world_SE3_left, reduction), geometry, reduction)
        self.background = KeptBackground()

    def seen(
        self, disparity: F32, mask: U8, timestamp_s: float, renewed: F32 | None = None,
        image: U8 | None = None, exposure: Exposure = REFERENCE, codes: U8 | None = None,
    ) -> SeenPixels:  # fmt: skip
        """What every pixel of a frame shows.

        Foreground as low as the floor shows that nobody is in the way, as the background does.

        Args:
            disparity: (H, W) float32 [px], NaN where invalid.
            mask: (H, W) uint8, non-zero where foreground.
            renewed: see ``SeenPixels``.
            image: (H, W[, 3]) uint8 grey or BGR, for the points' colours.
            exposure: of the image, relative to the recording's first.
            codes: (H, W) uint8 colour codes, where there is no image.
        """
        points = self.points(disparity, mask, image, exposure)
        if codes is not None:
            points = replace(points, colours=codes.reshape(-1)[points.pixels])
        if renewed is not None:
            self.background.renew(renewed, self.rays, timestamp_s)
        kind = np.where(mask.reshape(-1) > 0, np.uint8(NO_DEPTH), np.uint8(BACKGROUND_SEEN))
        low = points.xyz[:, 2] < self.params.height_min_m
        kind[points.pixels] = np.where(low, BACKGROUND_SEEN, SURFACE)
        range_m, colour = np.zeros(kind.size, np.float32), None
        if self.background.range_m is not None:
            np.multiply(self.background.range_m.reshape(-1), kind == BACKGROUND_SEEN, out=range_m)
        range_m[points.pixels] = np.linalg.norm(points.xyz - self.rays.centre_m.astype(np.float32), axis=1)
        if points.colours is not None and COLOURED[points.colours].any():
            colour = np.zeros(self.shape, np.uint8)
            colour.reshape(-1)[points.pixels] = points.colours
        return SeenPixels(self.rays, kind.reshape(self.shape), range_m.reshape(self.shape), colour, points, renewed)
