"""What must be known before the first frame: rows aligned, disparities to search, the floor."""

from __future__ import annotations

from dataclasses import dataclass

from calib.errors import WorkError
from calib.floor import find_floor
from calib.rig import Floor
from calib.types import F32
from planview.config import Config
from stereo.depth import DepthFromDisparity, back_project
from stereo.matcher import DisparityRange, SgbmMatcher, disparity_range
from stereo.recording import Recording, StereoFrame
from stereo.rectify import Rectifier, aligned_rectifier
from stereo.two_way import match_two_ways
from stereo.vertical import VerticalFit

FLOOR_STEP_PX = 3
"""The floor is fitted to every n-th row and column of the setup frames."""


@dataclass(frozen=True, eq=False)
class Setup:
    """A recording made ready.

    Attributes:
        rectifier: with the measured vertical residual taken out.
        floor: found in the recording or read from ``world.toml``.
        disparities: range that people on that floor can have.
        floor_source: "found" or the file that gave it.
        vertical: the row offset that was measured, before and after.
    """

    rectifier: Rectifier
    floor: Floor
    disparities: DisparityRange
    floor_source: str
    vertical: VerticalFit


def set_up(recording: Recording, config: Config) -> Setup:
    """Measure the vertical residual and find the floor in frames spread over the recording.

    Raises:
        WorkError: no usable frame, or no floor visible.
    """
    frames = recording.sample(config.analysis.setup_frames)
    if not frames:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    rectifier, vertical = aligned_rectifier(recording.rig, frames, config.rectify)
    if recording.world_SE3_left is not None:
        floor, source = Floor(recording.world_SE3_left), "world.toml"
    else:
        floor, source = floor_of(rectifier, frames, config), "found"
    return Setup(rectifier, floor, disparity_range(rectifier.geometry, config.range, floor), source, vertical)


def floor_of(rectifier: Rectifier, frames: list[StereoFrame], config: Config) -> Floor:
    """The floor in some frames (see ``calib.floor.find_floor``)."""
    geometry = rectifier.geometry
    searched = disparity_range(geometry, config.range)
    matcher = SgbmMatcher(geometry, config.sgbm, searched, rectifier.mask, rectifier.right_mask)
    to_depth = DepthFromDisparity(geometry)
    clouds: list[F32] = []
    for frame in frames:
        pair = rectifier(frame.left, frame.right)
        points = back_project(to_depth(match_two_ways(matcher, pair.left_grey, pair.right_grey)), geometry)
        clouds.append(points[::FLOOR_STEP_PX, ::FLOOR_STEP_PX].reshape(-1, 3))
    return find_floor(clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m, params=config.floor)
