"""A camera above the floor, and what each of its pixels shows: background, a surface, or a surface without depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.carried import Carried
from calib.floor_camera import FloorCamera, FloorPinhole
from calib.pose import SE3
from calib.rig import DepthSensor, Floor
from calib.types import F32, F64, U8
from planview.foreground.gain import Exposure
from planview.maps._kernels import back_project
from planview.maps.colour import CHROMA_CELLS, colour_codes
from planview.maps.grid import Grid
from planview.maps.plan_view import FloorPoints, MapParams, PlanViewMaps, plan_view
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange

BACKGROUND_SEEN, SURFACE, NO_DEPTH, UNKNOWN, SHADOW = range(5)
"""Kinds of pixels: the background is seen, foreground with depth, foreground without, pixels that show nothing (no
evidence for or against anybody), and of one camera what looks like background in a shadow."""
COLOURED = np.arange(256) % CHROMA_CELLS**2 != CHROMA_CELLS**2 // 2
"""(256,) bool, by code: not grey."""
REFERENCE = Exposure()
RENEW_S = 30.0
"""How far the background is, is measured again every so often [s]: moved furniture has become background then
(``ForegroundParams.learning_rate``), and what hides people rarely moves."""
NO_POINTS = FloorPoints(np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.int32))


@dataclass(frozen=True, eq=False)
class FloorRig:
    """A rectified pair above its floor; an image with depth stands for the pair that its noise is equivalent to.

    Attributes:
        geometry: of the rectified pair.
        floor: pose of the rectified left camera and how well it is known.
        floor_source: "found" in the recording, or the file that gave it.
        calibration: file or folder the calibration came from; empty when unknown.
        vertical_residual_px: row offset left after rectification [px]; NaN when unknown.
        disparities: range searched.
        grid: cells of the plan-view maps.
        reduction: foreground and maps use every ``reduction``-th row and column of the rectified image.
        sensor: how depth was measured; None where a pair was matched.
        correction: sentence on how the recording corrects the calibration; empty when that was not looked at.
    """

    geometry: RectifiedGeometry
    floor: Floor
    floor_source: str
    calibration: str
    vertical_residual_px: float
    disparities: DisparityRange
    grid: Grid
    reduction: int
    sensor: DepthSensor | None = None
    correction: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of disparity and foreground at the reduced size."""
        return -(-self.geometry.height // self.reduction), -(-self.geometry.width // self.reduction)

    @property
    def camera(self) -> FloorPinhole:
        """The rectified left camera above the floor."""
        return self.geometry.above(self.floor.world_SE3_left)


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


class MapBuilder(Carried):
    """Foreground and disparity of one rig to what its pixels show in the world, and to maps (Harville 2002, section 3).

    Attributes:
        rays: of the analysed image's pixels.

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
        self,
        geometry: RectifiedGeometry,
        world_SE3_left: SE3,
        params: MapParams | None = None,
        reduction: int = 1,
    ) -> None:
        self.params = params or MapParams()
        self.geometry = geometry
        self.world_SE3_left, self._reduction = world_SE3_left, reduction
        self.grid = floor_in_view(geometry, world_SE3_left, self.params)
        self.shape = (-(-geometry.height // reduction), -(-geometry.width // reduction))
        n = self.shape[0] * self.shape[1]
        self._points = np.empty((n, 3), dtype=np.float32)
        self._area = np.empty(n, dtype=np.float32)
        self._pixels = np.empty(n, dtype=np.int32)
        intrinsics = geometry.reduced_matrix(reduction)[[0, 1, 0, 1], [0, 1, 2, 2]]
        self._camera = np.append(intrinsics, geometry.disparity_metre)
        self._pose = np.ascontiguousarray(world_SE3_left.matrix[:3])
        self._disparity_min = geometry.disparity_at(_reach_m(geometry, self.params))
        self.reset()

    def reset(self) -> None:
        """Forget how far the background is."""
        self._background_m: F32 | None = None
        self._looked_s = -math.inf

    def background_due(self, timestamp_s: float) -> bool:
        """Whether the background is to be measured again."""
        return timestamp_s - self._looked_s >= RENEW_S

    def __call__(
        self, disparity: F32, mask: U8, image: U8 | None = None, exposure: Exposure = REFERENCE
    ) -> PlanViewMaps:
        """Build the maps of one frame.

        Args:
            disparity: (H, W) float32 [px], NaN where invalid.
            mask: (H, W) uint8, non-zero where foreground.
            image: (H, W[, 3]) uint8 grey or BGR, for the points' colours.
            exposure: of the image, relative to the recording's first.
        Raises:
            ValueError: the arrays do not have the size of the geometry.
        """
        return plan_view([self.points(disparity, mask, image, exposure)], self.grid, self.params)

    def points(self, disparity: F32, mask: U8, image: U8 | None = None, exposure: Exposure = REFERENCE) -> FloorPoints:
        """Foreground points of one frame; arguments and errors are those of a call."""
        if disparity.shape != self.shape or mask.shape != self.shape:
            raise ValueError(f"expected disparity and mask of {self.shape}, got {disparity.shape} and {mask.shape}")
        out = self._points, self._area, self._pixels
        limits = self._disparity_min, self.params.height_max_m
        n = back_project(disparity, mask, self._camera, self._pose, limits, out)
        pixels = self._pixels[:n].copy()
        colours = None if image is None else colour_codes(image, pixels, exposure)
        return FloorPoints(self._points[:n].copy(), self._area[:n].copy(), pixels, colours)

    @cached_property
    def rays(self) -> PixelRays:
        """See the class."""
        return PixelRays.of(self.geometry.above(self.world_SE3_left, self._reduction), self.geometry, self._reduction)

    def view(
        self, points: FloorPoints, mask: U8, timestamp_s: float, renewed: F32 | None = None, image: U8 | None = None
    ) -> View:
        """What every pixel of a frame shows.

        Foreground as low as the floor shows that nobody is in the way, as the background does.

        Args:
            points: of the foreground.
            mask: (H, W) uint8, non-zero where foreground.
            renewed, image: see ``View``.
        """
        if renewed is not None:
            self._looked_s, self._background_m = timestamp_s, np.zeros(self.shape, np.float32)
            far = np.float32(self.rays.disparity_metre) * self.rays.stretch
            np.divide(far, renewed, out=self._background_m, where=renewed > 0)
        kind = np.where(mask.reshape(-1) > 0, np.uint8(NO_DEPTH), np.uint8(BACKGROUND_SEEN))
        low = points.xyz[:, 2] < self.params.height_min_m
        kind[points.pixels] = np.where(low, BACKGROUND_SEEN, SURFACE)
        range_m, colour = np.zeros(kind.size, np.float32), None
        if self._background_m is not None:
            np.multiply(self._background_m.reshape(-1), kind == BACKGROUND_SEEN, out=range_m)
        range_m[points.pixels] = np.linalg.norm(points.xyz - self.rays.centre_m.astype(np.float32), axis=1)
        if points.colours is not None and COLOURED[points.colours].any():
            colour = np.zeros(self.shape, np.uint8)
            colour.reshape(-1)[points.pixels] = points.colours
        return View(
            self.rays, kind.reshape(self.shape), range_m.reshape(self.shape), colour, points, image, mask,
            renewed=renewed,
        )  # fmt: skip


def floor_in_view(geometry: RectifiedGeometry, world_SE3_left: SE3, params: MapParams) -> Grid:
    """The floor rectangle below everything between the floor and H_max that the camera sees within reach."""
    reach = _reach_m(geometry, params)
    u = np.linspace(0, geometry.width - 1, 17)
    v = np.linspace(0, geometry.height - 1, 17)
    rays = geometry.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    depths = np.linspace(0.2, reach, 60)
    points = world_SE3_left @ (rays[:, None, :] * depths[None, :, None])
    inside = (points[..., 2] >= 0.0) & (points[..., 2] <= params.height_max_m)
    out = points[..., :2] - world_SE3_left.translation[:2]
    inside &= np.hypot(out[..., 0], out[..., 1]) <= params.distance_max_m
    if not inside.any():
        raise ValueError("expected a camera that sees the space between floor and H_max, got none of it in view")
    visible = points[inside]
    margin = 0.5
    (x0, y0), (x1, y1) = visible[:, :2].min(axis=0) - margin, visible[:, :2].max(axis=0) + margin
    return Grid.covering(float(x0), float(y0), float(x1), float(y1), params.cell_m)


def _reach_m(geometry: RectifiedGeometry, params: MapParams) -> float:
    """Depth at which the predicted deviation reaches depth_std_max_m, which is far more than what it is nearby."""
    return math.sqrt(params.depth_std_max_m / geometry.depth_std_per_m2)
