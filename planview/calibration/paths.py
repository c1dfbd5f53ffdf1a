"""What one rig sees of the place that it watches: its floor, people's paths, and what stands still."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.pose import SE3
from calib.types import F32, F64
from planview.engine.config import Config
from planview.engine.stereo import stereo_engine
from planview.maps.grid import FloorRig
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.depth import back_project, median_image
from stereo.readers import open_any

TICK_S = 0.1
"""Time between the samples of a path [s]: a walker moves a hand's breadth in it."""


@dataclass(frozen=True, eq=False)
class WalkedPath:
    """One person without a gap: from tick ``first`` on (N, 2) floor positions, one per tick [m], median height [m], NaN
    when unknown, and (N, 2) how far the positions move when all disparities grow by a pixel [m]."""

    first: int
    xy_m: F64
    height_m: float
    per_px_m: F64

    @property
    def end(self) -> int:
        """The tick after the last sample."""
        return self.first + len(self.xy_m)

    def at(self, ticks: F64, disparity_px: float = 0.0) -> F64:
        """(N, 2) positions at fractional ticks, with all disparities larger by ``disparity_px``; NaN outside."""
        known, values = np.arange(self.first, self.end), self.xy_m + disparity_px * self.per_px_m
        return np.column_stack([np.interp(ticks, known, column, left=np.nan, right=np.nan) for column in values.T])


def paths_of(tracks: Trajectories, world_SE3_left: SE3, disparity_metre: float) -> list[WalkedPath]:
    """Confirmed people as paths, for the pose of the rectified left camera and f b [px m]; predicted rows are gaps."""
    known = (tracks.state == "confirmed") & np.isfinite(tracks.x_m + tracks.y_m + tracks.timestamp_s)
    rows = tracks.where(known)
    paths = []
    for track_id in np.unique(rows.track_id):
        own = rows.where(rows.track_id == track_id)
        # Over longer gaps a path is not interpolated [s].
        cuts = np.flatnonzero(np.diff(own.timestamp_s) > 0.5) + 1
        for part in np.split(np.arange(len(own)), cuts):
            times_s, columns = own.timestamp_s[part], (own.x_m[part], own.y_m[part])
            first, last = math.ceil(times_s[0] / TICK_S), math.floor(times_s[-1] / TICK_S)
            # Shorter pieces are left out [s].
            if (last - first) * TICK_S < 2.0:
                continue
            ticks = np.arange(first, last + 1) * TICK_S
            xy = np.column_stack([np.interp(ticks, times_s, column) for column in columns])
            heights = own.height_m[part][np.isfinite(own.height_m[part])]
            height_m = float(np.median(heights)) if len(heights) else math.nan
            # What an offset of the disparities does: dZ/dd = -Z^2 / (f b), along the ray to a head at 1.6 m.
            out = np.column_stack([xy, np.full(len(xy), 1.6)]) - world_SE3_left.translation
            depth = out @ world_SE3_left.rotation[:, 2]
            per_px_m = -out[:, :2] * depth[:, None] / disparity_metre
            paths.append(WalkedPath(first, xy, height_m, np.asarray(per_px_m)))
    return paths


@dataclass(frozen=True, eq=False)
class RigRecord:
    """One rig, in its own world and on its own clock: its recording, the pose of its rectified left camera, the paths
    of all people, and (N, 3) float32 points that stand still [m]."""

    path: Path
    world_SE3_left: SE3
    paths: list[WalkedPath]
    scene: F32


def record_rig(path: Path, config: Config | None = None, done: Callable[[], None] = lambda: None) -> RigRecord:
    """Track a rig's recording and gather the scene behind the people."""
    config = config or Config()
    recording = open_any(path)
    engine = stereo_engine(recording, config)
    (view,) = engine.rigs.values()
    collector, disparities = TrajectoryCollector(), []
    # Frames, spread over the recording, whose median is the scene without people.
    every = max(1, engine.recording.n_frames // 24)
    for result in engine:
        collector.add(result.frame, result.timestamp_s, result.tracks)
        if result.frame % every == 0 and result.depth is not None:
            disparities.append(result.depth.disparity)
        done()
    pose = view.floor.world_SE3_left
    paths = paths_of(collector.trajectories(), pose, view.geometry.disparity_metre)
    return RigRecord(path, pose, paths, _scene(view, disparities))


def _scene(view: FloorRig, disparities: list[F32]) -> F32:
    """Points of the median disparity that are known well enough."""
    if not disparities:
        return np.empty((0, 3), dtype=np.float32)
    geometry, disparity = view.geometry, median_image(disparities)
    # Points of the scene with a larger predicted depth deviation are left out [m].
    farthest = (0.30 / geometry.depth_std_m(1.0)) ** 0.5
    points = back_project(geometry.depth(disparity, farthest), geometry, view.reduction).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return np.asarray(view.floor.world_SE3_left @ points, dtype=np.float32)
