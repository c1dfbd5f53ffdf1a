"""What a rendered camera sees: a ray per pixel, and the projection back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.camera import Camera
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.types import F32, F64


@dataclass(frozen=True, eq=False)
class View:
    """A placed camera.

    Attributes:
        width, height: image size [px].
        focal_px: for sizes of pixels on surfaces.
        room_SE3_camera: where it is.
        project: (N, 3) camera frame [m] -> (N, 2) pixels, NaN behind the camera.
        unproject: (N, 2) pixels -> (N, 3) rays with unit z; NaN where no ray belongs to a pixel.
    """

    width: int
    height: int
    focal_px: float
    room_SE3_camera: SE3
    project: Callable[[F64], F64]
    unproject: Callable[[F64], F64]

    def rays(self) -> F32:
        """(H * W, 6) origin and direction in the room of every pixel centre.

        Directions have unit camera z, so that the ray parameter of a hit is its depth.
        """
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
        directions = np.nan_to_num(self.unproject(pixels), nan=0.0) @ self.room_SE3_camera.rotation.T
        origins = np.broadcast_to(self.room_SE3_camera.translation, directions.shape)
        return np.concatenate([origins, directions], axis=1).astype(np.float32)

    def ray_steps(self, rays: F32) -> tuple[F32, F32]:
        """How the rays (H * W, 6) change per pixel to the right and down."""
        grid = rays.reshape(self.height, self.width, 6)
        return (
            np.asarray(np.gradient(grid, axis=1)).reshape(-1, 6).astype(np.float32),
            np.asarray(np.gradient(grid, axis=0)).reshape(-1, 6).astype(np.float32),
        )

    def project_room(self, points: F64) -> F64:
        """(N, 2) pixels of room points (N, 3)."""
        return self.project(self.room_SE3_camera.inverse() @ points)


def camera_view(camera: Camera, room_SE3_camera: SE3) -> View:
    return View(camera.width, camera.height, camera.fx, room_SE3_camera, camera.project, camera.unproject)


def ground_view(camera: GroundCamera, room_SE3_world: SE3) -> View:
    """A view through the four-parameter camera, whose world frame is placed in the room."""
    c, s = np.cos(camera.tilt_rad), np.sin(camera.tilt_rad)
    # Columns: camera x right, y down, z forward in the world of the camera.
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -c, s], [0.0, -s, -c]])
    world_SE3_camera = SE3(rotation, np.array([0.0, 0.0, camera.height_m]))

    def project(points: F64) -> F64:
        return camera.project(world_SE3_camera @ points)

    def unproject(pixels: F64) -> F64:
        centre = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
        xy = np.asarray(pixels, np.float64) - centre
        radius, k = np.hypot(xy[:, 0], xy[:, 1]), camera.distortion_k
        inside = 1.0 + 4.0 * k * radius
        scale = np.where(inside >= 0, 2.0 / (1.0 + np.sqrt(np.maximum(inside, 0.0))), np.nan)
        return np.column_stack([xy * scale[:, None] / camera.focal_px, np.ones(len(xy))])

    return View(camera.width, camera.height, camera.focal_px, room_SE3_world @ world_SE3_camera, project, unproject)
