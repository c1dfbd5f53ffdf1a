"""A room seen from straight above, with people made of two discs: shoulders at 1.4 m and a head at their height."""

import numpy as np

from calib.rig import world_from_plane
from planview.maps.view import ViewBuilder
from planview.tracking.base import Observation
from stereo.depth import RectifiedGeometry

CAMERA_M = 4.0
GEOMETRY = RectifiedGeometry(160, 120, 100.0, 100.0, 79.5, 59.5, 0.2)
BUILDER = ViewBuilder(GEOMETRY, world_from_plane(np.array([0.0, 0.0, -1.0]), CAMERA_M))

Person = tuple[float, float, float]
"""x, y, height [m]."""


def observe(frame: int, people: list[Person], fps: float = 10.0) -> Observation:
    """What the tracker gets when people stand there."""
    disparity = np.full((120, 160), GEOMETRY.disparity_at(CAMERA_M), dtype=np.float32)
    mask = np.zeros((120, 160), dtype=np.uint8)
    v, u = np.indices(mask.shape)
    for x, y, height in sorted(people, key=lambda p: p[2]):
        for top, radius in ((height - 0.35, 0.2), (height, 0.1)):
            depth = CAMERA_M - top
            disc = (u - 79.5 - 100 * x / depth) ** 2 + (v - 59.5 + 100 * y / depth) ** 2 <= (100 * radius / depth) ** 2
            disparity[disc] = GEOMETRY.disparity_at(depth)
            mask[disc] = 255
    return Observation(frame, frame / fps, build_maps=lambda: BUILDER(disparity, mask))
