"""A pinhole camera with Brown, rational or fisheye distortion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64

LensModel = Literal["brown", "rational", "fisheye"]

_COEFFICIENTS: dict[str, tuple[int, ...]] = {"brown": (0, 4, 5), "rational": (8, 12, 14), "fisheye": (0, 4)}


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera; pixel (0, 0) is the centre of the top-left pixel.

    Attributes:
        width, height: image size [px].
        fx, fy, cx, cy: focal lengths and principal point [px].
        model: "brown" (k1 k2 p1 p2 k3), "rational" (OpenCV's 8, 12 or 14 coefficients) or
            "fisheye" (equidistant, k1..k4).
        distortion: coefficients in OpenCV's order; empty means none.
    Raises:
        ValueError: a size, focal length or coefficient that cannot be a camera's.
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
        """Pixels of points in the camera frame.

        Args:
            points: (N, 3) [m], z forward; a point at z <= 0 gives NaN.
        Returns:
            (N, 2) float64 [px].
        """
        p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        pixels = np.full((len(p), 2), np.nan)
        front = p[:, 2] > 0
        if front.any():
            q = np.ascontiguousarray(p[front]).reshape(-1, 1, 3)
            zero = np.zeros(3)
            if self.model == "fisheye":
                uv, _ = cv2.fisheye.projectPoints(q, zero, zero, self.matrix, self.coefficients)
            else:
                uv, _ = cv2.projectPoints(q, zero, zero, self.matrix, self.coefficients)
            pixels[front] = uv.reshape(-1, 2)
        return pixels

    def unproject(self, pixels: ArrayLike) -> F64:
        """Rays through pixels, at unit z.

        Args:
            pixels: (N, 2) [px].
        Returns:
            (N, 3) float64, camera frame, z = 1.
        """
        uv = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2))
        if len(uv) == 0:
            return np.empty((0, 3))
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-12)
        if self.model == "fisheye":
            xy = cv2.fisheye.undistortPoints(uv, self.matrix, self.coefficients, criteria=criteria)
        else:
            # OpenCV 5 moved the criteria into undistortPoints.
            iterate = getattr(cv2, "undistortPointsIter", None)
            if iterate is not None:
                xy = iterate(uv, self.matrix, self.coefficients, None, None, criteria)
            else:
                xy = cv2.undistortPoints(uv, self.matrix, self.coefficients, criteria=criteria)
        return np.column_stack([xy.reshape(-1, 2), np.ones(len(uv))])

    def scaled(self, width: int, height: int) -> Camera:
        """The same lens seen at another resolution of the same field of view."""
        sx, sy = width / self.width, height / self.height
        return Camera(
            width,
            height,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
            self.model,
            self.distortion,
        )
