"""What the marks are solved to, and whether it is enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from calib.errors import InputError
from calib.floor.find import floor_from_points
from calib.ground_camera import GroundCamera
from calib.people.calibration import HumanCalibration
from calib.rig import Floor
from calib.types import F64, Bool
from planview.calibration.floor import FloorDepths
from planview.calibration.page.marks import Point


class FloorFit(NamedTuple):
    """A floor through the points that are used, (n,) signed distances of every point from it [m], up positive, and
    (n,) whether the point lies on it."""

    floor: Floor
    distance_m: F64
    used: Bool


def fit_floor(view: FloorDepths, pixels: Sequence[Point]) -> FloorFit:
    """The plane that most points lie on; of several with as many, that of the points clicked first. Raises InputError:
    fewer than three points, a point without depth, or no three that span a floor."""
    points = view.points_at(np.array(pixels, dtype=np.float64).reshape(-1, 2))
    # A point this far from the plane of the others is not on the floor [m] (lower than a step)...
    # ...or three deviations of its depth, where that is more.
    limit = np.array([max(0.06, 3.0 * view.geometry.depth_std_m(float(p[2]))) for p in points])
    return fit_plane(points, limit, view.depth_std_m(points))


def fit_plane(points: F64, limit_m: F64, depth_std_m: F64) -> FloorFit:
    """As ``fit_floor``, of (n, 3) points [m] in the left camera's frame with (n,) distances that are allowed and (n,)
    deviations of depth [m]."""
    best: FloorFit | None = None
    problem = InputError(f"expected three or more floor points, found {len(points)}")

    def through(chosen: Sequence[int] | Bool) -> FloorFit:
        floor = floor_from_points(points[chosen], "floor points", depth_std_m[chosen])
        distance = (floor.world_SE3_left @ points)[:, 2]
        return FloorFit(floor, distance, np.abs(distance) <= limit_m)

    for triple in islice(combinations(range(len(points)), 3), 400):  # all of 14 points
        try:
            fit = through(list(triple))
        except InputError as error:
            problem = error
            continue
        if best is None or fit.used.sum() > best.used.sum():
            best = fit
    if best is None:
        raise problem
    return through(best.used)


class ValueRow(NamedTuple):
    """One value: its name, itself and its deviation, as text with units."""

    name: str
    value: str
    deviation: str


class Assessed(NamedTuple):
    """Whether a solution may be used without a second thought, and why."""

    enough: bool
    sentence: str


MAX_HEIGHT_STD, MAX_ANGLE_STD_DEG = 0.02, 1.0
"""Deviation of a floor's height, as a share of it, and of its angles, up to which it is known well enough (5 cm for a
camera at 2.5 m, and as much on the floor 3 m away)."""
FLOOR_VALUES = {"height above the floor": "{:.2f} m", "tilt from straight down": "{:.1f}°", "roll": "{:.1f}°"}
"""Names of a floor's values and how they are written."""


def _rows(above: Floor | GroundCamera, deviations: Sequence[float], found: Floor | None = None) -> list[ValueRow]:
    """The FLOOR_VALUES with their deviations, and in brackets those of a floor found without marks."""
    others = _values(found) if found else (None, None, None)
    rows = []
    for (name, form), value, std, other in zip(FLOOR_VALUES.items(), _values(above), deviations, others, strict=True):
        also = "" if other is None else f" (found {form.format(other)})"
        rows.append(ValueRow(name, form.format(value), f"± {form.format(std)}{also}"))
    return rows


def _values(above: Floor | GroundCamera) -> tuple[float, float, float]:
    """Height [m], tilt and roll [deg]."""
    return above.height_m, math.degrees(above.tilt_rad), math.degrees(above.roll_rad)


def floor_rows(fit: FloorFit, found: Floor | None) -> list[ValueRow]:
    """The values of a floor from points."""
    distance = ValueRow("points from the plane", f"{100 * fit.floor.residual_m:.1f} cm rms", "")
    return [*_rows(fit.floor, _floor_std(fit.floor), found), distance]


def floor_assessment(fit: FloorFit) -> Assessed:
    """A plane through three points fits whatever they lie on; the fourth one checks it, and their distances from each
    other decide how well it is known."""
    n_used, n_off = int(fit.used.sum()), int((~fit.used).sum())
    if n_off and n_used < n_off + 3:
        return Assessed(False, f"not enough: {n_off} of {n_used + n_off} points lie off the plane of the others")
    if n_used < 4:
        return Assessed(False, "not enough: three points fit any plane; add a fourth one far from them as a check")
    height, *angles = _floor_std(fit.floor)
    known = f"height known to {100 * height:.0f} cm and angles to {max(angles):.1f}°"
    limit = MAX_HEIGHT_STD * fit.floor.height_m
    if not (height <= limit and max(angles) <= MAX_ANGLE_STD_DEG):
        most = f"at most {100 * limit:.0f} cm and {MAX_ANGLE_STD_DEG:g}°"
        way = "add points far from the others, near and far, left and right"
        return Assessed(False, f"not enough: {known} only ({most}); {way}")
    off = f"; {n_off} off the plane not used" if n_off else ""
    return Assessed(True, f"enough: {n_used} points lie on one plane, {known}{off}")


def _floor_std(floor: Floor) -> tuple[float, ...]:
    """Of height [m], tilt and roll [deg]."""
    assert floor.covariance is not None
    height, tilt, roll = np.sqrt(floor.covariance.diagonal()).tolist()
    return height, math.degrees(tilt), math.degrees(roll)


@dataclass(frozen=True, eq=False)
class Solution:
    """A camera from samples, or the floor of a stereo recording from points; else the problem, empty where nothing was
    solved."""

    found: HumanCalibration | None = None
    fit: FloorFit | None = None
    problem: str = ""

    def rows(self, plain_floor: Floor | None = None) -> list[ValueRow]:
        """Values with their deviations, next to those of a floor found without points; empty without a solution."""
        if self.found is not None:
            camera, std = self.found.camera, self.found.std
            deviations = std.height * camera.height_m, math.degrees(std.tilt_rad), math.degrees(std.roll_rad)
            return [
                *_rows(camera, deviations),
                ValueRow("focal length", f"{camera.focal_px:.0f} px", f"± {std.focal * camera.focal_px:.0f} px"),
                ValueRow("lens", camera.lens, ""),
                ValueRow("floor positions", "", f"± {self.found.assessment.floor_error_m:.2f} m"),
            ]
        return floor_rows(self.fit, plain_floor) if self.fit else []

    def assessment(self) -> Assessed | None:
        """Whether it is enough; None where nothing was solved."""
        if self.problem:
            return Assessed(False, self.problem)
        if self.found is not None:
            return Assessed(self.found.assessment.enough, self.found.assessment.sentence)
        return floor_assessment(self.fit) if self.fit else None

    def metres(self, pixels: Sequence[Point]) -> list[Point | None]:
        """World (x, y) of pixels on the floor of the camera found, None where they are not on the floor."""
        if self.found is None:
            return [None] * len(pixels)
        xy = self.found.camera.back_project(np.array(pixels).reshape(-1, 2))
        return [(float(x), float(y)) if math.isfinite(x) and math.isfinite(y) else None for x, y in xy]
