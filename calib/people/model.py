"""A standing person as three cylinders (Zhang et al. 2008, section 3.1), and what is known before any sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from calib.ground_camera import GroundCamera, distortion_k
from calib.people.samples import HumanSample, MarkedPeople
from calib.types import F64, Bool

ADULT_HEIGHT_M = 1.70
ADULT_HEIGHT_STD_M = 0.12
"""Heights of standing adults of both sexes [m] (NCD-RisC 2016, adults born 1996, over countries)."""
CIRCLE_POINTS = 16
"""Points sampled on each circle; with 16 the polygon's box equals the circle's along both axes."""
HULL_POINTS = 24
"""Vertices of a projected hull: its extreme points in 24 directions (within 1 % of the area)."""


@dataclass(frozen=True)
class HumanModel:
    """Head, torso and leg cylinders of one person (figure 2, table 1). Raises ValueError: a size that is not positive
    and finite.

    Attributes:
        head_m, torso_m, leg_m: heights of the cylinders [m]; their sum is the person's height.
        head_radius_m, torso_radius_m, leg_radius_m: their radii [m].
    """

    head_m: float = 0.27
    torso_m: float = 0.70
    leg_m: float = 0.79
    head_radius_m: float = 0.09
    torso_radius_m: float = 0.21
    leg_radius_m: float = 0.12

    def __post_init__(self) -> None:
        if not all(math.isfinite(size) and size > 0 for size in astuple(self)):
            raise ValueError(f"expected positive cylinder sizes [m], got {astuple(self)}")

    @cached_property
    def height_m(self) -> float:
        """Floor to the top of the head [m]; 1.76 by default."""
        return self.head_m + self.torso_m + self.leg_m

    @property
    def planes(self) -> tuple[tuple[float, float], ...]:
        """(height, radius) [m] of the four critical planes, floor first: the wider cylinder where two meet."""
        hip_radius_m = max(self.leg_radius_m, self.torso_radius_m)
        shoulder_radius_m = max(self.torso_radius_m, self.head_radius_m)
        return (
            (0.0, self.leg_radius_m),
            (self.leg_m, hip_radius_m),
            (self.leg_m + self.torso_m, shoulder_radius_m),
            (self.height_m, self.head_radius_m),
        )

    def scaled(self, height_m: float) -> HumanModel:
        """The same proportions at another body height [m]."""
        scale = height_m / self.height_m
        return HumanModel(*(size * scale for size in astuple(self)))

    def circles(self) -> F64:
        """(4 * CIRCLE_POINTS, 3) float64 [m]: points on the circles of the critical planes, person at the origin."""
        unit = _directions(CIRCLE_POINTS)
        circles = []
        for height, radius in self.planes:
            circles.append(np.column_stack([radius * unit, np.full(CIRCLE_POINTS, height)]))
        return np.concatenate(circles)

    def outline_points(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 4 * CIRCLE_POINTS, 2) pixels of the circles at (..., 2) floor positions [m]; NaN behind the camera.

        Their convex hull is the person's outline (figure 3).
        """
        xy = np.asarray(xy_m, dtype=np.float64)
        points = np.broadcast_to(self.circles(), (*xy.shape[:-1], 4 * CIRCLE_POINTS, 3)).copy()
        points[..., :2] += xy[..., None, :]
        return camera.project(points)

    def hulls(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., HULL_POINTS, 2) convex hulls [px] of people at (..., 2) floor positions [m], in order of angle.

        Vertices may repeat; all are NaN where a part of the person is behind the camera.
        """
        points = self.outline_points(camera, xy_m)
        is_behind: Bool = np.asarray(~np.isfinite(points).all(axis=(-2, -1)))
        even = _whiten(np.where(is_behind[..., None, None], 0.0, points))
        extreme = np.argmax(even @ _directions(HULL_POINTS).T, axis=-2)
        hulls = np.take_along_axis(points, extreme[..., None], axis=-2)
        hulls[is_behind] = np.nan
        return hulls

    def head(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 2) float64 [px]: the top of the head's centre, for (..., 2) floor positions [m]."""
        return _project_at(camera, xy_m, self.height_m)

    def foot(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 2) float64 [px]: the middle between the feet, for (..., 2) floor positions [m]."""
        return _project_at(camera, xy_m, 0.0)

    def boxes(self, camera: GroundCamera, xy_m: ArrayLike) -> F64:
        """(..., 4) float64 left, top, width, height [px] of the outline, for (..., 2) floor positions [m]."""
        points = self.outline_points(camera, xy_m)
        low = points.min(axis=-2)
        high = points.max(axis=-2)
        return np.concatenate([low, high - low], axis=-1)


def _project_at(camera: GroundCamera, xy_m: ArrayLike, height_m: float) -> F64:
    return camera.project(np.insert(np.asarray(xy_m, dtype=np.float64), 2, height_m, axis=-1))


def _directions(count: int) -> F64:
    """(count, 2) unit vectors all around."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _whiten(points: F64) -> F64:
    """Stretch points to equal spread along both axes: an affine map keeps the hull and evens out its corners."""
    centred = points - points.mean(axis=-2, keepdims=True)
    x = centred[..., 0]
    y = centred[..., 1]
    spread_x = np.sqrt(np.maximum((x * x).mean(axis=-1), 1e-12))
    slope = (x * y).mean(axis=-1) / spread_x
    spread_y = np.sqrt(np.maximum((y * y).mean(axis=-1) - slope**2, 1e-12))
    even_x = x / spread_x[..., None]
    even_y = (y - slope[..., None] * even_x) / spread_y[..., None]
    return np.stack([even_x, even_y], axis=-1)


FOCAL, HEIGHT, TILT, ROLL, GIRTH, STATURE = range(6)
"""Order of the shared unknowns: log focal length, log camera height, tilt, roll, log of people's width and of their
mean height over the model's; two per person, its place, follow."""
N_SHARED = 6
N_CAMERA = 4
"""The first of them, which are the camera's."""
FIELDS_DEG: dict[str, tuple[float, float]] = {
    "pinhole": (20.0, 90.0),
    "normal": (20.0, 90.0),
    "normal-wide": (60.0, 120.0),
    "fisheye": (120.0, 150.0),
    "black-corner-fisheye": (150.0, 170.0),
}
"""Horizontal field of view per lens class: table 2, with the ends it leaves open closed by us. The paper's pinhole
(below 30 degrees, or synthetic video of any) is given the range of a normal lens, and both up to 90 degrees in place of
60: many webcams are as wide with hardly any distortion."""
KNOWN_CAMERA_STD = 0.02
"""Relative deviation of a focal length that was given (data sheets and EXIF round) or a camera height that was
measured."""
KNOWN_PERSON_STD = 0.01
"""Relative deviation of a body height that was given, with shoes."""
PERSON_STD = 0.045
"""Relative deviation of one adult's height from the mean (women and men together, 8 cm)."""
WIDTH_STD = 0.12
"""Relative deviation of the width of one person's box from the mean (arms, strides, turned sideways)."""
SWAY_STD_M = 0.04
"""Deviation of the head from above the middle between the feet along each floor axis [m] (gait)."""


@dataclass(frozen=True)
class KnownValues:
    """Values known besides the samples; None where not known. Raises ValueError: a value out of range, or both focal
    length and field of view.

    Attributes:
        focal_px, field_deg: focal length [px of the samples' image], or the horizontal field of view [deg].
        height_m: camera height above the floor [m].
        person_height_m: mean height of the people [m]; a sample may have its own (``HumanSample.height_m``).
    """

    focal_px: float | None = None
    field_deg: float | None = None
    height_m: float | None = None
    person_height_m: float | None = None

    def __post_init__(self) -> None:
        ranges = {"focal_px": (10, 1e5), "field_deg": (2, 175), "height_m": (0.3, 200), "person_height_m": (0.5, 2.5)}
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"expected {name} within {low:g} to {high:g}, found {value:g}")
        if self.focal_px is not None and self.field_deg is not None:
            raise ValueError("expected focal_px or field_deg, found both")

    def focal(self, width: int, k: float) -> float | None:
        """Focal length [px] of an image ``width`` wide whose lens has the distortion ``k`` [1/px]; None if unknown."""
        if self.field_deg is None:
            return self.focal_px
        # Half the width is where the distorted ray ends: r' = r + k r^2, its smaller root.
        edge = width / 2
        root = math.sqrt(max(1.0 + 4.0 * k * edge, 0.0))
        return 2.0 * edge / (1.0 + root) / math.tan(math.radians(self.field_deg) / 2)


Reading = Literal["outline", "level", "boxes"]
"""Ways in which samples are marked: boxes end where the outline does; boxes end at head and foot; heads and feet are
but the middles of the boxes' edges."""


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """Mean and deviation of every shared unknown, (N_SHARED,) float64, and how the samples are marked."""

    mean: F64
    std: F64
    reading: Reading


def prior_of(lens: str, width: int, known: KnownValues, reading: Reading) -> CameraPrior:
    """The prior of a lens class in an image ``width`` wide, and of the known values.

    Boxes take in arms and strides, so the width of people is free in them; where head and foot are marked and from
    straight above only the model's own width, fixed in the paper, separates height from focal length, so it is trusted.
    Roll: Zhang 2008, section 2, assumption 3, no significant one. All our choice.
    """
    mean = np.zeros(N_SHARED)
    std = np.full(N_SHARED, np.inf)
    # Half an image's width over the focal lengths at both ends of the class: between them, uniform in their logarithm.
    narrow, wide = (math.tan(math.radians(field) / 2) for field in FIELDS_DEG[lens])
    mean[FOCAL] = math.log(0.5 * width / math.sqrt(narrow * wide))
    # At least 0.3, since classes overlap.
    std[FOCAL] = max(0.3, math.log(wide / narrow) / math.sqrt(12.0))
    std[ROLL] = math.radians(2.0)
    std[GIRTH] = 0.5 if reading == "boxes" else 0.05
    # Relative deviation of the mean height of some people from the model's (1.76 m with shoes lies
    # between women and men of most countries).
    std[STATURE] = 0.025 if known.person_height_m is None else KNOWN_PERSON_STD
    focal = known.focal(width, distortion_k(lens, width))
    if focal is not None:
        mean[FOCAL] = math.log(focal)
        std[FOCAL] = KNOWN_CAMERA_STD
    if known.height_m is not None:
        mean[HEIGHT] = math.log(known.height_m)
        std[HEIGHT] = KNOWN_CAMERA_STD
    return CameraPrior(mean, std, reading)


def people_of(samples: Sequence[HumanSample], model: HumanModel, independent: int | None = None) -> MarkedPeople:
    """Samples as arrays, with the expected height of each person, and how many samples are worth one."""
    rows = np.stack([sample.row() for sample in samples])
    given = np.array([sample.height_m is not None for sample in samples], dtype=np.bool_)
    scale = np.array([(sample.height_m or model.height_m) / model.height_m for sample in samples])
    scale_std = np.where(given, KNOWN_PERSON_STD, PERSON_STD)
    repeats = max(1.0, len(samples) / max(1, independent or len(samples)))
    return MarkedPeople(rows, scale, scale_std, given, repeats)
