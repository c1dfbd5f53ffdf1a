"""One camera above a floor: camera.toml, or Tsai's XML as PETS has it; the lens alone of other tools is named."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.formats import base, load_rig
from calib.formats.base import Size, Source, is_tsai, read_source
from calib.formats.opencv import parse_storage
from calib.ground_camera import LENS_K_320, GroundCamera, load_ground_camera
from calib.io import UNITS_M, size_text
from calib.pose import SE3
from calib.types import F64

MAX_RMS = 0.01
"""Largest rms difference of pixels, as a share of the image's width, between a lens and that of a camera.toml that is
nearest to it (a hand's breadth at 5 m)."""
_LENS_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1", "K1", "intrinsics", "intrinsic")


class NoCameraError(InputError):
    """A camera above the floor is missing; ``focal_px`` is that of its lens, where it is known."""

    def __init__(self, message: str, focal_px: float = 0.0, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.focal_px = focal_px


def load_one_camera(path: Path, size: Size | None = None) -> GroundCamera:
    """The camera of a camera.toml or of a Tsai XML; the world is that of a camera.toml. Raises InputError: unreadable,
    a lens without a place above the floor, or a camera for images of another aspect.

    Args:
        size: (width, height) of the images [px]; a camera of another size and the same aspect is scaled.
    """
    if path.is_dir():
        return load_ground_camera(path)
    source = read_source(path)
    if is_tsai(source):
        try:
            return _fit_size(_nearest_camera(load_tsai(path)), path, size)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
    lens = _lens_of_pair(path) or _lens_alone(source)
    if lens is not None:
        focal_px = lens.focal_px
        if size and lens.size and size[0] * lens.size[1] == size[1] * lens.size[0]:
            focal_px *= size[0] / lens.size[0]
        actual = f"found only a lens ({lens.name}, focal length {focal_px:.0f} px)"
        raise NoCameraError(f"{path}: expected a camera.toml, which has its place as well, {actual}", focal_px)
    if not _is_camera_toml(path, source):
        raise InputError(f"{path}: expected a camera.toml or a Tsai XML, found neither")
    return _fit_size(load_ground_camera(path), path, size)


def holds_one_camera(path: Path) -> bool:
    """True for a calibration of one camera: a camera.toml, a Tsai XML or the lens of one."""
    if not path.is_file():
        return False
    try:
        source = read_source(path)
    except InputError:
        return False
    if path.suffix.lower() == ".toml":
        return _is_camera_toml(path, source)
    return is_tsai(source) or (_lens_of_pair(path) is None and _lens_alone(source) is not None)


def _is_camera_toml(path: Path, source: Source) -> bool:
    keys = {line.split("=")[0].strip() for line in source.text.splitlines()}
    if keys & {"focal_px", "tilt_deg", "lens"}:
        return True
    return path.suffix.lower() == ".toml" and "height_m" in keys


def _fit_size(camera: GroundCamera, path: Path, size: Size | None) -> GroundCamera:
    if size is None or size == camera.size:
        return camera
    if path.suffix.lower() != ".toml" and size[0] * camera.height == size[1] * camera.width:
        return camera.scaled(*size)
    actual = f"found one for {size_text(camera.size)} px"
    raise InputError(f"{path}: expected a camera for images of {size_text(size)} px, {actual}")


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
    def focal_px(self) -> float:
        """Focal length along x [px]."""
        return self.focal_mm / self.dx_mm

    @property
    def centre_m(self) -> F64:
        """(3,) camera centre in the world [m]."""
        return self.camera_SE3_world.inverse().translation

    def project(self, points_world: ArrayLike) -> F64:
        """(N, 2) pixels of (N, 3) world points [m]; NaN behind the camera and beyond where the lens turns back."""
        points = self.camera_SE3_world @ np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
        depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        ideal = self.focal_mm * points[:, :2] / depth[:, None]
        radius = np.maximum(np.linalg.norm(ideal, axis=1, keepdims=True), 1e-12)
        # The smallest r with r + kappa1 r^3 = |ideal|, by the sine of a third of an angle; NaN where there is none.
        steep = math.sqrt(3.0 * abs(self.kappa1))
        with np.errstate(invalid="ignore"):
            if self.kappa1 > 0:
                distorted = 2.0 / steep * np.sinh(np.arcsinh(1.5 * steep * radius) / 3.0)
            elif self.kappa1 < 0:
                distorted = 2.0 / steep * np.sin(np.arcsin(1.5 * steep * radius) / 3.0)
            else:
                distorted = radius
        sensor = ideal * (distorted / radius)
        return np.asarray(sensor / [self.dx_mm, self.dy_mm] + [self.cx, self.cy])

    def back_project(self, pixels: ArrayLike, height_m: float = 0.0) -> F64:
        """(N, 2) world x, y [m] of (N, 2) pixels that show a point at a height [m]; NaN where there is none."""
        flat = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        sensor = (flat - [self.cx, self.cy]) * [self.dx_mm, self.dy_mm]
        square = (sensor**2).sum(axis=1, keepdims=True)
        ideal = sensor * (1.0 + self.kappa1 * square)
        rays = np.column_stack([ideal / self.focal_mm, np.ones(len(ideal))])
        directions = rays @ self.camera_SE3_world.rotation
        centre = self.centre_m
        rise = np.where(np.abs(directions[:, 2]) > 1e-12, directions[:, 2], np.nan)
        distance = (height_m - centre[2]) / rise
        distance = np.where(distance > 0, distance, np.nan)
        return centre[:2] + distance[:, None] * directions[:, :2]


def load_tsai(path: Path) -> TsaiCamera:
    """Read a Tsai camera in millimetres."""
    source = read_source(path)
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

    geometry = values("Geometry")
    intrinsic = values("Intrinsic")
    extrinsic = values("Extrinsic")
    sx = base.number(intrinsic.get("sx", 1.0), "sx")
    if sx <= 0:
        raise ValueError(f"expected a positive sx, found {sx:g}")
    rx, ry, rz = (base.number_at(extrinsic, key) for key in ("rx", "ry", "rz"))
    translation_mm = np.array([base.number_at(extrinsic, key) for key in ("tx", "ty", "tz")])
    if "dpx" in geometry:
        pitch = base.number_at(geometry, "dpx")
    else:
        # The sensor's dx, stretched by ncx sensor elements over nfx pixels.
        dx, ncx, nfx = (base.number_at(geometry, key) for key in ("dx", "ncx", "nfx"))
        if nfx <= 0:
            raise ValueError(f"expected a positive nfx, found {nfx:g}")
        pitch = dx * ncx / nfx
    # R = Rz Ry Rx (Tsai's order).
    turn = SE3.from_rotvec([0.0, ry, 0.0]) @ SE3.from_rotvec([rx, 0.0, 0.0])
    turn = SE3.from_rotvec([0.0, 0.0, rz]) @ turn
    return TsaiCamera(
        width=base.whole_at(geometry, "width"),
        height=base.whole_at(geometry, "height"),
        focal_mm=base.number_at(intrinsic, "focal"),
        kappa1=base.number_at(intrinsic, "kappa1"),
        cx=base.number_at(intrinsic, "cx"),
        cy=base.number_at(intrinsic, "cy"),
        dx_mm=pitch / sx,
        dy_mm=base.number_at(geometry, "dpy", "dy"),
        camera_SE3_world=SE3(turn.rotation, translation_mm * UNITS_M["mm"]),
    )


def _nearest_camera(tsai: TsaiCamera) -> GroundCamera:
    """The camera.toml that shows the floor, and people on it, at nearly the same pixels, from the same height.

    Its principal point is the image's centre and its lens one of five: heading, tilt, roll and focal length make up
    for what the camera has besides.
    """
    size = (tsai.width, tsai.height)
    centre = tsai.centre_m
    axes = tsai.camera_SE3_world.rotation
    if not 0.3 <= centre[2] <= 200:
        raise ValueError(f"expected a camera 0.3 to 200 m above the floor, found {centre[2]:g} m (wrong units?)")
    world, seen = _seen_points(tsai)
    if len(world) < 12:
        raise ValueError("expected a camera that sees the floor, found one that looks away from it")
    # An upside-down camera is one that leans backwards.
    flip = -1.0 if axes[1, 2] > 0 else 1.0
    tilt = flip * math.acos(np.clip(-axes[2, 2], -1.0, 1.0))
    roll = math.asin(np.clip(axes[0, 2], -0.7, 0.7))
    yaw = math.atan2(flip * axes[2, 0], flip * axes[2, 1])
    if abs(tilt) <= 0.1:
        yaw = math.atan2(-axes[0, 1], axes[0, 0])
    start = np.array([math.log(tsai.focal_px), np.clip(tilt, -1.5, 1.5), roll, yaw])

    def camera(values: F64, lens: str) -> GroundCamera:
        focal, tilt, roll, _ = values.tolist()
        return GroundCamera(*size, math.exp(focal), float(centre[2]), tilt, lens, roll)

    from scipy.optimize import least_squares  # half a second

    def residuals(values: F64, lens: str) -> F64:
        c = math.cos(values[3])
        s = math.sin(values[3])
        points = np.column_stack([world[:, :2] @ np.array([[c, s], [-s, c]]), world[:, 2]])
        differences = camera(values, lens).project(points) - seen
        return np.asarray(np.nan_to_num(differences, nan=size[0]).ravel())

    low = np.array([-np.inf, -1.57, -0.78, -np.inf])
    high = np.array([np.inf, 1.57, 0.78, np.inf])
    fits = {}
    for lens in LENS_K_320:
        fits[lens] = least_squares(residuals, start, args=(lens,), bounds=(low, high), loss="soft_l1")
    best = min(fits, key=lambda lens: float(fits[lens].cost))
    values = fits[best].x
    rms = float(np.sqrt(2 * np.mean(residuals(values, best) ** 2)))
    if rms > MAX_RMS * size[0]:
        raise ValueError(f"expected a lens that a camera.toml can hold, found one that differs by {rms:.1f} px (rms)")
    return camera(values, best)


def _seen_points(tsai: TsaiCamera) -> tuple[F64, F64]:
    """(N, 3) points on the floor and at the height of heads [m], from below the camera, and their (N, 2) pixels."""
    centre = tsai.centre_m
    u = np.linspace(0.05, 0.95, 9) * (tsai.width - 1)
    v = np.linspace(0.05, 0.95, 9) * (tsai.height - 1)
    grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    points = []
    pixels = []
    for height_m in (0.0, min(1.7, 0.5 * centre[2])):
        xy = tsai.back_project(grid, height_m) - centre[:2]
        is_near = np.hypot(*xy.T) < 10 * centre[2]
        points.append(np.column_stack([xy[is_near], np.full(is_near.sum(), height_m)]))
        pixels.append(grid[is_near])
    return np.concatenate(points), np.concatenate(pixels)


class _Lens(NamedTuple):
    """A lens without a place: what its file is, its focal length, and the size of its images, if given."""

    name: str
    focal_px: float
    size: Size | None = None


def _lens_of_pair(path: Path) -> _Lens | None:
    """The left camera of a pair, in a file of both or with the other one next to it."""
    try:
        left = load_rig(path).left
    except InputError:
        return None
    return _Lens("left camera of a pair", left.fx, left.size)


def _lens_alone(source: Source) -> _Lens | None:
    """The lens that a file holds of one camera, without a pose that is read here; None of everything else."""
    colmap = re.search(r"^\d+ ([A-Z]\w*) (\d+) (\d+) ([0-9.]+)", source.text, re.MULTILINE)
    if colmap:
        return _Lens(f"COLMAP, {colmap[1]}", float(colmap[4]), (int(colmap[2]), int(colmap[3])))
    petrack = re.search(r'<(?:OLD|EXT)_MODEL [^>]*FX="([0-9.]+)"', source.text)
    if petrack:
        return _Lens("PeTrack project, whose pose is not read", float(petrack[1]))
    try:
        data = parse_storage(source.text)
    except ValueError:
        return None
    if "cam1" not in data and isinstance(data.get("cam0"), Mapping):
        data = data["cam0"]
    name = next((key for key in _LENS_KEYS if key in data), None)
    if name is None or {"M2", "K2", "R", "T"} & data.keys():
        return None
    value = data[name]
    while isinstance(value, Mapping):
        value = value.get("data", value.get("doubles"))
    numbers = re.findall(r"[^\s,\[\]]+", str(value))
    return _Lens(name, float(numbers[0])) if numbers else None
