"""The static scene of a recording as a cloud of coloured points on the world's axes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import InputError, WorkError
from calib.images import as_colour
from calib.io import reason
from calib.libraries import import_open3d
from calib.types import F32, U8
from planview.engine.config import Config
from planview.engine.front_end import FrontEnd
from planview.engine.setup import AnySetup
from stereo.depth import DepthFromDisparity, back_project, median_image
from stereo.floor import setup_frames
from stereo.recording import Recorded, RgbdRecording, StereoRecording

VOXEL_M = 0.015
"""Points are thinned to one in a cube of this side [m] (our choice: half a cell of the maps)."""
NEIGHBOURS, DEVIATIONS = 16, 2.0
"""A point whose mean distance to so many neighbours is so many deviations above the mean of all is left out (open3d's
``remove_statistical_outlier``; the values of its documentation, rounded)."""


@dataclass(frozen=True, eq=False)
class SceneCloud:
    """Points of what does not move.

    Attributes:
        points_m: (N, 3) float32 [m], world frame.
        colours: (N, 3) uint8, red, green, blue.
    """

    points_m: F32
    colours: U8


def scene_cloud(recording: StereoRecording | RgbdRecording, setup: AnySetup, config: Config) -> SceneCloud:
    """Median depth and median colour of frames spread over a recording: people who move are not in it.

    Raises:
        WorkError: no usable frame.
    """
    front_end: FrontEnd = setup.front_end(config)
    sampled: Recorded[Any] = recording
    images, disparities = [], []
    for frame in setup_frames(sampled, config.analysis.setup_frames):
        rectified = front_end.rectify(frame)
        images.append(as_colour(rectified.left))
        disparities.append(front_end.disparity(rectified))
    depth = DepthFromDisparity(front_end.geometry)(median_image(disparities))
    points = back_project(depth, front_end.geometry).reshape(-1, 3)
    colours = np.median(np.stack(images), axis=0).astype(np.uint8).reshape(-1, 3)[:, ::-1]
    known = np.isfinite(points).all(axis=1)
    world = setup.floor.world_SE3_left @ points[known].astype(np.float64)
    return SceneCloud(np.asarray(world, dtype=np.float32), np.ascontiguousarray(colours[known]))


def write_cloud(path: Path, cloud: SceneCloud) -> int:
    """Write a cloud, thinned and without outliers, in the format of the file's name (.ply, .pcd, .xyz).

    Returns:
        How many points were written.
    Raises:
        InputError: another format.
        WorkError: open3d is missing, or the file cannot be written.
    """
    if path.suffix.lower() not in (".ply", ".pcd", ".xyz"):
        raise InputError(f"{path}: expected a name that ends in .ply, .pcd or .xyz")
    o3d = import_open3d("a cloud of points")
    full = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points_m.astype(np.float64)))
    full.colors = o3d.utility.Vector3dVector(cloud.colours / 255.0)
    thin, _ = full.voxel_down_sample(VOXEL_M).remove_statistical_outlier(NEIGHBOURS, DEVIATIONS)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WorkError(f"{path}: cannot be written ({reason(error)})") from error
    if not o3d.io.write_point_cloud(str(path), thin):
        raise WorkError(f"{path}: cannot be written")
    return len(thin.points)
