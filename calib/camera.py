"""A pinhole camera with Brown, rational or fisheye distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64

LensModel = Literal["brown", "rational", "fisheye"]

_COEFFICIENTS: dict[str, tuple[int, ...]] = {"brown": (0, 4, 5), "rational": (8, 12, 14), "fisheye": (0, 4)}


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera; pixel (0, 0) is the centre of the top-left pixel. Raises ValueError: a size, focal
    length or coefficient that cannot be a camera's.

    Attributes:
        width, height: image size [px].
        fx, fy, cx, cy: focal lengths and principal point [px].
        model: "brown" (k1 k2 p1 p2 k3), "rational" (OpenCV's 8, 12 or 14 coefficients) or
            "fisheye" (equidistant, k1..k4).
        distortion: coefficients in OpenCV's order; empty means none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: LensModel = "brown"
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "distortion", tuple(float(k) for k in self.distortion))
        if self.width < 1 or self.height < 1:
            raise ValueError(f"expected a positive image size, got {self.width}x{self.height}")
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy, *self.distortion]).all():
            raise ValueError("expected finite camera parameters, got NaN or infinity")
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"expected positive focal lengths, got fx={self.fx:g} fy={self.fy:g}")
        if len(self.distortion) not in _COEFFICIENTS[self.model]:
            raise ValueError(
                f"expected {_COEFFICIENTS[self.model]} {self.model} coefficients, got {len(self.distortion)}"
            )

    @property
    def matrix(self) -> F64:
        """(3, 3) camera matrix K [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px], as OpenCV takes it."""
        return self.width, self.height

    @property
    def coefficients(self) -> F64:
        """(n,) float64 distortion coefficients; never empty."""
        return np.array(self.distortion or (0.0,) * 4)

    def project(self, points: ArrayLike) -> F64:
        """(N, 2) float64 pixels of (N, 3) points in the camera frame [m], z forward; a point at z <= 0 gives NaN."""
        p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        pixels = np.full((len(p), 2), np.nan)
        front = p[:, 2] > 0
        zero = np.zeros(3)
        if front.any():
            project = cv2.fisheye.projectPoints if self.model == "fisheye" else cv2.projectPoints
            front_pixels, _ = project(p[front].reshape(-1, 1, 3), zero, zero, self.matrix, self.coefficients)
            pixels[front] = np.asarray(front_pixels, dtype=np.float64).reshape(-1, 2)
        return pixels

    def unproject(self, pixels: ArrayLike) -> F64:
        """(N, 3) float64 rays through (N, 2) pixels in the camera frame, z = 1; NaN where the lens model has none."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        if len(uv) == 0:
            return np.empty((0, 3))
        # Many iterations, so that rays are exact to their last digits near the edge of a strong lens, too. OpenCV 4 has
        # a function of its own that takes them.
        undistort: Any = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
        undistort = cv2.fisheye.undistortPoints if self.model == "fisheye" else undistort
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 500, 1e-13)
        points = np.ascontiguousarray(uv).reshape(-1, 1, 2)
        undistorted = undistort(points, self.matrix, self.coefficients, R=None, P=None, criteria=criteria)
        xy = np.asarray(undistorted, dtype=np.float64).reshape(-1, 2)
        rays = np.column_stack([xy, np.ones(len(uv))])
        errors = np.linalg.norm(self.project(rays) - uv, axis=1)
        rays[~(errors < 1e-6), :2] = np.nan
        return rays

    def scaled(self, width: int, height: int) -> Camera:
        """The same lens at another resolution of the same field of view."""
        sx = width / self.width
        sy = height / self.height
        cx = (self.cx + 0.5) * sx - 0.5
        cy = (self.cy + 0.5) * sy - 0.5
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=cx, cy=cy)
