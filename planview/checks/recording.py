"""The frames, disparities and floor that the checks look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.errors import WorkError
from calib.rig import Floor
from calib.types import F32, F64, U8
from stereo.depth import DepthFromDisparity, RectifiedGeometry
from stereo.floor import BLIND_SENSOR, FloorEstimator, FloorSearch, floor_in, setup_frames
from stereo.matcher import DisparityRange
from stereo.readers.pair import StereoRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame
from stereo.rectify import RectifiedPair, Rectifier, aligned_rectifier
from stereo.rgbd import RectifiedRgbd, RgbdRectifier
from stereo.vertical import VerticalFit, VerticalParams, match_corners

MATCHED_FRAMES = 8
"""Frames in which corners are matched (our choice, for speed)."""
WIDE_SEARCH = VerticalParams(search_px=24, features=200)
"""Row offsets looked for in a pair that may be badly calibrated: a rig turned by 2 degrees still matches."""


class AnyRectifier(Protocol):
    """What the rectifiers of pairs and of images with depth have in common."""

    @property
    def geometry(self) -> RectifiedGeometry: ...

    @property
    def mask(self) -> U8: ...


class SceneEvidence(Protocol):
    """What is known of the scene, from a pair or from images with depth (see ``RecordingEvidence``)."""

    @property
    def rectifier(self) -> AnyRectifier: ...

    @property
    def disparities(self) -> list[F32]: ...

    @property
    def floor(self) -> Floor | None: ...

    @property
    def floor_refused(self) -> str: ...


@dataclass(frozen=True, eq=False)
class RgbdEvidence:
    """A recording of images with depth under examination.

    Attributes:
        spread, run, frames_asked, floor, floor_refused: as of ``RecordingEvidence``.
        rectifier: takes the distortion out.
        rectified: spread frames.
        disparities: (H, W) float32 [px] of each, equivalent to its depth.
        searched: range of the disparities.
    """

    recording: RgbdRecording
    spread: list[RgbdFrame]
    run: list[RgbdFrame]
    rectifier: RgbdRectifier
    rectified: list[RectifiedRgbd]
    disparities: list[F32]
    searched: DisparityRange
    floor: Floor | None
    floor_refused: str
    frames_asked: int


@dataclass(frozen=True, eq=False)
class RecordingEvidence:
    """A recording under examination.

    Attributes:
        spread: frames spread over the recording, those that a run measures its floor in.
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


def gather(recording: StereoRecording, frames: int, search: FloorSearch | None = None) -> RecordingEvidence:
    """Decode, rectify and match what the checks need.

    Args:
        frames: length of the run of consecutive frames.
        search: how a run looks for the floor.
    Raises:
        WorkError: not one frame can be used.
    """
    search = search or FloorSearch()
    count = max(3, min(frames, recording.n_frames))
    spread = setup_frames(recording, search.frames)
    plain = Rectifier(recording.rig, search.rectify)
    rectifier, vertical = aligned_rectifier(recording.rig, spread, search.rectify)
    estimator = FloorEstimator(rectifier, search)
    pairs = [rectifier(f.left, f.right) for f in spread]
    disparities = [estimator.disparity(pair) for pair in pairs]
    floor, refused = _floor(estimator, disparities)
    return RecordingEvidence(
        recording,
        spread,
        recording.at(busiest([f.left for f in spread], [f.index for f in spread], recording.n_frames, count)),
        plain,
        _matches(plain, spread, estimator.disparities),
        rectifier,
        vertical,
        pairs,
        disparities,
        estimator.disparities,
        floor,
        refused,
        min(search.frames, recording.n_frames) + count,
    )


def gather_rgbd(recording: RgbdRecording, frames: int, search: FloorSearch | None = None) -> RgbdEvidence:
    """Decode and rectify what the checks of images with depth need (see ``gather``)."""
    search = search or FloorSearch()
    count = max(3, min(frames, recording.n_frames))
    spread = setup_frames(recording, search.frames)
    rectifier = RgbdRectifier(recording.camera, recording.sensor, search.rectify)
    rectified = [rectifier(frame) for frame in spread]
    floor, refused = _found(
        lambda: floor_in([r.depth_m for r in rectified], rectifier.geometry, search.floor, BLIND_SENSOR)
    )
    return RgbdEvidence(
        recording,
        spread,
        recording.at(busiest([f.image for f in spread], [f.index for f in spread], recording.n_frames, count)),
        rectifier,
        rectified,
        [rectifier.disparity(r) for r in rectified],
        rectifier.disparities(),
        floor,
        refused,
        min(search.frames, recording.n_frames) + count,
    )


def busiest(images: list[U8], indices: list[int], n_frames: int, count: int) -> list[int]:
    """Indices of ``count`` consecutive frames around the spread frame that differs most from the usual picture.

    Args:
        images, indices: of the frames spread over the recording.
    """
    small = np.stack([image[::8, ::8].reshape(-1) for image in images]).astype(np.float32)
    change = (np.abs(small - np.median(small, axis=0)) > 25).mean(axis=1)
    # A change of light changes everything: it is no movement.
    change[change > 0.5] = 0.0
    middle = indices[int(np.argmax(change))]
    first = max(0, min(middle - count // 2, n_frames - count))
    return list(range(first, min(first + count, n_frames)))


def _matches(rectifier: Rectifier, spread: list[StereoFrame], searched: DisparityRange) -> F64:
    largest = searched.first_px + searched.count
    found = [np.empty((0, 4))]
    for frame in spread[:: max(1, len(spread) // MATCHED_FRAMES)]:
        pair = rectifier(frame.left, frame.right)
        found.append(match_corners(pair.left_grey, pair.right_grey, largest, WIDE_SEARCH, -largest))
    return np.concatenate(found)


def _floor(estimator: FloorEstimator, disparities: list[F32]) -> tuple[Floor | None, str]:
    to_depth = DepthFromDisparity(estimator.rectifier.geometry)
    return _found(lambda: estimator.floor(to_depth(d) for d in disparities))


def _found(floor: Callable[[], Floor]) -> tuple[Floor | None, str]:
    """The floor, or why there is none."""
    try:
        return floor(), ""
    except WorkError as error:
        return None, str(error)
