"""Ellipses in the image of one camera: no calibration is needed, sizes are learned."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I64, U8, Bool
from planview.foreground.masks import WALKER
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.camera_size import BREADTH_M, PERSON_M
from planview.tracking.ellipse_particle.fit.ellipses import SIZE_LIMIT
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.image_grid import averaged
from planview.tracking.ellipse_particle.known_size import Grid, KnownSize
from planview.tracking.ellipse_particle.outputs import image_state
from planview.tracking.ellipse_particle.params import ImagePlaneParams
from planview.tracking.ellipse_particle.planes import Estimates, PlaneView
from planview.tracking.ellipse_particle.regions import in_one_box, regions
from planview.tracking.ellipse_particle.visible_length import UNSURE, visible_length
from planview.trajectories.state import TrackState

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
FROM_ABOVE = UPRIGHT._replace(
    angle_spread=math.radians(45.0), angle_limit=math.radians(90.0), angle_walk=math.radians(30.0), proposal=1.0
)
"""People seen from straight above point anywhere, as they do on the floor."""
LENGTH_MIN_M = 0.85
"""Least length of a body in the image [m], from straight above: half its height, by which it reaches outwards."""
FOREGROUND_PX = 2
"""Pixels of foreground per cell that are enough: cells average them anyway. Our choice."""
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
        self.foreground_columns: int | None = FOREGROUND_PX * params.columns
        self._people = KnownSize(params, camera)
        self.reset()

    def reset(self) -> None:
        """Forget all frames, but not what ``study`` learned."""
        self._people.reset()
        self._outlines: Sequence[F32] = ()
        self._size: tuple[int, int] | None = None
        self._boxes: tuple[PlaneView, F64] | None = None

    @property
    def model(self) -> PlaneModel:
        """What is known of ellipses now: upright until the size learned has none."""
        prior = self._people.expected
        model = FROM_ABOVE if prior is not None and prior.any_direction else UPRIGHT
        looseness = 1.0 if prior is None else 1.0 + prior.half_length_slope
        return model._replace(outside_weight=self._params.outside_weight, looseness=looseness)

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn the size of people from a recording's beginning, before its first frame is tracked."""
        self._people.study(grid for grid in map(self._grid_of, observations) if grid is not None)

    def __call__(self, observation: Observation) -> PlaneView | None:
        """Learn the size of people from a frame; the frame's cells, None when it has no foreground to work on.

        Raises:
            ValueError: the foreground is not (H, W) uint8.
        """
        grid = self._grid_of(observation)
        if grid is None:
            return None
        self._people.update(grid)
        return grid(self._people.columns)

    def view(self, observation: Observation) -> PlaneView | None:
        """The frame's cells, on the grid for the size known now."""
        grid = self._grid_of(observation)
        return None if grid is None else grid(self._people.columns)

    def _grid_of(self, observation: Observation) -> Grid | None:
        """What makes the cells of a frame; None without foreground."""
        foreground = self._cleaned(observation)
        if foreground is None:
            return None
        height, width = _image_size(foreground, observation)
        return lambda columns: averaged(foreground, (width, height), columns, observation)

    def _cleaned(self, observation: Observation) -> U8 | None:
        """The foreground without specks."""
        foreground = self._foreground(observation)
        if foreground is None:
            return None
        self._size = _image_size(foreground, observation)
        clean = np.asarray(cv2.medianBlur(foreground, 3), dtype=np.uint8)
        # Averaging whole pixels has removed most specks already where the foreground is smaller than the image, and
        # the filter would eat thin people too; but not the specks of a frame that the codec or a jolt fills with them.
        if foreground.shape != self._size and float(cv2.subtract(foreground, clean).mean()) < 255 * SPECKLED:
            return foreground
        return clean

    def _foreground(self, observation: Observation) -> U8 | None:
        given = observation.foreground
        if given is None:
            return None
        if given.ndim != 2 or given.dtype != np.uint8:
            raise ValueError(f"expected a (H, W) uint8 foreground, got {given.shape} {given.dtype}")
        if observation.shadow is None:
            return given
        return np.asarray(np.where(observation.shadow > 0, np.uint8(round(255 * UNSURE)), given), dtype=np.uint8)

    def prior(self, view: PlaneView) -> SizePrior | None:
        """The size known now, in cells of the view."""
        return self._people.on(view)

    @property
    def notes(self) -> tuple[str, ...]:
        """The size that was learned, in a sentence."""
        return self._people.notes

    def cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        length_m = min(PERSON_M, max(LENGTH_MIN_M, BREADTH_M / prior.aspect))
        return np.asarray(2.0 * prior.half_lengths(rows) / length_m)

    def turns(self, measured: Bool, confirmed: Bool) -> list[I64]:
        return [np.flatnonzero(measured)]

    def separation(self, view: PlaneView) -> float:
        return 0.0

    def long_enough(self, view: PlaneView, ellipses: F64, order: I64, confirmed: Bool, prior: SizePrior) -> Bool:
        needed = np.where(confirmed, self._params.min_length, self._params.newcomer_length)
        return np.asarray(visible_length(view.mask, ellipses, order, prior) >= needed)

    def is_person(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Nobody stands where people would be smaller than any who is measured: near the horizon, and above it.

        Heads of people who come from below the image are there. 96 drawn views, 24 of them kiosks: 90.5 % of the
        crossings in place of 88.6, in kiosks 95.1 in place of 89.6.
        """
        prior = self.prior(view)
        return prior is None or prior.is_near_enough(float(cell[1]), SIZE_LIMIT)

    def is_separate(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Until a size that is learned in tracking is settled, what is in one region with a known person is a piece."""
        people = self._people
        return not people.is_learned or people.is_settled or not in_one_box(self._boxes_of(view), cell, known).any()

    def may_be_part(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """What lies in a region that the border cuts and that is larger than a person there, with nobody known in it.

        It may be the head of someone too near to be seen whole. Ten drawn kiosks: 90 % of the crossings in place of 80,
        other views as without.
        """
        prior, boxes, (rows, cols) = self.prior(view), self._boxes_of(view), view.mask.shape
        if prior is None or in_one_box(boxes, cell, known).any():
            return False
        low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
        is_cut = (low <= 0).any(axis=1) | (high >= (cols, rows)).any(axis=1)
        is_larger = boxes[:, 3] > 2 * SIZE_LIMIT * prior.half_length(float(cell[1]))
        return bool(in_one_box(boxes[is_cut & is_larger], cell, cell[None]).any())

    def _boxes_of(self, view: PlaneView) -> F64:
        """(N, 4) boxes of the regions of a frame, found once."""
        if self._boxes is None or self._boxes[0] is not view:
            self._boxes = view, regions(view.mask, None)[0]
        return self._boxes[1]

    def protect(self, outlines: Sequence[F32]) -> None:
        self._outlines = outlines

    def feedback(self) -> U8 | None:
        """(H, W) uint8, WALKER inside the outlines of people who have moved; None before the first image."""
        if self._size is None:
            return None
        mask = np.zeros(self._size, dtype=np.uint8)
        for shape in self._outlines:
            cv2.fillPoly(mask, [np.round(shape).astype(np.int32)], WALKER)
        return mask

    def states(self, view: PlaneView, estimates: Estimates) -> list[TrackState]:
        """Boxes; floor positions and heights too with a camera."""
        rows = zip(estimates.evidence, estimates.ellipses, estimates.velocities, strict=True)
        return [image_state(e.who, view, ellipse, velocity, self._camera) for e, ellipse, velocity in rows]


def _image_size(foreground: U8, observation: Observation) -> tuple[int, int]:
    """(height, width) of the image, of the foreground where there is none [px]."""
    height, width = foreground.shape if observation.image is None else observation.image.shape[:2]
    return height, width
