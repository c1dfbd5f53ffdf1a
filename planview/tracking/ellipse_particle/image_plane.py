"""Ellipses in the image of one camera: no calibration is needed, sizes are learned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, F64, I64, U8, Bool
from planview.foreground.masks import WALKER
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.camera_size import BREADTH_M, PERSON_M, size_of_camera
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.tracking.ellipse_particle.image_grid import FINER, SHORT, averaged, columns_for, regridded
from planview.tracking.ellipse_particle.outputs import image_state
from planview.tracking.ellipse_particle.params import ImagePlaneParams
from planview.tracking.ellipse_particle.planes import Estimates, PlaneView
from planview.tracking.ellipse_particle.regions import in_one_box, regions
from planview.tracking.ellipse_particle.size_learning import SizeBelief, SizeLearner
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
DOUBTFUL = 0.5
"""Share of what moves below which the size learned from it is doubtful: most of it has another one."""
LENGTH_MIN_M = 0.85
"""Least length of a body in the image [m], from straight above: half its height, by which it reaches outwards."""
FOREGROUND_PX = 2
"""Pixels of foreground per cell that are enough: cells average them anyway. Our choice."""
PIECE = 2.0
"""In the region of a known person so many times as long is a piece of that person: a head, where a low camera sees
heads in the rows in which people far away are small. Our choice: 200 people of 195 on 28 drawn views, 205 without it,
89.2 % of the crossings in place of 88.7."""
AT_ONCE = 2
"""People who may come at once in one region where the size is learned. Our choice: a pair; a third waits until one of
them is confirmed or gone. 1323 people of 1247 on 182 drawn views, 1361 without it, and as many crossings; no gain on 28
later ones."""
TYPICAL = 0.75
"""Where people are centred in the view of a calibrated camera, as a share of its height. Our choice."""
FLOODED = 0.5
"""Share of foreground above which a frame measures nothing (a light was switched, the camera moved). Our choice."""
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
        self.reset()

    def reset(self) -> None:
        self._coarse, self._fine = SizeLearner(self._params.learn_s), SizeLearner(self._params.learn_s)
        self._outlines: Sequence[F32] = ()
        self._size: tuple[int, int] | None = None
        self._sized: tuple[PlaneView, SizeBelief] | None = None
        self._boxes: tuple[PlaneView, F64] | None = None

    @property
    def model(self) -> PlaneModel:
        """What is known of ellipses now: upright until the size learned has none."""
        prior = None if self._sized is None else self._sized[1].prior
        model = FROM_ABOVE if prior is not None and prior.any_direction else UPRIGHT
        looseness = 1.0 if prior is None else 1.0 + prior.half_length_slope
        return model._replace(outside_weight=self._params.outside_weight, looseness=looseness)

    def __call__(self, observation: Observation) -> PlaneView | None:
        """Learn the size of people from a frame; the frame's cells, None when it has no foreground to work on.

        Raises:
            ValueError: the foreground is not (H, W) uint8.
        """
        foreground = self._cleaned(observation)
        if foreground is None:
            return None
        self._learn(foreground, observation)
        return self._averaged(foreground, observation, self._columns)

    def view(self, observation: Observation) -> PlaneView | None:
        """The frame's cells, on the grid for the size known now."""
        foreground = self._cleaned(observation)
        return None if foreground is None else self._averaged(foreground, observation, self._columns)

    def _averaged(self, foreground: U8, observation: Observation, columns: int) -> PlaneView:
        height, width = _image_size(foreground, observation)
        return averaged(foreground, (width, height), columns, observation)

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

    def _learn(self, foreground: U8, observation: Observation) -> None:
        """The given size, that of the camera, or the learned one, and its grid; a flooded frame teaches nothing."""
        view = self._averaged(foreground, observation, self._params.columns)
        given = self._given(view)
        if given is not None:
            self._sized = view, SizeBelief(given, 1.0, 2 * given.half_length(TYPICAL * view.mask.shape[0]))
        elif float(view.mask.mean()) <= FLOODED:
            self._sized = self._learned(view, foreground)

    def _learned(self, view: PlaneView, foreground: U8) -> tuple[PlaneView, SizeBelief] | None:
        """The size learned on the grid that suits it: on a fine one large people are many pieces."""
        belief = _taught(self._coarse, view)
        if belief is not None and belief.length >= SHORT:
            return view, belief
        finer = self._averaged(foreground, view.observation, round(FINER * self._params.columns))
        fine = _taught(self._fine, finer)
        if belief is None:
            return None
        return (view, belief) if fine is None else (finer, fine)

    @property
    def _columns(self) -> int:
        """Of the grid for the size known now."""
        columns = self._params.columns
        if self._sized is None:
            return columns
        view, belief = self._sized
        return columns_for(belief.length * columns / view.mask.shape[1], columns)

    def _given(self, view: PlaneView) -> SizePrior | None:
        """The size given by hand or by the camera, in cells of the view."""
        p = self._params
        if p.person_height_px is not None:
            return SizePrior(p.person_height_px / 2 / view.scale, 0.0, p.aspect)
        return None if self._camera is None else size_of_camera(self._camera, view.scale, p.aspect)

    def prior(self, view: PlaneView) -> SizePrior | None:
        """The size known now, in cells of the view."""
        return None if self._sized is None else regridded(self._sized[1].prior, self._sized[0], view)

    @property
    def notes(self) -> tuple[str, ...]:
        """The size that was learned, and how much of what moves is of it, in a sentence; none of a given size."""
        if self._params.person_height_px is not None or self._coarse.belief is None or self._sized is None:
            return ()
        view, belief = self._sized
        length_px = 2.0 * belief.prior.half_length((view.mask.shape[0] - 1) / 2) * view.scale
        shape = "long" if belief.prior.any_direction else "high"
        told = f"people are taken for {length_px:.0f} px {shape} in the middle of the image"
        doubt = "" if belief.confidence >= DOUBTFUL else ": set --person-height if that is wrong"
        return (f"{told}, learned from what moves; {belief.confidence:.0%} of it has that size{doubt}",)

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
        return True

    def is_separate(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """What is much smaller than a known person in its region is a piece; until the size is settled, all there."""
        prior = self.prior(view)
        if prior is None or self._coarse.belief is None:
            return True
        if self._coarse.settled:
            known = known[prior.half_lengths(known[:, 1]) > PIECE * prior.half_length(float(cell[1]))]
        return not in_one_box(self._boxes_of(view), cell, known).any()

    def has_room(self, view: PlaneView, cell: F64, newcomers: F64) -> bool:
        """People come one by one or in pairs; more at once in a region are pieces of someone larger than expected."""
        if self._coarse.belief is None or len(newcomers) < AT_ONCE:
            return True
        return int(in_one_box(self._boxes_of(view), cell, newcomers).sum()) < AT_ONCE

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


def _taught(learner: SizeLearner, view: PlaneView) -> SizeBelief | None:
    motion = view.observation.motion
    moving = None if motion is None else _moving(motion, view.mask.shape)
    return learner.update(view.mask, view.observation.timestamp_s, moving)


def _moving(motion: U8, shape: tuple[int, ...]) -> Bool:
    """(R, C) cells in which at least a quarter of the pixels moves."""
    share = cv2.resize(motion, (shape[1], shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(share >= 64, dtype=np.bool_)
