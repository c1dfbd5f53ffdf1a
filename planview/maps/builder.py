"""Disparity and foreground of one rig to what its pixels show, and to plan-view maps."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from calib.carried import Carried
from calib.pose import SE3
from calib.types import F32, U8
from planview.foreground.gain import Exposure
from planview.maps._kernels import back_project
from planview.maps.colour import colour_codes
from planview.maps.grid import Grid
from planview.maps.plan_view import MapParams, PlanViewMaps, plan_view
from planview.maps.view import BACKGROUND_SEEN, COLOURED, NO_DEPTH, SURFACE, FloorPoints, PixelRays, View
from stereo.depth import RectifiedGeometry

REFERENCE = Exposure()
RENEW_S = 30.0
"""How far the background is, is measured again every so often [s]: moved furniture has become background then
(``ForegroundParams.learning_rate``), and what hides people rarely moves."""


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
        self, disparity: F32, mask: U8, timestamp_s: float, renewed: F32 | None = None,
        image: U8 | None = None, exposure: Exposure = REFERENCE, codes: U8 | None = None,
    ) -> View:  # fmt: skip
        """What every pixel of a frame shows.

        Foreground as low as the floor shows that nobody is in the way, as the background does.

        Args:
            disparity: (H, W) float32 [px], NaN where invalid.
            mask: (H, W) uint8, non-zero where foreground.
            renewed: see ``View``.
            image: (H, W[, 3]) uint8 grey or BGR, for the points' colours.
            exposure: of the image, relative to the recording's first.
            codes: (H, W) uint8 colour codes, where there is no image.
        """
        points = self.points(disparity, mask, image, exposure)
        if codes is not None:
            points = replace(points, colours=codes.reshape(-1)[points.pixels])
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
