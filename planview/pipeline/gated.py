"""Decides which part of a pair is matched: where the background model cannot know the depth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from calib.rig import Floor
from calib.types import F32, U8
from planview.foreground.mixture import Foreground
from planview.trajectories.state import TrackState
from stereo.gate import MARGIN_PX, SAMPLE, Gate, MatchingParams, Window
from stereo.matcher import DisparityRange, RangeParams, SgbmMatcher, disparity_range
from stereo.recording import StereoFrame
from stereo.rectify import PartialPair, Rectifier

SAME_LEVELS = 12
"""Largest difference of a channel between two images of the same surface in the same light [levels of 255]: three
deviations of the luma that the foreground takes for noise (our choice)."""


class Measured(NamedTuple):
    """Disparity of a frame that was matched in part.

    Attributes:
        disparity: (H, W) float32 [px], of every pixel as it was measured last; NaN invalid.
        now: (h, w) float32 [px] at the analysis size, NaN also where nothing was measured in this frame.
        mask: (h, w) uint8, 255 where disparity was measured in this frame.
    """

    disparity: F32
    now: F32
    mask: U8


class MatchingMemory:
    """All that matching in part carries from frame to frame.

    Attributes:
        gate: place of the refresh.
        disparity: (H, W) float32 [px] as measured last.
        foreground: (h, w) uint8 mask of the last frame.
        background: every SAMPLE-th row and column of the analysed image, uint8, as it looked when it was last measured
            as background.
        boxes: left, top, width, height of the people who were not found in the last frame [px]; those who were are part
            of the foreground.
    """

    def __init__(self, gate: Gate, shape: tuple[int, int]) -> None:
        self.gate, self._shape = gate, shape
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.gate.reset()
        self.disparity: F32 = np.full(self.gate.size[::-1], np.nan, np.float32)
        self.foreground: U8 = np.zeros(self._shape, np.uint8)
        self.background: U8 | None = None
        self.boxes: tuple[tuple[float, float, float, float], ...] = ()


class GatedMatching:
    """Matches what may have changed, what was foreground, where people are, and a rotating refresh.

    Attributes:
        memory: what it carries from frame to frame.
    """

    def __init__(
        self,
        rectifier: Rectifier,
        matcher: SgbmMatcher,
        floor: Floor,
        range_params: RangeParams,
        matching: MatchingParams,
        shape: tuple[int, int],
        reduction: int,
    ) -> None:
        """Prepare.

        Args:
            shape, reduction: of the analysed image, every ``reduction``-th row and column of the rectified one.
        """
        self._rectifier, self._matcher = rectifier, matcher
        self._floor, self._range = floor, range_params
        self._shape, self._reduction = shape, reduction
        gate = Gate(rectifier.geometry.size, reduction, matching, lambda window: self._searched(window).count)
        self.memory = MatchingMemory(gate, shape)

    def rectify(self, frame: StereoFrame) -> PartialPair:
        """The part of the work that depends on no other frame."""
        return self._rectifier.partly(frame.left, frame.right)

    def __call__(self, pair: PartialPair, image: U8, foreground: Foreground, timestamp_s: float) -> Measured:
        """Match the next frame.

        Args:
            image: of the analysis size.
            foreground: the background of the frames before.
        """
        memory, whole = self.memory, self.memory.gate.whole
        windows = [whole]
        if foreground.settled:
            windows = memory.gate.windows(self._changed(image, foreground), memory.boxes, timestamp_s)
        now = np.full(self._shape, np.nan, np.float32)
        mask = np.zeros(self._shape, np.uint8)
        step = self._reduction
        for window in windows:
            found = self._whole(pair) if window == whole else self._part(pair, window)
            memory.disparity[window.slices] = found
            few = tuple(slice(-(-s.start // step), -(-s.stop // step)) for s in window.slices)
            now[few], mask[few] = found[::step, ::step], 255
        return Measured(memory.disparity.copy(), now, mask)

    def _changed(self, image: U8, foreground: Foreground) -> U8:
        """Samples that differ from the background, unless they were measured as background when they looked as now.

        That is a shadow or a patch of light, which depth has told from a person once. A person who stands still is no
        change: what was foreground stays in question.
        """
        changed = foreground.changed(image, SAMPLE)
        if self.memory.background is not None:
            apart = cv2.absdiff(_sampled(image), self.memory.background)
            same = cv2.inRange(apart, (0,) * 4, (SAME_LEVELS,) * 4)
            changed[same > 0] = 0
        before = cv2.medianBlur(_sampled(self.memory.foreground), 3)
        return np.asarray(cv2.bitwise_or(cv2.medianBlur(changed, 3), before), dtype=np.uint8)

    def learn(self, image: U8, foreground: U8, measured: U8, tracks: Sequence[TrackState]) -> None:
        """Keep what the next frame is compared with.

        Args:
            image, foreground, measured: of this frame, at the analysis size.
            tracks: people, with their boxes in the rectified image.
        """
        few = _sampled(image)
        if self.memory.background is None:
            self.memory.background = few.copy()
        known = cv2.bitwise_and(_sampled(measured), cv2.bitwise_not(_sampled(foreground)))
        cv2.copyTo(few, known, self.memory.background)
        self.memory.foreground = foreground
        self.memory.boxes = tuple(
            track.box_px for track in tracks if track.state == "lost" and not math.isnan(track.box_px[0])
        )

    def _whole(self, pair: PartialPair) -> F32:
        whole = self.memory.gate.whole
        return self._matcher(pair.left_grey(whole), pair.right_grey(whole))

    def _part(self, pair: PartialPair, window: Window) -> F32:
        outer = window.grown(MARGIN_PX, self.memory.gate.size)
        searched = self._searched(outer)
        right = pair.right_grey(self._matcher.right_of(outer, searched))
        found = self._matcher.part(pair.left_grey(outer), right, outer, searched)
        return found[window.within(outer.left, outer.top).slices]

    def _searched(self, window: Window) -> DisparityRange:
        """Disparities in a window: a person at 6 m does not need those of 2 m."""
        return disparity_range(self._rectifier.geometry, self._range, self._floor, window)


def _sampled(image: U8) -> U8:
    """Every SAMPLE-th row and column."""
    return np.ascontiguousarray(image[::SAMPLE, ::SAMPLE])
