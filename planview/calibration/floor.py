"""The floor of a recording, found or given, and a picture to judge it by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.floor.find import PeopleSeen, floor_from_people, floor_from_points
from calib.floor.plane import FLOOR_DISPARITY_STD_PX
from calib.images import as_colour
from calib.rig import Floor
from calib.types import F32, F64, U8
from planview.drawing.image import Project, grid_lines
from planview.drawing.style import Entry, as_bgr, with_legend
from planview.trajectories.table import Trajectories
from stereo.depth import RectifiedGeometry, median_image
from stereo.floor import FloorSearch, spread_frames
from stereo.recording import DepthCamera, Recording, StereoPair

GRID_COLOUR = (90, 220, 90)
AXIS_COLOUR = (60, 200, 255)

_LEGEND = [
    Entry(as_bgr(GRID_COLOUR), "a line per metre of floor"),
    Entry(as_bgr(AXIS_COLOUR), "x and y, 1 m from below the camera"),
]


class FloorDepths:
    """Depth of frames spread over a recording, to find the floor in. Raises WorkError: no usable frame.

    Attributes:
        geometry: of the (rectified left) images.
        image: (H, W[, 3]) uint8, that of the middle frame.
        find: the floor that a run on the recording finds. Raises WorkError: no floor is visible.
        depth_of: the (H, W) float32 depth of a frame of the recording [m], NaN where unknown.
    """

    def __init__(self, recording: Recording[StereoPair | DepthCamera], search: FloorSearch) -> None:
        seen = spread_frames(recording, search)
        self.geometry = seen.rectifier.geometry
        self.image = seen.images[len(seen.frames) // 2]
        self.find = seen.floor
        self._depths = seen.depths
        self.depth_of: Callable[[Any], F32] = seen.depth_of

    @cached_property
    def background(self) -> F32:
        """(H, W) float32 median depth over the frames [m], NaN where never known."""
        return median_image(self._depths)

    def points_at(self, pixels: ArrayLike) -> F64:
        """(N, 3) points [m] in the rectified left camera frame, by the background's depth around (N, 2) pixels. Raises
        InputError: a pixel outside the image or without depth."""
        background = self.background
        height, width = background.shape
        points = []
        for u, v in np.asarray(pixels, dtype=np.float64):
            row = round(v)
            col = round(u)
            if not (0 <= row < height and 0 <= col < width):
                raise InputError(f"expected pixels inside {width}x{height}, found ({u:g}, {v:g})")
            patch = background[max(0, row - 4) : row + 5, max(0, col - 4) : col + 5]
            if not np.isfinite(patch).any():
                raise InputError(f"expected pixels with depth, found none around ({u:g}, {v:g})")
            points.append(self.geometry.rays((u, v)) * float(np.nanmedian(patch)))
        return np.array(points)

    def depth_std_m(self, points: F64) -> F64:
        """(N,) deviation of the background's depth at (N, 3) points [m]."""
        share = FLOOR_DISPARITY_STD_PX / self.geometry.disparity_std_px
        return np.array([share * self.geometry.depth_std_m(float(z)) for z in points[:, 2]])

    def floor_at(self, places: F64) -> Floor:
        """The floor through (N, 2) pixels, whose depth is looked up, or (N, 3) points [m]. Raises InputError: as
        ``points_at``, or they lie in no plane below the camera."""
        if places.shape[1] == 3:
            return floor_from_points(places, "points=")
        points = self.points_at(places)
        return floor_from_points(points, "points=", self.depth_std_m(points))

    def picture(self, floor: Floor) -> U8:
        """The left image with a metric grid on the floor, and a legend."""
        camera = self.geometry.above(floor.world_SE3_left)
        grid = draw_grid(self.image, camera.project, floor.extent_m or (-5.0, -5.0, 5.0, 5.0))
        return with_legend(grid, _LEGEND)


def parse_points(given: Sequence[str | Sequence[float]] | F64) -> F64:
    """Points as rows or as typed: ``u,v`` in pixels of the rectified left image or ``x,y,z`` in metres, (N, 2) or
    (N, 3). Raises InputError: not numbers, or of both kinds."""
    try:
        points = np.array([each.split(",") if isinstance(each, str) else each for each in given], dtype=np.float64)
    except ValueError:
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
        raise InputError(f"expected all u,v in pixels or all x,y,z in metres, found {given}", argument="points")
    if len(points) < 3:
        raise InputError(f"expected three or more, found {len(points)}", argument="points")
    return points


def floor_from_tracks(
    recording: Recording[StereoPair | DepthCamera], view: FloorDepths, tracks: Trajectories, used: Floor, path: Path
) -> Floor:
    """Refine the floor ``used`` in a run on a recording by where its tracks' heads and feet are (see
    ``calib.floor.find.floor_from_people``); ``path`` is that of the tracks, for messages."""
    rows = tracks.where(np.array(tracks.state == "confirmed") & np.isfinite(tracks.height_m))
    frames = np.unique(rows.frame)
    if len(frames):
        spread = np.linspace(0, len(frames) - 1, 60).astype(int)
        frames = frames[np.unique(spread)]
    rows = rows.where(np.isin(rows.frame, frames))
    world = np.column_stack([rows.x_m, rows.y_m, rows.height_m])
    heads = used.world_SE3_left.inverse() @ world
    feet = np.full_like(heads, np.nan)
    for frame in recording.at(frames.tolist()):
        depth = view.depth_of(frame)
        for row in np.flatnonzero(rows.frame == frame.index):
            feet[row] = _foot(depth, view.geometry, rows.box_px[row])
    return floor_from_people(PeopleSeen(rows.track_id, heads, feet), used, str(path))


def _foot(depth: F32, geometry: RectifiedGeometry, box: F64) -> F64:
    """(3,) point where the box's lowest band has depth [m], NaN when it is cut off or has none."""
    image_height, image_width = depth.shape
    left, top, width, height = box
    bottom = top + height
    if not np.isfinite(box).all() or bottom > image_height - 3:
        return np.full(3, np.nan)
    # Feet are searched in this lowest share of a person's box [1].
    first_row = max(0, int(bottom - 0.08 * height))
    last_row = max(1, int(bottom))
    first_column = max(0, int(left + 0.25 * width))
    last_column = min(image_width, max(1, int(left + 0.75 * width)))
    band = depth[first_row:last_row, first_column:last_column]
    if np.isfinite(band).sum() < 5:
        return np.full(3, np.nan)
    middle = (left + width / 2, (first_row + last_row) / 2)
    return geometry.rays(middle) * float(np.nanmedian(band))


def draw_grid(image: U8, project: Project, extent_m: tuple[float, float, float, float]) -> U8:
    """A floor grid with lines every metre and the axes from below the camera, on a copy."""
    canvas = as_colour(image).copy()
    size = (canvas.shape[1], canvas.shape[0])
    for line in grid_lines(project, extent_m, size):
        points = np.rint(line.pixels).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(canvas, [points], False, GRID_COLOUR, 1, cv2.LINE_AA)
    for name, axis in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0))):
        ends = project(np.array([[0.0, 0.0, 0.0], axis]))
        if not np.isfinite(ends).all():
            continue
        start, end = np.clip(np.rint(ends), -9999, 9999).astype(int).tolist()
        cv2.arrowedLine(canvas, start, end, AXIS_COLOUR, 2, cv2.LINE_AA)
        cv2.putText(canvas, name, end, cv2.FONT_HERSHEY_SIMPLEX, 0.6, AXIS_COLOUR, 2, cv2.LINE_AA)
    return canvas
