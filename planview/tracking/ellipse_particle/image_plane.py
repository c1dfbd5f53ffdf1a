"""Ellipses in the image of one camera: no calibration is needed, sizes are learned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I64, U8, Bool
from planview.foreground.masks import PERSON
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.background import Background
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.outputs import image_state
from planview.tracking.ellipse_particle.params import ImagePlaneParams
from planview.tracking.ellipse_particle.planes import Estimates, PlaneView
from planview.tracking.ellipse_particle.size_learning import SizeLearner
from planview.tracking.ellipse_particle.visible_length import visible_length
from planview.trajectories.state import TrackState

PERSON_M = 1.7
"""Body height of an adult [m], which turns speeds in m/s into cells."""
UPRIGHT = PlaneModel(
    angle_spread=math.radians(6.0),
    angle_limit=math.radians(20.0),
    angle_walk=math.radians(5.0),
    separation=0.0,
    proposal=0.5,
    outside_weight=1.0,
)
"""People in an image: walkers lean by 5 or 6 degrees, at most three deviations, and hide one another. An ellipse that
is proposed has the expected size and lies on a coarse grid; fitted, it gains more of a person who is smaller or
strides. Our choice."""
SPECKLED = 0.02
"""A frame with more specks than this share of its pixels is noisy. The outlines of ten people, each a tenth of the
image high, lose a quarter of it to the same filter. Our choice."""


class ImagePlane:
    """Foreground of the image: mixture of Gaussians with shadows removed, specks removed, cells averaged.

    Args:
        camera: gives floor positions and heights; None leaves them unknown.
    """

    name: Literal["image", "floor"] = "image"

    def __init__(self, params: ImagePlaneParams, camera: GroundCamera | None = None) -> None:
        self._params = params
        self._camera = camera
        self.needs_foreground = params.source == "given"
        self.model = UPRIGHT._replace(outside_weight=params.outside_weight)
        self.reset()

    def reset(self) -> None:
        self._background = Background(self._params)
        self._learner = SizeLearner(self._params)
        self._learned_on: tuple[int, int] | None = None
        self._outlines: Sequence[F32] = ()
        self._size: tuple[int, int] | None = None

    def __call__(self, observation: Observation) -> PlaneView | None:
        """The frame's cells; None when the observation has no image or foreground to work on.

        Raises:
            ValueError: image or foreground is not uint8 of (H, W) or, for images, (H, W, 3).
        """
        if observation.image is not None:
            self._size = (observation.image.shape[0], observation.image.shape[1])
        foreground = self._foreground(observation)
        if foreground is None:
            return None
        height, width = foreground.shape if observation.image is None else observation.image.shape[:2]
        clean = cv2.medianBlur(foreground, 3)
        # Averaging whole pixels has removed most specks already where the foreground is smaller than the image, and
        # the filter would eat thin people too; but not the specks of a frame that the codec or a jolt fills with them.
        if foreground.shape[1] != width and float(cv2.subtract(foreground, clean).mean()) < 255 * SPECKLED:
            clean = foreground
        cols = min(width, self._params.columns)
        rows = max(1, round(height * cols / width))
        cells = cv2.resize(clean, (cols, rows), interpolation=cv2.INTER_AREA)
        mask = np.asarray(cells, dtype=np.float32) / np.float32(255)
        scale = width / cols
        return PlaneView(mask, scale, ((scale - 1) / 2, (scale - 1) / 2), observation)

    def _foreground(self, observation: Observation) -> U8 | None:
        if self._params.source == "given":
            given = observation.foreground
            if given is not None and (given.ndim != 2 or given.dtype != np.uint8):
                raise ValueError(f"expected a (H, W) uint8 foreground, got {given.shape} {given.dtype}")
            return given
        image = observation.image
        if image is None:
            return None
        if image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise ValueError(f"expected a (H, W[, 3]) uint8 image, got {image.shape} {image.dtype}")
        return self._background.update(image)

    def prior(self, view: PlaneView) -> SizePrior | None:
        """The given size, else the learned one; an image of another size is another scene."""
        p = self._params
        if p.person_height_px is not None:
            return SizePrior(p.person_height_px / 2 / view.scale, 0.0, p.aspect)
        shape = (view.mask.shape[0], view.mask.shape[1])
        if self._learned_on != shape:
            self._learner, self._learned_on = SizeLearner(p), shape
        return self._learner.update(view.mask, view.observation.timestamp_s)

    def cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        return np.asarray(2.0 * prior.half_lengths(rows) / PERSON_M)

    def turns(self, measured: Bool, confirmed: Bool) -> list[I64]:
        return [np.flatnonzero(measured)]

    def separation(self, view: PlaneView) -> float:
        return 0.0

    def long_enough(self, view: PlaneView, ellipses: F64, order: I64, confirmed: Bool, prior: SizePrior) -> Bool:
        needed = np.where(confirmed, self._params.min_length, self._params.newcomer_length)
        return np.asarray(visible_length(view.mask, ellipses, order, prior) >= needed)

    def is_person(self, view: PlaneView, cell: F64, known: F64) -> bool:
        return True

    def is_separate(self, view: PlaneView, cell: F64, known: F64) -> bool:
        return True

    def protect(self, outlines: Sequence[F32]) -> None:
        self._outlines = outlines
        self._background.protect(outlines)

    def feedback(self) -> U8 | None:
        """(H, W) uint8, PERSON inside the outlines of people who have moved; None before the first image."""
        if self._size is None:
            return None
        mask = np.zeros(self._size, dtype=np.uint8)
        for shape in self._outlines:
            cv2.fillPoly(mask, [np.round(shape).astype(np.int32)], PERSON)
        return mask

    def states(self, view: PlaneView, estimates: Estimates) -> list[TrackState]:
        """Boxes; floor positions and heights too with a camera."""
        rows = zip(estimates.evidence, estimates.ellipses, estimates.velocities, strict=True)
        return [image_state(e.who, view, ellipse, velocity, self._camera) for e, ellipse, velocity in rows]
