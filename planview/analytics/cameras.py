"""Cameras whose pixels rules may be given in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.floor.world_file import load_world
from calib.formats import load_rig
from calib.pose import SE3
from calib.types import F64
from planview.analytics.geometry import RulePlane
from stereo.depth import RectifiedGeometry
from stereo.rectify import RectifyParams
from stereo.view import common_geometry


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


def stereo_plane(rig_path: Path, world_path: Path | None = None) -> RulePlane:
    """The plane of a rig: its calibration, and world.toml beside it unless given.

    Raises:
        InputError: no rig or no world.toml there.
    """
    rig = load_rig(rig_path)
    folder = rig_path if rig_path.is_dir() else rig_path.parent
    world = world_path or folder / "world.toml"
    if not world.is_file():
        raise InputError(f"{world}: expected the pose of the rig (planview calibrate floor writes it), found no file")
    params = RectifyParams()
    geometry = common_geometry(rig, rig.rectifying_rotations()[0], params.working_px, params.field_quantile)
    return RulePlane(StereoFloorCamera(geometry, load_world(world).world_SE3_left))
