"""Image boxes of people on the floor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.pose import SE3
from planview.engine._box_kernels import extent_of_prism
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry

BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""


class BodyBoxes:
    """Boxes around upright prisms of a person's width and height, clipped to the rectified left image."""

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3) -> None:
        left_SE3_world = world_SE3_left.inverse()
        self._projection = np.ascontiguousarray(geometry.matrix @ left_SE3_world.matrix[:3])
        self._size = geometry.size

    def __call__(self, track: TrackState) -> TrackState:
        """The track with ``box_px`` in pixels of the rectified left image; unchanged where it is not in view."""
        if math.isnan(track.x_m) or math.isnan(track.height_m):
            return track
        extent = extent_of_prism(self._projection, track.x_m, track.y_m, BODY_RADIUS_M, track.height_m)
        if extent[0] > extent[1]:
            return track
        left, right = max(-0.5, extent[0]), min(self._size[0] - 0.5, extent[1])
        top, bottom = max(-0.5, extent[2]), min(self._size[1] - 0.5, extent[3])
        if right <= left or bottom <= top:
            return track
        return replace(track, box_px=(left, top, right - left, bottom - top))
