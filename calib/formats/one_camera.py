"""One camera above a floor: camera.toml, or Tsai's XML as PETS has it; the lens alone of other tools is named."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

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
_LENS_KEYS = {"camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1", "K1", "intrinsics", "intrinsic"}


class LensOnlyError(InputError):
    """The calibration of a lens, which does not say where the camera is."""

    def __init__(self, path: Path, name: str, focal_px: float) -> None:
        found = f"found only a lens ({name}, focal length {focal_px:.0f} px)"
        super().__init__(f"{path}: expected a camera.toml, which also says where the camera is, {found}")
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
            return _fitted(_nearest(load_tsai(path)), path, size)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
    if (lens := _lens_of_pair(path) or _lens_alone(source)) is None:
        if not _is_camera_toml(path, source):
            raise InputError(f"{path}: expected a camera.toml or a Tsai XML, found neither")
        return _fitted(load_ground_camera(path), path, size)
    name, focal_px, own = lens
    if size and own and size[0] * own[1] == size[1] * own[0]:
        focal_px *= size[0] / own[0]
    raise LensOnlyError(path, name, focal_px)


def holds_one_camera(path: Path) -> bool:
    """Whether a calibration is of one camera: a camera.toml, a Tsai XML or the lens of one."""
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
    return bool(keys & {"focal_px", "tilt_deg", "lens"}) or (path.suffix.lower() == ".toml" and "height_m" in keys)


def _fitted(camera: GroundCamera, path: Path, size: Size | None) -> GroundCamera:
    if size is None or size == camera.size:
        return camera
    if path.suffix.lower() != ".toml" and size[0] * camera.height == size[1] * camera.width:
        return camera.scaled(*size)
    found = f"found one for {size_text(camera.size)} px"
    raise InputError(f"{path}: expected a camera for images of {size_text(size)} px, {found}")


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


def _nearest(tsai: TsaiCamera) -> GroundCamera:
    """The camera.toml that shows the floor, and people on it, at nearly the same pixels, from the same height.

    Its principal point is the image's centre and its lens one of five: heading, tilt, roll and focal length make up
    for what the camera has besides.
    """
    size = (tsai.width, tsai.height)
    centre = tsai.centre_m
    axes = tsai.camera_SE3_world.rotation
    if not 0.3 <= centre[2] <= 200:
        raise ValueError(f"expected a camera 0.3 to 200 m above the floor, found {centre[2]:g} m (wrong units?)")
    # An upside-down camera is one that leans backwards.
    flip = -1.0 if axes[1, 2] > 0 else 1.0
    tilt = flip * math.acos(np.clip(-axes[2, 2], -1.0, 1.0))
    yaw = math.atan2(flip * axes[2, 0], flip * axes[2, 1]) if abs(tilt) > 0.1 else math.atan2(-axes[0, 1], axes[0, 0])
    start = np.array(
        [math.log(tsai.focal_px), np.clip(tilt, -1.5, 1.5), math.asin(np.clip(axes[0, 2], -0.7, 0.7)), yaw]
    )
    grid = np.stack(np.meshgrid(*(np.linspace(0.05, 0.95, 9) * (n - 1) for n in size)), axis=-1).reshape(-1, 2)
    places = []
    pixels = []
    for height_m in (0.0, min(1.7, 0.5 * centre[2])):
        xy = tsai.back_project(grid, height_m) - centre[:2]
        near = np.hypot(*xy.T) < 10 * centre[2]
        places.append(np.column_stack([xy[near], np.full(near.sum(), height_m)]))
        pixels.append(grid[near])
    world = np.concatenate(places)
    seen = np.concatenate(pixels)
    if len(world) < 12:
        raise ValueError("expected a camera that sees the floor, found one that looks away from it")

    def camera(v: F64, lens: str) -> GroundCamera:
        return GroundCamera(*size, math.exp(v[0]), float(centre[2]), float(v[1]), lens, float(v[2]))

    from scipy.optimize import least_squares  # half a second

    def off(v: F64, lens: str) -> F64:
        c = math.cos(v[3])
        s = math.sin(v[3])
        turned = np.column_stack([world[:, :2] @ np.array([[c, s], [-s, c]]), world[:, 2]])
        return np.asarray(np.nan_to_num(camera(v, lens).project(turned) - seen, nan=size[0]).ravel())

    low = np.array([-np.inf, -1.57, -0.78, -np.inf])
    high = np.array([np.inf, 1.57, 0.78, np.inf])
    fits = {lens: least_squares(off, start, args=(lens,), bounds=(low, high), loss="soft_l1") for lens in LENS_K_320}
    lens = min(fits, key=lambda name: float(fits[name].cost))
    rms = float(np.sqrt(2 * np.mean(off(fits[lens].x, lens) ** 2)))
    if rms > MAX_RMS * size[0]:
        raise ValueError(f"expected a lens that a camera.toml can hold, found one that differs by {rms:.1f} px (rms)")
    return camera(fits[lens].x, lens)


_Lens = tuple[str, float, Size | None]
"""What a file of a lens is, the focal length [px] and the size of its images [px], None where it is not given."""


def _lens_of_pair(path: Path) -> _Lens | None:
    """The left camera of a pair, in a file of both or with the other one next to it."""
    try:
        left = load_rig(path).left
    except InputError:
        return None
    return "left camera of a pair", left.fx, left.size


def _lens_alone(source: Source) -> _Lens | None:
    """The lens that a file holds of one camera, without a pose that is read here; None of everything else."""
    words = [line.split() for line in source.text.splitlines() if line.strip() and not line.startswith("#")]
    if words and len(words[0]) >= 5 and words[0][0].isdigit() and words[0][1].isupper():
        with suppress(ValueError):
            return f"COLMAP, {words[0][1]}", float(words[0][4]), (int(words[0][2]), int(words[0][3]))
    if petrack := re.search(r'<(?:OLD|EXT)_MODEL [^>]*FX="([0-9.]+)"', source.text):
        return "PeTrack project, whose pose is not read", float(petrack[1]), None
    try:
        data = parse_storage(source.text)
    except ValueError:
        return None
    held = data["cam0"] if "cam1" not in data and isinstance(data.get("cam0"), Mapping) else data
    name = next((key for key in _LENS_KEYS if key in held), None)
    if name is None or {"M2", "K2", "R", "T"} & held.keys():
        return None
    value = held[name]
    while isinstance(value, Mapping):
        value = value.get("data", value.get("doubles"))
    values = str(value).replace("[", " ").replace("]", " ").replace(",", " ").split()
    return (name, float(values[0]), None) if values else None
