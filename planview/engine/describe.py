"""An engine's camera and floor in figures, for run.json and pictures."""

from __future__ import annotations

import math

import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F64
from planview.engine.info import CameraInfo, FloorInfo
from planview.maps.view import StereoView
from stereo.depth import StereoFloorCamera

VIEW_DISTANCE_M = 15.0
"""The outline of a stereo camera's view on the floor ends here [m]: depth is too coarse beyond (our choice)."""
PERSON_PX = 20.0
"""That of a single camera ends where a person of 1.7 m is so high in the image [px] (our choice)."""


def stereo_camera_info(view: StereoView) -> CameraInfo:
    """The rectified left camera, or that of images with depth."""
    geometry, residual_px = view.geometry, view.vertical_residual_px
    pose = view.floor.world_SE3_left
    rays = geometry.rays(_border(*geometry.size)) @ pose.rotation.T
    return CameraInfo(
        width=geometry.width,
        height=geometry.height,
        focal_px=geometry.focal_u_px,
        baseline_m=geometry.baseline_m if view.sensor is None else None,
        depth_sensor=view.sensor,
        calibration=view.calibration or None,
        correction=view.correction or None,
        vertical_residual_px=None if math.isnan(residual_px) else residual_px,
        view_m=_outline(rays, pose.translation, VIEW_DISTANCE_M),
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
        lens=camera.lens,
        view_m=_outline(
            camera.rays(_border(camera.width, camera.height)),
            np.array([0.0, 0.0, camera.height_m]),
            max(VIEW_DISTANCE_M, 1.7 * camera.focal_px / PERSON_PX),
        ),
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


def _outline(rays: F64, camera_m: F64, reach_m: float) -> list[tuple[float, float]]:
    """Floor points around the view: where the rays of the border meet the floor, at most ``reach_m`` away.

    A ray that meets it beyond, or points above the horizon, stands for the floor in its direction.

    Args:
        rays: (N, 3) directions once around the image, world frame.
        camera_m: (3,) place of the camera [m].
    """
    across = np.hypot(rays[:, 0], rays[:, 1])
    down = np.maximum(-rays[:, 2], 1e-12)
    reach = np.where(rays[:, 2] < 0, np.minimum(camera_m[2] * across / down, reach_m), reach_m)
    places = camera_m[:2] + rays[:, :2] * (reach / np.maximum(across, 1e-12))[:, None]
    return [(float(x), float(y)) for x, y in places]
