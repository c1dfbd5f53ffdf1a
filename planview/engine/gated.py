"""Decides which part of a pair is matched: where the background model cannot know the depth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from calib.rig import Floor
from calib.types import F32, U8
from planview.foreground.mixture import Foreground
from planview.trajectories.state import TrackState
from stereo.gating import MARGIN, SAMPLE, Gate, MatchingParams, Window
from stereo.matcher import Levels, SampledDisparity, SgbmMatcher, farthest_head_m

SAME_LEVELS = 12
"""Largest difference of a channel between two images of the same surface in the same light [levels of 255]: three
deviations of the luma that the foreground takes for noise (our choice)."""


class MatchingMemory:
    """All that matching in part carries from frame to frame.

    Attributes:
        gate: place of the refresh.
        disparity: (h, w) float32 [px] as measured last, at the analysis size.
        foreground: (h, w) uint8 mask of the last frame.
        background: (h, w[, 3]) uint8, every SAMPLE-th row and column of the analysed image as it looked when it was
            last measured as background.
        boxes: left, top, width, height of the people who were not found in the last frame [samples]; those who were
            are part of the foreground.
    """

    def __init__(self, gate: Gate, shape: tuple[int, int]) -> None:
        self.gate, self._shape = gate, shape
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.gate.reset()
        self.disparity: F32 = np.full(self._shape, np.nan, np.float32)
        self.foreground: U8 = np.zeros(self._shape, np.uint8)
        self.background: U8 | None = None
        self.boxes: tuple[tuple[float, float, float, float], ...] = ()


class GatedMatching:
    """Matches what may have changed, what was foreground, where people are, and a rotating refresh.

    Attributes:
        memory: what it carries from frame to frame.
    """

    def __init__(self, matcher: SgbmMatcher, floor: Floor, params: MatchingParams) -> None:
        """Prepare, for samples that make up the analysed image."""
        self._matcher, self._gated = matcher, params.gated
        self.memory = MatchingMemory(Gate(matcher.shape, params), matcher.shape)
        # Breadth of a head [m] (anthropometric tables, adults). A change that does not fill half of a square so wide,
        # at the place in view where heads look smallest, is noise or a fleck of light.
        geometry = matcher.geometry
        head_px = geometry.focal_u_px * 0.15 / farthest_head_m(geometry, floor)
        self._grain = max(3, 2 * int((head_px / (matcher.step * SAMPLE) + 1) / 2) - 1)

    def levels(self, left_grey: U8, right_grey: U8) -> Levels:
        """The part of the work that depends on no other frame."""
        return self._matcher.levels(left_grey, right_grey)

    def __call__(
        self, levels: Levels, image: U8, foreground: Foreground, timestamp_s: float
    ) -> tuple[SampledDisparity, F32, U8]:
        """Match the next frame.

        Args:
            image: of the analysis size.
            foreground: the background of the frames before.
        Returns:
            The disparity of every pixel as it was measured last; (h, w) float32 [px], NaN also where nothing was
            measured in this frame; and (h, w) uint8, 255 where disparity was measured in this frame.
        """
        memory = self.memory
        windows = memory.gate.whole
        if self._gated and foreground.settled:
            windows = memory.gate.windows(self._changed(image, foreground), memory.boxes, timestamp_s)
        now = np.full(image.shape[:2], np.nan, np.float32)
        mask = np.zeros(image.shape[:2], np.uint8)
        for window in windows:
            now[window.slices], mask[window.slices] = self._match(levels, window), 255
        memory.disparity = np.where(mask > 0, now, memory.disparity)
        geometry = self._matcher.geometry
        return SampledDisparity(memory.disparity, self._matcher.step, (geometry.height, geometry.width)), now, mask

    def _match(self, levels: Levels, window: Window) -> F32:
        """Samples of a window, from a larger one whose margin is thrown away."""
        outer = window.grown(MARGIN, self._matcher.shape[::-1])
        return self._matcher.part(levels, outer)[window.within(outer.left, outer.top).slices]

    def _changed(self, image: U8, foreground: Foreground) -> U8:
        """Samples that differ from the background, unless they were measured as background when they looked as now.

        That is a shadow or a patch of light, by an earlier measurement of depth. A person who stands still is no
        change: what was foreground stays in question.
        """
        changed = foreground.changed(image, SAMPLE)
        if self.memory.background is not None:
            changed[alike(_samples_of(image), self.memory.background) > 0] = 0
        before = solid(_samples_of(self.memory.foreground), self._grain)
        return np.asarray(cv2.bitwise_or(solid(changed, self._grain), before), dtype=np.uint8)

    def learn(self, image: U8, foreground: U8, measured: U8, tracks: Sequence[TrackState]) -> None:
        """Keep what the next frame is compared with.

        Args:
            image, foreground, measured: of this frame, at the analysis size.
            tracks: people, with their boxes in the rectified image.
        """
        seen, n = _samples_of(image), self._matcher.step
        if self.memory.background is None:
            self.memory.background = seen.copy()
        known = cv2.bitwise_and(_samples_of(measured), cv2.bitwise_not(_samples_of(foreground)))
        cv2.copyTo(seen, known, self.memory.background)
        self.memory.foreground = foreground
        lost = (track.box_px for track in tracks if track.state == "lost" and not math.isnan(track.box_px[0]))
        self.memory.boxes = tuple((a / n, b / n, c / n, d / n) for a, b, c, d in lost)


def alike(image: U8, other: U8) -> U8:
    """255 where no channel of two images, grey or BGR, differs by more than SAME_LEVELS."""
    return np.asarray(cv2.inRange(cv2.absdiff(image, other), (0,) * 4, (SAME_LEVELS,) * 4), dtype=np.uint8)


def solid(mask: U8, side: int) -> U8:
    """255 where more than half of the square of ``side`` around a sample of a mask (0, 255) is set."""
    share = cv2.boxFilter(mask, -1, (side, side), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.inRange(share, 128, 255), dtype=np.uint8)


def _samples_of(image: U8) -> U8:
    """Every SAMPLE-th row and column."""
    height, width = image.shape[:2]
    if height % SAMPLE or width % SAMPLE:
        return np.ascontiguousarray(image[::SAMPLE, ::SAMPLE])
    return np.asarray(cv2.resize(image, (width // SAMPLE, height // SAMPLE), interpolation=cv2.INTER_NEAREST), np.uint8)
