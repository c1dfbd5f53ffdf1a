"""Lines and polygons on the floor or in the image, and the camera that relates the two."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.ground_camera import GroundCamera
from calib.types import F64
from calib.world import load_world
from planview.trajectories.file import within_ring
from stereo.depth import StereoFloorCamera
from stereo.rectify import RectifyParams, ideal_pinhole

PlaneName = Literal["floor", "image"]


class RulePlane:
    """Where rules are applied: on the floor; in the image for rules in pixels of a camera that is not known.

    Args:
        camera: relates pixels and metres; None when unknown.
        image_size: (width, height) [px] where only that is known.
    """

    def __init__(
        self, camera: GroundCamera | StereoFloorCamera | None = None, image_size: tuple[int, int] | None = None
    ) -> None:
        self.camera = camera
        self.image_size = camera.size if camera is not None else image_size

    def place(self, points: F64, *, in_pixels: bool, what: str) -> tuple[PlaneName, F64]:
        """The plane and the points in it: pixels go to the floor when the camera is known.

        Pixels are taken as showing the floor; the line is straight on the floor between the two places shown there.

        Raises:
            InputError: outside the view, or above the horizon.
        """
        if self.camera is None:
            if not in_pixels:
                return "floor", points
            self._require_in_view(points, _along(points), what)
            return "image", points
        if not in_pixels:
            outline = _along(points)
            pixels = self.camera.project(np.column_stack([outline, np.zeros(len(outline))]))
            self._require_in_view(points, pixels, what, self.camera.back_project(self._raster()))
            return "floor", points
        self._require_in_view(points, _along(points), what)
        on_floor = self.camera.back_project(points)
        if not np.isfinite(on_floor).all():
            bad = tuple(points[~np.isfinite(on_floor).all(axis=1)][0].tolist())
            raise InputError(f"{what}: expected pixels that show the floor, found {bad} above the horizon")
        return "floor", on_floor

    def beyond_border(self, line: F64) -> F64:
        """A line (2, 2) with ends at the border moved on by the image's larger side: a person whom the border cuts has
        the feet there."""
        if self.image_size is None:
            return line
        length = float(np.hypot(*(line[1] - line[0])))
        last = np.array(self.image_size) - 1.0
        inside = np.minimum(line, last - line).min(axis=1)
        ahead = (line[1] - line[0]) / length * max(self.image_size)
        return np.asarray(line + (inside <= 1.0)[:, None] * np.stack([-ahead, ahead]))

    def _require_in_view(self, points: F64, outline_px: F64, what: str, raster: F64 | None = None) -> None:
        """Raise unless part of the outline is in the image, or a zone surrounds some of what the image shows."""
        if self.image_size is None:
            return
        width, height = self.image_size
        u, v = outline_px.T
        if ((u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)).any():
            return
        visible = self._raster() if raster is None else raster[np.isfinite(raster).all(axis=1)]
        if len(points) > 2 and (Outline(points).depth(*visible.T) > 0).any():
            return
        raise InputError(f"{what}: expected a place inside the view of {width}x{height} pixels, found it outside")

    def _raster(self) -> F64:
        """(64, 2) pixels spread over the image."""
        width, height = self.image_size or (0, 0)
        u, v = np.meshgrid(np.linspace(0, width - 1, 8), np.linspace(0, height - 1, 8))
        return np.column_stack([u.ravel(), v.ravel()])


def _along(points: F64) -> F64:
    """Points on the closed outline, corners included."""
    # Points along a line that are tested for being in view.
    t = np.linspace(0.0, 1.0, 65)[:, None]
    ends = np.roll(points, -1, axis=0)
    return np.concatenate([a + t * (b - a) for a, b in zip(points, ends, strict=True)])


def crossing_edges(polygon: F64) -> tuple[int, int] | None:
    """The first two edges of a closed (N, 2) polygon that cross or touch without being neighbours, if any."""
    n = len(polygon)
    ends = np.roll(polygon, -1, axis=0)
    for i in range(n):
        for j in range(i + 1, n):
            neighbours = j == i + 1 or (i == 0 and j == n - 1)
            if neighbours:
                if _folds_back(polygon, i, j):
                    return i, j
            elif segments_meet(polygon[i], ends[i], polygon[j], ends[j]):
                return i, j
    return None


def _folds_back(polygon: F64, i: int, j: int) -> bool:
    """Neighbouring edges that run over each other (or an edge of no length)."""
    n = len(polygon)
    shared = j if j == i + 1 else i
    a, b, c = polygon[(shared - 1) % n], polygon[shared], polygon[(shared + 1) % n]
    return bool(abs(cross(b - a, c - b)) < 1e-12 and float(np.dot(a - b, c - b)) >= 0 and n > 3)


def segments_meet(a: F64, b: F64, c: F64, d: F64) -> bool:
    """Whether segments ab and cd have a point in common."""
    d1, d2 = cross(b - a, c - a), cross(b - a, d - a)
    d3, d4 = cross(d - c, a - c), cross(d - c, b - c)
    if d1 * d2 < 0 and d3 * d4 < 0:
        return True
    on = ((d1, a, b, c), (d2, a, b, d), (d3, c, d, a), (d4, c, d, b))
    return any(side == 0 and ((np.minimum(p, q) <= x) & (x <= np.maximum(p, q))).all() for side, p, q, x in on)


def cross(a: F64, b: F64) -> float:
    """z of the cross product: positive when b points to the left of a."""
    return float(a[0] * b[1] - a[1] * b[0])


class Outline:
    """An (N, 2) polygon, for asking about points."""

    def __init__(self, polygon: F64) -> None:
        edges = np.roll(polygon, -1, axis=0) - polygon
        self._polygon = polygon
        self._edges: list[list[float]] = np.hstack([polygon, edges, (edges**2).sum(axis=1, keepdims=True)]).tolist()

    def depth(self, x: F64, y: F64) -> F64:
        """Distance of points (of any shape) to the outline: positive inside, negative outside, NaN for NaN."""
        nearest = np.full(x.shape, np.inf)
        for px, py, ex, ey, square in self._edges:
            t = np.clip(((x - px) * ex + (y - py) * ey) / square, 0.0, 1.0)
            nearest = np.minimum(nearest, np.hypot(px + t * ex - x, py + t * ey - y))
        return np.where(within_ring(self._polygon, x, y), nearest, -nearest)


def inner_radius(polygon: F64) -> float:
    """Roughly the radius of the largest circle inside: the deepest point of a 24 x 24 raster."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    x, y = low[:, None] + (np.arange(24) + 0.5) / 24 * (high - low)[:, None]
    return max(0.0, float(Outline(polygon).depth(*np.meshgrid(x, y)).max()))


def stereo_plane(rig_path: Path) -> RulePlane:
    """The plane of a rig: its calibration, and world.toml beside it. Raises InputError: no rig or no
    world.toml there."""
    rig = load_rig(rig_path)
    world = (rig_path if rig_path.is_dir() else rig_path.parent) / "world.toml"
    if not world.is_file():
        raise InputError(f"{world}: expected the pose of the rig (planview calibrate floor writes it), found no file")
    rotation, params = rig.rectifying_rotations()[0], RectifyParams()
    geometry = ideal_pinhole(rig.left, rotation, params.working_px, params.field_quantile, rig.baseline_m)
    return RulePlane(StereoFloorCamera(geometry, load_world(world).world_SE3_left))
