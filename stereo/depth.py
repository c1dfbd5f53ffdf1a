"""Metres from disparity, and how far they may be off."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64


@dataclass(frozen=True)
class RectifiedGeometry:
    """Pinhole geometry of a rectified pair: no distortion, rows aligned, disparity 0 at infinity.

    Attributes:
        width, height: image size [px].
        fu, fv: focal lengths [px].
        cx, cy: principal point of both images [px]; pixel (0, 0) is the centre of the top-left pixel.
        baseline_m: distance between the cameras along x [m].
    """

    width: int
    height: int
    fu: float
    fv: float
    cx: float
    cy: float
    baseline_m: float

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px], as OpenCV takes it."""
        return self.width, self.height

    @property
    def focal_px(self) -> float:
        """Focal length along the rows, the one that turns disparity into depth [px]."""
        return self.fu

    @property
    def matrix(self) -> F64:
        """(3, 3) camera matrix K [px]."""
        return np.array([[self.fu, 0.0, self.cx], [0.0, self.fv, self.cy], [0.0, 0.0, 1.0]])

    @property
    def disparity_metre(self) -> float:
        """Disparity of a point one metre away, f b [px m]; depth is this divided by disparity."""
        return self.fu * self.baseline_m


class DepthParams(Params):
    """Depth from disparity."""

    disparity_std_px: float = Field(0.25, gt=0.0, le=5.0)
    """Standard deviation of a disparity [px]. SGBM's parabola fit is biased towards whole pixels by up to about
    0.15 px and sensor noise adds 0.1-0.2 px on weak texture (our measurements on rendered scenes)."""
    depth_max_m: float = Field(30.0, gt=0.5, le=200.0)
    """Farther points are left out [m]: their predicted deviation exceeds any room (our choice)."""


class DepthFromDisparity:
    """Depth, its predicted deviation and points, all in the rectified left camera."""

    def __init__(self, geometry: RectifiedGeometry, params: DepthParams | None = None) -> None:
        self.geometry = geometry
        self.params = params or DepthParams()
        self._disparity_min = geometry.disparity_metre / self.params.depth_max_m

    def __call__(self, disparity: F32) -> F32:
        """Depth along the optical axis.

        Args:
            disparity: (H, W) float32 [px], NaN invalid.
        Returns:
            (H, W) float32 [m]; NaN where the disparity is NaN, not positive, or means more than depth_max_m.
        """
        usable = np.where(disparity >= self._disparity_min, disparity, np.float32(np.nan))
        return np.divide(np.float32(self.geometry.disparity_metre), usable, dtype=np.float32)

    def deviation(self, depth: F32) -> F32:
        """Predicted standard deviation of depths, sigma_z = z^2 / (f b) sigma_d.

        Args:
            depth: any shape, float32 [m].
        Returns:
            same shape, float32 [m].
        """
        scale = np.float32(self.params.disparity_std_px / self.geometry.disparity_metre)
        return np.asarray(depth * depth * scale, dtype=np.float32)


def back_project(depth: F32, geometry: RectifiedGeometry) -> F32:
    """Points of a depth image.

    Args:
        depth: (H, W) float32 [m], NaN invalid.
    Returns:
        (H, W, 3) float32 [m], rectified left camera frame; NaN where the depth is.
    """
    rows, cols = depth.shape
    x = ((np.arange(cols) - geometry.cx) / geometry.fu).astype(np.float32)
    y = ((np.arange(rows) - geometry.cy) / geometry.fv).astype(np.float32)
    points = cv2.merge([depth * x[None, :], depth * y[:, None], depth])
    return np.asarray(points, dtype=np.float32)
