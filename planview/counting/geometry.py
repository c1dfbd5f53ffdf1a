"""Lines and polygons on the floor or in the image, and the camera that relates the two."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import shapely

from calib.errors import InputError
from calib.formats import load_rig
from calib.ground_camera import GroundCamera
from calib.types import F64
from calib.world import load_world
from stereo.depth import StereoFloorCamera
from stereo.rectify import RectifyParams, ideal_pinhole

PlaneName = Literal["floor", "image"]


class RulePlane:
    """Where rules are applied: on the floor; in the image for rules in pixels of a camera that is not known.
    ``image_size``: (width, height) [px] where only that is known."""

    def __init__(
        self, camera: GroundCamera | StereoFloorCamera | None = None, image_size: tuple[int, int] | None = None
    ) -> None:
        self.camera = camera
        self.image_size = camera.size if camera is not None else image_size

    def place(self, points: F64, *, in_pixels: bool, what: str) -> tuple[PlaneName, F64]:
        """The plane and the points in it. Pixels go to the floor when the camera is known, where the line between them
        is straight. Raises InputError: outside the view, or above the horizon."""
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
        """A line (2, 2) whose ends at the border are moved on by the image's larger side, where the feet of people are
        whom the border cuts."""
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


class Outline:
    """An (N, 2) polygon, for asking about points."""

    def __init__(self, polygon: F64) -> None:
        self._polygon = polygon

    def depth(self, x: F64, y: F64) -> F64:
        """Distance of points (of any shape) to the outline: positive inside, negative outside, NaN for NaN."""
        area = shapely.Polygon(self._polygon)
        away = np.where(np.isfinite(x + y), shapely.distance(area.exterior, shapely.points(x, y)), np.nan)
        return np.where(shapely.contains_xy(area, x, y), away, -away)

    def inner_radius(self) -> float:
        """Radius of the largest circle inside, within a hundredth of the polygon's size."""
        tolerance = float(np.ptp(self._polygon, axis=0).max()) / 100
        return float(shapely.maximum_inscribed_circle(shapely.Polygon(self._polygon), tolerance).length)


def problem_of(polygon: F64) -> str:
    """Why an (N, 2) polygon is none, in words that end "found ..."; empty where it is one."""
    shape = shapely.Polygon(polygon)
    if shapely.convex_hull(shape).area < 1e-6:
        return "points on a line"
    if not shape.is_valid:
        return "edges that cross or touch at " + str(shapely.is_valid_reason(shape)).partition("[")[2].rstrip("]")
    return ""


def stereo_plane(rig_path: Path) -> RulePlane:
    """The plane of a rig with a world.toml in its folder. Raises InputError: no rig or no world.toml there."""
    rig = load_rig(rig_path)
    world = (rig_path if rig_path.is_dir() else rig_path.parent) / "world.toml"
    if not world.is_file():
        raise InputError(f"{world}: expected the pose of the rig above the floor (calibrate it first), found no file")
    rotation, params = rig.rectifying_rotations()[0], RectifyParams()
    geometry = ideal_pinhole(rig.left, rotation, params.working_px, params.field_quantile, rig.baseline_m)
    return RulePlane(StereoFloorCamera(geometry, load_world(world).world_SE3_left))
