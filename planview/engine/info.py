"""An engine's camera and floor in figures, as ``run.json`` and pictures have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import singledispatch
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from calib.floor_camera import FloorCamera, FloorPinhole
from calib.ground_camera import GroundCamera
from calib.pose import SE3

if TYPE_CHECKING:  # readers of results need none of their kernels
    from planview.maps.grid import FloorRig

VIEW_DISTANCE_M = 15.0
"""The outline of a stereo camera's view on the floor ends here [m]: depth is too coarse beyond (our choice)."""


class InfoPart(BaseModel):
    """Part of run.json."""

    model_config = ConfigDict(extra="ignore", ser_json_inf_nan="null")

    @field_validator("*", mode="before")
    @classmethod
    def _writable(cls, value: object) -> object:
        """Names of files that are not UTF-8 are written out, since JSON cannot hold them."""
        return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


class FloorInfo(InfoPart):
    """The floor that was found, or given by world.toml."""

    height_m: float
    """Height of the left camera above the floor [m]."""
    tilt_deg: float
    """Angle of the optical axis from straight down [degrees]."""
    roll_deg: float
    """Angle of the image's x axis to the floor [degrees]."""
    inlier_fraction: float | None = None
    """Share of the floor's points within tolerance; None when the floor was given."""
    residual_m: float | None = None
    """Root mean square distance of the inliers [m]."""
    world_SE3_left: list[list[float]] | None = None
    """Pose of the rectified left camera, (4, 4), for a stereo recording."""
    source: str = "found"
    """"found" in the recording, or the file that gave it."""


class CameraInfo(InfoPart):
    """The (rectified left) camera, enough to draw its view on the floor."""

    width: int
    height: int
    """Image size [px]."""
    focal_px: float | None = None
    """Along a row; ``focal_v_px`` along a column."""
    focal_v_px: float | None = None
    center_px: tuple[float, float] | None = None
    """Principal point; None for a single camera, whose is the middle of the image."""
    lens: str | None = None
    """Class of lens of a single camera (camera.toml); None for others."""
    baseline_m: float | None = None
    """Between left and right camera; None for one camera."""
    depth_sensor: str | None = None
    """Technology that measured the depth of images with depth; None for others."""
    calibration: str | None = None
    """File or folder the calibration came from."""
    correction: str | None = None
    """Correction of that calibration by the recording, or its uncertainty; None where it was not examined."""
    vertical_residual_px: float | None = None
    """Median row offset that the corrected calibration leaves [px]."""
    view_m: list[tuple[float, float]] = Field(default_factory=list)
    """Outline of the view on the floor, world frame (x, y) [m], when known."""
    name: str = ""
    """Name of a rig among several."""
    at_m: tuple[float, float] = (0.0, 0.0)
    """Place of the camera on the floor, world frame (x, y) [m]."""
    sensors: list[CameraInfo] = Field(default_factory=list)
    """All cameras of a recording with several rigs, the first one included."""


@singledispatch
def camera_info(camera: FloorCamera | None, rigs: Mapping[str, FloorRig]) -> CameraInfo | None:
    """The camera of the first of some rigs by name, with those of all where there are several, or a single camera; None
    for one that is not calibrated."""
    sensors = [_rig_info(rig) for rig in rigs.values()]
    if len(sensors) > 1:
        for sensor, (name, rig) in zip(sensors, rigs.items(), strict=True):
            x_m, y_m, _ = rig.floor.world_SE3_left.translation.tolist()
            sensor.name = name
            sensor.at_m = (x_m, y_m)
        return sensors[0].model_copy(update={"sensors": sensors})
    return sensors[0] if sensors else None


@camera_info.register(GroundCamera)
def _one_camera_info(camera: GroundCamera, _rigs: Mapping[str, FloorRig]) -> CameraInfo:
    return CameraInfo(
        width=camera.width,
        height=camera.height,
        focal_px=camera.focal_px,
        lens=camera.lens,
        correction=camera.std and camera.std.sentence,
        # The view ends where a person of 1.7 m is so high in the image [px] (our choice).
        view_m=_outline(camera, max(VIEW_DISTANCE_M, 1.7 * camera.focal_px / 20.0)),
    )


def _rig_info(rig: FloorRig) -> CameraInfo:
    geometry = rig.geometry
    residual_px = rig.vertical_residual_px
    return CameraInfo(
        width=geometry.width,
        height=geometry.height,
        focal_px=geometry.focal_u_px,
        focal_v_px=geometry.focal_v_px,
        center_px=(geometry.cu_px, geometry.cv_px),
        baseline_m=geometry.baseline_m if rig.technology is None else None,
        depth_sensor=rig.technology,
        calibration=rig.calibration or None,
        correction=rig.correction or None,
        vertical_residual_px=None if math.isnan(residual_px) else residual_px,
        view_m=_outline(rig.camera, VIEW_DISTANCE_M),
    )


@singledispatch
def floor_info(camera: FloorCamera | None, rigs: Mapping[str, FloorRig], source: str) -> FloorInfo | None:
    """The floor below the first of some rigs, or below a single camera of a ``source``; None for one that is not
    calibrated."""
    for rig in rigs.values():
        floor = rig.floor
        known = not math.isnan(floor.inlier_fraction)
        return FloorInfo(
            height_m=floor.height_m,
            tilt_deg=math.degrees(floor.tilt_rad),
            roll_deg=math.degrees(floor.roll_rad),
            inlier_fraction=floor.inlier_fraction if known else None,
            residual_m=floor.residual_m if known else None,
            world_SE3_left=floor.world_SE3_left.matrix.tolist(),
            source=rig.floor_source,
        )
    return None


@floor_info.register(GroundCamera)
def _one_camera_floor_info(camera: GroundCamera, _rigs: Mapping[str, FloorRig], source: str) -> FloorInfo:
    return FloorInfo(
        height_m=camera.height_m,
        tilt_deg=math.degrees(camera.tilt_rad),
        roll_deg=math.degrees(camera.roll_rad),
        source=source,
    )


def camera_of(rig: CameraInfo, floor: FloorInfo) -> FloorCamera | None:
    """The camera that these figures are of; None for one without a focal length. Raises ValueError: figures of none."""
    if rig.focal_px is None:
        return None
    if floor.world_SE3_left is None:
        return GroundCamera(
            rig.width,
            rig.height,
            rig.focal_px,
            floor.height_m,
            math.radians(floor.tilt_deg),
            rig.lens or "pinhole",
            math.radians(floor.roll_deg),
        )
    if rig.center_px is None or rig.focal_v_px is None:
        return None
    (u, v), pose = rig.center_px, SE3.from_matrix(floor.world_SE3_left)
    matrix = np.array([[rig.focal_px, 0.0, u], [0.0, rig.focal_v_px, v], [0.0, 0.0, 1.0]])
    return FloorPinhole((rig.width, rig.height), matrix, pose)


def _outline(camera: FloorCamera, reach_m: float) -> list[tuple[float, float]]:
    """Floor points around the view: where the rays of the border meet the floor, at most ``reach_m`` away.

    A ray that meets it beyond, or points above the horizon, stands for the floor in its direction.
    """
    (w, h), t = (n - 1 for n in camera.size), np.linspace(0.0, 1.0, 16, endpoint=False)
    zeros = 0.0 * t
    sides = [(t * w, zeros), (zeros + w, t * h), (w - t * w, zeros + h), (zeros, h - t * h)]
    rays = camera.rays(np.concatenate([np.column_stack(side) for side in sides]))
    centre = camera.centre_m
    across = np.hypot(rays[:, 0], rays[:, 1])
    down = np.maximum(-rays[:, 2], 1e-12)
    reach = np.where(rays[:, 2] < 0, np.minimum(centre[2] * across / down, reach_m), reach_m)
    places = centre[:2] + rays[:, :2] * (reach / np.maximum(across, 1e-12))[:, None]
    return [(float(x), float(y)) for x, y in places]
