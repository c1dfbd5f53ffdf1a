"""Where people are observed, as columns: of one frame while a run goes on, of many of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.types import F64, I8, I64, Bool
from planview.counting.geometry import PlaneName
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories

PERSON_M = 1.7
"""Height that a box is taken to show where only boxes are known: it gives metres to pixels [m]."""


class InPlane(NamedTuple):
    """(N,) positions in a plane and its units per metre there; NaN where the plane is not known."""

    x: F64
    y: F64
    unit: F64


@dataclass(frozen=True, eq=False)
class Places:
    """Rows of tracks, (N,) each.

    Attributes:
        track_id: int64.
        confirmed: whether the state is confirmed.
        observed: whether the row has a place and is more than a prediction.
        floor_m: (N, 2) position [m].
        box_px: (N, 4) left, top, width, height.
    """

    track_id: I64
    confirmed: Bool
    observed: Bool
    floor_m: F64
    box_px: F64

    @staticmethod
    def of_states(tracks: Sequence[TrackState]) -> Places:
        """One frame's tracks."""
        return _places(
            np.array([track.track_id for track in tracks], dtype=np.int64),
            np.array([track.state for track in tracks], dtype=np.str_),
            np.array([(track.x_m, track.y_m) for track in tracks], dtype=np.float64).reshape(-1, 2),
            np.array([track.box_px for track in tracks], dtype=np.float64).reshape(-1, 4),
        )

    @staticmethod
    def of_rows(tracks: Trajectories, rows: slice | I64) -> Places:
        """Rows of a table."""
        floor_m = np.column_stack([tracks.x_m[rows], tracks.y_m[rows]])
        return _places(tracks.track_id[rows], tracks.state[rows], floor_m, tracks.box_px[rows])

    def within(self, plane: PlaneName) -> InPlane:
        """The positions in a plane: on the floor, or of the foot in the image, the middle of the box's lower edge."""
        if plane == "floor":
            return InPlane(self.floor_m[:, 0], self.floor_m[:, 1], np.ones(len(self.floor_m)))
        left, top, width, height = self.box_px.T
        return InPlane(left + width / 2, top + height, np.where(height > 0, height / PERSON_M, np.nan))

    def metres(self) -> F64:
        """(N, 2) places in metres: on the floor where known, else from the image."""
        foot = self.within("image")
        image_m = np.column_stack([foot.x, foot.y]) / foot.unit[:, None]
        return np.where(np.isfinite(self.floor_m[:, :1]), self.floor_m, image_m)


def _places(track_id: I64, state: np.ndarray[tuple[int], np.dtype[np.str_]], floor_m: F64, box_px: F64) -> Places:
    places = Places(track_id, state == "confirmed", state != "lost", floor_m, box_px)
    known = np.isfinite(places.metres().sum(axis=1))
    return Places(track_id, places.confirmed, places.observed & known, floor_m, box_px)


def side_codes(side: F64, decided: Bool, known: Bool) -> I8:
    """(N,) 0 not known, 1 and 2 below 0 and decided or not, 3 and 4 from 0 on and undecided or not."""
    return np.where(known, np.where(side >= 0, 3 + decided, 2 - decided), 0).astype(np.int8)
