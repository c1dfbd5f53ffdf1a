"""A colour camera and a depth sensor that look the same way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.camera import Camera
from calib.pose import SE3

DepthSensor = Literal["structured-light", "time-of-flight", "stereo"]
"""How a depth camera measures, which decides how its noise grows with depth."""

IDENTITY = SE3(np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class RgbdRig:
    """Calibration of images with depth.

    Attributes:
        camera: of the image.
        depth_camera: of the depth; None where depth lies in the image's own pixel grid (registered).
        camera_SE3_depth: maps the depth camera's coordinates to those of the image's camera [m].
        units_per_m: depth values per metre; None when the file does not say.
        sensor: how depth is measured; None when the file does not say.
        source: where it came from, for messages and run.json.
    """

    camera: Camera
    depth_camera: Camera | None = None
    camera_SE3_depth: SE3 = IDENTITY
    units_per_m: float | None = None
    sensor: DepthSensor | None = None
    source: str = ""

    def scaled(self, size: tuple[int, int], depth_size: tuple[int, int]) -> RgbdRig:
        """The same rig for images and depth of other resolutions of the same fields of view."""
        depth = self.depth_camera and self.depth_camera.scaled(*depth_size)
        return replace(self, camera=self.camera.scaled(*size), depth_camera=depth)
