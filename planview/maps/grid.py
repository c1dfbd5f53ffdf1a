"""The floor divided into cells, and the rig above it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from calib.floor_camera import FloorPinhole
from calib.params import Params
from calib.pose import SE3
from calib.rig import DepthTechnology, Floor
from stereo.depth import RectifiedGeometry
from stereo.matcher import DisparityRange

MAX_CELLS = 4_000_000
"""Largest map that is accepted; 4 million cells of 3 cm are a hall of 60 m x 60 m."""
MARGIN_M = 0.5
"""Floor around everything in view that a grid covers [m]."""


class MapParams(Params):
    """Plan-view maps."""

    cell_m: float = Field(0.04, ge=0.005, le=0.5)
    """Side of a cell [m]. Harville 2002, section 3: 2-4 cm; positions are finer, since heads are located by points;
    below 5 mm the cells of a head hold no points."""
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


@dataclass(frozen=True)
class Grid:
    """A rectangle of the floor in square cells: row follows y, column follows x, row 0 at y_min.

    A cell owns its lower edges: column = floor((x - x_min_m) / cell_m).

    Attributes:
        x_min_m, y_min_m: lower corner [m].
        cell_m: side of a cell [m].
        n_rows, n_cols: size of every map on this grid.
    Raises:
        ValueError: not positive, or more than MAX_CELLS cells.
    """

    x_min_m: float
    y_min_m: float
    cell_m: float
    n_rows: int
    n_cols: int

    def __post_init__(self) -> None:
        if self.cell_m <= 0 or self.n_rows < 1 or self.n_cols < 1:
            raise ValueError(f"expected positive cells and sizes, got {self.cell_m} m, {self.n_rows}x{self.n_cols}")
        if self.n_rows * self.n_cols > MAX_CELLS:
            found = f"{self.n_rows}x{self.n_cols} of {self.cell_m:g} m"
            raise ValueError(f"expected at most {MAX_CELLS} cells, got {found}: a larger maps.cell_m has fewer")

    @staticmethod
    def covering(x_min_m: float, y_min_m: float, x_max_m: float, y_max_m: float, cell_m: float) -> Grid:
        """The smallest grid from the lower corner that covers the rectangle."""
        return Grid(
            x_min_m,
            y_min_m,
            cell_m,
            max(1, math.ceil((y_max_m - y_min_m) / cell_m)),
            max(1, math.ceil((x_max_m - x_min_m) / cell_m)),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(n_rows, n_cols)."""
        return self.n_rows, self.n_cols

    @property
    def x_max_m(self) -> float:
        return self.x_min_m + self.n_cols * self.cell_m

    @property
    def y_max_m(self) -> float:
        return self.y_min_m + self.n_rows * self.cell_m

    def centre_of(self, row: float, col: float) -> tuple[float, float]:
        """World (x, y) [m] of the centre of a (fractional) cell."""
        return self.x_min_m + (col + 0.5) * self.cell_m, self.y_min_m + (row + 0.5) * self.cell_m

    def index_of(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Fractional (row, col) at which ``centre_of`` gives (x, y)."""
        return (y_m - self.y_min_m) / self.cell_m - 0.5, (x_m - self.x_min_m) / self.cell_m - 0.5

    def nearest(self, x_m: float, y_m: float) -> tuple[int, int]:
        """(row, col) of the cell at or nearest to a place."""
        row, col = self.index_of(x_m, y_m)
        return min(max(round(row), 0), self.n_rows - 1), min(max(round(col), 0), self.n_cols - 1)


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
        technology: how depth was measured; None where a pair was matched.
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
    technology: DepthTechnology | None = None
    correction: str = ""

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of disparity and foreground at the reduced size."""
        return -(-self.geometry.height // self.reduction), -(-self.geometry.width // self.reduction)

    @property
    def camera(self) -> FloorPinhole:
        """The rectified left camera above the floor."""
        return self.geometry.above(self.floor.world_SE3_left)


def floor_in_view(geometry: RectifiedGeometry, world_SE3_left: SE3, params: MapParams) -> Grid:
    """The floor rectangle below everything between the floor and H_max that the camera sees within reach."""
    reach = reach_m(geometry, params)
    u = np.linspace(0, geometry.width - 1, 17)
    v = np.linspace(0, geometry.height - 1, 17)
    rays = geometry.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    depths = np.linspace(0.2, reach, 60)
    points = world_SE3_left @ (rays[:, None, :] * depths[None, :, None])
    height_m = points[..., 2]
    from_camera_m = points[..., :2] - world_SE3_left.translation[:2]
    distance_m = np.hypot(from_camera_m[..., 0], from_camera_m[..., 1])
    inside = (height_m >= 0.0) & (height_m <= params.height_max_m) & (distance_m <= params.distance_max_m)
    if not inside.any():
        raise ValueError("expected a camera that sees the space between floor and H_max, got none of it in view")
    visible = points[inside][:, :2]
    low = visible.min(axis=0) - MARGIN_M
    high = visible.max(axis=0) + MARGIN_M
    return Grid.covering(float(low[0]), float(low[1]), float(high[0]), float(high[1]), params.cell_m)


def reach_m(geometry: RectifiedGeometry, params: MapParams) -> float:
    """Depth at which the predicted deviation reaches depth_std_max_m, which is far more than what it is nearby."""
    return math.sqrt(params.depth_std_max_m / geometry.depth_std_per_m2)
