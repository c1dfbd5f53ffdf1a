"""Calibration of images with depth, as JSON, TOML or YAML of any tool: its keys are recognised, not its layout.

A colour camera (``rgb``, ``color``, ..., or the file itself), optionally a depth camera, its pose (``depth_to_color``
and such), a depth scale and what names the device. Without a pose the depth camera stands where the colour camera does;
without a depth camera, or with one of the same numbers, depth is registered. Open3D's ``intrinsic_matrix`` and the
rotations of RealSense's ``rs2_extrinsics`` are stored by columns.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.formats import base, refuse_other_aspect, refuse_strange_camera
from calib.formats.base import Size
from calib.io import closed_text, entries, parse_toml, size_text
from calib.pose import SE3
from calib.rig import IDENTITY, DepthTechnology, RgbdRig
from calib.types import F64

PARSERS: dict[str, Callable[[str], Any]] = {
    ".json": base.parse_json, ".toml": parse_toml, ".yaml": base.parse_yaml, ".yml": base.parse_yaml,
}  # fmt: skip
_OTHER_FILES = ("world.toml", "rules.toml", "camera.toml", "config.toml")
_COLOUR = ("rgb", "color", "colour", "camera", "image", "left")
_TO_COLOUR = ("depth_to_rgb", "depth_to_color")
_TO_DEPTH = ("rgb_to_depth", "color_to_depth")
_SCALE = ("depth_scale", "depth_factor", "depthmapfactor")
_ROTATION = ("r", "rotation")
_TRANSLATION = ("t", "translation", "t_m")
_DISTORTION = ("distortion", "distortion_coefficients", "coeffs", "d")
_MATRIX = ("intrinsic_matrix", "camera_matrix", "k")
"""Keys in lower case, as Open3D, ORB-SLAM, ROS and RealSense's tools write them."""
_TECHNOLOGIES: dict[DepthTechnology, str] = {
    "time-of-flight": r"time.?of.?flight|\btof\b|azure|k4a|kinect.?(v2|2|one|azure)|femto|l515|[nw]fov",
    "structured-light": r"structured|kinect|xtion|primesense|astra|sr300|carmine",
    "stereo": r"stereo|realsense|\bd4\d\d|oak|\bzed",
}


def load_rgbd(path: Path, size: Size, depth_size: Size) -> RgbdRig:
    """Read the calibration of images with depth at a file or in a folder, scaled to their sizes [px] where the aspect
    fits. Raises InputError: none there, unreadable, or for images of another aspect."""
    calibration = find_rgbd(path)
    if calibration is None:
        closed = closed_text([path] if path.is_file() else entries(path))
        expected = "a calibration of the images (JSON, TOML or YAML with fx, fy, cx, cy)"
        raise InputError(f"{path}: expected {expected}, found {closed or 'none'}")
    file, data = calibration
    try:
        return fit_rgbd(replace(_rig(data, size, depth_size), source=str(file)), size, depth_size)
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        raise InputError(f"{file}: expected a calibration of images with depth, but {error}") from error


def fit_rgbd(rig: RgbdRig, size: Size, depth_size: Size) -> RgbdRig:
    """The rig for images and depth of these sizes [px], which must have its aspects. Raises InputError: others."""
    rig_depth_size = rig.depth_camera.size if rig.depth_camera else depth_size
    refuse_other_aspect(rig.source, rig.camera.size, size)
    refuse_other_aspect(rig.source, rig_depth_size, depth_size)
    if rig.camera.size == size and rig_depth_size == depth_size:
        return rig
    note = f"{rig.source} (scaled from {size_text(rig.camera.size)} to {size_text(size)})"
    return replace(rig.scaled(size, depth_size), source=note)


def find_rgbd(path: Path) -> tuple[Path, Mapping[str, Any]] | None:
    """The first file at a path that holds a camera, and its content; None without one."""
    files = [path] if path.is_file() else [f for f in entries(path) if f.suffix.lower() in PARSERS]
    for file in files:
        if file.name.lower() in _OTHER_FILES or not file.is_file():
            continue
        parse: Callable[[str], Any] = PARSERS.get(file.suffix.lower(), base.parse_yaml)
        try:
            data = _lower_keys(parse(base.read_source(file).text))
        except (InputError, ValueError, RecursionError):
            continue
        if _tables(data):
            return file, data
    return None


def _lower_keys(data: Any) -> Any:
    """Tables with keys in lower case, without a tool's prefix (ORB-SLAM writes ``Camera.fx``)."""
    if not isinstance(data, Mapping):
        return data
    return {str(key).lower().removeprefix("camera."): _lower_keys(value) for key, value in data.items()}


def _tables(data: Any) -> dict[str, Mapping[str, Any]]:
    """The tables that hold a camera: "colour", and "depth" where there is one."""
    if not isinstance(data, Mapping):
        return {}
    tables = {}
    for name in reversed(_COLOUR):
        if _is_camera(data.get(name)):
            tables["colour"] = data[name]
    if not tables and _is_camera(data):
        tables["colour"] = data
    if tables and _is_camera(data.get("depth")):
        tables["depth"] = data["depth"]
    return tables


def _is_camera(table: Any) -> bool:
    if not isinstance(table, Mapping):
        return False
    return {"fx", "fy"} <= table.keys() or not table.keys().isdisjoint(_MATRIX)


def _first(table: Mapping[str, Any], names: Iterable[str]) -> Any:
    """Value of the first of the names that is present; None without one."""
    return next((table[name] for name in names if name in table), None)


def _rig(data: Mapping[str, Any], size: Size, depth_size: Size) -> RgbdRig:
    tables = _tables(data)
    if tables["colour"] is data.get("left") and _is_camera(data.get("right")):
        raise ValueError("it is that of a stereo pair: name the camera of the images alone")
    lenses = data.get("distortion")
    if not isinstance(lenses, Mapping):
        lenses = {}
    colour = _camera(tables["colour"], _first(lenses, _COLOUR), size, "image")
    rig = RgbdRig(colour, units_per_m=_units_per_m(data, tables.get("depth", {})), technology=_technology(data))
    if "depth" not in tables:
        return rig
    pose = _pose(data, "ppx" in tables["colour"])
    depth = _camera(tables["depth"], lenses.get("depth"), depth_size, "depth")
    if pose is None and depth == colour:
        return rig
    return replace(rig, depth_camera=depth, camera_SE3_depth=pose or IDENTITY)


def _camera(table: Mapping[str, Any], lens: Any, size: Size, name: str) -> Camera:
    """The camera of a table; ``lens`` are coefficients that stand next to the cameras, for a table without its own."""
    own_lens = _first(table, _DISTORTION)
    coefficients = np.empty(0)
    if own_lens or lens:
        coefficients = base.numbers(own_lens or lens, f"{name} distortion", (4, 5, 8, 12, 14))
    elif "k1" in table:
        terms = [base.number(table[key], key) for key in ("k1", "k2", "p1", "p2", "k3") if key in table]
        coefficients = np.array(terms)
    width = _first(table, ("width", "image_width"))
    height = _first(table, ("height", "image_height"))
    if width is not None and height is not None:
        size = base.whole(width, "width"), base.whole(height, "height")
    lens_name = str(table.get("distortion_model", table.get("model", ""))).lower()
    is_fisheye = "fisheye" in lens_name or "equidistant" in lens_name
    model: LensModel | None = "fisheye" if is_fisheye else None
    camera = base.camera(size, _matrix(table), coefficients, model, name)
    refuse_strange_camera(camera, name)
    return camera


def _matrix(table: Mapping[str, Any]) -> F64:
    """(4,) fx, fy, cx, cy, or a flat camera matrix."""
    if "fx" in table:
        centre = [base.number(_first(table, names), names[0]) for names in (("cx", "ppx"), ("cy", "ppy"))]
        return np.array([base.number_at(table, "fx"), base.number_at(table, "fy"), *centre])
    matrix = base.numbers(_first(table, _MATRIX), "camera matrix", 9).reshape(3, 3)
    is_by_columns = matrix[0, 2] == 0 and matrix[2, 0] != 0
    return np.asarray((matrix.T if is_by_columns else matrix).ravel(), dtype=np.float64)


def _pose(data: Mapping[str, Any], is_by_columns: bool) -> SE3 | None:
    """camera_SE3_depth, when a key names it."""
    key = next((key for key in (*_TO_COLOUR, *_TO_DEPTH) if isinstance(data.get(key), Mapping)), None)
    if key is None:
        return None
    rotation = _first(data[key], _ROTATION)
    translation = _first(data[key], _TRANSLATION)
    if rotation is None or translation is None:
        raise ValueError(f"expected R and T in {key}, found {', '.join(data[key]) or 'nothing'}")
    matrix = base.numbers(rotation, f"R of {key}", 9).reshape(3, 3)
    if is_by_columns:
        matrix = matrix.T
    shift = base.numbers(translation, f"T of {key}", 3)
    # No camera is 2 m away from the sensor in its own housing: such numbers are millimetres.
    if np.linalg.norm(shift) > 2.0:
        shift = shift * 1e-3
    pose = base.transform(matrix.ravel(), shift, key)
    return pose.inverse() if key in _TO_DEPTH else pose


def _units_per_m(data: Mapping[str, Any], depth: Mapping[str, Any]) -> float | None:
    """Depth values per metre; a scale below 1 is metres per value."""
    for table in (data, depth):
        for name in _SCALE:
            if name not in table or isinstance(table[name], Mapping):
                continue
            scale = base.number_at(table, name)
            if scale <= 0:
                raise ValueError(f"expected a positive {name}, found {scale:g}")
            return scale if scale >= 1.0 else 1.0 / scale
    return None


def _technology(data: Mapping[str, Any]) -> DepthTechnology | None:
    """Technology of the depth sensor that a text of the file names; None without one."""
    names = ("sensor", "device", "camera_model", "model", "name", "depth_mode", "device_name")
    values = [data.get(name) for name in names]
    text = " ".join(value for value in values if isinstance(value, str)).lower()
    return next((technology for technology, pattern in _TECHNOLOGIES.items() if re.search(pattern, text)), None)
