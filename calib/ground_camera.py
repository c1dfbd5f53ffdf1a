"""One camera above a floor: four parameters of Zhang et al. 2008 (section 3.2) and a small roll; our file for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.io import expecting_table, load_toml, write_whole
from calib.types import F64

LENS_K_320: dict[str, float] = {
    "pinhole": 0.0,
    "normal": -0.00062,
    "normal-wide": -0.001,
    "fisheye": -0.0015,
    "black-corner-fisheye": -0.0019,
}
"""Table 2: factor K of r' = r + K r^2, in 1/px of a 320x240 image."""
LEVEL_PX = 1e-9
"""Vertical part of a ray, of a length of about the focal length [px], below which it is level."""


def distortion_k(lens: str, width: int) -> float:
    """K of a lens in 1/px of an image ``width`` wide."""
    return LENS_K_320[lens] * 320.0 / width


class CameraDeviations(NamedTuple):
    """Standard deviations of what is known of a camera.

    Attributes:
        height, focal: of the camera's height and focal length, relative [1].
        tilt_deg, roll_deg: of its angles [degrees].
        relative, from_camera: of places on the floor over their distance from the camera [1]: relative to each other,
            after the shift and turn of the floor that fit best, and from the camera.
    """

    height: float
    tilt_deg: float
    focal: float
    roll_deg: float
    relative: float
    from_camera: float

    @property
    def sentence(self) -> str:
        """What they mean for places on the floor."""
        return (
            f"places are known to {self.relative:.0%} of their distance relative to each other, to "
            f"{self.from_camera:.0%} from the camera"
        )


@dataclass(frozen=True)
class GroundCamera:
    """A ``FloorCamera`` at (0, 0, height_m) looking down along +Y, principal point at the image centre.

    World frame: Z up, floor at Z = 0, X right, Y forward (as ``calib.rig.world_from_plane`` defines it). Raises
    ValueError: a parameter out of its range.

    Attributes:
        width, height: image size [px].
        focal_px: focal length [px].
        height_m: height of the camera above the floor [m].
        tilt_rad: angle of the optical axis from straight down (0: overhead) [rad].
        lens: class of table 2; its K is scaled to this image's width.
        roll_rad: the image's rotation about its centre, clockwise on a screen, against an upright camera's [rad]. The
            paper assumes none (section 3, assumption 3); at 25 m, 3 degrees move a floor position by a metre.
        std: how well all of this is known; None where that is unknown.
    """

    width: int
    height: int
    focal_px: float
    height_m: float
    tilt_rad: float
    lens: str = "pinhole"
    roll_rad: float = 0.0
    std: CameraDeviations | None = None

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"expected a positive image size, got {self.width}x{self.height}")
        for name, value in (("focal length", self.focal_px), ("camera height", self.height_m)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"expected a positive {name}, got {value}")
        for name, value, limit in (("tilt", self.tilt_rad, 90), ("roll", self.roll_rad, 45)):
            if not abs(value) < math.radians(limit):
                raise ValueError(f"expected a {name} within (-{limit}, {limit}) degrees, got {math.degrees(value)}")
        if self.lens not in LENS_K_320:
            raise ValueError(f"expected a lens of {', '.join(LENS_K_320)}, got {self.lens!r}")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) [px]."""
        return self.width, self.height

    @property
    def distortion_k(self) -> float:
        """K of r' = r + K r^2 in 1/px of this image."""
        return distortion_k(self.lens, self.width)

    @property
    def centre_m(self) -> F64:
        """See ``FloorCamera``."""
        return np.array([0.0, 0.0, self.height_m])

    @property
    def pixel_sr(self) -> float:
        """See ``FloorCamera``."""
        return 1.0 / self.focal_px**2

    @property
    def projection(self) -> F64:
        """See ``FloorCamera``."""
        s = math.sin(self.tilt_rad)
        c = math.cos(self.tilt_rad)
        turned = math.sin(self.roll_rad)
        upright = math.cos(self.roll_rad)
        roll = np.array([[upright, -turned, 0.0], [turned, upright, 0.0], [0.0, 0.0, 1.0]])
        axes = roll @ np.array([[1.0, 0.0, 0.0], [0.0, -c, -s], [0.0, s, -c]])
        u = 0.5 * (self.width - 1)
        v = 0.5 * (self.height - 1)
        lens = np.array([[self.focal_px, 0.0, u], [0.0, self.focal_px, v], [0.0, 0.0, 1.0]])
        return np.asarray(lens @ np.column_stack([axes, -axes @ self.centre_m]))

    def project(self, points_world: ArrayLike) -> F64:
        """(..., 2) pixels of (..., 3) world points [m], NaN behind the camera (Zhang et al. 2008, section 3.2).

        Pixel (0, 0) is the centre of the top-left pixel.
        """
        p = np.asarray(points_world, dtype=np.float64)
        s = math.sin(self.tilt_rad)
        c = math.cos(self.tilt_rad)
        drop = self.height_m - p[..., 2]
        depth = p[..., 1] * s + drop * c
        depth = np.where(depth > 1e-6, depth, np.nan)
        x = self.focal_px * p[..., 0] / depth
        y = self.focal_px * (drop * s - p[..., 1] * c) / depth
        r = np.hypot(x, y)
        k = self.distortion_k
        # r + K r^2 turns back at r = -1/(2K): beyond it the image has no such point.
        scale = np.where(1.0 + 2.0 * k * r > 0.0, 1.0 + k * r, np.nan)
        x = x * scale
        y = y * scale
        s = math.sin(self.roll_rad)
        c = math.cos(self.roll_rad)
        return np.stack([c * x - s * y + (self.width - 1) / 2, s * x + c * y + (self.height - 1) / 2], axis=-1)

    def back_project(self, pixels: ArrayLike, height_m: float = 0.0) -> F64:
        """(..., 2) world (x, y) [m] of (..., 2) pixels [px] that show points at a height above the floor [m].

        NaN where the ray does not meet that height ahead of the camera: of what is lower than the camera it does below
        the horizon, of what is higher above it.
        """
        ray = self.rays(pixels)
        down = -ray[..., 2]
        below_m = self.height_m - height_m
        meets = below_m * down > abs(below_m) * LEVEL_PX
        lam = np.where(meets, below_m / np.where(meets, down, 1.0), np.nan)
        return lam[..., None] * ray[..., :2]

    def rays(self, pixels: ArrayLike) -> F64:
        """(..., 3) directions in the world of (..., 2) pixels, of length focal_px at the image centre."""
        uv = np.asarray(pixels, dtype=np.float64)
        right = uv[..., 0] - (self.width - 1) / 2
        low = uv[..., 1] - (self.height - 1) / 2
        s = math.sin(self.roll_rad)
        c = math.cos(self.roll_rad)
        x = c * right + s * low
        y = c * low - s * right
        r = np.hypot(x, y)
        k = self.distortion_k
        if k != 0.0:
            # Solve r' = r + K r^2 for the smaller root.
            root = np.sqrt(np.where(1.0 + 4.0 * k * r >= 0.0, 1.0 + 4.0 * k * r, np.nan))
            scale = np.where(r > 0, 2.0 / (1.0 + root), 1.0)
            x = x * scale
            y = y * scale
        s = math.sin(self.tilt_rad)
        c = math.cos(self.tilt_rad)
        return np.stack([x, self.focal_px * s - y * c, -(self.focal_px * c + y * s)], axis=-1)

    def std_m(self, x_m: float, y_m: float) -> float:
        """Deviation of a place on the floor along each axis, since this is known no better [m]; NaN where unknown."""
        if self.std is None:
            return math.nan
        return self.std.from_camera * math.hypot(x_m, y_m) / math.sqrt(2)

    def scaled(self, width: int, height: int) -> GroundCamera:
        """The same camera at another resolution of the same field of view."""
        return replace(self, width=width, height=height, focal_px=self.focal_px * width / self.width)


def save_ground_camera(camera: GroundCamera, path: Path) -> None:
    """Write ``camera.toml``."""
    text = (
        "# planview camera above a floor: at (0, 0, height_m), looking along +y, tilt from straight down\n"
        f"width = {camera.width}\nheight = {camera.height}\nfocal_px = {float(camera.focal_px)!r}\n"
        f"height_m = {float(camera.height_m)!r}\ntilt_deg = {math.degrees(camera.tilt_rad)!r}\n"
        f'lens = "{camera.lens}"\nroll_deg = {math.degrees(camera.roll_rad)!r}\n'
    )
    if camera.std is not None:
        text += "\n[std] # standard deviations; places on the floor over their distance from the camera\n"
        text += "".join(f"{name} = {value!r}\n" for name, value in camera.std._asdict().items())
    write_whole(path, text)


def load_ground_camera(path: Path) -> GroundCamera:
    """Read ``camera.toml``. Raises InputError: unreadable, keys missing or unknown, or values out of range."""
    keys = {"width", "height", "focal_px", "height_m", "tilt_deg", "lens", "roll_deg", "std"}
    with expecting_table(path, "a camera.toml"):
        data = load_toml(path, "a camera.toml")
        if unknown := set(data) - keys:
            raise InputError(f"{path}: expected the keys {sorted(keys)}, found {sorted(unknown)[0]!r}")
        std = data.get("std")
        return GroundCamera(
            width=int(data["width"]),
            height=int(data["height"]),
            focal_px=float(data["focal_px"]),
            height_m=float(data["height_m"]),
            tilt_rad=math.radians(float(data["tilt_deg"])),
            lens=str(data.get("lens", "pinhole")),
            roll_rad=math.radians(float(data.get("roll_deg", 0.0))),
            std=std and CameraDeviations(*(float(std[name]) for name in CameraDeviations._fields)),
        )
