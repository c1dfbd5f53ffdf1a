"""The rectified left camera of a pair above its floor."""

from __future__ import annotations

import numpy as np

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

    def project(self, points_world: F64) -> F64:
        """(N, 2) pixels of (N, 3) world points [m]; NaN behind the camera."""
        p = (points_world - self._pose.translation) @ self._pose.rotation
        depth = np.where(p[:, 2] > 1e-6, p[:, 2], np.nan)
        g = self._geometry
        return np.column_stack([g.focal_u_px * p[:, 0] / depth + g.cu_px, g.focal_v_px * p[:, 1] / depth + g.cv_px])

    def back_project(self, pixels: F64) -> F64:
        """(N, 2) places on the floor [m] that (N, 2) pixels show; NaN above the horizon."""
        g = self._geometry
        u, v = (pixels[:, 0] - g.cu_px) / g.focal_u_px, (pixels[:, 1] - g.cv_px) / g.focal_v_px
        rays = np.column_stack([u, v, np.ones_like(u)]) @ self._pose.rotation.T
        down = np.where(rays[:, 2] < -1e-9, -rays[:, 2], np.nan)
        reach = self._pose.translation[2] / down
        return np.asarray(self._pose.translation[:2] + reach[:, None] * rays[:, :2])
