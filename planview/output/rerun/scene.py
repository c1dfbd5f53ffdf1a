"""What stands still in a rerun recording: cameras, a metre grid, the scene as a cloud, the floor as an image."""

from __future__ import annotations

import math

import cv2
import numpy as np
import rerun as rr

from calib.images import as_colour
from calib.types import F32, U8
from planview.drawing.plan import PlanBounds
from planview.engine.engine import FrameResult
from planview.maps.view import StereoView
from stereo.depth import DepthFromDisparity, back_project

SCENE_POINTS_MAX = 60_000
"""Points of the static scene."""
SETTLED_S = 3.0
"""From then on the foreground knows who is no part of the scene, and what stood behind them is filled in [s]."""
RADIUS_M = 0.012
FLOOR_LIGHT = 0.55
"""The image on the floor is darkened by this, so that the maps on it stand out."""
UNDER, OVER = -50.0, 10.0
"""Order of drawing of floor and maps: both lie in one plane, since what is transparent hides what lies below it."""
GRID_LINES_MAX = 40
HEIGHT_SHOWN_M = (-0.5, 3.5)
"""What lies lower or higher is noise or hides the view."""


class StaticScene:
    """Logs the scene without people: what the first frame shows, filled in where people stood once they have moved.

    Args:
        stereo: the (first head's) pair above the floor.
    """

    def __init__(self, stereo: StereoView) -> None:
        self._stereo = stereo
        self._points: F32 | None = None
        self._colours: U8 | None = None
        self._started_s = 0.0
        self.done = False

    def take(self, stream: rr.RecordingStream, result: FrameResult) -> None:
        """Take a frame; nothing is computed once the scene is known."""
        if self.done:
            return
        image, disparity = result.image, result.disparity
        if image is None or disparity is None:
            return
        if self._points is None:
            self._started_s = result.timestamp_s
        elif result.timestamp_s - self._started_s < SETTLED_S:
            return
        else:
            self.done = True
        self._fill(image, disparity, result.observation.foreground)
        self._log(stream)

    def _fill(self, image: U8, disparity: F32, foreground: U8 | None) -> None:
        """Points of the background; where there is none now, those taken before."""
        step = self._stereo.reduction
        geometry = self._stereo.geometry
        points = back_project(DepthFromDisparity(geometry)(disparity), geometry)[::step, ::step].reshape(-1, 3)
        pose = self._stereo.floor.world_SE3_left
        world = np.asarray(points @ pose.rotation.T + pose.translation, dtype=np.float32)
        colours = _rgb(image)[::step, ::step].reshape(-1, 3)
        if self._points is None or self._colours is None:
            self._points, self._colours = world, colours.copy()
            return
        known = np.isfinite(world[:, 2])
        if foreground is not None:
            known &= foreground.reshape(-1) == 0
        self._points[known], self._colours[known] = world[known], colours[known]

    def _log(self, stream: rr.RecordingStream) -> None:
        assert self._points is not None and self._colours is not None
        z = self._points[:, 2]
        with np.errstate(invalid="ignore"):
            keep = np.flatnonzero((z > HEIGHT_SHOWN_M[0]) & (z < HEIGHT_SHOWN_M[1]) & self._near())
        keep = keep[:: max(1, -(-len(keep) // SCENE_POINTS_MAX))]
        cloud = rr.Points3D(self._points[keep], colors=self._colours[keep], radii=RADIUS_M)
        stream.log("world/scene", cloud, static=True)

    def _near(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Within the grid, and a little beyond."""
        assert self._points is not None
        grid, x, y = self._stereo.grid, self._points[:, 0], self._points[:, 1]
        across = (x > grid.x_min_m - 1) & (x < grid.x_max_m + 1)
        return np.asarray(across & (y > grid.y_min_m - 1) & (y < grid.y_max_m + 1))

    def log_floor(self, stream: rr.RecordingStream, image: U8) -> None:
        """The image laid on the floor, under the maps."""
        grid = self._stereo.grid
        rows, cols = np.indices(grid.shape)
        x, y = grid.centre_of(0, 0)
        places = np.stack([x + cols * grid.cell_m, y + rows * grid.cell_m, np.zeros(grid.shape)], axis=-1)
        pixels = np.nan_to_num(self._stereo.camera.project(places), nan=-1.0).astype(np.float32)
        shown = cv2.remap(_rgb(image), pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        dimmed = np.asarray(shown * FLOOR_LIGHT, dtype=np.uint8)
        visible = np.where(dimmed.any(axis=2), 255, 0).astype(np.uint8)
        image_map = _grid_map(np.dstack([dimmed, visible]), self._stereo, UNDER)
        stream.log("plan/floor", image_map, static=True)


def metre_grid(bounds: PlanBounds) -> rr.LineStrips3D:
    """Lines every metre of a part of the floor, every five metres of a large one."""
    x_min, y_min = math.floor(bounds.x_min_m), math.floor(bounds.y_min_m)
    x_max, y_max = math.ceil(bounds.x_max_m), math.ceil(bounds.y_max_m)
    step = 1 if max(x_max - x_min, y_max - y_min) <= GRID_LINES_MAX else 5
    lines = [[(x, y_min, 0.01), (x, y_max, 0.01)] for x in range(x_min, x_max + 1, step)]
    lines += [[(x_min, y, 0.01), (x_max, y, 0.01)] for y in range(y_min, y_max + 1, step)]
    return rr.LineStrips3D(lines, colors=[90, 90, 90], radii=-0.5)


def map_image(values: F32, largest: float, stereo: StereoView) -> rr.GridMap:
    """A plan-view map in colours, transparent where it is empty, so that the floor shows.

    Args:
        values: (n_rows, n_cols), row 0 at y_min.
        largest: value of the brightest colour.
    """
    levels = np.clip(values * (255.0 / largest), 0, 255).astype(np.uint8)
    bgr = np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO), dtype=np.uint8)
    rgba = np.dstack([bgr[..., ::-1], np.where(levels > 0, 255, 0).astype(np.uint8)])
    rgba[levels == 0] = 0
    return _grid_map(rgba, stereo, OVER)


def _grid_map(pixels: U8, stereo: StereoView, order: float) -> rr.GridMap:
    """(n_rows, n_cols, 4) RGBA pixels of the grid, row 0 at y_min, where a grid map has its upper row first."""
    grid = stereo.grid
    return rr.GridMap(
        data=np.ascontiguousarray(pixels[::-1]).tobytes(),
        format=rr.components.ImageFormat(
            width=grid.n_cols, height=grid.n_rows, color_model="RGBA", channel_datatype="U8"
        ),
        cell_size=grid.cell_m,
        translation=[grid.x_min_m, grid.y_min_m, 0.0],
        draw_order=order,
    )  # fmt: skip


def _rgb(image: U8) -> U8:
    return np.ascontiguousarray(as_colour(image)[..., ::-1])
