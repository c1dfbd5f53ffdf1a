"""What the tracker knows about pixels, for the foreground model (Harville 2002, ECCV; notes, section 2)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import U8
from planview.foreground import BACKGROUND, PERSON
from planview.maps import FloorPoints
from planview.tracking.base import TrackState


class FeedbackParams(Params):
    """Feedback from tracker to foreground; our choices, the sequel to the paper gives only the idea."""

    enabled: bool = True
    """Give feedback at all."""
    body_m: float = Field(0.6, gt=0.0)
    """Foreground this near to a person's axis on the floor is his [m]: an arm's length."""
    travelled_m: float = Field(0.5, ge=0.0)
    """Only who has moved this far since he appeared is protected from being learned [m]: furniture that was mistaken
    for a person does not walk, and must fade into the background."""
    ground_m: float = Field(0.12, ge=0.0)
    """Foreground lower than this and away from everybody is floor under a new light [m]: a shoe's height."""
    spread_px: int = Field(5, ge=0, le=50)
    """A person's pixels are widened by so much for the next frame [px]."""


class Feedback:
    """Remembers who has walked, and paints the mask for the next frame."""

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self._origin: dict[int, tuple[float, float]] = {}
        self._walked: set[int] = set()

    def reset(self) -> None:
        """Forget everybody."""
        self._origin.clear()
        self._walked.clear()

    def __call__(self, points: FloorPoints, tracks: Sequence[TrackState], shape: tuple[int, int]) -> U8 | None:
        """The mask for the next frame.

        Args:
            points: foreground points of this frame; their pixels index an image of ``shape``.
            tracks: people after this frame.
        Returns:
            (H, W) uint8 of NO_OPINION, PERSON and BACKGROUND; None when feedback is off.
        """
        p = self.params
        if not p.enabled:
            return None
        self._remember(tracks)
        painted = np.zeros(shape[0] * shape[1], dtype=np.uint8)
        near = np.zeros(len(points.xyz), dtype=bool)
        for track in tracks:
            body = (points.xyz[:, 0] - track.x_m) ** 2 + (points.xyz[:, 1] - track.y_m) ** 2 < p.body_m**2
            near |= body
            if track.track_id in self._walked and track.state == "confirmed":
                painted[points.pixels[body]] = PERSON
        side = 2 * p.spread_px + 1
        mask = np.asarray(cv2.dilate(painted.reshape(shape), np.ones((side, side), dtype=np.uint8)), dtype=np.uint8)
        ground = points.pixels[~near & (points.xyz[:, 2] < p.ground_m)]
        flat = mask.reshape(-1)
        flat[ground[flat[ground] != PERSON]] = BACKGROUND
        return mask

    def _remember(self, tracks: Sequence[TrackState]) -> None:
        alive = {track.track_id for track in tracks}
        self._walked &= alive
        self._origin = {i: xy for i, xy in self._origin.items() if i in alive}
        for track in tracks:
            x, y = self._origin.setdefault(track.track_id, (track.x_m, track.y_m))
            if (track.x_m - x) ** 2 + (track.y_m - y) ** 2 >= self.params.travelled_m**2:
                self._walked.add(track.track_id)
