"""What is known of a camera and of people before any sample, as deviations of Gaussian priors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.ground_camera import GroundCamera
from calib.human.model import HumanModel
from calib.human.samples import HumanSample, People
from calib.types import F64

FOCAL, HEIGHT, TILT, ROLL, GIRTH, STATURE = range(6)
"""Order of the shared unknowns: log focal length, log camera height, tilt, roll, log of people's width and of their
mean height over the model's; two per person, its place, follow."""
N_SHARED = 6
N_CAMERA = 4
"""The first so many of them are the camera's."""
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
KNOWN_FOCAL_STD = 0.02
"""Relative deviation of a focal length that was told: data sheets and EXIF round (our choice)."""
KNOWN_HEIGHT_STD = 0.02
"""Relative deviation of a camera height that was measured (our choice)."""
KNOWN_PERSON_STD = 0.01
"""Relative deviation of a body height that was told, with shoes (our choice)."""
STATURE_STD = 0.025
"""Relative deviation of the mean height of some people from the model's (our choice: 1.76 m with shoes lies between
women and men of most countries)."""
PERSON_STD = 0.045
"""Relative deviation of one adult's height from the mean (our choice: women and men together, 8 cm)."""
WIDTH_STD = 0.12
"""Relative deviation of the width of one person's box from the mean (our choice: arms, strides, turned sideways)."""
LEAN_M = 0.04
"""Deviation of the head from above the middle between the feet along each floor axis [m] (our choice: gait)."""


@dataclass(frozen=True)
class KnownValues:
    """Values known beside the samples; None where not known.

    Attributes:
        focal_px: focal length [px of the samples' image].
        field_deg: horizontal field of view [deg], in place of the focal length.
        height_m: camera height above the floor [m].
        person_height_m: mean height of the people [m]; a sample may have its own (``HumanSample.height_m``).
    Raises:
        ValueError: a value out of range, or both focal length and field of view.
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
        root = 1.0 + 4.0 * k * edge
        return 2.0 * edge / (1.0 + math.sqrt(max(root, 0.0))) / math.tan(math.radians(self.field_deg) / 2)


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """Mean and deviation of every shared unknown, and how well points are marked.

    Attributes:
        mean, std: (N_SHARED,) float64.
        boxes_only: heads and feet are but the middles of the boxes' edges.
        level_ends: boxes end at the marked heads and feet, and not where the outline does.
    """

    mean: F64
    std: F64
    boxes_only: bool
    level_ends: bool


def usual_focal_px(lens: str, width: int) -> float:
    """Middle of the focal lengths of a lens class [px], in equal ratios."""
    narrow, wide = (0.5 * width / math.tan(math.radians(field) / 2) for field in FIELDS_DEG[lens])
    return math.sqrt(narrow * wide)


def _focal_std(lens: str) -> float:
    """Deviation of the log of a class's focal lengths, were they uniform; at least 0.3, since classes overlap."""
    narrow, wide = (math.tan(math.radians(field) / 2) for field in FIELDS_DEG[lens])
    return max(0.3, math.log(wide / narrow) / math.sqrt(12.0))


def prior_of(camera: GroundCamera, known: KnownValues, boxes_only: bool, level_ends: bool) -> CameraPrior:
    """The prior of a lens class and of the known values.

    Boxes take in arms and strides, so the width of people is free in them; where head and foot are marked and from
    straight above only the model's own width, which the paper fixes, tells height from focal length, so it is trusted.
    Roll: Zhang 2008, section 2, assumption 3, no significant one. All our choice.

    Args:
        camera: any camera of the lens and image size.
        known: values given.
        boxes_only: samples without heads and feet of their own.
        level_ends: samples whose boxes end at head and foot.
    """
    mean, std = np.zeros(N_SHARED), np.full(N_SHARED, np.inf)
    mean[FOCAL] = math.log(usual_focal_px(camera.lens, camera.width))
    std[FOCAL] = _focal_std(camera.lens)
    std[ROLL] = math.radians(2.0)
    std[GIRTH] = 0.5 if boxes_only else 0.05
    std[STATURE] = STATURE_STD if known.person_height_m is None else KNOWN_PERSON_STD
    focal = known.focal(camera.width, camera.distortion_k)
    if focal is not None:
        mean[FOCAL], std[FOCAL] = math.log(focal), KNOWN_FOCAL_STD
    if known.height_m is not None:
        mean[HEIGHT], std[HEIGHT] = math.log(known.height_m), KNOWN_HEIGHT_STD
    return CameraPrior(mean, std, boxes_only, level_ends)


def people_of(samples: Sequence[HumanSample], model: HumanModel, independent: int | None = None) -> People:
    """Samples as arrays, with what is expected of each person's height, and how many are worth one."""
    told = np.array([s.height_m is not None for s in samples], dtype=np.bool_)
    scale = np.array([1.0 if s.height_m is None else s.height_m / model.height_m for s in samples])
    deviation = np.where(told, KNOWN_PERSON_STD, PERSON_STD)
    repeats = max(1.0, len(samples) / max(1, independent or len(samples)))
    return People(np.stack([s.row() for s in samples]), scale, deviation, told, repeats)


def scaled_model(model: HumanModel, known: KnownValues) -> HumanModel:
    """The model at the height known of the people."""
    return model if known.person_height_m is None else model.scaled(known.person_height_m)
