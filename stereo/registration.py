"""Depth moved from the depth sensor's frame into the image's camera."""

from __future__ import annotations

import numpy as np

from calib.rgbd import RgbdRig
from calib.types import F32, F64
from stereo._kernels import register_depth
from stereo.view import source_pixels

MARGIN = 0.25
"""A lens shows as much more than its own pinhole to each side [of the image size]; farther rays are left out."""


class DepthRegistration:
    """Depth in the pixels of the image; of surfaces that fall on one pixel the nearest counts."""

    def __init__(self, rig: RgbdRig) -> None:
        """Prepare; a rig whose depth is registered already gives depth back as it is."""
        self._rig = rig
        depth, image = rig.depth_camera, rig.camera
        if depth is None:
            return
        columns, rows = np.meshgrid(np.arange(depth.width), np.arange(depth.height))
        rays = depth.unproject(np.column_stack([columns.ravel(), rows.ravel()])) @ rig.camera_SE3_depth.rotation.T
        self._rays = rays.reshape(depth.height, depth.width, 3).astype(np.float32)
        x, y = round(MARGIN * image.width), round(MARGIN * image.height)
        size = image.width + 2 * x, image.height + 2 * y
        pinhole: F64 = image.matrix + np.array([[0, 0, x], [0, 0, y], [0, 0, 0]])
        self._pinhole = pinhole[[0, 1, 0, 1], [0, 1, 2, 2]]
        self._distorted = source_pixels(image, np.eye(3), np.asarray(np.linalg.inv(pinhole), dtype=np.float64), size)
        # Depth of fewer pixels per degree leaves no holes; a quarter more bridges turns and lenses.
        self._half_px = max(0.5, 0.625 * max(image.fx / depth.fx, image.fy / depth.fy))

    def __call__(self, depth_m: F32) -> F32:
        """(H, W) float32 [m] along the image's optical axis, NaN where unknown.

        Args:
            depth_m: (h, w) float32 [m] as measured, NaN (or 0) where unknown.
        Raises:
            ValueError: depth of another size than the calibration's.
        """
        image, depth = self._rig.camera, self._rig.depth_camera or self._rig.camera
        if depth_m.shape != (depth.height, depth.width):
            raise ValueError(f"expected depth of {(depth.height, depth.width)}, got {depth_m.shape}")
        if self._rig.depth_camera is None:
            return depth_m
        nearest = np.empty((image.height, image.width), dtype=np.float32)
        shift = self._rig.camera_SE3_depth.translation
        register_depth(depth_m, self._rays, shift, self._pinhole, self._distorted, self._half_px, nearest)
        return nearest
