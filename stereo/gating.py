"""Matches the parts of a rectified pair whose depth is not known from earlier frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.rig import Floor
from calib.types import F32, U8
from stereo.matcher import Levels, SampledDisparity, SgbmMatcher, Window, farthest_head_m

TILE = 8
"""Side of the tiles that windows are made of [samples]: a head at 8 m (our choice)."""
SAMPLE = 2
"""Changes are given for every n-th row and column of the samples."""
REFRESH_TILES = 5
"""Side of the squares that the refresh visits one after the other [tiles]: small enough to cost little in a frame,
large enough that the margin does not double it (our choice)."""
MARGIN = 8
"""What is matched around a window and thrown away [samples]: the texture test and the refinement look 4 samples far,
and the path costs take some steps (Hirschmueller 2008, section 2.3)."""
MOST_OF_IT = 0.7
"""Share of the image from which all of it is matched: two windows cost more than one of their area (our choice)."""
SAME_LEVELS = 12
"""Largest difference of a channel between two images of the same surface in the same light [levels of 255]: three
deviations of the luma that the foreground takes for noise (our choice)."""


class MatchingParams(Params):
    """Where disparity is measured."""

    gated: bool = True
    """Match only where something may have changed, where people are, and in a rotating refresh; elsewhere the disparity
    measured last is kept. false matches every pixel of every frame."""
    refresh_s: float = Field(default=4.0, gt=0.0, le=600.0)
    """The refresh visits every pixel once in so many seconds [s]: what hides from colour is found as late as that (our
    choice)."""


class MatchingMemory:
    """All that matching in part carries from frame to frame.

    Attributes:
        disparity: (h, w) float32 [px] of the samples as measured last.
        foreground: (h, w) uint8 mask of the last frame.
        background: (h, w[, 3]) uint8, every SAMPLE-th row and column of the samples as they looked when they were
            last measured as background; None at first.
        boxes: left, top, width, height [px] of the people who were not found in the last frame; those who were are
            part of the foreground.
        last_s, due, place: time of the last frame [s], share of a turn that the refresh is behind, and the square that
            it visits next.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.disparity: F32 = np.full(self._shape, np.nan, np.float32)
        self.foreground: U8 = np.zeros(self._shape, np.uint8)
        self.background: U8 | None = None
        self.boxes: tuple[tuple[float, float, float, float], ...] = ()
        self.last_s, self.due, self.place = math.nan, 0.0, 0


class GatedMatching:
    """Matches what may have changed, what was foreground, where people are, and a rotating refresh.

    Attributes:
        memory: what it carries from frame to frame.
    """

    def __init__(self, matcher: SgbmMatcher, floor: Floor, params: MatchingParams) -> None:
        self._matcher, self._params = matcher, params
        self.memory = MatchingMemory(matcher.shape)
        self._size = matcher.shape[::-1]
        self._tiles = -(-matcher.shape[0] // TILE), -(-matcher.shape[1] // TILE)
        # Breadth of a head [m] (anthropometric tables, adults). A change that does not fill half of a square so wide,
        # at the place in view where heads look smallest, is noise or a fleck of light.
        head_px = matcher.geometry.focal_u_px * 0.15 / farthest_head_m(matcher.geometry, floor)
        self._grain = max(3, 2 * int((head_px / (matcher.step * SAMPLE) + 1) / 2) - 1)

    def levels(self, left_grey: U8, right_grey: U8) -> Levels:
        """The part of the work that depends on no other frame."""
        return self._matcher.levels(left_grey, right_grey)

    def __call__(self, levels: Levels, image: U8, changed: U8 | None, now_s: float) -> tuple[SampledDisparity, F32, U8]:
        """The disparity of every pixel as it was measured last; (h, w) float32 [px], NaN also where nothing was
        measured in this frame; and (h, w) uint8, 255 where disparity was measured in this frame.

        Args:
            image: (h, w[, 3]) uint8, the samples of the left camera.
            changed: uint8, every SAMPLE-th row and column of the samples, non-zero where they differ from the
                background; None while no background is known.
        """
        windows = [Window(0, 0, *self._size)]
        if self._params.gated and changed is not None:
            windows = self.windows(self._in_question(image, changed), now_s)
        now, measured = np.full(self._matcher.shape, np.nan, np.float32), np.zeros(self._matcher.shape, np.uint8)
        for window in windows:  # from a larger one whose margin is thrown away
            outer = window.grown(MARGIN, self._size)
            top, left, (height, width) = window.top - outer.top, window.left - outer.left, now[window.slices].shape
            now[window.slices] = self._matcher.part(levels, outer)[top : top + height, left : left + width]
            measured[window.slices] = 255
        self.memory.disparity = np.where(measured > 0, now, self.memory.disparity)
        geometry = self._matcher.geometry
        shape = geometry.height, geometry.width
        return SampledDisparity(self.memory.disparity, self._matcher.step, shape), now, measured

    def learn(self, image: U8, foreground: U8, measured: U8, lost: Sequence[tuple[float, float, float, float]]) -> None:
        """Keep what the next frame is compared with, samples of this one; ``lost``: see ``MatchingMemory.boxes``."""
        memory, seen = self.memory, samples_of(image)
        if memory.background is None:
            memory.background = seen.copy()
        known = cv2.bitwise_and(samples_of(measured), cv2.bitwise_not(samples_of(foreground)))
        cv2.copyTo(seen, known, memory.background)
        memory.foreground, memory.boxes = foreground, tuple(lost)

    def _in_question(self, image: U8, changed: U8) -> U8:
        """Samples that changed, unless they were measured as background when they looked as now, and foreground.

        The former are a shadow or a patch of light, by an earlier measurement of depth. A person who stands still is no
        change: what was foreground stays in question.
        """
        if self.memory.background is not None:
            changed = np.where(alike(samples_of(image), self.memory.background) > 0, np.uint8(0), changed)
        before = solid(samples_of(self.memory.foreground), self._grain)
        return np.asarray(cv2.bitwise_or(solid(changed, self._grain), before), dtype=np.uint8)

    def windows(self, changed: U8, now_s: float) -> list[Window]:
        """Windows of samples to match, one around each group of changes that touch, or all; ``changed`` is non-zero
        where something may have changed in every SAMPLE-th row and column of the samples, uint8."""
        # Two samples around a change are in question too: an outline, which blurs into the background (our choice).
        wide = cv2.dilate(changed, np.ones((5, 5), np.uint8))
        per_tile = TILE // SAMPLE
        bottom, right = (max(0, n * per_tile - m) for n, m in zip(self._tiles, changed.shape, strict=True))
        padded = cv2.copyMakeBorder(wide, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
        tiles = np.minimum(cv2.resize(padded, self._tiles[::-1], interpolation=cv2.INTER_AREA), 1)
        side = TILE * self._matcher.step
        for left, top, width, height in self.memory.boxes:
            row, col = (max(0, int(edge // side)) for edge in (top, left))
            tiles[row : int((top + height) // side) + 1, col : int((left + width) // side) + 1] = 1
        self._mark_refresh(tiles, now_s)
        count, _, stats, _ = cv2.connectedComponentsWithStats(tiles, connectivity=4)
        found = [
            Window(TILE * left, TILE * top, TILE * (left + width), TILE * (top + height)).grown(0, self._size)
            for left, top, width, height in stats[1:count, :4].tolist()
        ]
        outer = (window.grown(MARGIN, self._size) for window in found)
        work = sum((w.right - w.left) * (w.bottom - w.top) for w in outer)
        return found if work < MOST_OF_IT * self._size[0] * self._size[1] else [Window(0, 0, *self._size)]

    def _mark_refresh(self, tiles: U8, now_s: float) -> None:
        """Mark the squares that are due."""
        memory, (rows, cols) = self.memory, (-(-n // REFRESH_TILES) for n in self._tiles)
        elapsed = 0.0 if math.isnan(memory.last_s) else max(0.0, now_s - memory.last_s)
        memory.last_s = now_s
        memory.due = min(memory.due + elapsed / self._params.refresh_s, 1.0)
        while memory.due >= 1.0 / (rows * cols):
            memory.due -= 1.0 / (rows * cols)
            row, col = (REFRESH_TILES * place for place in divmod(memory.place, cols))
            tiles[row : row + REFRESH_TILES, col : col + REFRESH_TILES] = 1
            memory.place = (memory.place + 1) % (rows * cols)


def alike(image: U8, other: U8) -> U8:
    """255 where no channel of two images, grey or BGR, differs by more than SAME_LEVELS."""
    return np.asarray(cv2.inRange(cv2.absdiff(image, other), (0,) * 4, (SAME_LEVELS,) * 4), dtype=np.uint8)


def solid(mask: U8, side: int) -> U8:
    """255 where more than half of the square of ``side`` around a sample of a mask (0, 255) is set."""
    share = cv2.boxFilter(mask, -1, (side, side), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.inRange(share, 128, 255), dtype=np.uint8)


def samples_of(image: U8) -> U8:
    """Every SAMPLE-th row and column."""
    return np.ascontiguousarray(image[::SAMPLE, ::SAMPLE])
