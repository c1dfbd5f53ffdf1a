"""What the checks look at, gathered once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.errors import WorkError
from calib.floor.find import find_floor
from calib.rig import Floor
from calib.types import F32, F64
from stereo.depth import DepthFromDisparity, back_project
from stereo.matcher import DisparityRange, SgbmMatcher, disparity_range
from stereo.readers.pair import StereoRecording
from stereo.recording import StereoFrame
from stereo.rectify import RectifiedPair, Rectifier, aligned_rectifier
from stereo.two_way import match_two_ways
from stereo.vertical import VerticalFit, VerticalParams, match_corners

SPREAD_FRAMES = 16
"""Frames spread over the recording: enough medians for a background without people, in half a dozen seconds."""
MATCHED_FRAMES = 8
WIDE_SEARCH = VerticalParams(search_px=24, features=200)
"""Row offsets looked for in a pair that may be badly calibrated: a rig turned by 2 degrees still matches."""
POINT_STEP_PX = 3


@dataclass(frozen=True, eq=False)
class Evidence:
    """A recording under examination.

    Attributes:
        spread: frames spread over the recording.
        run: consecutive frames where most moves.
        plain: rectifier of the calibration as it is.
        matches: (N, 4) float64 [px] of ``plain``'s images: u, v, u in the right image, row offset; disparities of
            both signs were searched.
        rectifier: with the row offset taken out.
        vertical: row offset before and after.
        pairs: rectified spread frames.
        disparities: (H, W) float32 [px] of each.
        searched: range of the disparities.
        floor: found in them, None when ``floor_refused`` says why not.
        frames_asked: how many frames ``spread`` and ``run`` were meant to have.
    """

    recording: StereoRecording
    spread: list[StereoFrame]
    run: list[StereoFrame]
    plain: Rectifier
    matches: F64
    rectifier: Rectifier
    vertical: VerticalFit
    pairs: list[RectifiedPair]
    disparities: list[F32]
    searched: DisparityRange
    floor: Floor | None
    floor_refused: str
    frames_asked: int


def gather(recording: StereoRecording, frames: int) -> Evidence:
    """Decode, rectify and match what the checks need.

    Args:
        frames: length of the run of consecutive frames.
    Raises:
        WorkError: not one frame can be used.
    """
    count = max(3, min(frames, recording.n_frames))
    spread = recording.sample(min(SPREAD_FRAMES, count))
    if not spread:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    plain = Rectifier(recording.rig)
    rectifier, vertical = aligned_rectifier(recording.rig, spread)
    pairs = [rectifier(f.left, f.right) for f in spread]
    searched = disparity_range(rectifier.geometry)
    disparities = _disparities(rectifier, pairs, searched)
    floor, refused = _floor(rectifier, disparities)
    return Evidence(
        recording,
        spread,
        recording.at(busiest(spread, recording.n_frames, count)),
        plain,
        _matches(plain, spread, searched),
        rectifier,
        vertical,
        pairs,
        disparities,
        searched,
        floor,
        refused,
        min(SPREAD_FRAMES, count) + count,
    )


def busiest(spread: list[StereoFrame], n_frames: int, count: int) -> list[int]:
    """Indices of ``count`` consecutive frames around the spread frame that differs most from the usual picture."""
    small = np.stack([f.left[::8, ::8].reshape(-1) for f in spread]).astype(np.float32)
    change = (np.abs(small - np.median(small, axis=0)) > 25).mean(axis=1)
    # A change of light changes everything: it is no movement.
    change[change > 0.5] = 0.0
    middle = spread[int(np.argmax(change))].index
    first = max(0, min(middle - count // 2, n_frames - count))
    return list(range(first, min(first + count, n_frames)))


def _disparities(rectifier: Rectifier, pairs: list[RectifiedPair], searched: DisparityRange) -> list[F32]:
    """Disparities without the matcher's lag, which would raise the camera; NaN outside the rectified picture."""
    matcher = SgbmMatcher(rectifier.geometry, None, searched)
    outside = rectifier.mask == 0
    found = [match_two_ways(matcher, p.left_grey, p.right_grey) for p in pairs]
    for disparity in found:
        disparity[outside] = np.nan
    return found


def _matches(rectifier: Rectifier, spread: list[StereoFrame], searched: DisparityRange) -> F64:
    largest = searched.first_px + searched.count
    found = [np.empty((0, 4))]
    for frame in spread[:: max(1, len(spread) // MATCHED_FRAMES)]:
        pair = rectifier(frame.left, frame.right)
        found.append(match_corners(pair.left_grey, pair.right_grey, largest, WIDE_SEARCH, -largest))
    return np.concatenate(found)


def _floor(rectifier: Rectifier, disparities: list[F32]) -> tuple[Floor | None, str]:
    geometry = rectifier.geometry
    to_depth = DepthFromDisparity(geometry)
    step = POINT_STEP_PX
    clouds = [back_project(to_depth(d), geometry)[::step, ::step].reshape(-1, 3) for d in disparities]
    try:
        return find_floor(clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m), ""
    except WorkError as error:
        return None, str(error)
