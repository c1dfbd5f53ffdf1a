"""The plane that a tracker works in: the image of one camera, or the floor below a stereo camera.

Whatever differs between the two is asked here; the tracker itself is the same for both.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from calib.types import F32, F64, I64, U8, Bool
from planview.tracking.base import Observation
from planview.tracking.ellipse_particle.existence import ExistenceEvidence
from planview.tracking.ellipse_particle.fit.prior import PlaneModel, SizePrior
from planview.trajectories.state import TrackState


@dataclass(frozen=True, eq=False)
class PlaneView:
    """Foreground of one frame on the tracker's grid.

    Attributes:
        mask: (R, C) float32, foreground share of each cell, 0..1.
        scale: plane units per cell (px in the image, m on the floor).
        origin: (x, y) of the centre of cell (0, 0) in plane units.
        observation: what the foreground was made of.
    """

    mask: F32
    scale: float
    origin: tuple[float, float]
    observation: Observation

    def to_plane(self, xy: F64) -> F64:
        """(..., 2) plane coordinates of fractional cells."""
        return np.asarray(np.asarray(xy) * self.scale + np.asarray(self.origin))

    def bare(self) -> PlaneView:
        """The grid without the frame's images, to be kept."""
        seen = self.observation
        return replace(self, observation=Observation(seen.frame, seen.timestamp_s))

    def to_cells(self, xy: F64) -> F64:
        """(..., 2) fractional cells of plane coordinates."""
        return np.asarray((np.asarray(xy) - np.asarray(self.origin)) / self.scale)


@dataclass(frozen=True, eq=False)
class Estimates:
    """The objects after a frame; row n of each is one object.

    Attributes:
        evidence: of their existence.
        ellipses: (N, 5) [cells].
        velocities: (N, 2) [plane units per second].
    """

    evidence: Sequence[ExistenceEvidence]
    ellipses: F64
    velocities: F64


class TrackingPlane(Protocol):
    """What differs between the image and the floor.

    Attributes:
        name: of the plane.
        foreground_columns: columns of foreground that are enough, None for all.
    """

    name: Literal["image", "floor"]
    foreground_columns: int | None

    @property
    def model(self) -> PlaneModel:
        """What is known of ellipses now."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the plane found out about the recording, a sentence each."""

    def reset(self) -> None:
        """Forget everything."""

    def study(self, observations: Iterable[Observation]) -> None:
        """Learn from a recording's beginning what ``reset`` does not forget."""

    def __call__(self, observation: Observation) -> PlaneView | None:
        """The frame's cells; None when the observation has nothing to work on.

        Raises:
            ValueError: the observation's arrays are not what they should be.
        """

    def view(self, observation: Observation) -> PlaneView | None:
        """The cells of an earlier frame once more, on the grid of now."""

    def prior(self, view: PlaneView) -> SizePrior | None:
        """Size expected of objects [cells], None while it is not known."""

    def cells_per_m(self, view: PlaneView, prior: SizePrior, rows: F64) -> F64:
        """(N,) cells per metre at centre rows (N,)."""

    def turns(self, measured: Bool, confirmed: Bool) -> list[I64]:
        """The objects that are filtered together, one turn after the other.

        Args:
            measured, confirmed: (N,) what is known of the objects.
        """

    def separation(self, view: PlaneView) -> float:
        """Smallest distance of two objects [cells]; 0 lets them hide one another."""

    def long_enough(self, view: PlaneView, ellipses: F64, order: I64, confirmed: Bool, prior: SizePrior) -> Bool:
        """(N,) whether enough of a person's length shows of each ellipse, outside those earlier in the order.

        Args:
            ellipses: (N, 5) [cells].
            order: (N,) indices.
            confirmed: (N,) ellipses of confirmed objects, of which less may show.
        """

    def is_person(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Whether a person may be at a place (2,) [cells], and no part of one of the (N, 2) known people [cells]."""

    def is_separate(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Whether a place (2,) [cells] can be told apart from the (N, 2) known people [cells]."""

    def may_be_part(self, view: PlaneView, cell: F64, known: F64) -> bool:
        """Whether what is at a place (2,) [cells] may be part of someone none of the (N, 2) known people [cells] is."""

    def protect(self, outlines: Sequence[F32]) -> None:
        """Keep what is inside these outlines (N, 2) [plane units] out of the background."""

    def feedback(self) -> U8 | None:
        """What ``ImageTracker.feedback`` gives."""

    def states(self, view: PlaneView, estimates: Estimates) -> list[TrackState]:
        """Rows of ``tracks.csv``, one per object."""
