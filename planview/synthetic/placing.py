"""Cameras of a scene: where they are, and their true calibration."""

from __future__ import annotations

import math

import cv2
import numpy as np

from calib.camera import Camera
from calib.ground_camera import GroundCamera
from calib.pose import SE3
from calib.rig import StereoRig, world_from_plane
from planview.synthetic.scene import CameraMount, Mount, Rig


def mount_pose(mount: Mount) -> SE3:
    """room_SE3_camera of a mount: x right, y down, z forward."""
    a, b = math.radians(mount.heading_deg), math.radians(mount.tilt_deg)
    ahead = np.array([math.cos(a), math.sin(a), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = math.sin(b) * ahead - math.cos(b) * up
    right = np.cross(ahead, up)
    down = np.cross(forward, right)
    rotation = np.column_stack([right, down, forward])
    roll, _ = cv2.Rodrigues(np.array([0.0, 0.0, math.radians(mount.roll_deg)]))
    return SE3(rotation @ roll, np.array(mount.at_m))


def stereo_rig(mount: Rig) -> StereoRig:
    """The rig's true calibration."""
    cx, cy = (mount.width - 1) / 2, (mount.height - 1) / 2
    ox, oy = mount.centre_offset_px
    k = tuple(mount.distortion)
    fx, fy = mount.focal_px, mount.focal_px * mount.aspect
    left = Camera(mount.width, mount.height, fx, fy, cx + ox, cy + oy, "brown", k)
    right = Camera(mount.width, mount.height, fx, fy, cx - ox, cy - oy, "brown", tuple(0.97 * c for c in k))
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
