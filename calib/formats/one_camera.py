"""One camera above a floor: camera.toml, or Tsai's XML as PETS has it; the lens alone of other tools is named."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.formats.base import Size, Source, read_source
from calib.formats.opencv import parse_storage
from calib.formats.tsai import TsaiCamera, is_tsai, load_tsai
from calib.ground_camera import LENS_K_320, GroundCamera, load_ground_camera
from calib.io import size_text
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
    raise InputError(
        f"{path}: expected a camera for images of {size_text(size)} px, found one for {size_text(camera.size)} px"
    )


def _nearest(tsai: TsaiCamera) -> GroundCamera:
    """The camera.toml that shows the floor, and people on it, at nearly the same pixels, from the same height.

    Its principal point is the image's centre and its lens one of five: heading, tilt, roll and focal length make up
    for what the camera has besides.
    """
    size, centre, axes = tsai.size, tsai.centre_m, tsai.camera_SE3_world.rotation
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
    places, pixels = [], []
    for height_m in (0.0, min(1.7, 0.5 * centre[2])):
        xy = tsai.back_project(grid, height_m) - centre[:2]
        near = np.hypot(*xy.T) < 10 * centre[2]
        places.append(np.column_stack([xy[near], np.full(near.sum(), height_m)]))
        pixels.append(grid[near])
    world, seen = np.concatenate(places), np.concatenate(pixels)
    if len(world) < 12:
        raise ValueError("expected a camera that sees the floor, found one that looks away from it")

    def camera(v: F64, lens: str) -> GroundCamera:
        return GroundCamera(*size, math.exp(v[0]), float(centre[2]), float(v[1]), lens, float(v[2]))

    from scipy.optimize import least_squares  # half a second

    def off(v: F64, lens: str) -> F64:
        c, s = math.cos(v[3]), math.sin(v[3])
        turned = np.column_stack([world[:, :2] @ np.array([[c, s], [-s, c]]), world[:, 2]])
        return np.asarray(np.nan_to_num(camera(v, lens).project(turned) - seen, nan=size[0]).ravel())

    low, high = np.array([-np.inf, -1.57, -0.78, -np.inf]), np.array([np.inf, 1.57, 0.78, np.inf])
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
