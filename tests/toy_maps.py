"""A small plan-view recording made without images: a block of points that walks over a floor."""

from pathlib import Path

import numpy as np
from toy_stereo import ToyWorld

from calib.rig import Floor
from planview.engine.config import Config
from planview.maps.grid import FloorRig
from planview.maps.recording import MapsWriter, RecordedPoints, RecordedViews
from planview.maps.view import ViewBuilder
from stereo.depth import Depth, RectifiedGeometry
from stereo.matcher import DisparityRange
from stereo.recording import Frame, Skipped

GEOMETRY = RectifiedGeometry(80, 60, 58.0, 58.0, 39.5, 29.5, 0.12)


def write_toy_maps(path: Path, n_frames: int = 40) -> Path:
    """Colours, pixels without depth and one background; frame 7 was skipped."""
    config, pose = Config(), ToyWorld().world_SE3_left
    cloud = ViewBuilder(GEOMETRY, pose, config.maps, 1)
    floor = Floor(pose, 0.8, 0.01, extent_m=(-3.0, 0.0, 3.0, 6.0))
    view = FloorRig(GEOMETRY, floor, "found", "toy", 0.1, DisparityRange(0, 16), cloud.grid, 1)
    writer = MapsWriter(path, RecordedViews(view, config.model_dump_json()), 15.0)
    background = np.full(cloud.shape, GEOMETRY.disparity_at(4.0), np.float32)
    rng = np.random.default_rng(4)
    for index in (i for i in range(n_frames) if i != 7):
        disparity, mask = background.copy(), np.zeros(cloud.shape, np.uint8)
        left = 5 + index
        mask[15:45, left : left + 12] = 255
        disparity[15:45, left : left + 12] = GEOMETRY.disparity_at(3.0) + rng.normal(0, 0.05, (30, 12))
        disparity[20:23, left : left + 3] = np.nan
        image = np.full((*cloud.shape, 3), (40, 40, 160), np.uint8)
        renewed = background if index == 0 else None
        depth = Depth.of_whole(image, disparity, 1)
        view_now = cloud.view(cloud.points(disparity, mask, image), mask, index / 15.0, renewed, depth)
        writer.add(Frame(index, index / 15.0, (RecordedPoints.of(view_now),)))
    writer.close([Skipped(7, "left: file is missing")])
    return path
