"""Disparity of every n-th row and column, at a fraction of the cost of all of them."""

from __future__ import annotations

from threading import local
from typing import NamedTuple

import cv2
import numpy as np

from calib.types import F32, I16, U8
from stereo._kernels import disparity_from_fixed
from stereo._sampled_sgm_kernels import NONE, PathParams, SampleLayout, layout, match_samples, room
from stereo.depth import RectifiedGeometry
from stereo.gating import MatchingWork, Window
from stereo.matcher import STEP, TEXTURE_PX, DisparityRange, SgbmParams, right_of, speckle_px, valid_mask

_HALF = {
    1: [0.0, 0.131, 0.239, 0.307, 0.358, 0.408, 0.451, 0.481],
    2: [0.0, 0.102, 0.193, 0.270, 0.330, 0.381, 0.428, 0.469],
}
FRACTIONS = {
    step: np.array([*half, 0.5, *(1.0 - value for value in reversed(half[1:]))], dtype=np.float32)
    for step, half in _HALF.items()
}
"""Expected fraction of a pixel where the parabola gives 0/16 ... 15/16, by step, as ``stereo.matcher.SUBPIXEL`` and
from the same textures: the last for larger steps. OpenCV rounds towards zero, which these do not. What is left is
0.11 px rms at every pixel and 0.10 px at every second one, where OpenCV has 0.11 px."""
MAX_P2 = 700
"""Largest penalty that int16 holds beside the costs of three paths."""


class SampledDisparity(NamedTuple):
    """Disparity of every n-th row and column of an image.

    Attributes:
        samples: (h, w) float32 [px of the image], NaN invalid.
        step: n.
        shape: (H, W) of the image; not asked for when every pixel is a sample.
    """

    samples: F32
    step: int = 1
    shape: tuple[int, int] = (0, 0)

    @property
    def image(self) -> F32:
        """(H, W) float32 [px]: that of the nearest sample to the left and above."""
        if self.step == 1:
            return self.samples
        height, width = self.shape
        return np.repeat(np.repeat(self.samples, self.step, axis=0), self.step, axis=1)[:height, :width]


class _Room(local):
    """Memory to work in, of each thread."""

    def __init__(self) -> None:
        self.planes: U8 = np.empty(0, np.uint8)
        self.work: I16 = np.empty(0, np.int16)

    def of(self, at: SampleLayout, count: int) -> tuple[U8, I16]:
        """Arrays for ``match_samples``."""
        shape, n = room(at, count)
        n_planes = shape[0] * shape[1] * shape[2]
        if len(self.planes) < n_planes:
            self.planes = np.empty(n_planes, np.uint8)
        if len(self.work) < n:
            self.work = np.empty(n, np.int16)
        return self.planes[:n_planes].reshape(shape), self.work[:n]


class SampledMatcher:
    """Semi-global matching whose costs are those of StereoSGBM, but whose paths visit every n-th row and column only.

    What is thrown away afterwards is not computed: blocks are compared at full resolution, so that a disparity is as
    precise as one of the full matcher; paths (Hirschmueller 2008, section 2.3) run from the left, the right and from
    above as in OpenCV's fast pass. A path has n times fewer samples than pixels, so that its penalties are an n-th and
    weigh as much against the costs along it. OpenCV's stripes are not needed, as windows are matched side by side.
    Where every pixel is a sample, OpenCV is faster.

    Attributes:
        step, work: see ``WindowMatcher``.
    """

    work = MatchingWork(rows_px=12, columns_px=12, per_sample=20, per_window=25_000)
    """Rows and columns: what is laid out around a window. Per sample: rectifying its pixels, their slopes, the tests
    after matching. Per window: calls and buffers (0.15 ms). Measured on windows of 112x112 to 256x320 px over 16 to 64
    disparities at every second pixel, and holds within a third."""

    def __init__(self, geometry: RectifiedGeometry, params: SgbmParams, step: int, mask: U8, right_mask: U8) -> None:
        """Prepare.

        Args:
            step: every n-th row and column is wanted.
            mask, right_mask: (H, W) uint8, 0 where the left and the right image show nothing.
        """
        self.params, self.step = params, step
        self._masks = tuple(valid_mask(mask_, params)[::step] for mask_ in (mask, right_mask))
        self._speckle = round(speckle_px(geometry, params) / step**2)
        self._texture = np.ones((2 * (TEXTURE_PX // (2 * step)) + 1,) * 2, np.uint8)
        self._room = _Room()

    def part(self, left_grey: U8, right_grey: U8, window: Window, disparities: DisparityRange) -> F32:
        """See ``WindowMatcher``."""
        height, width = left_grey.shape
        at = layout(height, width, self.step, self.params.block_px)
        per_px = self.params.block_px**2 / self.step / (1 << at.shift)
        p1, p2 = (min(round(p * per_px), MAX_P2) for p in (self.params.p1, self.params.p2))
        choice = PathParams(p1, max(p2, p1 + 1), self.params.uniqueness_percent, self.params.left_right_px)
        fixed = np.empty((at.rows, at.columns), np.int16)
        darkest, brightest = np.empty((2, at.rows, at.columns), np.uint8)
        offset = window.left - right_of(window, disparities).left
        planes, work = self._room.of(at, disparities.count)
        match_samples(
            np.ascontiguousarray(left_grey), np.ascontiguousarray(right_grey), offset,
            disparities.first_px, disparities.count, at, choice, planes, work, fixed, darkest, brightest,
        )  # fmt: skip
        return self._checked(fixed, darkest, brightest, window, disparities.first_px)

    def _checked(self, fixed: I16, darkest: U8, brightest: U8, window: Window, first_px: int) -> F32:
        """Pixels, without what stands alone, and without texture or outside of an image.

        There is no median of 3x3 as in OpenCV: over samples it would be n times as wide and round people off.
        """
        cv2.filterSpeckles(fixed, int(NONE), self._speckle, STEP)
        fixed[fixed >= 0] += STEP * first_px
        rows = slice(window.top // self.step, window.top // self.step + len(fixed))
        disparity = np.empty(fixed.shape, np.float32)
        disparity_from_fixed(
            fixed,
            self._masks[0][rows, window.left : window.right : self.step],
            self._masks[1][rows],
            np.asarray(cv2.erode(darkest, self._texture), dtype=np.uint8),
            np.asarray(cv2.dilate(brightest, self._texture), dtype=np.uint8),
            window.left,
            self.step,
            STEP * first_px,
            FRACTIONS[min(self.step, max(FRACTIONS))],
            self.params.saturated_level,
            self.params.texture_min,
            disparity,
        )
        return disparity
