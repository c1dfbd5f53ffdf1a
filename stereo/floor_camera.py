"""The rectified left camera of a pair above its floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calib.pose import SE3
from calib.types import F64
from stereo.depth import RectifiedGeometry


class StereoFloorCamera:
    """The rectified left camera of a rig above the floor; its pixels are those of the boxes in tracks.csv."""

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3) -> None:
        self._geometry = geometry
        self._pose = world_SE3_left

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px]."""
        return self._geometry.size

    def project(self, points_world: ArrayLike) -> F64:
        """(..., 2) pixels of (..., 3) world points [m]; NaN behind the camera."""
        points = np.asarray(points_world, dtype=np.float64)
        return self._geometry.project((points - self._pose.translation) @ self._pose.rotation)

    def back_project(self, pixels: ArrayLike) -> F64:
        """(..., 2) places on the floor [m] that (..., 2) pixels show; NaN above the horizon."""
        rays = self._geometry.rays(pixels) @ self._pose.rotation.T
        down = np.where(rays[..., 2] < -1e-9, -rays[..., 2], np.nan)
        reach = self._pose.translation[2] / down
        return np.asarray(self._pose.translation[:2] + reach[..., None] * rays[..., :2])
