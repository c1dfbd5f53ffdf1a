"""What an engine knows about its camera and floor, for run.json and pictures."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64
from planview.pipeline.factory import Engine
from planview.pipeline.pipeline import Pipeline
from planview.runs.info import CameraInfo, FloorInfo

VIEW_DISTANCE_M = 15.0
"""The outline of the view on the floor ends here [m]."""


def camera_info(engine: Engine) -> CameraInfo | None:
    """The rectified left camera, or the single one; None for one that is not calibrated."""
    if isinstance(engine, Pipeline):
        geometry, vertical = engine.setup.rectifier.geometry, engine.setup.vertical
        return CameraInfo(
            width=geometry.width,
            height=geometry.height,
            focal_px=geometry.focal_u_px,
            baseline_m=geometry.baseline_m,
            calibration=engine.recording.rig.source or None,
            vertical_residual_px=None if math.isnan(vertical.after_px) else vertical.after_px,
            view_m=_stereo_view(engine),
        )
    camera = engine.camera
    if camera is None:
        return None
    return CameraInfo(
        width=camera.width,
        height=camera.height,
        focal_px=camera.focal_px,
        view_m=_outline(camera.back_project(_border(camera.width, camera.height)), np.zeros(2)),
    )


def floor_info(engine: Engine) -> FloorInfo | None:
    """Where the camera is above the floor."""
    if isinstance(engine, Pipeline):
        floor = engine.setup.floor
        known = not math.isnan(floor.inlier_fraction)
        return FloorInfo(
            height_m=floor.height_m,
            tilt_deg=math.degrees(floor.tilt_rad),
            roll_deg=math.degrees(floor.roll_rad),
            inlier_fraction=floor.inlier_fraction if known else None,
            residual_m=floor.residual_m if known else None,
            world_SE3_left=floor.world_SE3_left.matrix.tolist(),
            source=engine.setup.floor_source,
        )
    camera = engine.camera
    if camera is None:
        return None
    tilt_deg, roll_deg = math.degrees(camera.tilt_rad), math.degrees(camera.roll_rad)
    return FloorInfo(height_m=camera.height_m, tilt_deg=tilt_deg, roll_deg=roll_deg, source="camera.toml")


def _stereo_view(engine: Pipeline) -> list[tuple[float, float]]:
    geometry, pose = engine.setup.rectifier.geometry, engine.setup.floor.world_SE3_left
    u, v = _border(geometry.width, geometry.height).T
    rays = np.column_stack(
        [(u - geometry.cu_px) / geometry.focal_u_px, (v - geometry.cv_px) / geometry.focal_v_px, np.ones(len(u))]
    )
    directions = rays @ pose.rotation.T
    reach = np.where(directions[:, 2] < -1e-9, pose.translation[2] / np.maximum(-directions[:, 2], 1e-9), np.nan)
    return _outline(pose.translation[:2] + reach[:, None] * directions[:, :2], pose.translation[:2])


def _border(width: int, height: int, samples: int = 16) -> F64:
    """(N, 2) pixels once around the image."""
    t = np.linspace(0.0, 1.0, samples, endpoint=False)
    w, h = width - 1, height - 1
    zeros = np.zeros(samples)
    sides = [(t * w, zeros), (zeros + w, t * h), (w - t * w, zeros + h), (zeros, h - t * h)]
    return np.concatenate([np.column_stack(side) for side in sides])


def _outline(floor_m: F64, camera_m: F64) -> list[tuple[float, float]]:
    """Floor points around the view; what lies beyond the horizon or VIEW_DISTANCE_M is left out."""
    seen = np.isfinite(floor_m).all(axis=1)
    seen &= np.hypot(*(np.nan_to_num(floor_m) - camera_m).T) <= VIEW_DISTANCE_M
    return [(float(x), float(y)) for x, y in floor_m[seen]]
