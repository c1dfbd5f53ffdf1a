"""Depth on its image: whether edges of both, and what moves in both, lie on each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from calib.doubt import Score
from calib.images import as_grey
from calib.types import F32, F64
from stereo.depth import median_image
from stereo.doctor.pairs import CHANGE_LEVEL, WIDTH
from stereo.recording import Frame, Shot

REACH_PX = (16, 32)
"""Shifts of depth on its image searched down and across, each way [px of WIDTH]: a tenth of the image (our choice)."""
EDGES_MIN = 0.15
"""Sum of the correlations of edges and of what moves from which they are judged; what belongs together has 0.5 or more
(our choice)."""
SHIFT_PX_MAX = 12.0
"""Depth may lie this far from its image [px of 640]: registered depth of Kinects lies 8 px to one side, since it ends
where the light's shadow begins."""
NEARER_M = 0.2
"""Least distance by which what moves is nearer than the usual depth [m]."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Maps of the images of some frames and of their depth, (h, WIDTH) each: edges, and what moves, in turn."""

    seen: Sequence[F32]
    measured: Sequence[F32]

    @staticmethod
    def of(frames: Sequence[Frame[Shot]]) -> Overlay:
        images = small_images(frames)
        depths = small_depths(frames)
        usual = median_image(images)
        usual_depth = median_image(depths)
        seen: list[F32] = []
        measured: list[F32] = []
        for image, depth in zip(images, depths, strict=True):
            with np.errstate(invalid="ignore"):
                nearer = usual_depth - depth > NEARER_M
            moved = np.abs(image - usual) > CHANGE_LEVEL
            seen += [_edges(image), moved.astype(np.float32)]
            measured += [_depth_edges(depth), nearer.astype(np.float32)]
        return Overlay(seen, measured)

    def lay(self, lay: Callable[[F32], F32]) -> Overlay:
        """Depth laid onto the image in another way."""
        return replace(self, measured=[np.ascontiguousarray(lay(one)) for one in self.measured])

    @cached_property
    def correlation(self) -> F64:
        """(2 y + 1, 2 x + 1) correlation of image and depth at every shift, edges and what moves together."""
        total = np.zeros((2 * REACH_PX[0] + 1, 2 * REACH_PX[1] + 1))
        for measured, seen in zip(self.measured, self.seen, strict=True):
            total += _correlation(measured, seen)
        return total / max(1, len(self.seen) // 2)

    @property
    def best_shift(self) -> tuple[int, int]:
        """Shift at which depth lies best on the image, across and down [px of WIDTH]."""
        down, across = np.unravel_index(int(np.argmax(self.correlation)), self.correlation.shape)
        return int(across) - REACH_PX[1], int(down) - REACH_PX[0]

    @property
    def at_best_shift(self) -> Overlay:
        """Itself where that is as near as it may be."""
        across, down = self.best_shift
        if max(abs(across), abs(down)) * 640.0 / WIDTH <= SHIFT_PX_MAX:
            return self
        return self.lay(lambda depth: np.roll(depth, (down, across), axis=(0, 1)))


def place_score(overlay: Overlay) -> Score:
    """Score of depth on its image at the best shift."""
    peak = float(overlay.correlation.max())
    return Score(math.log(max(peak, 0.5 * EDGES_MIN)), f"edges fit by {peak:.2f}")


def offset_score(overlay: Overlay) -> Score:
    """Score of depth on its image as it is."""
    here = float(overlay.correlation[REACH_PX])
    return Score(math.log(max(here, 0.5 * EDGES_MIN)), f"edges fit by {here:.2f}")


def small_images(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, WIDTH) grey image of each frame."""
    images = []
    for frame in frames:
        small = cv2.resize(as_grey(frame.image), _small(frame), interpolation=cv2.INTER_AREA)
        images.append(np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), dtype=np.float32))
    return images


def small_depths(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, WIDTH) depth of each frame [m], NaN where unknown."""
    nearest = [cv2.resize(frame.images[1], _small(frame), interpolation=cv2.INTER_NEAREST) for frame in frames]
    return [np.asarray(depth, dtype=np.float32) for depth in nearest]


def _small(frame: Frame[Shot]) -> tuple[int, int]:
    rows, columns = frame.image.shape[:2]
    return WIDTH, max(1, round(rows * WIDTH / columns))


def _edges(image: F32) -> F32:
    """Strength of the edges of an image; capped at that of the strongest tenth."""
    strength = np.hypot(cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1))
    return np.asarray(np.minimum(strength, np.percentile(strength, 90)), dtype=np.float32)


def _depth_edges(depth: F32) -> F32:
    """1 where known depth jumps within three pixels, else 0."""
    known = np.isfinite(depth)
    around = np.ones((3, 3), np.uint8)
    far = cv2.dilate(np.where(known, depth, 0.0).astype(np.float32), around)
    near = cv2.erode(np.where(known, depth, 99.0).astype(np.float32), around)
    return np.asarray(far - near > 0.1 + 0.05 * near, dtype=np.float32)


def _correlation(measured: F32, seen: F32) -> F64:
    """(2 y + 1, 2 x + 1) correlation of two maps of one size, the first moved by every shift of ``REACH_PX``."""
    a = measured - measured.mean()
    b = seen - seen.mean()
    y, x = REACH_PX
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    if norm < 1e-6:
        return np.zeros((2 * y + 1, 2 * x + 1))
    size = seen.shape[0] + y, seen.shape[1] + x
    product = np.fft.irfft2(np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size), size)
    around = np.roll(product, (y, x), (0, 1))[: 2 * y + 1, : 2 * x + 1]
    return np.asarray(around / norm, dtype=np.float64)
