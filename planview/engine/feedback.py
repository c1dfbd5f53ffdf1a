"""Feedback of the tracker to the foreground model (Harville 2002, ECCV: A Framework for High-Level Feedback)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import U8
from planview.engine._feedback_kernels import paint
from planview.foreground.masks import BACKGROUND, PERSON
from planview.maps.builder import FloorPoints
from planview.trajectories.state import TrackState


class FeedbackParams(Params):
    """Feedback from tracker to foreground; our choices, the paper gives only the idea."""

    enabled: bool = True
    """Give feedback at all."""
    body_m: float = Field(0.6, gt=0.0, le=5.0)
    """Foreground this near to a person's axis on the floor belongs to the person [m]: an arm's length."""
    travelled_m: float = Field(0.5, ge=0.0, le=100.0)
    """Only a track that has moved this far since its start is protected from being learned [m]: furniture that was
    mistaken for a person does not walk, and must fade into the background."""
    ground_m: float = Field(0.12, ge=0.0, le=2.0)
    """Foreground lower than this and away from every person is floor under a new light [m]: a shoe's height."""
    spread_px: int = Field(5, ge=0, le=50)
    """A person's pixels are widened by so much for the next frame [px]."""


class Feedback:
    """Remembers which tracks have walked, and paints the mask for the next frame.

    Attributes:
        mask: (H, W) uint8, as the last call returned it; None at first.
    """

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self.mask: U8 | None = None
        self._origin: dict[int, tuple[float, float]] = {}
        self._walked: set[int] = set()

    def reset(self) -> None:
        """Forget all tracks."""
        self.mask = None
        self._origin.clear()
        self._walked.clear()

    def __call__(self, points: FloorPoints, tracks: Sequence[TrackState], shape: tuple[int, int]) -> U8 | None:
        """The mask for the next frame.

        Args:
            points: foreground points of this frame; their pixels index an image of ``shape``.
            tracks: people after this frame.
        Returns:
            (H, W) uint8 of NO_FEEDBACK, PERSON and BACKGROUND; None when feedback is off.
        """
        p = self.params
        if not p.enabled:
            return None
        self._remember(tracks)
        people = np.array(
            [(t.x_m, t.y_m, t.state == "confirmed" and t.track_id in self._walked) for t in tracks], dtype=np.float64
        ).reshape(-1, 3)
        persons, ground = np.zeros(shape, dtype=np.uint8), np.zeros(shape, dtype=np.uint8)
        paint(points.xyz, points.pixels, people, p.body_m, p.ground_m, persons.reshape(-1), ground.reshape(-1))
        mask = np.multiply(ground, np.uint8(BACKGROUND), out=ground)
        left, top, width, height = cv2.boundingRect(persons)
        if width:
            reach = p.spread_px
            part = (
                slice(max(0, top - reach), top + height + reach),
                slice(max(0, left - reach), left + width + reach),
            )
            side = 2 * reach + 1
            spread = cv2.dilate(persons[part], np.ones((side, side), dtype=np.uint8))
            # A person's pixel is no ground.
            np.copyto(mask[part], np.uint8(PERSON), where=spread > 0)
        self.mask = mask
        return mask

    def _remember(self, tracks: Sequence[TrackState]) -> None:
        alive = {track.track_id for track in tracks}
        self._walked &= alive
        self._origin = {i: xy for i, xy in self._origin.items() if i in alive}
        for track in tracks:
            x, y = self._origin.setdefault(track.track_id, (track.x_m, track.y_m))
            if (track.x_m - x) ** 2 + (track.y_m - y) ** 2 >= self.params.travelled_m**2:
                self._walked.add(track.track_id)
