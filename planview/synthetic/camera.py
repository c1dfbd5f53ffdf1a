"""Cameras of a scene: where they are, their true calibration, a ray per pixel and the projection back."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import NamedTuple

import cv2
import numpy as np

from calib.camera import Camera
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.rig import StereoRig, world_from_plane
from calib.types import F32, F64
from planview.synthetic.scene import CameraMount, Mount, Rig


@dataclass(frozen=True, eq=False)
class CameraView:
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
        """(H * W, 6) origin and direction in the room of every pixel centre. Directions have unit camera z, so that the
        ray parameter of a hit is its depth."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
        directions = np.nan_to_num(self.unproject(pixels), nan=0.0) @ self.room_SE3_camera.rotation.T
        origins = np.broadcast_to(self.room_SE3_camera.translation, directions.shape)
        return np.concatenate([origins, directions], axis=1).astype(np.float32)

    def ray_steps(self, rays: F32) -> tuple[F32, F32]:
        """Changes of the rays (H * W, 6) per pixel to the right and down."""
        grid = rays.reshape(self.height, self.width, 6)
        return (
            np.asarray(np.gradient(grid, axis=1)).reshape(-1, 6).astype(np.float32),
            np.asarray(np.gradient(grid, axis=0)).reshape(-1, 6).astype(np.float32),
        )


def camera_view(camera: Camera, room_SE3_camera: SE3) -> CameraView:
    return CameraView(camera.width, camera.height, camera.fx, room_SE3_camera, camera.project, camera.unproject)


def ground_view(camera: GroundCamera, room_SE3_world: SE3) -> CameraView:
    """A view through the four-parameter camera, whose world frame is placed in the room."""
    cosine = np.cos(camera.tilt_rad)
    sine = np.sin(camera.tilt_rad)
    # Columns: camera x right, y down, z forward in the world of the camera.
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -cosine, sine], [0.0, -sine, -cosine]])
    world_SE3_camera = SE3(rotation, np.array([0.0, 0.0, camera.height_m]))

    def project(points: F64) -> F64:
        return camera.project(world_SE3_camera @ points)

    def unproject(pixels: F64) -> F64:
        return np.asarray(camera.rays(pixels) @ rotation / camera.focal_px)

    pose = room_SE3_world @ world_SE3_camera
    return CameraView(camera.width, camera.height, camera.focal_px, pose, project, unproject)


def mount_pose(mount: Mount) -> SE3:
    """room_SE3_camera of a mount: x right, y down, z forward."""
    heading = math.radians(mount.heading_deg)
    tilt = math.radians(mount.tilt_deg)
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = math.sin(tilt) * ahead - math.cos(tilt) * up
    right = np.cross(ahead, up)
    down = np.cross(forward, right)
    rotation = np.column_stack([right, down, forward])
    roll, _ = cv2.Rodrigues(np.array([0.0, 0.0, math.radians(mount.roll_deg)]))
    return SE3(rotation @ roll, np.array(mount.at_m))


def stereo_rig(mount: Rig) -> StereoRig:
    """The rig's true calibration."""
    off_x, off_y = mount.centre_offset_px
    centre_x = (mount.width - 1) / 2
    centre_y = (mount.height - 1) / 2
    left = Camera(
        mount.width,
        mount.height,
        mount.focal_px,
        mount.focal_px * mount.aspect,
        centre_x + off_x,
        centre_y + off_y,
        distortion=tuple(mount.distortion),
    )
    right_distortion = tuple(0.97 * coefficient for coefficient in mount.distortion)
    right = replace(left, cx=centre_x - off_x, cy=centre_y - off_y, distortion=right_distortion)
    left_SE3_right = SE3.from_rotvec(np.deg2rad(mount.right_rotation_deg), [mount.baseline_m, *mount.right_offset_m])
    return StereoRig(left, right, left_SE3_right.inverse(), "rendered")


def ground_camera(mount: CameraMount) -> GroundCamera:
    """The single camera's true calibration."""
    return GroundCamera(
        mount.width, mount.height, mount.focal_px, mount.at_m[2], math.radians(mount.tilt_deg), mount.lens
    )


def rectified_world(rig: StereoRig, room_SE3_left: SE3) -> tuple[SE3, SE3]:
    """world_SE3_rectified of the left camera, and world_SE3_room."""
    rectified_SE3_room = SE3(rig.rectifying_rotations()[0], np.zeros(3)) @ room_SE3_left.inverse()
    normal = rectified_SE3_room.rotation @ np.array([0.0, 0.0, 1.0])
    world_SE3_rectified = world_from_plane(normal, float(room_SE3_left.translation[2]))
    return world_SE3_rectified, world_SE3_rectified @ rectified_SE3_room


class PlacedCameras(NamedTuple):
    """The cameras of a mount in a room.

    Attributes:
        rig, ground_camera: the true pair, or the true single camera; the other is None.
        world_SE3_room: canonical world of the rectified left camera (or of the single camera).
        world_SE3_left: placement of the rectified left camera in that world, None for a single camera.
    """

    views: Sequence[CameraView]
    world_SE3_room: SE3
    rig: StereoRig | None = None
    ground_camera: GroundCamera | None = None
    world_SE3_left: SE3 | None = None


@singledispatch
def placed_cameras(mount: Mount, scale: float) -> PlacedCameras:
    """The cameras of a pair or of a single one, with images of so many times the size."""
    raise TypeError(type(mount))


@placed_cameras.register
def _placed_pair(mount: Rig, scale: float) -> PlacedCameras:
    rig = stereo_rig(mount).scaled(*_size(mount, scale))
    room_SE3_left = mount_pose(mount)
    world_SE3_left, world_SE3_room = rectified_world(rig, room_SE3_left)
    right = room_SE3_left @ rig.right_SE3_left.inverse()
    views = camera_view(rig.left, room_SE3_left), camera_view(rig.right, right)
    return PlacedCameras(views, world_SE3_room, rig=rig, world_SE3_left=world_SE3_left)


@placed_cameras.register
def _placed_camera(mount: CameraMount, scale: float) -> PlacedCameras:
    camera = ground_camera(mount).scaled(*_size(mount, scale))
    heading = math.radians(mount.heading_deg) - math.pi / 2
    turn = SE3.from_rotvec([0.0, 0.0, heading], [mount.at_m[0], mount.at_m[1], 0.0])
    return PlacedCameras([ground_view(camera, turn)], turn.inverse(), ground_camera=camera)


def _size(mount: Mount, scale: float) -> tuple[int, int]:
    return max(8, round(mount.width * scale)), max(8, round(mount.height * scale))
