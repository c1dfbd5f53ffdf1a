"""Parts of a rectified pair that are matched, where most of the image is known from earlier frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import U8

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


class MatchingParams(Params):
    """Where disparity is measured."""

    gated: bool = True
    """Match only where something may have changed, where people are, and in a rotating refresh; elsewhere the disparity
    measured last is kept. false matches every pixel of every frame."""
    refresh_s: float = Field(default=4.0, gt=0.0, le=600.0)
    """The refresh visits every pixel once in so many seconds [s]: what hides from colour is found as late as that (our
    choice)."""


class Window(NamedTuple):
    """Columns left ... right - 1 and rows top ... bottom - 1 of an image [px]."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Of the image's array."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def grown(self, margin: int, size: tuple[int, int]) -> Window:
        """With a margin, inside an image of (width, height)."""
        return Window(
            max(0, self.left - margin),
            max(0, self.top - margin),
            min(size[0], self.right + margin),
            min(size[1], self.bottom + margin),
        )

    def within(self, left: int, top: int) -> Window:
        """In pixels of a window that begins there."""
        return Window(self.left - left, self.top - top, self.right - left, self.bottom - top)


class Gate:
    """Chooses the windows of each frame; carries only the place of the refresh from frame to frame."""

    def __init__(self, shape: tuple[int, int], params: MatchingParams) -> None:
        """Start the refresh; ``shape`` (height, width) of the samples."""
        self._params, self._size = params, shape[::-1]
        self._tiles = -(-shape[0] // TILE), -(-shape[1] // TILE)
        self.reset()

    def reset(self) -> None:
        """Forget the place of the refresh."""
        self._place, self._due, self._last_s = 0, 0.0, math.nan

    @property
    def whole(self) -> list[Window]:
        """All samples."""
        return [Window(0, 0, *self._size)]

    def windows(self, changed: U8, boxes: Sequence[tuple[float, float, float, float]], now_s: float) -> list[Window]:
        """Windows of samples to match: one around each group of changes that touch, or all.

        Args:
            changed: every SAMPLE-th row and column of the samples, uint8, non-zero where something may have changed.
            boxes: left, top, width, height of people [samples].
            now_s: time of the frame [s].
        """
        # Two samples around a change are in question too: an outline, which blurs into the background (our choice).
        wide = cv2.dilate(changed, np.ones((5, 5), np.uint8))
        per_tile = TILE // SAMPLE
        bottom, right = (max(0, n * per_tile - m) for n, m in zip(self._tiles, changed.shape, strict=True))
        padded = cv2.copyMakeBorder(wide, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
        tiles = np.minimum(cv2.resize(padded, self._tiles[::-1], interpolation=cv2.INTER_AREA), 1)
        for left, top, width, height in boxes:
            row, col = (max(0, int(edge // TILE)) for edge in (top, left))
            tiles[row : int((top + height) // TILE) + 1, col : int((left + width) // TILE) + 1] = 1
        self._refresh(tiles, now_s)
        count, _, stats, _ = cv2.connectedComponentsWithStats(tiles, connectivity=4)
        found = [self._window(*(int(n) for n in stats[k, :4])) for k in range(1, count)]
        outer = (window.grown(MARGIN, self._size) for window in found)
        work = sum((w.right - w.left) * (w.bottom - w.top) for w in outer)
        return found if work < MOST_OF_IT * self._size[0] * self._size[1] else self.whole

    def _window(self, left: int, top: int, width: int, height: int) -> Window:
        right, bottom = TILE * (left + width), TILE * (top + height)
        return Window(TILE * left, TILE * top, right, bottom).grown(0, self._size)

    def _refresh(self, tiles: U8, now_s: float) -> None:
        """Mark the squares that are due."""
        rows, cols = (-(-n // REFRESH_TILES) for n in self._tiles)
        elapsed = 0.0 if math.isnan(self._last_s) else max(0.0, now_s - self._last_s)
        self._last_s = now_s
        self._due = min(self._due + elapsed / self._params.refresh_s, 1.0)
        while self._due >= 1.0 / (rows * cols):
            self._due -= 1.0 / (rows * cols)
            row, col = (REFRESH_TILES * place for place in divmod(self._place, cols))
            tiles[row : row + REFRESH_TILES, col : col + REFRESH_TILES] = 1
            self._place = (self._place + 1) % (rows * cols)
