"""A camera above a floor: what the rest of the house asks of it, and the ideal pinhole."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from calib.pose import SE3
from calib.types import F64


class FloorCamera(Protocol):
    """Places in a world whose floor is at Z = 0 [m] to pixels and back; pixel (0, 0) is the centre of the top-left one.

    Attributes:
        size: (width, height) of the image [px].
        centre_m: (3,) float64, the camera's centre [m].
        projection: (3, 4) float64, world points to homogeneous pixels as a pinhole shows them.
        distortion_k: K of r' = r + K r^2 from those to the pixels of the image [1/px].
        pixel_sr: 1 / (fu fv), area of the surface that a pixel shows over squared depth.
    """

    @property
    def size(self) -> tuple[int, int]: ...

    @property
    def centre_m(self) -> F64: ...

    @property
    def projection(self) -> F64: ...

    @property
    def distortion_k(self) -> float: ...

    @property
    def pixel_sr(self) -> float: ...

    def rays(self, pixels: ArrayLike) -> F64:
        """(..., 3) directions in the world of (..., 2) pixels, of one depth along the optical axis; NaN where a pixel
        shows nothing."""

    def project(self, points_world: ArrayLike) -> F64:
        """(..., 2) pixels of (..., 3) world points [m]; NaN behind the camera."""

    def back_project(self, pixels: ArrayLike) -> F64:
        """(..., 2) places on the floor [m] that (..., 2) pixels show; NaN above the horizon."""


@dataclass(frozen=True, eq=False)
class FloorPinhole:
    """A pinhole without distortion above the floor, as rectified images have it: a ``FloorCamera``.

    Attributes:
        size: see ``FloorCamera``.
        matrix: (3, 3) float64 camera matrix K [px].
        world_SE3_camera: its pose.
    """

    size: tuple[int, int]
    matrix: F64
    world_SE3_camera: SE3
    distortion_k = 0.0

    @property
    def centre_m(self) -> F64:
        """See ``FloorCamera``."""
        return self.world_SE3_camera.translation

    @property
    def pixel_sr(self) -> float:
        """See ``FloorCamera``."""
        return float(1.0 / (self.matrix[0, 0] * self.matrix[1, 1]))

    @cached_property
    def projection(self) -> F64:
        """See ``FloorCamera``."""
        return np.asarray(self.matrix @ self.world_SE3_camera.inverse().matrix[:3])

    def rays(self, pixels: ArrayLike) -> F64:
        """See ``FloorCamera``; of unit depth."""
        p = np.asarray(pixels, dtype=np.float64)
        k = self.matrix
        u = (p[..., 0] - k[0, 2]) / k[0, 0]
        v = (p[..., 1] - k[1, 2]) / k[1, 1]
        return np.stack([u, v, np.ones_like(u)], axis=-1) @ self.world_SE3_camera.rotation.T

    def project(self, points_world: ArrayLike) -> F64:
        """See ``FloorCamera``."""
        points = np.asarray(points_world, dtype=np.float64)
        k = self.matrix
        p = (points - self.world_SE3_camera.translation) @ self.world_SE3_camera.rotation
        z = np.where(p[..., 2] > 1e-6, p[..., 2], np.nan)
        return np.stack([k[0, 0] * p[..., 0] / z + k[0, 2], k[1, 1] * p[..., 1] / z + k[1, 2]], axis=-1)

    def back_project(self, pixels: ArrayLike) -> F64:
        """See ``FloorCamera``."""
        rays = self.rays(pixels)
        centre = self.world_SE3_camera.translation
        down = np.where(rays[..., 2] < -1e-9, -rays[..., 2], np.nan)
        return np.asarray(centre[:2] + rays[..., :2] * (centre[2] / down)[..., None])
