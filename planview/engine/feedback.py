"""People in the image of a rig: their boxes, and the mask that protects them from becoming background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.pose import SE3
from calib.types import U8
from planview.engine.config import FeedbackParams
from planview.foreground.params import BACKGROUND, PERSON
from planview.maps.builder import FloorPoints
from planview.tracking.base import Decision
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry

OWN_M = 0.6
"""Foreground this near to a person's axis on the floor belongs to the person [m]: an arm's length."""
TRAVELLED_M = 0.5
"""Only a track that has moved this far since its start is protected from being learned [m]: furniture that was
mistaken for a person does not walk, and must fade into the background."""
GROUND_M = 0.12
"""Foreground lower than this and away from every person is floor under a new light [m]: a shoe's height."""


class Feedback:
    """Feedback of the tracker to the foreground model (Harville 2002, ECCV: A Framework for High-Level Feedback).

    Remembers which tracks have walked, and paints the mask for the next frame.

    Attributes:
        mask: (H, W) uint8, as the last call returned it; None at first.
    """

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self.mask: U8 | None = None
        self._origin: dict[int, tuple[float, float]] = {}
        self._walked: set[int] = set()

    def __call__(
        self,
        points: FloorPoints,
        tracks: Sequence[TrackState],
        shape: tuple[int, int],
        decisions: Sequence[Decision] = (),
    ) -> U8 | None:
        """The mask for the next frame.

        Args:
            points: foreground points of this frame; their pixels index an image of ``shape``.
            tracks: people after this frame.
            decisions: of this frame, which may give people their ids.
        Returns:
            (H, W) uint8 of NO_FEEDBACK, PERSON and BACKGROUND; None when feedback is off.
        """
        p = self.params
        if not p.enabled:
            return None
        self._remember(tracks, decisions)
        x, y, z = np.ascontiguousarray(points.xyz.T)
        near_any, near_walker = np.zeros(len(z), np.bool_), np.zeros(len(z), np.bool_)
        for track in tracks:
            off_x, off_y = x - np.float32(track.x_m), y - np.float32(track.y_m)
            near = off_x * off_x + off_y * off_y < OWN_M**2
            near_any |= near
            if track.state == "confirmed" and track.track_id in self._walked:
                near_walker |= near
        self.mask = mask = np.zeros(shape, np.uint8)
        mask.reshape(-1)[points.pixels[(z < GROUND_M) & ~near_any]] = BACKGROUND
        persons = np.zeros(shape, np.uint8)
        persons.reshape(-1)[points.pixels[near_walker]] = 1
        left, top, width, height = cv2.boundingRect(persons)
        if width:
            reach, side = p.spread_px, 2 * p.spread_px + 1
            rows, columns = (slice(max(0, low - reach), low + n + reach) for low, n in ((top, height), (left, width)))
            spread = cv2.dilate(persons[rows, columns], np.ones((side, side), dtype=np.uint8))
            # A person's pixel is no ground.
            mask[rows, columns][spread > 0] = PERSON
        return mask

    def _remember(self, tracks: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        for known in decisions:
            if known.was in self._origin:
                self._origin.setdefault(known.track_id, self._origin[known.was])
                self._walked |= {known.track_id} if known.was in self._walked else set()
        alive = {track.track_id for track in tracks}
        self._walked &= alive
        self._origin = {i: xy for i, xy in self._origin.items() if i in alive}
        for track in tracks:
            x, y = self._origin.setdefault(track.track_id, (track.x_m, track.y_m))
            if (track.x_m - x) ** 2 + (track.y_m - y) ** 2 >= TRAVELLED_M**2:
                self._walked.add(track.track_id)


BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""


class BodyBoxes:
    """Boxes around upright prisms of a person's width and height, clipped to the rectified left image."""

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3) -> None:
        self._projection = geometry.matrix @ world_SE3_left.inverse().matrix[:3]
        self._size = geometry.size

    def __call__(self, tracks: Sequence[TrackState]) -> tuple[TrackState, ...]:
        """The tracks with ``box_px`` in pixels of the rectified left image; unchanged where they are not in view."""
        at, r = np.array([(t.x_m, t.y_m, t.height_m) for t in tracks]).reshape(-1, 1, 3), BODY_RADIUS_M
        corners = np.array([(x, y, z) for x in (-r, r) for y in (-r, r) for z in (0.0, 1.0)])
        xyz = np.concatenate([at[..., :2] + corners[:, :2], at[..., 2:] * corners[:, 2:]], axis=-1)
        u, v, depth = np.moveaxis(xyz @ self._projection[:, :3].T + self._projection[:, 3], -1, 0)
        # Corners of a body nearer to the camera's plane than this are left out [m].
        front, (width, height) = depth > 0.1, self._size
        with np.errstate(divide="ignore", invalid="ignore"):
            (left, top), (right, bottom) = (
                [least(np.where(front, part / depth, sign * np.inf), axis=1) for part in (u, v)]
                for least, sign in ((np.min, 1), (np.max, -1))
            )
        left, top = np.maximum(left, -0.5), np.maximum(top, -0.5)
        sides = np.minimum(right, width - 0.5) - left, np.minimum(bottom, height - 0.5) - top
        return tuple(
            replace(track, box_px=(x, y, w, h)) if w > 0 and h > 0 else track
            for track, x, y, w, h in zip(tracks, *(part.tolist() for part in (left, top, *sides)), strict=True)
        )
