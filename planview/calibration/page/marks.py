"""Marks on a frame, moved part by part, and the camera or floor that they give."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from typing import Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from calib.floor.find import floor_from_points
from calib.ground_camera import GroundCamera
from calib.people.calibration import HumanCalibration
from calib.people.samples import HumanSample
from calib.rig import Floor
from calib.types import F64, Bool
from planview.calibration.floor import FloorDepths

Point = tuple[float, float]
Part = Literal["head", "foot", "nw", "ne", "sw", "se", "whole", "point"]
CORNERS: dict[Part, Point] = {"nw": (0.0, 0.0), "ne": (1.0, 0.0), "sw": (0.0, 1.0), "se": (1.0, 1.0)}
"""Corners of a box by its width and height."""


@dataclass
class Draft:
    """A person being marked; what is not marked yet is None."""

    box_px: tuple[float, float, float, float] | None = None
    head_px: Point | None = None
    foot_px: Point | None = None

    @property
    def step(self) -> Literal["box", "head", "foot"]:
        """The part that is marked next."""
        return "box" if self.box_px is None else "head" if self.head_px is None else "foot"


class Handle(NamedTuple):
    """A part of a numbered sample, "whole" for all of a person, or a numbered floor point ("point")."""

    number: int
    part: Part


def handle_points(sample: HumanSample) -> list[tuple[Part, Point]]:
    """Head, foot and corners of a sample [px]."""
    left, top, width, height = sample.box_px
    corners = [(part, (left + a * width, top + b * height)) for part, (a, b) in CORNERS.items()]
    return [("head", sample.head_px), ("foot", sample.foot_px), *corners]


def part_under_mouse(samples: Sequence[tuple[int, HumanSample]], at: Point, reach_px: float) -> Handle | None:
    """The part of numbered samples under the mouse: the nearest part within reach, else the smallest box around it."""
    found = [
        (math.hypot(u - at[0], v - at[1]), Handle(number, part))
        for number, sample in samples
        for part, (u, v) in handle_points(sample)
    ]
    near = [entry for entry in found if entry[0] <= reach_px]
    if near:
        return min(near, key=lambda entry: entry[0])[1]
    around = [(s.box_px[2] * s.box_px[3], Handle(number, "whole")) for number, s in samples if _inside(s, at)]
    return min(around)[1] if around else None


def nearest(points: Sequence[Point], at: Point, reach_px: float) -> Handle | None:
    """The floor point under the mouse."""
    distances = [math.hypot(u - at[0], v - at[1]) for u, v in points]
    best = min(range(len(points)), key=distances.__getitem__, default=-1)
    return Handle(best, "point") if best >= 0 and distances[best] <= reach_px else None


def moved(sample: HumanSample, part: Part, by: Point) -> HumanSample:
    """A sample with one part, or all of it, moved [px]. Raises ValueError: it would be no standing person any more."""
    (left, top, width, height), (du, dv) = sample.box_px, by
    if part == "whole":
        box = (left + du, top + dv, width, height)
        return replace(sample, box_px=box, head_px=_add(sample.head_px, by), foot_px=_add(sample.foot_px, by))
    if part == "head":
        return replace(sample, head_px=_add(sample.head_px, by))
    if part == "foot":
        return replace(sample, foot_px=_add(sample.foot_px, by))
    right, bottom = CORNERS[part]  # 1 for the edge that moves, else the opposite one does
    left, width = (left, width + du) if right else (left + du, width - du)
    top, height = (top, height + dv) if bottom else (top + dv, height - dv)
    return replace(sample, box_px=(left, top, width, height))


def _add(point: Point, by: Point) -> Point:
    return point[0] + by[0], point[1] + by[1]


def _inside(sample: HumanSample, at: Point) -> bool:
    left, top, width, height = sample.box_px
    return left <= at[0] <= left + width and top <= at[1] <= top + height


class ValueRow(NamedTuple):
    """One value: its name, itself and its deviation, as text with units."""

    name: str
    value: str
    deviation: str


class Assessed(NamedTuple):
    """Verdict on a solution, and why."""

    enough: bool
    sentence: str


_VALUES = (
    ("height above the floor", "{:.2f} m", "height_m", 1.0),
    ("tilt from straight down", "{:.1f}°", "tilt_rad", math.degrees(1)),
    ("roll", "{:.1f}°", "roll_rad", math.degrees(1)),
)


def _rows(above: Floor | GroundCamera, std: Sequence[float], found: Floor | None = None) -> list[ValueRow]:
    """Height, tilt and roll with their deviations, and in brackets those of a floor found without marks."""
    rows = []
    for (name, form, key, unit), deviation in zip(_VALUES, std, strict=True):
        also = "" if found is None else f" (found {form.format(unit * getattr(found, key))})"
        value = form.format(unit * getattr(above, key))
        rows.append(ValueRow(name, value, f"± {form.format(unit * deviation)}{also}"))
    return rows


MAX_HEIGHT_STD = 0.02
MAX_ANGLE_STD_DEG = 1.0
"""Deviation of a floor's height, as a share of it, and of its angles, up to which it is known well enough (5 cm for a
camera at 2.5 m, and as much on the floor 3 m away)."""


class FloorFit(NamedTuple):
    """A floor through the points that are used, (n,) signed distances of every point from it [m], up positive, and
    (n,) whether the point lies on it."""

    floor: Floor
    distance_m: F64
    used: Bool

    @property
    def std(self) -> tuple[float, float, float]:
        """Deviations of height [m], tilt and roll [rad]."""
        assert self.floor.covariance is not None
        height, tilt, roll = np.sqrt(self.floor.covariance.diagonal()).tolist()
        return height, tilt, roll

    def rows(self, found: Floor | None) -> list[ValueRow]:
        """The values of the floor, next to those of one found without points."""
        distance = ValueRow("points from the plane", f"{100 * self.floor.residual_m:.1f} cm rms", "")
        return [*_rows(self.floor, self.std, found), distance]

    def assessment(self) -> Assessed:
        """A plane through three points fits whatever they lie on; the fourth one checks it, and their distances from
        each other decide how well it is known."""
        n_used = int(self.used.sum())
        n_off = int((~self.used).sum())
        if n_off and n_used < n_off + 3:
            return Assessed(False, f"not enough: {n_off} of {n_used + n_off} points lie off the plane of the others")
        if n_used < 4:
            return Assessed(False, "not enough: three points fit any plane; add a fourth one far from them as a check")
        height_m = self.std[0]
        angle_deg = math.degrees(max(self.std[1:]))
        known = f"height known to {100 * height_m:.0f} cm and angles to {angle_deg:.1f}°"
        limit_m = MAX_HEIGHT_STD * self.floor.height_m
        if not (height_m <= limit_m and angle_deg <= MAX_ANGLE_STD_DEG):
            most = f"at most {100 * limit_m:.0f} cm and {MAX_ANGLE_STD_DEG:g}°"
            way = "add points far from the others, near and far, left and right"
            return Assessed(False, f"not enough: {known} only ({most}); {way}")
        off = f"; {n_off} off the plane not used" if n_off else ""
        return Assessed(True, f"enough: {n_used} points lie on one plane, {known}{off}")


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


@dataclass(frozen=True, eq=False)
class Solution:
    """A camera from samples, or the floor of a stereo recording from points; else the problem, empty where nothing was
    solved."""

    found: HumanCalibration | None = None
    fit: FloorFit | None = None
    problem: str = ""

    def rows(self, plain_floor: Floor | None = None) -> list[ValueRow]:
        """Values with their deviations, next to those of a floor found without points; empty without a solution."""
        if self.found is None:
            return self.fit.rows(plain_floor) if self.fit else []
        camera = self.found.camera
        std = self.found.std
        return [
            *_rows(camera, (std.height * camera.height_m, *np.radians([std.tilt_deg, std.roll_deg]))),
            ValueRow("focal length", f"{camera.focal_px:.0f} px", f"± {std.focal * camera.focal_px:.0f} px"),
            ValueRow("lens", camera.lens, ""),
            ValueRow("places on the floor, of their distance", "", f"± {std.from_camera:.0%}"),
        ]

    def assessment(self) -> Assessed | None:
        """Verdict on it; None where nothing was solved."""
        if self.problem:
            return Assessed(False, self.problem)
        if self.found is not None:
            return Assessed(self.found.assessment.enough, self.found.assessment.sentence)
        return self.fit.assessment() if self.fit else None
