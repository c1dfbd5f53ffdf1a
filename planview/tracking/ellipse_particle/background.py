"""Foreground of colour images by OpenCV's mixture of Gaussians, with people kept out of the background."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calib.types import F32, U8
from planview.tracking.ellipse_particle.params import ImagePlaneParams

NOISE = 3.0
"""Deviation of the noise of cameras and codecs in an 8-bit picture [grey levels]: 2 to 4."""
NOISES = 8
"""Pictures of noise, taken in turn."""
VARIANCE_GATE = 16.0
"""Squared deviations within which a pixel is background (OpenCV's default)."""
SUBTRACTION = 2
"""The mixture looks at the image reduced by the smallest whole factor that brings it down to so many pixels per cell;
its foreground is averaged over cells anyway, and averaged pixels are less noisy. Our choice."""
SHADOW = 127
"""OpenCV's label of a shadow."""
UNSURE = 0.4 / 1.4
"""Foreground share of a shadow label: it may be dark clothes just as well, so it speaks neither for nor against a
person: s - w (1 - s) = 0 for ``EllipseFitParams.background_weight`` w = 0.4."""
FOREGROUND = np.zeros(256, dtype=np.uint8)
"""Foreground of each label."""
FOREGROUND[[SHADOW, 255]] = round(255 * UNSURE), 255


class Background:
    """Mixture of Gaussians per pixel with shadow removal (the paper's reference [10], off the shelf).

    The mixture absorbs people who stand still. So the pixels of people (``protect``) are replaced by the last
    background there, with noise, before the mixture learns (without noise its variances would shrink, and the true
    background would be foreground when they leave); it looks at the real image without learning. That takes a second
    pass, which is skipped in every other frame once the mixture is settled, and while no person is there to protect.
    """

    def __init__(self, params: ImagePlaneParams) -> None:
        self._params = params
        self._frames = 0
        self._mixture: cv2.BackgroundSubtractorMOG2 | None = None
        self._empty: U8 = np.zeros((0, 0), dtype=np.uint8)
        self._noise = np.zeros((0, 0, 0), dtype=np.int16)
        self._people: list[F32] = []
        self._scale = 1.0

    def protect(self, outlines: Sequence[F32]) -> None:
        """Keep what is inside these outlines, (N, 2) [px of the image], out of the background from now on."""
        self._people = list(outlines)

    def update(self, image: U8) -> U8:
        """Foreground of the next frame.

        Args:
            image: (H, W) or (H, W, 3) uint8; another size than before starts anew.
        Returns:
            (h, w) uint8 of the reduced size, 255 where foreground, 73 where shadow or dark clothes.
        """
        factor = -(-image.shape[1] // (SUBTRACTION * self._params.columns))
        if factor > 1:
            size = (max(1, image.shape[1] // factor), max(1, image.shape[0] // factor))
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        self._scale = 1.0 / factor
        if self._mixture is None or image.shape != self._empty.shape:
            self._frames = 0
            self._people = []
            self._empty = image.copy()
            noise = np.random.default_rng(0).normal(0.0, NOISE, (NOISES, *image.shape))
            self._noise = np.round(noise).astype(np.int16)
            self._mixture = cv2.createBackgroundSubtractorMOG2(
                history=self._params.history, varThreshold=VARIANCE_GATE, detectShadows=True
            )
        self._frames += 1
        # As OpenCV's own automatic rate: an average of all frames first, exponential forgetting later.
        rate = 1.0 / min(2 * self._frames, self._params.history)
        if not self._people:
            labels = np.asarray(self._mixture.apply(image, learningRate=rate), dtype=np.uint8)
            self._remember(image, labels, np.full(labels.shape, 255, dtype=np.uint8))
        else:
            labels = np.asarray(self._mixture.apply(image, learningRate=0), dtype=np.uint8)
            if self._frames < self._params.history // 10 or self._frames % 2 == 0:
                self._learn(image, labels, rate if self._frames < self._params.history // 10 else 2 * rate)
        return np.asarray(cv2.LUT(labels, FOREGROUND))

    def _learn(self, image: U8, labels: U8, rate: float) -> None:
        free = np.full(image.shape[:2], 255, dtype=np.uint8)
        for outline in self._people:
            cv2.fillPoly(free, [np.round(outline * self._scale).astype(np.int32)], 0)
        self._remember(image, labels, free)
        scene = cv2.add(self._empty, self._noise[self._frames % len(self._noise)], dtype=cv2.CV_8U)
        cv2.copyTo(image, free, scene)
        assert self._mixture is not None
        self._mixture.apply(scene, learningRate=rate)

    def _remember(self, image: U8, labels: U8, free: U8) -> None:
        """Keep the last background of each pixel that no person covers."""
        _, background = cv2.threshold(labels, 0, 255, cv2.THRESH_BINARY_INV)
        cv2.copyTo(image, cv2.bitwise_and(background, free), self._empty)
