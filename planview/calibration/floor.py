"""The floor of a recording, found or given, and a picture to judge it by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError, WorkError
from calib.floor.find import find_floor
from calib.floor.points import PeopleSeen, floor_from_people, floor_from_points
from calib.rig import Floor
from calib.types import F32, F64, U8
from planview.calibration.pictures import draw_grid
from planview.pipeline.config import Config
from planview.trajectories.table import Trajectories
from stereo.depth import DepthFromDisparity, RectifiedGeometry, back_project
from stereo.matcher import SgbmMatcher, disparity_range
from stereo.readers.pair import StereoRecording
from stereo.rectify import Rectifier, aligned_rectifier
from stereo.two_way import match_two_ways

STEP_PX = 2
"""The floor is fitted to every n-th row and column."""
PATCH_PX = 4
"""A given pixel's depth is the median of a square of this half side."""
FOOT_BAND = 0.08
"""Feet are looked for in this lowest share of a person's box [1] (our choice)."""
MAX_TRACK_FRAMES = 60


@dataclass(frozen=True, eq=False)
class FloorView:
    """Depth over some frames of a recording.

    Attributes:
        geometry: of the rectified pair.
        image: (H, W[, 3]) uint8, rectified left image of the middle frame.
        depths: one (H, W) float32 [m] per frame, NaN without depth.
    """

    rectifier: Rectifier
    matcher: SgbmMatcher
    image: U8
    depths: tuple[F32, ...]

    @property
    def geometry(self) -> RectifiedGeometry:
        return self.rectifier.geometry

    @property
    def background(self) -> F32:
        """(H, W) float32 median depth over the frames [m], NaN where never known."""
        stack = np.stack(self.depths)
        known = np.isfinite(stack).any(axis=0)
        median = np.full(stack.shape[1:], np.nan, dtype=np.float32)
        median[known] = np.nanmedian(stack[:, known], axis=0)
        return median

    def find(self, config: Config) -> Floor:
        """The floor by itself (see ``calib.floor.find.find_floor``)."""
        clouds = [back_project(d, self.geometry)[::STEP_PX, ::STEP_PX].reshape(-1, 3) for d in self.depths]
        geometry = self.geometry
        return find_floor(clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m, params=config.floor)

    def points_at(self, pixels: ArrayLike) -> F64:
        """(N, 3) points [m] in the rectified left camera frame, by the background's depth around (N, 2) pixels.

        Raises:
            InputError: a pixel outside the image or without depth.
        """
        background = self.background
        height, width = background.shape
        points = []
        for u, v in np.asarray(pixels, dtype=np.float64):
            row, col = round(v), round(u)
            if not (0 <= row < height and 0 <= col < width):
                raise InputError(f"--points: expected pixels inside {width}x{height}, found ({u:g}, {v:g})")
            patch = background[max(0, row - PATCH_PX) : row + PATCH_PX + 1, max(0, col - PATCH_PX) : col + PATCH_PX + 1]
            if not np.isfinite(patch).any():
                raise InputError(f"--points: expected pixels with depth, found none around ({u:g}, {v:g})")
            points.append(ray(self.geometry, u, v) * float(np.nanmedian(patch)))
        return np.array(points)

    def picture(self, floor: Floor) -> U8:
        """The left image with a metric grid on the floor."""
        return draw_grid(self.image, WorldProjector(self.geometry, floor), floor.extent_m or (-5.0, -5.0, 5.0, 5.0))


def ray(geometry: RectifiedGeometry, u: float, v: float) -> F64:
    """(3,) ray at unit z through a pixel."""
    return np.array([(u - geometry.cu_px) / geometry.focal_u_px, (v - geometry.cv_px) / geometry.focal_v_px, 1.0])


class WorldProjector:
    """World points to pixels of the rectified left camera."""

    def __init__(self, geometry: RectifiedGeometry, floor: Floor) -> None:
        self._left_SE3_world = floor.world_SE3_left.inverse()
        self._matrix = geometry.matrix

    def __call__(self, points_world: ArrayLike) -> F64:
        """(N, 2) pixels of (N, 3) world points, NaN behind the camera."""
        p = self._left_SE3_world @ np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        z = np.where(p[:, 2] > 0.05, p[:, 2], np.nan)
        homogeneous = (p / z[:, None]) @ self._matrix.T
        return np.asarray(homogeneous[:, :2])


def view_floor(recording: StereoRecording, config: Config, n_frames: int) -> FloorView:
    """Depth of frames spread over a recording.

    Raises:
        WorkError: no usable frame.
    """
    frames = recording.sample(n_frames)
    if not frames:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    rectifier, _ = aligned_rectifier(recording.rig, frames, config.rectify)
    geometry = rectifier.geometry
    searched = disparity_range(geometry, config.range)
    matcher = SgbmMatcher(geometry, config.sgbm, searched, rectifier.mask, rectifier.right_mask)
    to_depth = DepthFromDisparity(geometry)
    pairs = [rectifier(frame.left, frame.right) for frame in frames]
    depths = tuple(to_depth(match_two_ways(matcher, pair.left_grey, pair.right_grey)) for pair in pairs)
    return FloorView(rectifier, matcher, pairs[len(pairs) // 2].left, depths)


def given_floor(view: FloorView, points: F64, pixels: bool) -> Floor:
    """The floor through points by hand: pixels of the rectified left image, or metres in its camera frame."""
    return floor_from_points(view.points_at(points) if pixels else points, "--points")


def floor_from_tracks(
    recording: StereoRecording, view: FloorView, tracks: Trajectories, used: Floor, path: Path
) -> Floor:
    """Refine a floor by where tracked people's heads and feet are (see ``calib.floor.points.floor_from_people``).

    Args:
        recording: that was tracked.
        view: of the same recording.
        tracks: from a run on it.
        used: the floor of that run.
        path: of the tracks, for messages.
    """
    rows = tracks.where(np.array(tracks.state == "confirmed") & np.isfinite(tracks.height_m))
    frames = np.unique(rows.frame)
    picked = frames[np.unique(np.linspace(0, len(frames) - 1, MAX_TRACK_FRAMES).astype(int))] if len(frames) else frames
    rows = rows.where(np.isin(rows.frame, picked))
    world = np.column_stack([rows.x_m, rows.y_m, rows.height_m])
    heads = used.world_SE3_left.inverse() @ world
    feet = np.full_like(heads, np.nan)
    to_depth = DepthFromDisparity(view.geometry)
    for frame in recording.at([int(i) for i in picked]):
        pair = view.rectifier(frame.left, frame.right)
        depth = to_depth(view.matcher(pair.left_grey, pair.right_grey))
        for i in np.flatnonzero(rows.frame == frame.index):
            feet[i] = _foot(depth, view.geometry, rows.box_px[i])
    return floor_from_people(PeopleSeen(rows.track_id, heads, feet), used, str(path))


def _foot(depth: F32, geometry: RectifiedGeometry, box: F64) -> F64:
    """(3,) point where the box's lowest band has depth [m], NaN when it is cut off or has none."""
    height, width = depth.shape
    left, top, w, h = box
    bottom = top + h
    if not np.isfinite(box).all() or bottom > height - 3:
        return np.full(3, np.nan)
    rows = slice(max(0, int(bottom - FOOT_BAND * h)), max(1, int(bottom)))
    columns = slice(max(0, int(left + 0.25 * w)), min(width, max(1, int(left + 0.75 * w))))
    band = depth[rows, columns]
    if np.isfinite(band).sum() < 5:
        return np.full(3, np.nan)
    return ray(geometry, left + w / 2, (rows.start + rows.stop) / 2) * float(np.nanmedian(band))
