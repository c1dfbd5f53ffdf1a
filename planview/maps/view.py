"""What one camera saw in a frame: background, a surface at a distance, or a surface without depth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.floor_camera import FloorCamera
from calib.types import F32, F64, I32, U8
from planview.maps.colour import CHROMA_CELLS
from stereo.depth import RectifiedGeometry

BACKGROUND_SEEN, SURFACE, NO_DEPTH, UNKNOWN, SHADOW = range(5)
"""Kinds of pixels: the background is seen, foreground with depth, foreground without, pixels that show nothing (no
evidence for or against anybody), and of one camera what looks like background in a shadow."""
COLOURED = np.arange(256) % CHROMA_CELLS**2 != CHROMA_CELLS**2 // 2
"""(256,) bool, by code: not grey."""


@dataclass(frozen=True, eq=False)
class FloorPoints:
    """Foreground points of one frame in the world frame.

    Attributes:
        xyz: (N, 3) float32 [m].
        area: (N,) float32, surface that the pixel subtends, Z^2/(fu fv) [m^2].
        pixels: (N,) int32, row * width + column in the foreground mask.
        colours: (N,) uint8 colour codes (``planview.maps.colour``), None where no image was given.
    """

    xyz: F32
    area: F32
    pixels: I32
    colours: U8 | None = None


NO_POINTS = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))


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
        """(H, W, 6) float32: horizontal unit vector below each ray; cosine and sine of the ray's depression, the
        depression and the azimuth [rad]."""
        flat, up = np.hypot(self.direction[..., 0], self.direction[..., 1])[..., None], self.direction[..., 2:]
        along = np.where(flat > 1e-6, self.direction[..., :2] / np.maximum(flat, 1e-6), (1.0, 0.0))
        angles = np.arctan2(-up, flat), np.arctan2(along[..., 1:], along[..., :1])
        return np.concatenate([along, flat, -up, *angles], axis=-1).astype(np.float32)

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


NO_RAYS = PixelRays(
    np.full(3, np.nan), np.empty((0, 0, 3), np.float32), np.empty((0, 0), np.float32), np.empty((0, 0), np.float32),
    np.full((3, 4), np.nan), np.nan, np.nan,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class View:
    """What each pixel of one camera shows in a frame.

    Attributes:
        rays: of the camera; NO_RAYS where its place is not known.
        kind: (H, W) uint8 of BACKGROUND_SEEN, SURFACE, NO_DEPTH, UNKNOWN and SHADOW.
        range_m: (H, W) float32 along the ray: the surface's, or the background's where that is seen; 0 unknown.
        colour: (H, W) uint8 colour codes (``planview.maps.colour``); None where all is grey:
            light alone does not distinguish clothes.
        points: foreground points in the world; their pixels index the images above.
        image: (H, W[, 3]) uint8, at this size, of one camera as recorded; None where it was not recorded.
        foreground: (H, W) uint8, 255 where not background; None where nothing shows.
        motion: (H, W) uint8, 255 where consecutive frames differ; None where that is not looked at.
        renewed: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
        shows: whether anything is known.
    """

    rays: PixelRays
    kind: U8
    range_m: F32
    colour: U8 | None
    points: FloorPoints = NO_POINTS
    image: U8 | None = None
    foreground: U8 | None = None
    motion: U8 | None = None
    renewed: F32 | None = None
    shows: bool = True

    @staticmethod
    def unknown(shape: tuple[int, int], image: U8 | None = None, rays: PixelRays = NO_RAYS) -> View:
        """What a camera sees in a frame that shows nothing."""
        kind, ranges = np.full(shape, UNKNOWN, np.uint8), np.zeros(shape, np.float32)
        return View(rays, kind, ranges, None, image=image, shows=False)

    @staticmethod
    def of_mask(foreground: U8, motion: U8 | None = None, image: U8 | None = None, shadow: U8 | None = None) -> View:
        """Of one camera without depth; ``shadow``: (H, W) uint8, 255 where foreground was removed for its colour."""
        kind = np.where(foreground > 0, np.uint8(NO_DEPTH), np.uint8(BACKGROUND_SEEN))
        if shadow is not None:
            kind[(shadow > 0) & (foreground == 0)] = SHADOW
        ranges = np.zeros(foreground.shape, np.float32)
        return View(NO_RAYS, kind, ranges, None, image=image, foreground=foreground, motion=motion)
