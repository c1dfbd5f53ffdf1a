"""One calibrated camera above a floor in Tsai's model, as PETS publishes it in XML."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.formats import base
from calib.formats.base import Size, Source
from calib.io import UNITS_M
from calib.pose import SE3
from calib.types import F64


@dataclass(frozen=True)
class TsaiCamera:
    """Tsai's camera (Tsai 1987): radial distortion from image to ideal, Xu = Xd (1 + kappa1 Rd^2), in millimetres.
    Raises ValueError: a size, focal length or pitch that cannot be a camera's.

    Attributes:
        width, height, cx, cy: image size and principal point [px].
        focal_mm, kappa1: focal length, and radial coefficient [1/mm^2].
        dx_mm, dy_mm: pixel pitch, Tsai's dpx / sx and dpy.
        camera_SE3_world: pose; the world's Z is up, floor at Z = 0 [m].
    """

    width: int
    height: int
    focal_mm: float
    kappa1: float
    cx: float
    cy: float
    dx_mm: float
    dy_mm: float
    camera_SE3_world: SE3

    def __post_init__(self) -> None:
        for name in ("width", "height", "focal_mm", "dx_mm", "dy_mm"):
            value = float(getattr(self, name))
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"expected a positive {name}, found {value:g}")
        if not 0.05 <= self.focal_px / self.width <= 50:
            raise ValueError(
                f"expected a focal length in the units of the pixel pitch, found {self.focal_px:.3g} px "
                f"for an image of {self.width} px"
            )

    @property
    def size(self) -> Size:
        """(width, height) [px]."""
        return self.width, self.height

    @property
    def focal_px(self) -> float:
        """Focal length along x [px]."""
        return self.focal_mm / self.dx_mm

    @property
    def centre_m(self) -> F64:
        """(3,) camera centre in the world [m]."""
        return self.camera_SE3_world.inverse().translation

    def project(self, points_world: ArrayLike) -> F64:
        """(N, 2) pixels of (N, 3) world points [m]; NaN behind the camera and beyond where the lens turns back."""
        p = self.camera_SE3_world @ np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        depth = np.where(p[:, 2] > 0, p[:, 2], np.nan)
        ideal = self.focal_mm * p[:, :2] / depth[:, None]
        # The smallest r with r + kappa1 r^3 = |ideal|, by the sine of a third of an angle; NaN where there is none.
        steep = math.sqrt(3.0 * abs(self.kappa1))
        radius = np.maximum(np.linalg.norm(ideal, axis=1, keepdims=True), 1e-12)
        sine, arcsine = (np.sinh, np.arcsinh) if self.kappa1 > 0 else (np.sin, np.arcsin)
        with np.errstate(invalid="ignore"):
            r = 2.0 / steep * sine(arcsine(1.5 * steep * radius) / 3.0) if steep else radius
        return np.asarray(ideal * (r / radius) / [self.dx_mm, self.dy_mm] + [self.cx, self.cy])

    def back_project(self, pixels: ArrayLike, height_m: float = 0.0) -> F64:
        """(N, 2) world x, y [m] of (N, 2) pixels that show a point at a height [m]; NaN where there is none."""
        sensor = (np.asarray(pixels, dtype=np.float64).reshape(-1, 2) - [self.cx, self.cy]) * [self.dx_mm, self.dy_mm]
        ideal = sensor * (1.0 + self.kappa1 * (sensor**2).sum(axis=1, keepdims=True))
        rays = np.column_stack([ideal / self.focal_mm, np.ones(len(ideal))]) @ self.camera_SE3_world.rotation
        centre = self.centre_m
        falling = np.where(np.abs(rays[:, 2]) > 1e-12, rays[:, 2], np.nan)
        distance = (height_m - centre[2]) / falling
        distance = np.where(distance > 0, distance, np.nan)
        return centre[:2] + distance[:, None] * rays[:, :2]


def is_tsai(source: Source) -> bool:
    """Does this text hold one camera in Tsai's model?"""
    return "<Geometry" in source.text and "<Extrinsic" in source.text


def load_tsai(path: Path) -> TsaiCamera:
    """Read a Tsai camera in millimetres."""
    source = base.read_source(path)
    if not is_tsai(source):
        raise InputError(f"{path}: expected a Tsai camera (XML with Geometry, Intrinsic, Extrinsic), found none")
    try:
        return _from_xml(source.text)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: expected a Tsai camera, but {error}") from error


def _from_xml(text: str) -> TsaiCamera:
    root = base.parse_xml(text)

    def values(tag: str) -> Mapping[str, str]:
        node = root.find(tag)
        if node is None:
            raise ValueError(f"expected the element {tag}, found none")
        return node.attrib

    geometry, intrinsic, extrinsic = values("Geometry"), values("Intrinsic"), values("Extrinsic")
    sx = base.number(intrinsic.get("sx", 1.0), "sx")
    if sx <= 0:
        raise ValueError(f"expected a positive sx, found {sx:g}")
    focal, kappa1, cx, cy = (base.number_at(intrinsic, key) for key in ("focal", "kappa1", "cx", "cy"))
    rx, ry, rz, *translation = (base.number_at(extrinsic, key) for key in ("rx", "ry", "rz", "tx", "ty", "tz"))
    if "dpx" in geometry:
        pitch = base.number(geometry["dpx"], "dpx")
    else:  # the sensor's dx, stretched by ncx sensor elements over nfx pixels
        dx, ncx, nfx = (base.number_at(geometry, key) for key in ("dx", "ncx", "nfx"))
        if nfx <= 0:
            raise ValueError(f"expected a positive nfx, found {nfx:g}")
        pitch = dx * ncx / nfx
    rotation = SE3.identity()
    for turn in ([rx, 0.0, 0.0], [0.0, ry, 0.0], [0.0, 0.0, rz]):  # R = Rz Ry Rx (Tsai's order)
        rotation = SE3.from_rotvec(turn) @ rotation
    pose = SE3(rotation.rotation, np.array(translation) * UNITS_M["mm"])
    size = base.whole_at(geometry, "width"), base.whole_at(geometry, "height")
    return TsaiCamera(*size, focal, kappa1, cx, cy, pitch / sx, base.number_at(geometry, "dpy", "dy"), pose)
