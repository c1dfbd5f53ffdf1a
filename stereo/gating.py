"""Windows of a rectified pair that are matched, where most of the image is known from earlier frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import U8
from stereo._kernels import cost, split

TILE = 8
"""Side of the tiles that windows are made of [px of the analysed image]: a head at 8 m (our choice)."""
SAMPLE = 2
"""Changes are given for every n-th row and column of the analysed image."""
REFRESH_TILES = 5
"""Side of the squares that the refresh visits one after the other [tiles]: small enough to cost little in a frame,
large enough that the margin does not double it (our choice)."""
MARGIN_PX = 8
"""What is matched around a window and thrown away [px of the matched image]: the window of the texture test (7 px),
half a block, and the first steps of the path costs (Hirschmueller 2008, section 2.3)."""
SAMPLE_WORK, WINDOW_WORK, STRIPE_ROWS = 33, 60_000, 20
"""What matching costs, in the work of a pixel and disparity: besides its disparities a pixel (the prefilter, the tests
after matching), a window (calls and buffers, 0.2 ms), and the rows by which OpenCV's four stripes overlap. Measured on
windows of 64x48 to 256x384 px over 16 to 80 disparities, and holds within a quarter."""


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
    """Chooses the windows of each frame; carries only the place of the refresh from frame to frame.

    Attributes:
        size: (width, height) of the rectified image [px].
        tile_px: side of a tile in it [px].
        margin_px: what is matched around a window, MARGIN_PX made up to whole samples [px].
    """

    def __init__(
        self,
        size: tuple[int, int],
        reduction: int,
        params: MatchingParams,
        searched: Callable[[Window], int],
    ) -> None:
        """Start the refresh.

        Args:
            size: (width, height) of the rectified image [px].
            reduction: the analysed image is every n-th row and column of it.
            searched: how many disparities a window needs.
        """
        self.size, self.tile_px = size, TILE * reduction
        self.margin_px = reduction * -(-MARGIN_PX // reduction)
        self._shape = rows, _ = -(-size[1] // self.tile_px), -(-size[0] // self.tile_px)
        self._refresh_s = params.refresh_s
        per_sample = np.zeros((rows, rows))
        for top in range(rows):
            for last in range(top, rows):
                window = Window(0, top * self.tile_px, size[0], min(size[1], (last + 1) * self.tile_px))
                per_sample[top, last] = searched(window) + SAMPLE_WORK
        # Rows and columns that a window costs besides its own [samples]; rows between samples are not matched.
        margin = 2 * self.margin_px / reduction
        self._costs = per_sample, TILE, margin + STRIPE_ROWS, margin, WINDOW_WORK / reduction
        self._bands, self._work_of_whole = self._best_bands()
        self.reset()

    def reset(self) -> None:
        """The refresh begins at the top left."""
        self._place, self._due, self._last_s = 0, 0.0, math.nan

    @property
    def whole(self) -> list[Window]:
        """The image, in bands where that is less work: far rows need fewer disparities."""
        return [self._window(top, 0, bottom, self._shape[1]) for top, bottom in self._bands]

    def _best_bands(self) -> tuple[list[tuple[int, int]], float]:
        """First and last row of tiles of each of up to four bands, the last excluded, and the work of all of them."""
        choices = []
        for count in range(1, min(4, self._shape[0]) + 1):
            edges = np.linspace(0, self._shape[0], count + 1).round().astype(int).tolist()
            boxes = [(top, 0, bottom, self._shape[1]) for top, bottom in pairwise(edges)]
            work = sum(cost(box, *self._costs) for box in boxes)
            choices.append((work, list(pairwise(edges))))
        work, bands = min(choices)
        return bands, work

    def windows(self, changed: U8, boxes: Sequence[tuple[float, float, float, float]], now_s: float) -> list[Window]:
        """What is to be matched; the whole image when its windows cost as much.

        Args:
            changed: every SAMPLE-th row and column of the analysed image, uint8, non-zero where something may have
                changed.
            boxes: left, top, width, height of people [px of the rectified image].
            now_s: time of the frame [s].
        """
        tiles = self._tiles(changed)
        for left, top, width, height in boxes:
            row, col = (max(0, int(edge // self.tile_px)) for edge in (top, left))
            tiles[row : int((top + height) // self.tile_px) + 1, col : int((left + width) // self.tile_px) + 1] = 1
        self._refresh(tiles, now_s)
        found = np.empty((64, 4), np.int64)  # more are noise all over the image, which is then matched as a whole
        n, total = split(cv2.integral(tiles), *self._costs, found)
        if n < 0 or total >= self._work_of_whole:
            return self.whole
        return [self._window(*(int(edge) for edge in box)) for box in found[:n]]

    def _tiles(self, changed: U8) -> U8:
        """Tiles with a change in them or near them."""
        # Two samples around a change are in question too: an outline, which blurs into the background (our choice).
        wide = cv2.dilate(changed, np.ones((5, 5), np.uint8))
        per_tile = TILE // SAMPLE
        bottom, right = (max(0, n * per_tile - m) for n, m in zip(self._shape, changed.shape, strict=True))
        padded = cv2.copyMakeBorder(wide, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
        any_change = cv2.resize(padded, self._shape[::-1], interpolation=cv2.INTER_AREA)
        return np.asarray(np.minimum(any_change, 1), dtype=np.uint8)

    def _refresh(self, tiles: U8, now_s: float) -> None:
        """Mark the squares that are due."""
        rows, cols = (-(-n // REFRESH_TILES) for n in self._shape)
        elapsed = 0.0 if math.isnan(self._last_s) else max(0.0, now_s - self._last_s)
        self._last_s = now_s
        self._due = min(self._due + elapsed / self._refresh_s, 1.0)
        while self._due >= 1.0 / (rows * cols):
            self._due -= 1.0 / (rows * cols)
            row, col = (REFRESH_TILES * place for place in divmod(self._place, cols))
            tiles[row : row + REFRESH_TILES, col : col + REFRESH_TILES] = 1
            self._place = (self._place + 1) % (rows * cols)

    def _window(self, top: int, left: int, bottom: int, right: int) -> Window:
        t = self.tile_px
        return Window(t * left, t * top, t * right, t * bottom).grown(0, self.size)
