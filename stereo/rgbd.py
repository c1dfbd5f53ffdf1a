"""Images with depth, made ready as a rectified pair is: registered, without distortion, and as disparity.

Every stage after matching works in disparity, d = f b / z, whose noise does not depend on depth where depth is
triangulated. The depth of a sensor is taken there by the baseline that a pair with the sensor's own noise would have:
a deviation of depth k z^2 is the deviation ``DISPARITY_STD_PX`` of the disparity at b = DISPARITY_STD_PX / (f k).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib.camera import Camera
from calib.kernels import kernel
from calib.rig import DepthTechnology, RgbdRig
from calib.types import F32, F64, U8
from stereo.depth import DISPARITY_STD_PX, RectifiedGeometry
from stereo.matcher import DISPARITY_STEP, DisparityRange
from stereo.rectify import RectifyParams, Warp, ideal_pinhole, source_pixels


def pixel_rays(camera: Camera) -> F64:
    """(H, W, 3) float64 ray of every pixel of a camera, at unit depth."""
    rows, columns = np.indices(camera.size[::-1])
    rays = camera.unproject(np.column_stack([columns.ravel(), rows.ravel()]))
    return rays.reshape(*rows.shape, 3)


class DepthRegistration:
    """Depth in the pixels of the image; of surfaces that fall on one pixel the nearest counts."""

    def __init__(self, rig: RgbdRig) -> None:
        """Prepare; a rig whose depth is registered already gives depth back as it is."""
        self._rig = rig
        depth = rig.depth_camera
        image = rig.camera
        if depth is None:
            return
        rays = pixel_rays(depth)
        turned = rays.reshape(-1, 3) @ rig.camera_SE3_depth.rotation.T
        self._rays = turned.reshape(rays.shape).astype(np.float32)
        # A lens shows as much more than its own pinhole to each side; farther rays are left out.
        x = round(0.25 * image.width)
        y = round(0.25 * image.height)
        size = image.width + 2 * x, image.height + 2 * y
        pinhole: F64 = image.matrix + np.array([[0, 0, x], [0, 0, y], [0, 0, 0]])
        self._pinhole = pinhole[[0, 1, 0, 1], [0, 1, 2, 2]]
        to_ray = np.asarray(np.linalg.inv(pinhole))
        self._distorted = source_pixels(image, np.eye(3), to_ray, size)
        # Depth of fewer pixels per degree leaves no holes; a quarter more bridges turns and lenses.
        self._half_px = max(0.5, 0.625 * max(image.fx / depth.fx, image.fy / depth.fy))

    def __call__(self, depth_m: F32) -> F32:
        """(H, W) float32 [m] along the image's optical axis, NaN where unknown, of (h, w) float32 [m] as measured, NaN
        (or 0) where unknown. Raises ValueError: depth of another size than the calibration's."""
        image = self._rig.camera
        depth = self._rig.depth_camera or self._rig.camera
        if depth_m.shape != (depth.height, depth.width):
            raise ValueError(f"expected depth of {(depth.height, depth.width)}, got {depth_m.shape}")
        if self._rig.depth_camera is None:
            return depth_m
        nearest = np.empty((image.height, image.width), dtype=np.float32)
        shift = self._rig.camera_SE3_depth.translation
        register_depth(depth_m, self._rays, shift, self._pinhole, self._distorted, self._half_px, nearest)
        return nearest


@kernel
def register_depth(
    depth: F32, rays: F32, shift: F64, pinhole: F64, distorted: F32, half_px: float, nearest: F32
) -> None:
    """Depth of one camera as another sees it: the nearest surface of each of its pixels.

    ``rays`` (h, w, 3) is the ray of each depth pixel at unit depth, turned into the other camera's frame; ``shift`` its
    translation there; ``pinhole`` (fu, fv, cu, cv) of the other camera without distortion, ``distorted`` (H', W', 2)
    the recorded pixel of each of the pinhole's, NaN where there is none. A point fills the pixels within ``half_px`` of
    its own. Fills ``nearest`` (H, W), NaN where no point falls.
    """
    nearest[:] = np.inf
    rows, cols = nearest.shape
    table_rows = distorted.shape[0] - 1
    table_cols = distorted.shape[1] - 1
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            d = depth[row, col]
            z = d * rays[row, col, 2] + shift[2]
            if not (d > 0.0 and z > 0.0):
                continue
            u = pinhole[0] * (d * rays[row, col, 0] + shift[0]) / z + pinhole[2]
            v = pinhole[1] * (d * rays[row, col, 1] + shift[1]) / z + pinhole[3]
            if not (u >= 0.0 and v >= 0.0 and u < table_cols and v < table_rows):
                continue
            i = int(v)
            j = int(u)
            a = v - i
            b = u - j
            x = (1.0 - a) * ((1.0 - b) * distorted[i, j, 0] + b * distorted[i, j + 1, 0])
            x += a * ((1.0 - b) * distorted[i + 1, j, 0] + b * distorted[i + 1, j + 1, 0])
            y = (1.0 - a) * ((1.0 - b) * distorted[i, j, 1] + b * distorted[i, j + 1, 1])
            y += a * ((1.0 - b) * distorted[i + 1, j, 1] + b * distorted[i + 1, j + 1, 1])
            if not (x > -half_px - 1.0 and y > -half_px - 1.0 and x < cols + half_px and y < rows + half_px):
                continue
            for r in range(max(0, math.ceil(y - half_px)), min(rows, math.ceil(y + half_px))):
                for c in range(max(0, math.ceil(x - half_px)), min(cols, math.ceil(x + half_px))):
                    nearest[r, c] = min(nearest[r, c], np.float32(z))
    for row in range(rows):
        for col in range(cols):
            if nearest[row, col] == np.inf:
                nearest[row, col] = np.nan


NOISE: dict[DepthTechnology, tuple[float, float]] = {
    "structured-light": (1.425e-3, 0.0), "time-of-flight": (5e-4, 0.005), "stereo": (4.7e-3, 0.0),
}  # fmt: skip
"""Standard deviation of a measured depth z: growth with squared depth [1/m], and what is left however near [m].

Structured light: Khoshelham and Elberink 2012 (Sensors 12), eq. 10 with m = 2.85e-5 / cm and half a step of
disparity: 1.3 cm at 3 m, 3.6 cm at 5 m. Time of flight: Fankhauser et al. 2015 (Kinect v2 for mobile robot navigation)
measured 1.3 mm at 1 m and 4.3 mm at 4 m on flat targets; that growth, with 5 mm of multipath and motion.
Stereo: sigma_d / (f b) of an active stereo camera, 0.1 px of 848 over 5 cm (after RealSense D435)."""


class RgbdRectifier:
    """Takes the lens distortion out of images of a camera with depth; their orientation stays.

    Attributes:
        geometry: the pinhole, with the baseline of a pair that has the sensor's noise.
        mask: (H, W) uint8, 255 where the image shows something.
    """

    def __init__(self, camera: Camera, technology: DepthTechnology, params: RectifyParams | None = None) -> None:
        self.camera = camera
        p = params or RectifyParams()
        pinhole = ideal_pinhole(camera, np.eye(3), p.working_px, p.field_quantile, 1.0)
        per_m2, min_m = NOISE[technology]
        baseline_m = DISPARITY_STD_PX / (pinhole.focal_u_px * per_m2)
        self.geometry: RectifiedGeometry = replace(pinhole, baseline_m=baseline_m, depth_std_min_m=min_m)
        self._warp = Warp(camera, np.eye(3), pinhole.pixel_to_ray, pinhole.size, p.working_px)
        self.mask = self._warp.mask

    def __call__(self, image: U8, depth_m: F32) -> tuple[U8, F32]:
        """An image, (H, W) or (H, W, 3) uint8, and its (H, W) float32 depth [m] without distortion; NaN where unknown.
        Raises ValueError: an image or a depth of another size than the camera's."""
        size = self.camera.size[::-1]
        if image.shape[:2] != size or depth_m.shape != size:
            raise ValueError(f"expected image and depth of {size}, got {image.shape} and {depth_m.shape}")
        return self._warp(image), self._warp.nearest(depth_m)

    def disparity(self, depth_m: F32) -> F32:
        """(H, W) float32 equivalent disparity [px] of depth [m], NaN where it is unknown."""
        return np.asarray(np.float32(self.geometry.disparity_metre) / depth_m, dtype=np.float32)

    def disparities(self) -> DisparityRange:
        """Equivalent disparities from infinity to 0.4 m: no depth sensor for rooms measures nearer."""
        return DisparityRange(0, DISPARITY_STEP * int(np.ceil(self.geometry.disparity_at(0.4) / DISPARITY_STEP)))
