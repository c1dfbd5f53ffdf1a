"""What one head tells about the place it watches: its floor, people's paths, and what stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.types import F32
from planview.calibration.head_paths import DisparityEffect
from planview.engine.config import Config
from planview.engine.factory import floor_tracker
from planview.engine.pipeline import Pipeline
from planview.engine.setup import set_up_any
from planview.trajectories.table import Trajectories, TrajectoryCollector
from stereo.depth import back_project, median_image
from stereo.readers import open_any

SCENE_FRAMES = 24
"""Frames, spread over the recording, whose median is the scene without people (our choice)."""
SCENE_STD_MAX_M = 0.30
"""Points of the scene with a larger predicted depth deviation are left out [m] (our choice)."""


@dataclass(frozen=True, eq=False)
class HeadRecord:
    """One head, in its own world and on its own clock.

    Attributes:
        path: of its recording.
        effect: pose above its own floor, and what an offset of the disparities does.
        tracks: of all people.
        scene: (N, 3) float32 points that stand still [m].
    """

    path: Path
    effect: DisparityEffect
    tracks: Trajectories
    scene: F32


def record_head(path: Path, config: Config | None = None, done: Callable[[], None] = lambda: None) -> HeadRecord:
    """Track a head's recording and gather the scene behind the people.

    Args:
        done: called after every frame.
    Raises:
        InputError: no such recording or calibration.
        WorkError: no floor is visible.
    """
    config = config or Config()
    recording = open_any(path)
    setup = set_up_any(recording, config)
    engine = Pipeline(recording, setup, config, floor_tracker("template", config))
    collector, disparities = TrajectoryCollector(), []
    every = max(1, engine.recording.n_frames // SCENE_FRAMES)
    for result in engine:
        collector.add(result.frame, result.timestamp_s, result.tracks)
        if result.frame % every == 0 and result.disparity is not None:
            disparities.append(result.disparity)
        done()
    effect = DisparityEffect(engine.stereo.floor.world_SE3_left, engine.stereo.geometry.disparity_metre)
    return HeadRecord(path, effect, collector.trajectories(), _scene(engine, disparities))


def _scene(engine: Pipeline, disparities: list[F32]) -> F32:
    """Points of the median disparity that are known well enough."""
    if not disparities:
        return np.empty((0, 3), dtype=np.float32)
    geometry = engine.stereo.geometry
    disparity = median_image(disparities)
    farthest = (SCENE_STD_MAX_M / geometry.depth_std_m(1.0)) ** 0.5
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.float32(geometry.disparity_metre) / disparity
        depth[~((disparity > 0) & (depth < farthest))] = np.nan
    points = back_project(np.asarray(depth, dtype=np.float32), geometry).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return np.asarray(engine.stereo.floor.world_SE3_left @ points, dtype=np.float32)
