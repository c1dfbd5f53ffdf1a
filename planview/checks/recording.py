"""The frames, disparities and floor that the checks look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from calib.errors import WorkError
from calib.images import as_grey
from calib.rig import Floor
from calib.types import F32, F64, U8
from stereo.floor import FloorEstimator, FloorSearch, sensor_floor, setup_frames
from stereo.matcher import DisparityRange
from stereo.recording import RgbdRecording, StereoRecording
from stereo.rectify import RectifiedPair, Rectifier, aligned_rectifier
from stereo.rgbd import RgbdRectifier
from stereo.rig_correction import RigCorrection, match_corners


class PairEvidence(NamedTuple):
    """What is known of a pair alone: the rectifier of the calibration as it is, (N, 4) float64 matches [px] in its
    images (u, v, u in the right one, row offset; disparities of both signs were searched), the correction of the
    calibration that a run makes, and the spread frames rectified by it."""

    plain: Rectifier
    matches: F64
    correction: RigCorrection
    rectified: list[RectifiedPair]


@dataclass(frozen=True, eq=False)
class Evidence:
    """A recording under examination.

    Attributes:
        spread, run: frames spread over the recording, in which a run measures its floor, and consecutive ones where
            most moves; ``frames_asked`` is how many both were meant to have.
        rectifier, pair: of a pair by the corrected rig; None of images with depth.
        lefts: (H, W) uint8 grey of each spread frame, rectified; the left one of a pair.
        disparities: (H, W) float32 [px] of each, in the range ``searched``; of images with depth equivalent to it.
        floor: found in them, None when ``floor_refused`` gives the reason.
    """

    recording: StereoRecording | RgbdRecording
    spread: list[Any]
    run: list[Any]
    rectifier: Rectifier | RgbdRectifier
    lefts: list[U8]
    disparities: list[F32]
    searched: DisparityRange
    floor: Floor | None
    floor_refused: str
    frames_asked: int
    pair: PairEvidence | None


def gather(recording: StereoRecording | RgbdRecording, frames: int, search: FloorSearch | None = None) -> Evidence:
    """Decode, rectify and match what the checks need, of consecutive ``frames`` and with the ``search`` for the
    floor of a run. Raises WorkError: not one frame can be used."""
    search = search or FloorSearch()
    count = max(3, min(frames, recording.n_frames))
    spread: list[Any] = setup_frames(recording, search.frames)
    find: Callable[[], Floor]
    rectifier: Rectifier | RgbdRectifier
    if isinstance(recording, StereoRecording):
        plain = Rectifier(recording.rig, search.rectify)
        rectifier, correction = aligned_rectifier(recording.rig, spread, search.rectify)
        estimator = FloorEstimator(rectifier, search)
        pairs = [rectifier(f.left, f.right) for f in spread]
        lefts, disparities = [p.left_grey for p in pairs], [estimator.disparity(pair) for pair in pairs]
        searched = estimator.disparities
        find = partial(estimator.floor, pairs, [rectifier.geometry.depth(d) for d in disparities])
        largest, found = searched.first_px + searched.count, [np.empty((0, 4))]
        # Frames in which corners are matched (for speed).
        for frame in spread[:: max(1, len(spread) // 8)]:
            p = plain(frame.left, frame.right)
            # Row offsets searched in a pair that may be badly calibrated: a rig turned by 2 degrees still matches.
            found.append(match_corners(p.left_grey, p.right_grey, largest, -largest, search_px=24, features=200))
        pair = PairEvidence(plain, np.concatenate(found), correction, pairs)
    else:
        rectifier = depth_rectifier = RgbdRectifier(recording.camera, recording.sensor, search.rectify)
        rectified = [depth_rectifier(frame) for frame in spread]
        lefts, disparities = [as_grey(r.left) for r in rectified], [depth_rectifier.disparity(r) for r in rectified]
        searched, pair = depth_rectifier.disparities(), None
        find = partial(sensor_floor, recording, depth_rectifier, search.floor, search.frames)
    floor, refused = None, ""
    try:
        floor = find()
    except WorkError as error:
        refused = str(error)
    images = [f.left if isinstance(recording, StereoRecording) else f.image for f in spread]
    run = recording.at(busiest(images, [f.index for f in spread], recording.n_frames, count))
    asked = min(search.frames, recording.n_frames) + count
    return Evidence(recording, spread, run, rectifier, lefts, disparities, searched, floor, refused, asked, pair)


def busiest(images: list[U8], indices: list[int], n_frames: int, count: int) -> list[int]:
    """Indices of ``count`` consecutive frames around the one, of (H, W) images with these indices spread over the
    recording, that differs most from the usual picture."""
    small = np.stack([image[::8, ::8].reshape(-1) for image in images]).astype(np.float32)
    change = (np.abs(small - np.median(small, axis=0)) > 25).mean(axis=1)
    # A change of light changes everything: it is no movement.
    change[change > 0.5] = 0.0
    middle = indices[int(np.argmax(change))]
    first = max(0, min(middle - count // 2, n_frames - count))
    return list(range(first, min(first + count, n_frames)))
