"""A camera above the floor, and what each of its pixels shows: background, a surface, or a surface without depth.

Surfaces have colour codes, enough to distinguish clothes, too little to make a picture of: a cell of luma and chroma
(YUV). People are compared by histograms of codes, smoothed over neighbouring cells so that a slightly other light moves
little mass (our choice; the cells are as wide as a sensor's noise and the difference of light within a room leave room
for).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.carried import Carried
from calib.floor_camera import FloorCamera
from calib.kernels import kernel
from calib.pose import SE3
from calib.types import F32, F64, I32, U8
from planview.foreground.gain import Exposure
from planview.maps.grid import MapParams, floor_in_view, reach_m
from planview.maps.plan_view import FloorPoints, PlanViewMaps, plan_view
from stereo.depth import Depth, RectifiedGeometry, middle_px

BACKGROUND_SEEN = 0
SURFACE = 1
NO_DEPTH = 2
UNKNOWN = 3
SHADED = 4
"""Kinds of pixels: the background is seen, foreground with depth, foreground without, pixels that show nothing (no
evidence for or against anybody), and of one camera what looks like background in a shadow."""
LUMA_CELLS = 8
CHROMA_EDGES = (-24.0, -8.0, 8.0, 24.0)
"""Edges of the cells of U and V around grey [levels of 255]; noise of grey clothes is below 8."""
CHROMA_CELLS = len(CHROMA_EDGES) + 1
CODES = LUMA_CELLS * CHROMA_CELLS**2
COLOURED = np.arange(256) % CHROMA_CELLS**2 != CHROMA_CELLS**2 // 2
"""(256,) bool, by code: not grey."""
LUMA_SPREAD = 0.75
CHROMA_SPREAD = 0.4
"""Deviation of the smoothing, in cells: light differs by a fifth within a room, chroma hardly."""
REFERENCE = Exposure()
RENEW_S = 30.0
"""Time after which the range of the background is measured again [s]: moved furniture has become background then
(``ForegroundParams.learning_rate``), and what hides people rarely moves."""
NO_POINTS = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))


class PixelRays(NamedTuple):
    """The rays of a camera's analysis pixels in the world, as kernels take them.

    Attributes:
        centre_m: (3,) float64, the camera's centre [m].
        level: (H, W, 6) float32: horizontal unit vector below each ray; cosine and sine of the ray's depression, the
            depression and the azimuth [rad].
        stretch: (H, W) float32, range along the ray over depth.
        matched_m: (H, W) float32, range along the ray from which on the right camera sees the ray, too; 0 where depth
            does not come from a pair [m].
        projection: (3, 4) float64, world points to analysis pixels.
        pixel_sr: 1 / (fu fv), area of a pixel's surface over squared depth.
        disparity_metre: disparity of one metre [px m].
        distortion_k: K of r' = r + K r^2 [1/px] from ``projection`` to pixels.
    """

    centre_m: F64
    level: F32
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

    @staticmethod
    def of(camera: FloorCamera, pair: RectifiedGeometry | None = None, step: int = 1) -> PixelRays:
        """The rays of every pixel of a camera; pixels that see nothing look up.

        Args:
            pair: that measures depth, of ``step`` x ``step`` pixels a pixel of the camera; None for masks alone.
        """
        width, height = camera.size
        rows, cols = np.mgrid[:height, :width].astype(np.float64)
        rays = camera.rays(np.stack([cols, rows], axis=-1))
        unit = np.nan_to_num(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
        unit[(unit == 0).all(axis=-1)] = (0.0, 0.0, 1.0)
        # Far from the axis of a wide lens depth vanishes.
        stretch = 1.0 / np.maximum(unit @ camera.projection[2, :3], 0.05)
        disparity_metre = 1.0
        matched_m = np.zeros(stretch.shape)
        if pair is not None:
            disparity_metre = pair.disparity_metre
            if pair.depth_std_min_m == 0.0:
                matched_m = stretch * disparity_metre / np.maximum(middle_px(cols, step), 0.5)
        return PixelRays(
            centre_m=camera.centre_m,
            level=_level_and_angles(unit.astype(np.float32)),
            stretch=stretch.astype(np.float32),
            matched_m=matched_m.astype(np.float32),
            projection=camera.projection,
            pixel_sr=camera.pixel_sr,
            disparity_metre=disparity_metre,
            distortion_k=camera.distortion_k,
        )


def _level_and_angles(unit: F32) -> F32:
    """``PixelRays.level`` of (H, W, 3) unit vectors."""
    up = unit[..., 2:]
    flat = np.hypot(unit[..., 0], unit[..., 1])[..., None]
    along = np.where(flat > 1e-6, unit[..., :2] / np.maximum(flat, 1e-6), (1.0, 0.0))
    depression = np.arctan2(-up, flat)
    azimuth = np.arctan2(along[..., 1:], along[..., :1])
    return np.concatenate([along, flat, -up, depression, azimuth], axis=-1).astype(np.float32)


NO_RAYS = PixelRays(
    np.full(3, np.nan), np.empty((0, 0, 6), np.float32), np.empty((0, 0), np.float32), np.empty((0, 0), np.float32),
    np.full((3, 4), np.nan), np.nan, np.nan,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class View:
    """A frame of one camera, pixel by pixel.

    Attributes:
        rays: of the camera; NO_RAYS where its place is not known.
        kind: (H, W) uint8 of BACKGROUND_SEEN, SURFACE, NO_DEPTH, UNKNOWN and SHADED.
        range_m: (H, W) float32 along the ray: the surface's, or the background's where that is seen; 0 unknown.
        colour: (H, W) uint8 colour codes; None where all is grey: light alone does not distinguish clothes.
        points: foreground points in the world; their pixels index the images above.
        image: (H, W[, 3]) uint8, at this size, of one camera as recorded; None where it was not recorded.
        motion: (H, W) uint8, 255 where consecutive frames differ; None where that is not looked at.
        renewed: (H, W) float32 [px], the background's disparity where it is another from this frame on; else None.
        depth: what was measured; None of one camera, of recorded views, and where there is no frame.
    Raises:
        ValueError: arrays of different sizes.
    """

    rays: PixelRays
    kind: U8
    range_m: F32
    colour: U8 | None
    points: FloorPoints = NO_POINTS
    image: U8 | None = None
    motion: U8 | None = None
    renewed: F32 | None = None
    depth: Depth | None = None

    def __post_init__(self) -> None:
        arrays = (self.kind, self.range_m, self.colour, self.motion, self.renewed)
        shapes = {array.shape for array in arrays if array is not None}
        if self.rays is not NO_RAYS:
            shapes.add(self.rays.shape)
        if len(shapes) > 1:
            raise ValueError(f"expected one size of rays, kinds, ranges and colours, got {sorted(shapes)}")

    @cached_property
    def shows(self) -> bool:
        """True if anything is known."""
        return bool((self.kind != UNKNOWN).any())

    @cached_property
    def foreground(self) -> U8 | None:
        """(H, W) uint8, 255 where not background; None where nothing shows."""
        if not self.shows:
            return None
        mask = np.where((self.kind == SURFACE) | (self.kind == NO_DEPTH), np.uint8(255), np.uint8(0))
        mask.reshape(-1)[self.points.pixels] = 255  # also of what is as low as the floor
        return mask

    @staticmethod
    def unknown(
        shape: tuple[int, int], image: U8 | None = None, rays: PixelRays = NO_RAYS, depth: Depth | None = None
    ) -> View:
        """View of a frame that shows nothing."""
        kind = np.full(shape, UNKNOWN, np.uint8)
        range_m = np.zeros(shape, np.float32)
        return View(rays, kind, range_m, None, image=image, depth=depth)

    @staticmethod
    def of_mask(foreground: U8, motion: U8 | None = None, image: U8 | None = None, shadow: U8 | None = None) -> View:
        """View of a camera without depth; ``shadow``: (H, W) uint8, 255 where foreground was removed for its colour."""
        kind = np.where(foreground > 0, np.uint8(NO_DEPTH), np.uint8(BACKGROUND_SEEN))
        if shadow is not None:
            kind[(shadow > 0) & (foreground == 0)] = SHADED
        range_m = np.zeros(foreground.shape, np.float32)
        return View(NO_RAYS, kind, range_m, None, image=image, motion=motion)


class ViewBuilder(Carried):
    """Foreground and disparity of one rig to what its pixels show in the world, and to maps (Harville 2002, section 3).

    Attributes:
        rays: of the analysed image's pixels.
        shape: (height, width) of the disparities and masks to come.

    Args:
        geometry: the rectified pair.
        world_SE3_left: pose of the rectified left camera.
        params: see MapParams.
        reduction: pixels of the disparities and masks to come are ``reduction`` x ``reduction`` of the rectified
            image; disparities keep its pixels as their unit.
    Raises:
        ValueError: the floor within reach is larger than a grid may be (a larger cell_m helps).
    """

    CARRIED = "_background_m", "_looked_s"

    def __init__(
        self, geometry: RectifiedGeometry, world_SE3_left: SE3, params: MapParams | None = None, reduction: int = 1
    ) -> None:
        self.params = params or MapParams()
        self.grid = floor_in_view(geometry, world_SE3_left, self.params)
        self._geometry = geometry
        self._reduction = reduction
        self._left = geometry.above(world_SE3_left, reduction)
        self.shape = self._left.size[::-1]
        intrinsics = self._left.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
        self._camera = np.append(intrinsics, geometry.disparity_metre)
        self._pose = np.ascontiguousarray(world_SE3_left.matrix[:3])
        disparity_min_px = geometry.disparity_at(reach_m(geometry, self.params))
        self._limits = (disparity_min_px, self.params.height_max_m)
        self.reset()

    def reset(self) -> None:
        """Forget how far the background is."""
        self._background_m: F32 | None = None
        self._looked_s = -math.inf

    @cached_property
    def rays(self) -> PixelRays:
        """See the class."""
        return PixelRays.of(self._left, self._geometry, self._reduction)

    def background_due(self, timestamp_s: float) -> bool:
        """True if it is time to measure the background again."""
        return timestamp_s - self._looked_s >= RENEW_S

    def __call__(
        self, disparity: F32, mask: U8, image: U8 | None = None, exposure: Exposure = REFERENCE
    ) -> PlanViewMaps:
        """The maps of one frame; arguments and errors are those of ``points``."""
        return plan_view([self.points(disparity, mask, image, exposure)], self.grid, self.params)

    def points(self, disparity: F32, mask: U8, image: U8 | None = None, exposure: Exposure = REFERENCE) -> FloorPoints:
        """Foreground points of one frame.

        Args:
            disparity: (H, W) float32 [px], NaN where invalid.
            mask: (H, W) uint8, non-zero where foreground.
            image: (H, W[, 3]) uint8 grey or BGR, for the points' colours.
            exposure: of the image, relative to the recording's first.
        Raises:
            ValueError: the arrays do not have the size of the geometry.
        """
        shapes = [disparity.shape, mask.shape]
        if image is not None:
            shapes.append(image.shape[:2])
        if any(shape != self.shape for shape in shapes):
            raise ValueError(f"expected disparity, mask and image of {self.shape}, got {shapes}")
        xyz, area, pixels = back_project(disparity, mask, self._camera, self._pose, self._limits)
        colours = None
        if image is not None:
            colours = colour_codes(image, pixels, exposure)
        return FloorPoints(xyz, area, pixels, colours)

    def view(
        self, points: FloorPoints, mask: U8, timestamp_s: float, renewed: F32 | None = None, depth: Depth | None = None
    ) -> View:
        """View of a frame.

        Foreground as low as the floor shows that nobody is in the way, as the background does.

        Args:
            points: of the foreground.
            mask: (H, W) uint8, non-zero where foreground.
            renewed, depth: see ``View``.
        """
        if renewed is not None:
            self._measure_background(renewed, timestamp_s)
        kind = np.where(mask > 0, np.uint8(NO_DEPTH), np.uint8(BACKGROUND_SEEN))
        is_low = points.xyz[:, 2] < self.params.height_min_m
        kind.reshape(-1)[points.pixels] = np.where(is_low, BACKGROUND_SEEN, SURFACE)

        range_m = np.zeros(self.shape, np.float32)
        if self._background_m is not None:
            np.multiply(self._background_m, kind == BACKGROUND_SEEN, out=range_m)
        from_camera = points.xyz - self.rays.centre_m.astype(np.float32)
        range_m.reshape(-1)[points.pixels] = np.linalg.norm(from_camera, axis=1)

        colour = None
        if points.colours is not None and COLOURED[points.colours].any():
            colour = np.zeros(self.shape, np.uint8)
            colour.reshape(-1)[points.pixels] = points.colours
        image = None if depth is None else depth.image
        return View(self.rays, kind, range_m, colour, points, image, renewed=renewed, depth=depth)

    def _measure_background(self, disparity: F32, timestamp_s: float) -> None:
        """Take over how far the background is, from its disparity [px]."""
        self._looked_s = timestamp_s
        self._background_m = np.zeros(self.shape, np.float32)
        one_px_m = np.float32(self.rays.disparity_metre) * self.rays.stretch
        np.divide(one_px_m, disparity, out=self._background_m, where=disparity > 0)


@kernel
def back_project(disparity: F32, mask: U8, camera: F64, pose: F64, limits: tuple[float, float]) -> tuple[F32, F32, I32]:
    """Foreground pixels with a disparity to world points (Harville 2002, eq. 1 and 2).

    Args:
        camera: fu, fv, cu, cv, fu times the baseline.
        pose: (3, 4) world_SE3_left.
        limits: less disparity and points above are dropped [px, m].
    Returns:
        Points (N, 3), area (N,) = Z^2/(fu fv), pixels (N,) = row * width + column.
    """
    fu, fv, cu, cv, focal_baseline = camera
    disparity_min, height_max_m = limits
    room = len(mask.nonzero()[0])  # numba's count_nonzero imports scipy
    points = np.empty((room, 3), np.float32)
    area = np.empty(room, np.float32)
    pixels = np.empty(room, np.int32)
    rows, cols = disparity.shape
    n = 0
    for row in range(rows):
        ray_y = (row - cv) / fv
        bx = pose[0, 1] * ray_y + pose[0, 2]
        by = pose[1, 1] * ray_y + pose[1, 2]
        bz = pose[2, 1] * ray_y + pose[2, 2]
        for col in range(cols):
            if mask[row, col] == 0:
                continue
            d = disparity[row, col]
            if not d >= disparity_min:
                continue
            z = focal_baseline / d
            ray_x = (col - cu) / fu
            height = z * (pose[2, 0] * ray_x + bz) + pose[2, 3]
            if height > height_max_m:
                continue
            points[n, 0] = z * (pose[0, 0] * ray_x + bx) + pose[0, 3]
            points[n, 1] = z * (pose[1, 0] * ray_x + by) + pose[1, 3]
            points[n, 2] = height
            area[n] = z * z / (fu * fv)
            pixels[n] = row * cols + col
            n += 1
    return points[:n], area[:n], pixels[:n]


def colour_codes(image: U8, pixels: I32, exposure: Exposure) -> U8:
    """Codes of some pixels.

    Args:
        image: (H, W) grey or (H, W, 3) BGR.
        pixels: (N,) int32, row * W + column.
        exposure: of the image; codes are those of the reference exposure.
    Returns:
        (N,) uint8, luma cell * CHROMA_CELLS^2 + U cell * CHROMA_CELLS + V cell.
    """
    codes = np.empty(len(pixels), np.uint8)
    encode_colours(np.ascontiguousarray(image).reshape(image.shape[0] * image.shape[1], -1), pixels, *exposure, codes)
    return codes


@kernel
def encode_colours(image: U8, pixels: I32, gain: float, offset: float, codes: U8) -> None:
    """``colour_codes`` of an image (H * W, channels), in float32."""
    f = np.float32
    g = f(gain)
    o = f(offset)
    scale = f(LUMA_CELLS / 256.0)
    top = f(LUMA_CELLS - 1)
    for i in range(len(pixels)):
        pixel = image[pixels[i]]
        luma = f(pixel[0])
        u = f(0)
        v = f(0)
        if len(pixel) > 1:
            blue = f(pixel[0])
            green = f(pixel[1])
            red = f(pixel[2])
            luma = f(0.114) * blue + f(0.587) * green + f(0.299) * red
            u = f(0.492) * (blue - luma) / g
            v = f(0.877) * (red - luma) / g
        code = int(min(max((luma - o) / g * scale, f(0)), top))
        for value in (u, v):
            code *= CHROMA_CELLS
            for edge in CHROMA_EDGES:
                code += int(value > edge)
        codes[i] = code


def smoothing() -> F32:
    """(CODES, CODES) float32 matrix that spreads a histogram of codes over neighbouring cells; rows sum to 1."""

    def spread(n: int, deviation: float) -> F32:
        steps = np.arange(n)
        kernel = np.exp(-0.5 * ((steps[:, None] - steps[None, :]) / deviation) ** 2)
        return np.asarray(kernel / kernel.sum(axis=1, keepdims=True), dtype=np.float32)

    chroma = spread(CHROMA_CELLS, CHROMA_SPREAD)
    return np.kron(spread(LUMA_CELLS, LUMA_SPREAD), np.kron(chroma, chroma))
