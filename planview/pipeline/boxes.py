"""Image boxes of people on the floor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.pose import SE3
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry

BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""


class BodyBoxes:
    """Boxes around upright prisms of a person's width and height, clipped to the rectified left image."""

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3) -> None:
        left_SE3_world = world_SE3_left.inverse()
        self._projection = geometry.matrix @ left_SE3_world.matrix[:3]
        self._size = geometry.size
        r = BODY_RADIUS_M
        self._corners = np.array([(x, y, z, 1.0) for x in (-r, r) for y in (-r, r) for z in (0.0, 1.0)]).T

    def __call__(self, track: TrackState) -> TrackState:
        """The track with ``box_px`` in pixels of the rectified left image; unchanged where it is not in view."""
        if math.isnan(track.x_m) or math.isnan(track.height_m):
            return track
        corners = self._corners.copy()
        corners[0] += track.x_m
        corners[1] += track.y_m
        corners[2] *= track.height_m
        u, v, depth = self._projection @ corners
        front = depth > 0.1
        if not front.any():
            return track
        u, v = u[front] / depth[front], v[front] / depth[front]
        left, right = max(-0.5, float(u.min())), min(self._size[0] - 0.5, float(u.max()))
        top, bottom = max(-0.5, float(v.min())), min(self._size[1] - 0.5, float(v.max()))
        if right <= left or bottom <= top:
            return track
        return replace(track, box_px=(left, top, right - left, bottom - top))
