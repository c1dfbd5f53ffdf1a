"""An engine's camera and floor in figures, for run.json and pictures."""

from __future__ import annotations

import math

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.maps.view import StereoView
from planview.pipeline.info import CameraInfo, FloorInfo
from stereo.floor_camera import StereoFloorCamera

VIEW_DISTANCE_M = 15.0
"""The outline of the view on the floor ends here [m]."""


def stereo_camera_info(view: StereoView) -> CameraInfo:
    """The rectified left camera, or that of images with depth."""
    geometry, residual_px = view.geometry, view.vertical_residual_px
    on_floor = view.camera.back_project(_border(*geometry.size))
    return CameraInfo(
        width=geometry.width,
        height=geometry.height,
        focal_px=geometry.focal_u_px,
        baseline_m=geometry.baseline_m if view.sensor is None else None,
        depth_sensor=view.sensor,
        calibration=view.calibration or None,
        vertical_residual_px=None if math.isnan(residual_px) else residual_px,
        view_m=_outline(on_floor, view.floor.world_SE3_left.translation[:2]),
    )


def stereo_floor_info(view: StereoView) -> FloorInfo:
    """The floor below a stereo pair."""
    floor = view.floor
    known = not math.isnan(floor.inlier_fraction)
    return FloorInfo(
        height_m=floor.height_m,
        tilt_deg=math.degrees(floor.tilt_rad),
        roll_deg=math.degrees(floor.roll_rad),
        inlier_fraction=floor.inlier_fraction if known else None,
        residual_m=floor.residual_m if known else None,
        world_SE3_left=floor.world_SE3_left.matrix.tolist(),
        source=view.floor_source,
    )


class StereoDescription:
    """What an ``Engine`` tells about its rectified pair."""

    stereo: StereoView

    @property
    def camera(self) -> StereoFloorCamera:
        """The rectified left camera above the floor."""
        return self.stereo.camera

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the rectified images [px]."""
        return self.stereo.geometry.size

    def camera_info(self) -> CameraInfo:
        """See ``Engine``."""
        return stereo_camera_info(self.stereo)

    def floor_info(self) -> FloorInfo:
        """See ``Engine``."""
        return stereo_floor_info(self.stereo)


def ground_camera_info(camera: GroundCamera) -> CameraInfo:
    """A single camera."""
    return CameraInfo(
        width=camera.width,
        height=camera.height,
        focal_px=camera.focal_px,
        view_m=_outline(camera.back_project(_border(camera.width, camera.height)), np.zeros(2)),
    )


def ground_floor_info(camera: GroundCamera) -> FloorInfo:
    """The floor below a single camera."""
    tilt_deg, roll_deg = math.degrees(camera.tilt_rad), math.degrees(camera.roll_rad)
    return FloorInfo(height_m=camera.height_m, tilt_deg=tilt_deg, roll_deg=roll_deg, source="camera.toml")


def _border(width: int, height: int, samples: int = 16) -> F64:
    """(N, 2) pixels once around the image."""
    t = np.linspace(0.0, 1.0, samples, endpoint=False)
    w, h = width - 1, height - 1
    zeros = np.zeros(samples)
    sides = [(t * w, zeros), (zeros + w, t * h), (w - t * w, zeros + h), (zeros, h - t * h)]
    return np.concatenate([np.column_stack(side) for side in sides])


def _outline(floor_m: F64, camera_m: F64) -> list[tuple[float, float]]:
    """Floor points around the view; what lies beyond the horizon or VIEW_DISTANCE_M is left out."""
    inside = np.isfinite(floor_m).all(axis=1)
    inside &= np.hypot(*(np.nan_to_num(floor_m) - camera_m).T) <= VIEW_DISTANCE_M
    return [(float(x), float(y)) for x, y in floor_m[inside]]
