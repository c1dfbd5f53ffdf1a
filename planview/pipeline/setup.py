"""What must be known before the first frame: rows aligned, disparities to search, the floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import WorkError
from calib.floor.find import find_floor
from calib.rig import Floor
from calib.types import F32, F64
from planview.pipeline.config import Config
from stereo.depth import DepthFromDisparity, back_project
from stereo.matcher import DisparityRange, SgbmMatcher, disparity_range
from stereo.recording import Recording, StereoFrame
from stereo.rectify import Rectifier, aligned_rectifier
from stereo.two_way import match_two_ways
from stereo.vertical import VerticalFit, VerticalParams, match_corners

FLOOR_STEP_PX = 3
"""The floor is fitted to every n-th row and column of the setup frames."""
VALID_LEAST = 0.03
"""Smallest share of pixels with disparity in the median setup frame: a bare room still has more, unrelated images less
(our choice)."""
ORDER_FRAMES = 4
ORDER_MATCHES = 40
"""Setup frames, and fewest corners found in both images, by which left and right are told apart (our choice)."""
ORDER_SEARCH = VerticalParams(search_px=24)
"""Rows are wide apart when the wrong calibration is taken to an image."""
ORDER_LEAST = 0.5
"""Smallest share of corners nearer than infinity: of swapped images nearly all are beyond (our choice)."""
ROWS_MOST = 5.0
"""Largest median row offset of the corners [px of 640]. It could be taken out, but a rig that is so far off its rows is
as far off along them, where nobody sees it, and all depth is wrong (our choice; a worn factory calibration has 0.5)."""


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
        WorkError: no usable frame, left and right swapped, hardly any disparity, or no floor visible.
    """
    frames = recording.sample(config.analysis.setup_frames)
    if not frames:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    refuse_foreign(recording.path, Rectifier(recording.rig, config.rectify), frames)
    rectifier, vertical = aligned_rectifier(recording.rig, frames, config.rectify)
    if recording.world_SE3_left is not None:
        floor, source = Floor(recording.world_SE3_left), "world.toml"
    else:
        floor, source = floor_of(rectifier, frames, config), "found"
    return Setup(rectifier, floor, disparity_range(rectifier.geometry, config.range, floor), source, vertical)


def refuse_foreign(path: Path, rectifier: Rectifier, frames: Sequence[StereoFrame]) -> None:
    """Matched corners must lie nearer than infinity and about on their rows.

    Args:
        rectifier: of the calibration as it is, without correction.
    Raises:
        WorkError: left and right are swapped, or the calibration is another rig's.
    """
    matches = _corners(rectifier, frames)
    if len(matches) < ORDER_MATCHES:
        return
    beyond = float(np.mean(matches[:, 0] - matches[:, 2] <= -0.5))
    if beyond > 1.0 - ORDER_LEAST:
        raise WorkError(
            f"{path}: expected the left camera's images left and the right one's right, found {beyond:.0%} of "
            "the matched corners beyond infinity: left and right are swapped, or the calibration is wrong"
        )
    rows = float(np.median(np.abs(matches[:, 3]))) * 640.0 / rectifier.geometry.width
    if rows > ROWS_MOST:
        raise WorkError(
            f"{path}: expected matched corners on the same row, found them {rows:.1f} px of 640 off: "
            "left and right are swapped, or the calibration is another rig's (planview doctor tells)"
        )


def _corners(rectifier: Rectifier, frames: Sequence[StereoFrame]) -> F64:
    searched = disparity_range(rectifier.geometry)
    largest = float(searched.first_px + searched.count)
    found = [np.empty((0, 4))]
    for frame in frames[:: -(-len(frames) // ORDER_FRAMES)]:
        pair = rectifier(frame.left, frame.right)
        found.append(match_corners(pair.left_grey, pair.right_grey, largest, ORDER_SEARCH, -largest))
    return np.concatenate(found)


def floor_of(rectifier: Rectifier, frames: Sequence[StereoFrame], config: Config) -> Floor:
    """The floor in some frames (see ``calib.floor.find.find_floor``).

    Raises:
        WorkError: hardly any disparity is valid, or no floor is visible.
    """
    geometry = rectifier.geometry
    searched = disparity_range(geometry, config.range)
    matcher = SgbmMatcher(geometry, config.sgbm, searched, rectifier.mask, rectifier.right_mask)
    to_depth = DepthFromDisparity(geometry)
    clouds: list[F32] = []
    for frame in frames:
        pair = rectifier(frame.left, frame.right)
        points = back_project(to_depth(match_two_ways(matcher, pair.left_grey, pair.right_grey)), geometry)
        clouds.append(points[::FLOOR_STEP_PX, ::FLOOR_STEP_PX].reshape(-1, 3))
    _refuse_blind(clouds)
    return find_floor(clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m, params=config.floor)


def _refuse_blind(clouds: list[F32]) -> None:
    valid = float(np.median([np.isfinite(cloud[:, 2]).mean() for cloud in clouds])) if clouds else 0.0
    if valid < VALID_LEAST:
        raise WorkError(
            f"expected disparity in at least {VALID_LEAST:.0%} of the pixels, found {valid:.1%}: left and right are "
            "swapped, the calibration belongs to another rig, or the images show no texture (planview doctor tells)"
        )
