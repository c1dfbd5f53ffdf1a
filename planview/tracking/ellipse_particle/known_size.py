"""What is known of the size of people in the image of one camera, and from where."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import Bool
from planview.tracking.ellipse_particle.camera_size import size_of_camera
from planview.tracking.ellipse_particle.fit.prior import SizePrior
from planview.tracking.ellipse_particle.image_grid import FINER, SHORT, columns_for, regridded
from planview.tracking.ellipse_particle.params import ImagePlaneParams
from planview.tracking.ellipse_particle.planes import PlaneView
from planview.tracking.ellipse_particle.size_learning import SizeBelief, SizeLearner

Grid = Callable[[int], PlaneView]
"""Makes the cells of a frame on a grid of so many columns."""
Sized = tuple[PlaneView, SizeBelief]
"""A size, in the cells of a grid."""

DOUBTFUL = 0.5
"""Share of what moves below which the size learned from it is doubtful: most of it has another one."""
TYPICAL = 0.75
"""Where people are centred in the view of a calibrated camera, as a share of its height. Our choice."""
FLOODED = 0.5
"""Share of foreground above which a frame teaches nothing, and measures nothing (a light was switched, the camera
moved). Our choice."""


class KnownSize:
    """The size of people: given by hand or by the camera, else learned, before a recording is tracked or meanwhile.

    Args:
        camera: tells the size where it looks neither steeply down nor along the floor.
    """

    def __init__(self, params: ImagePlaneParams, camera: GroundCamera | None) -> None:
        self._params, self._camera = params, camera
        self._studied: Sized | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all frames, but not what ``study`` learned."""
        self._coarse, self._fine = SizeLearner(self._params.learn_s), SizeLearner(self._params.learn_s)
        self._sized: Sized | None = None

    def study(self, grids: Iterable[Grid]) -> None:
        """Learn the size from the frames of a recording's beginning at once; not where it is given.

        Who comes first, and whether alone, then decides nothing. Where it cannot be told, it is learned in tracking.

        Args:
            grids: of frames in order; no more are taken than those of the first ``learn_s`` seconds.
        """
        coarse, fine = SizeLearner(self._params.learn_s), SizeLearner(self._params.learn_s)
        view = finer = None
        for grid in grids:
            view, finer = grid(self._params.columns), grid(self._finer)
            if self._given(view) is not None:
                return
            if view.observation.timestamp_s > self._params.learn_s:
                break
            if not is_flooded(view):
                coarse.collect(*_lesson(view))
                fine.collect(*_lesson(finer))
        if view is not None and finer is not None:
            beliefs = coarse.learn(len(view.mask)), fine.learn(len(finer.mask))
            self._studied = _suited(view.bare(), beliefs[0], finer.bare(), beliefs[1])

    def update(self, grid: Grid) -> None:
        """Learn from the next frame, unless the size is known already; a flooded one teaches nothing."""
        if self._studied is not None:
            self._sized = self._studied
            return
        view = grid(self._params.columns)
        given = self._given(view)
        if given is not None:
            self._sized = view, SizeBelief(given, 1.0, 2 * given.half_length(TYPICAL * view.mask.shape[0]))
        elif not is_flooded(view):
            self._sized = self._learned(view, grid)

    def _learned(self, view: PlaneView, grid: Grid) -> Sized | None:
        """The size so far; the finer grid is made only where it may be needed."""
        belief = self._coarse.update(*_lesson(view))
        if belief is not None and belief.length >= SHORT:
            return view, belief
        finer = grid(self._finer)
        return _suited(view, belief, finer, self._fine.update(*_lesson(finer)))

    @property
    def _finer(self) -> int:
        return round(FINER * self._params.columns)

    def _given(self, view: PlaneView) -> SizePrior | None:
        """The size given by hand or by the camera, in cells of the view."""
        p = self._params
        if p.person_height_px is not None:
            return SizePrior(p.person_height_px / 2 / view.scale, 0.0, p.aspect)
        return None if self._camera is None else size_of_camera(self._camera, view.scale, p.aspect)

    @property
    def is_learned(self) -> bool:
        """Whether the size is known, and was not given."""
        return self._studied is not None or self._coarse.belief is not None

    @property
    def is_settled(self) -> bool:
        """Whether a learned size will hardly change any more."""
        return self._studied is not None or self._coarse.settled

    @property
    def expected(self) -> SizePrior | None:
        """The size known now, in cells of the grid that it was learned on."""
        return None if self._sized is None else self._sized[1].prior

    def on(self, view: PlaneView) -> SizePrior | None:
        """The size known now, in cells of the view."""
        return None if self._sized is None else regridded(self._sized[1].prior, self._sized[0], view)

    @property
    def columns(self) -> int:
        """Of the grid for the size known now."""
        columns = self._params.columns
        if self._sized is None:
            return columns
        view, belief = self._sized
        return columns_for(belief.length * columns / view.mask.shape[1], columns)

    @property
    def notes(self) -> tuple[str, ...]:
        """The size that was learned, and how much of what moves is of it, in a sentence; none of a given size."""
        if self._sized is None or not self.is_learned:
            return ()
        view, belief = self._sized
        length_px = 2.0 * belief.prior.half_length((view.mask.shape[0] - 1) / 2) * view.scale
        shape = "long" if belief.prior.any_direction else "high"
        told = f"people are taken for {length_px:.0f} px {shape} in the middle of the image"
        doubt = (
            "" if belief.confidence >= DOUBTFUL else ": set ellipse_particle.image.person_height_px if that is wrong"
        )
        return (f"{told}, learned from what moves; {belief.confidence:.0%} of it has that size{doubt}",)


def is_flooded(view: PlaneView) -> bool:
    """Whether so much of a frame is foreground that it tells nothing of people."""
    return float(view.mask.mean()) > FLOODED


def _suited(view: PlaneView, belief: SizeBelief | None, finer: PlaneView, fine: SizeBelief | None) -> Sized | None:
    """The size on the grid that suits it: on a fine one large people are many pieces."""
    if belief is None:
        return None
    return (view, belief) if belief.length >= SHORT or fine is None else (finer, fine)


def _lesson(view: PlaneView) -> tuple[np.ndarray, float, Bool | None]:
    """What a learner takes of a frame; of its cells move those of which at least a quarter of the pixels does."""
    motion, (rows, cols) = view.observation.motion, view.mask.shape
    moving = None
    if motion is not None:
        moving = np.asarray(cv2.resize(motion, (cols, rows), interpolation=cv2.INTER_AREA) >= 64, dtype=np.bool_)
    return view.mask, view.observation.timestamp_s, moving
