"""Plan-view maps of height and occupancy (Harville 2002, section 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from calib.pose import SE3
from calib.types import F32, I32, U8
from planview.foreground.gain import Exposure
from planview.maps._kernels import accumulate, back_project
from planview.maps.colour import colour_codes
from planview.maps.grid import Grid, GridParams
from stereo.depth import RectifiedGeometry

REFERENCE = Exposure()
TEMPLATE_M = 0.8
"""Side of a person's template, 2 W_avg [m] (Harville 2002, section 4)."""


class MapParams(GridParams):
    """Plan-view maps."""

    height_max_m: float = Field(2.4, gt=0.5, le=5.0)
    """H_max [m]: how high a very tall person reaches standing on tiptoe (Harville 2002, section 3); 2.4 m is the
    95th percentile of men's vertical grip reach plus toes (our choice)."""
    height_min_m: float = Field(0.15, ge=0.0, le=1.0)
    """Foreground lower than this is the floor under another light, or a shoe [m], and left out of the maps: three
    deviations of the floor's depth measured from 2.7 m above (our choice)."""
    smoothing_m: float = Field(0.04, ge=0.0, le=0.2)
    """Standard deviation of the Gaussian that smooths both maps [m]. Harville 2002, section 3: 1-4 cm."""
    occupancy_min: float = Field(0.25, ge=0.0, le=10.0)
    """theta_occ as visible surface per floor area [m^2/m^2]: height counts only where there is more. A head viewed
    from the side or from above gives about 1, stray matches are far below (our choice; the paper gives no value)."""
    depth_std_max_m: float = Field(0.40, ge=0.01, le=10.0)
    """Points whose predicted depth deviation is larger [m] are left out: beyond it a body smears over more than the
    2 W_avg of a template (Harville 2002, section 4; our choice)."""
    distance_max_m: float = Field(15.0, gt=0.5, le=100.0)
    """Farthest horizontal distance covered by the grid [m], where the depth allows it (our choice)."""


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
class PlanViewMaps:
    """Maps of one frame, all (n_rows, n_cols) float32 on the same grid.

    Attributes:
        grid: where the cells are.
        height_raw: highest point per cell [m], 0 where none fell.
        occupancy_raw: visible foreground surface per cell [m^2].
        height: smoothed and masked height H_masked [m].
        occupancy: smoothed occupancy O_sm [m^2].
        occupancy_min: theta_occ of this grid [m^2 per cell].
        points: the points that the maps were made of.
    """

    grid: Grid
    height_raw: F32
    occupancy_raw: F32
    height: F32
    occupancy: F32
    occupancy_min: float
    points: FloorPoints

    def around(self, x_m: float, y_m: float) -> tuple[F32, F32]:
        """The maps around a place as a template (Harville 2002, section 4), 0 outside of the grid.

        Returns:
            T_H [m] and T_O [m^2], (n, n) float32 of TEMPLATE_M, centred on the cell of the place.
        """
        half = round(TEMPLATE_M / 2 / self.grid.cell_m)
        row, col = self.grid.nearest(x_m, y_m)
        window = np.s_[row : row + 2 * half + 1, col : col + 2 * half + 1]
        return np.pad(self.height, half)[window], np.pad(self.occupancy, half)[window]


def accumulated(points: FloorPoints, grid: Grid, height_min_m: float) -> tuple[F32, F32]:
    """Highest point [m] and summed area [m^2] of every cell, of points above ``height_min_m``."""
    height, total = np.empty(grid.shape, np.float32), np.empty(grid.shape, np.float32)
    accumulate(points.xyz, points.area, height_min_m, grid.x_min_m, grid.y_min_m, grid.cell_m, height, total)
    return height, total


def plan_view(points: FloorPoints, grid: Grid, params: MapParams) -> PlanViewMaps:
    """Points to maps: accumulate, smooth, mask. Height is smoothed over occupied cells only, or edges would sink."""
    height_raw, occupancy_raw = accumulated(points, grid, params.height_min_m)
    height, occupancy = np.zeros_like(height_raw), np.zeros_like(occupancy_raw)
    occupancy_min = params.occupancy_min * grid.cell_m**2
    # Most of the floor is empty: only the part around occupied cells is worth smoothing.
    sigma = params.smoothing_m / grid.cell_m
    margin = 2 * math.ceil(3 * sigma)
    left, top, width, n_rows = cv2.boundingRect((occupancy_raw > 0.0).view(np.uint8))
    if width:
        part = np.s_[max(0, top - margin) : top + n_rows + margin, max(0, left - margin) : left + width + margin]
        raw = height_raw[part]
        if sigma > 0.0:
            occupancy[part] = _blur(occupancy_raw[part], sigma)
            share = _blur((raw > 0.0).astype(np.float32), sigma)
            smooth = np.divide(_blur(raw, sigma), np.maximum(share, 1e-3), dtype=np.float32)
        else:
            occupancy[part], smooth = occupancy_raw[part], raw
        np.copyto(height[part], smooth, where=occupancy[part] >= np.float32(occupancy_min))
    return PlanViewMaps(grid, height_raw, occupancy_raw, height, occupancy, occupancy_min, points)


def _blur(image: F32, sigma: float) -> F32:
    size = 2 * max(1, round(3 * sigma)) + 1
    return np.asarray(cv2.GaussianBlur(image, (size, size), sigma, borderType=cv2.BORDER_CONSTANT), np.float32)


class MapBuilder:
    """Foreground disparity to height and occupancy maps (Harville 2002, section 3).

    Args:
        geometry: the rectified pair.
        world_SE3_left: pose of the rectified left camera.
        params: see MapParams.
        reduction: pixels of the disparities and masks to come are ``reduction`` x ``reduction`` of the rectified
            image; disparities keep its pixels as their unit.
    Raises:
        ValueError: the floor within reach is larger than a grid may be (a larger cell_m helps).
    """

    def __init__(
        self,
        geometry: RectifiedGeometry,
        world_SE3_left: SE3,
        params: MapParams | None = None,
        reduction: int = 1,
    ) -> None:
        self.params = params or MapParams()
        self.geometry = geometry
        self.world_SE3_left = world_SE3_left
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
        return plan_view(self.points(disparity, mask, image, exposure), self.grid, self.params)

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
