"""A standing person as three cylinders, and its outline in the image (Zhang et al. 2008, section 3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calib.ground_camera import GroundCamera
from calib.types import F64, Bool

CIRCLE_POINTS = 16
"""Points sampled on each circle; with 16 the polygon's box equals the circle's along both axes."""
HULL_POINTS = 24
"""Vertices of a projected hull: its extreme points in so many directions (our choice; within 1 % of the area)."""


@dataclass(frozen=True)
class HumanModel:
    """Head, torso and leg cylinders of one person (figure 2, table 1).

    Attributes:
        head_m, torso_m, leg_m: heights of the cylinders [m]; their sum is the person's height.
        head_radius_m, torso_radius_m, leg_radius_m: their radii [m].
    Raises:
        ValueError: a size that is not positive and finite.
    """

    head_m: float = 0.27
    torso_m: float = 0.70
    leg_m: float = 0.79
    head_radius_m: float = 0.09
    torso_radius_m: float = 0.21
    leg_radius_m: float = 0.12

    def __post_init__(self) -> None:
        sizes = (self.head_m, self.torso_m, self.leg_m, self.head_radius_m, self.torso_radius_m, self.leg_radius_m)
        if not all(math.isfinite(s) and s > 0 for s in sizes):
            raise ValueError(f"expected positive cylinder sizes [m], got {sizes}")

    @property
    def height_m(self) -> float:
        """Floor to the top of the head [m]; 1.76 by default."""
        return self.head_m + self.torso_m + self.leg_m

    @property
    def planes(self) -> tuple[tuple[float, float], ...]:
        """(height, radius) [m] of the four critical planes, floor first: the wider cylinder where two meet."""
        hip, shoulder = self.leg_m, self.leg_m + self.torso_m
        return (
            (0.0, self.leg_radius_m),
            (hip, max(self.leg_radius_m, self.torso_radius_m)),
            (shoulder, max(self.torso_radius_m, self.head_radius_m)),
            (self.height_m, self.head_radius_m),
        )

    def scaled(self, height_m: float) -> HumanModel:
        """The same proportions at another body height [m]."""
        s = height_m / self.height_m
        return HumanModel(
            self.head_m * s,
            self.torso_m * s,
            self.leg_m * s,
            self.head_radius_m * s,
            self.torso_radius_m * s,
            self.leg_radius_m * s,
        )

    def circles(self) -> F64:
        """(4 * CIRCLE_POINTS, 3) float64 [m]: points on the circles of the critical planes, person at the origin."""
        angle = 2.0 * np.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        rings = [np.column_stack([r * unit, np.full(CIRCLE_POINTS, z)]) for z, r in self.planes]
        return np.concatenate(rings)

    def outline_points(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """Pixels of the circles' points, whose convex hull is the person's outline (figure 3).

        Args:
            camera: of the image.
            xy_m: (..., 2) floor positions [m].
        Returns:
            (..., 4 * CIRCLE_POINTS, 2) float64 [px]; NaN for points behind the camera.
        """
        xy = np.asarray(xy_m, dtype=np.float64)
        points = np.broadcast_to(self.circles(), (*xy.shape[:-1], 4 * CIRCLE_POINTS, 3)).copy()
        points[..., :2] += xy[..., None, :]
        return camera.project(points)

    def hulls(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """Convex hulls of people at many positions.

        Args:
            camera: of the image.
            xy_m: (..., 2) floor positions [m].
        Returns:
            (..., HULL_POINTS, 2) float64 [px], a convex polygon in order of angle (vertices may repeat);
            all NaN where a part of the person is behind the camera.
        """
        points = self.outline_points(camera, xy_m)
        bad: Bool = np.asarray(~np.isfinite(points).all(axis=(-2, -1)))
        pick = np.argmax(_whitened(np.where(bad[..., None, None], 0.0, points)) @ _directions().T, axis=-2)
        hulls = np.take_along_axis(points, pick[..., None], axis=-2)
        hulls[bad] = np.nan
        return hulls

    def hull(self, camera: GroundCamera, x_m: float, y_m: float) -> F64:
        """(HULL_POINTS, 2) float64 [px]: the convex hull of one person (see ``hulls``)."""
        return self.hulls(camera, (x_m, y_m))

    def head(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 2) float64 [px]: the top of the head's centre, for (..., 2) floor positions [m]."""
        return camera.project(_at_height(xy_m, self.height_m))

    def foot(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 2) float64 [px]: the middle between the feet, for (..., 2) floor positions [m]."""
        return camera.project(_at_height(xy_m, 0.0))

    def boxes(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 4) float64 left, top, width, height [px] of the outline, for (..., 2) floor positions [m]."""
        points = self.outline_points(camera, xy_m)
        low, high = points.min(axis=-2), points.max(axis=-2)
        return np.concatenate([low, high - low], axis=-1)


def _directions() -> F64:
    angle = 2.0 * np.pi * np.arange(HULL_POINTS) / HULL_POINTS
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _whitened(points: F64) -> F64:
    """Points stretched to equal spread along both axes: an affine map keeps the hull and evens out its corners."""
    centred = points - points.mean(axis=-2, keepdims=True)
    xx, yy, xy = ((centred[..., i] * centred[..., j]).mean(axis=-1) for i, j in ((0, 0), (1, 1), (0, 1)))
    sx = np.sqrt(np.maximum(xx, 1e-12))
    sy = np.sqrt(np.maximum(yy - (xy / sx) ** 2, 1e-12))
    x = centred[..., 0] / sx[..., None]
    return np.stack([x, (centred[..., 1] - (xy / sx)[..., None] * x) / sy[..., None]], axis=-1)


def _at_height(xy_m: ArrayLike, height_m: float) -> F64:
    xy = np.asarray(xy_m, dtype=np.float64)
    return np.concatenate([xy, np.full((*xy.shape[:-1], 1), height_m)], axis=-1)
