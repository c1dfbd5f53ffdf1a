"""A pinhole camera with Brown, rational or fisheye distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64, Bool

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
        if front.any():
            pixels[front] = self._project(p[front])[0]
        return pixels

    def unproject(self, pixels: ArrayLike) -> F64:
        """(N, 3) float64 rays through (N, 2) pixels in the camera frame, z = 1; NaN where the lens model has none.

        Exact to the last digits (Newton's method on the lens equation).
        """
        uv = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
        if len(uv) == 0:
            return np.empty((0, 3))
        ideal = (uv - [self.cx, self.cy]) / [self.fx, self.fy]
        # OpenCV's fixed-point guess at the ray, (N, 2).
        k, d = self.matrix, self.coefficients
        if self.model == "fisheye":
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-9)
            guess = cv2.fisheye.undistortPoints(uv.reshape(-1, 1, 2), k, d, criteria=criteria)
        else:
            guess = cv2.undistortPoints(uv.reshape(-1, 1, 2), k, d)
        xy = np.array(guess, dtype=np.float64).reshape(-1, 2)
        # Tangent of the widest ray taken from OpenCV, which marks failures with huge numbers.
        failed = ~np.isfinite(xy).all(axis=1) | (np.abs(xy).max(axis=1) > 1e3)
        xy[failed] = ideal[failed]
        xy, done = self._newton(uv, xy)
        if not done.all():
            # OpenCV's iteration can leave the basin of a strong lens: start again from the ideal ray.
            again = ~done
            xy[again], done[again] = self._newton(uv[again], ideal[again])
        xy[~done] = np.nan
        return np.column_stack([xy, np.ones(len(uv))])

    def _project(self, points: F64) -> tuple[F64, F64]:
        """Pixels of points in front of the camera and their (N, 2, 2) derivative by x and y."""
        q, zero = np.ascontiguousarray(points).reshape(-1, 1, 3), np.zeros(3)
        if self.model == "fisheye":
            uv, jacobian = cv2.fisheye.projectPoints(q, zero, zero, self.matrix, self.coefficients)
            # Columns: f (2), c (2), k (4), rotation (3), translation (3), alpha.
            by_xy = jacobian[:, 11:13]
        else:
            uv, jacobian = cv2.projectPoints(q, zero, zero, self.matrix, self.coefficients)
            # Columns: rotation (3), translation (3), f (2), c (2), k.
            by_xy = jacobian[:, 3:5]
        return np.asarray(uv, dtype=np.float64).reshape(-1, 2), np.asarray(by_xy, dtype=np.float64).reshape(-1, 2, 2)

    def _newton(self, uv: F64, start: F64) -> tuple[F64, Bool]:
        """Solve project(x, y, 1) = uv by Newton steps, halved while they do not help."""
        xy = start.copy()
        error, by_xy = self._miss(xy, uv)
        size, scale = np.linalg.norm(error, axis=1), np.ones(len(uv))
        for _ in range(30):
            # Newton stops here; float64 has about 1e-13 px at 1000 px.
            # A step cut to this share of Newton's still did not help: there is nothing to find nearby.
            i = np.flatnonzero((size > 1e-11) & (scale > 1e-4))
            if len(i) == 0:
                break
            # (N, 2) solutions of N 2x2 systems; zero where a matrix is singular.
            a, b, c, d = np.moveaxis(by_xy[i].reshape(-1, 4), 1, 0)
            det = a * d - b * c
            safe = np.where(np.abs(det) > 1e-12, det, np.inf)
            x, y = error[i].T
            trial = xy[i] - scale[i, None] * np.stack([(d * x - b * y) / safe, (a * y - c * x) / safe], axis=-1)
            trial_error, trial_by_xy = self._miss(trial, uv[i])
            trial_size = np.linalg.norm(trial_error, axis=1)
            better = trial_size < size[i]
            j = i[better]
            xy[j], error[j], by_xy[j] = trial[better], trial_error[better], trial_by_xy[better]
            size[j] = trial_size[better]
            scale[i] = np.where(better, np.minimum(1.0, 2 * scale[i]), scale[i] / 4)
        # A pixel whose ray still misses by more has none in this lens model.
        return xy, size < 1e-6

    def _miss(self, xy: F64, uv: F64) -> tuple[F64, F64]:
        pixels, by_xy = self._project(np.column_stack([xy, np.ones(len(xy))]))
        return pixels - uv, by_xy

    def scaled(self, width: int, height: int) -> Camera:
        """The same lens at another resolution of the same field of view."""
        sx, sy = width / self.width, height / self.height
        cx, cy = (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=cx, cy=cy)
