"""Labels that the tracker gives to the foreground: pixels of people, and of the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from calib.carried import Carried
from calib.types import U8
from planview.engine.config import FeedbackParams
from planview.foreground.params import BACKGROUND, PERSON
from planview.maps.view import View
from planview.tracking.base import Decision
from planview.trajectories.state import TrackState

OWN_M = 0.6
"""Foreground this near to a person's axis on the floor belongs to the person [m]: an arm's length."""
TRAVELLED_M = 0.5
"""Only a track that has moved this far since its start is protected from being learned [m]: furniture that was
mistaken for a person does not walk, and must fade into the background."""
GROUND_M = 0.12
"""Foreground lower than this and away from every person is floor under a new light [m]: a shoe's height."""


class Feedback(Carried):
    """Feedback of the tracker to the foreground model (Harville 2002, ECCV: A Framework for High-Level Feedback).

    Remembers which tracks have walked, and paints the mask for the next frame.

    Attributes:
        mask: (H, W) uint8, as the last call returned it; None at first.
    """

    CARRIED = "mask", "_starts"

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self.mask: U8 | None = None
        # Where each track began, None once it has walked.
        self._starts: dict[int, tuple[float, float] | None] = {}

    def update(self, tracks: Sequence[TrackState], view: View, decisions: Sequence[Decision] = ()) -> U8 | None:
        """The mask for the next frame, (H, W) uint8 of NO_FEEDBACK, PERSON and BACKGROUND: the last one where a view
        shows nothing, None when feedback is off. ``decisions`` of this frame may give people their ids."""
        p = self.params
        points = view.points
        shape = view.kind.shape
        if not (p.enabled and view.shows):
            return self.mask
        self._remember(tracks, decisions)
        x, y, z = np.ascontiguousarray(points.xyz.T)
        near_any = np.zeros(len(z), np.bool_)
        near_walker = np.zeros(len(z), np.bool_)
        for track in tracks:
            off_x = x - np.float32(track.x_m)
            off_y = y - np.float32(track.y_m)
            near = off_x * off_x + off_y * off_y < OWN_M**2
            near_any |= near
            if track.state == "confirmed" and self._starts[track.track_id] is None:
                near_walker |= near
        self.mask = mask = np.zeros(shape, np.uint8)
        mask.reshape(-1)[points.pixels[(z < GROUND_M) & ~near_any]] = BACKGROUND
        persons = np.zeros(shape, np.uint8)
        persons.reshape(-1)[points.pixels[near_walker]] = 1
        left, top, width, height = cv2.boundingRect(persons)
        if width:
            reach = p.spread_px
            side = 2 * p.spread_px + 1
            rows, columns = (slice(max(0, low - reach), low + n + reach) for low, n in ((top, height), (left, width)))
            spread = cv2.dilate(persons[rows, columns], np.ones((side, side), dtype=np.uint8))
            # A person's pixel is not floor.
            mask[rows, columns][spread > 0] = PERSON
        return mask

    def _remember(self, tracks: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        for known in decisions:
            if known.was in self._starts:
                start = self._starts[known.was]
                self._starts[known.track_id] = start and self._starts.get(known.track_id, start)
        self._starts = {t.track_id: self._starts.get(t.track_id, (t.x_m, t.y_m)) for t in tracks}
        for track in tracks:
            start = self._starts[track.track_id]
            if start is not None and math.dist(start, (track.x_m, track.y_m)) >= TRAVELLED_M:
                self._starts[track.track_id] = None
