"""Calibration of images with depth, as JSON, TOML or YAML of any tool: its keys are recognised, not its layout.

A colour camera (``rgb``, ``color``, ..., or the file itself), optionally a depth camera, its pose (``depth_to_color``
and such), a depth scale and what names the device. Without a pose the depth camera stands where the colour camera does;
without a depth camera, or with one of the same numbers, depth is registered. Open3D's ``intrinsic_matrix`` and the
rotations of RealSense's ``rs2_extrinsics`` are stored by columns.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
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
_COLOUR = ("rgb", "color", "colour", "color_camera", "rgb_camera", "camera", "image", "left")
_DEPTH = ("depth", "depth_camera", "ir")
_TO_COLOUR = re.compile(r"(depth|ir)_?(to|2)_?(rgb|colou?r|camera)|(rgb|colou?r|camera)_se3_depth")
_TO_DEPTH = re.compile(r"(rgb|colou?r|camera)_?(to|2)_?(depth|ir)|depth_se3_(rgb|colou?r|camera)")
_SCALE = ("depth_scale", "depth_factor", "depthmapfactor", "units_per_m", "depth_units", "png_depth_scale", "scale")
_ROTATION = ("r", "rotation", "rot")
_TRANSLATION = ("t", "translation", "t_m", "translation_m", "t_mm")
_DISTORTION = ("distortion", "distortion_coefficients", "coeffs", "d", "dist", "distcoeffs")
_MATRIX = ("intrinsic_matrix", "camera_matrix", "k", "matrix", "intrinsics", "intrinsic")
_TECHNOLOGIES: dict[DepthTechnology, str] = {
    "time-of-flight": r"time.?of.?flight|\btof\b|azure|k4a|kinect.?(v2|2|one|azure)|femto|l515|[nw]fov",
    "structured-light": r"structured|kinect|xtion|primesense|astra|sr300|carmine",
    "stereo": r"stereo|realsense|\bd4\d\d|oak|\bzed",
}


def load_rgbd(path: Path, size: Size, depth_size: Size) -> RgbdRig:
    """Read the calibration of images with depth at a file or in a folder, scaled to their sizes [px] where the aspect
    fits. Raises InputError: none there, unreadable, or for images of another aspect."""
    found = find_rgbd(path)
    if found is None:
        closed = closed_text([path] if path.is_file() else entries(path))
        holding = "a calibration of the images (JSON, TOML or YAML with fx, fy, cx, cy)"
        raise InputError(f"{path}: expected {holding}, found {closed or 'none'}")
    file, data = found
    try:
        return fitted_rgbd(replace(_rig(data, size, depth_size), source=str(file)), size, depth_size)
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        raise InputError(f"{file}: expected a calibration of images with depth, but {error}") from error


def fitted_rgbd(rig: RgbdRig, size: Size, depth_size: Size) -> RgbdRig:
    """The rig for images and depth of these sizes [px], which must have its aspects. Raises InputError: others."""
    depth = rig.depth_camera
    for own, images in ((rig.camera.size, size), (depth.size if depth else depth_size, depth_size)):
        refuse_other_aspect(rig.source, own, images)
    if rig.camera.size == size and (depth is None or depth.size == depth_size):
        return rig
    note = f"{rig.source} (scaled from {size_text(rig.camera.size)} to {size_text(size)})"
    return replace(rig.scaled(size, depth_size), source=note)


def find_rgbd(path: Path) -> tuple[Path, Mapping[str, Any]] | None:
    """The first file at a path that holds a camera, and its content; None without one."""
    files = [path] if path.is_file() else [f for f in entries(path) if f.suffix.lower() in PARSERS]
    for file in files:
        if file.name.lower() in _OTHER_FILES or not file.is_file():
            continue
        try:
            parse: Callable[[str], Any] = PARSERS.get(file.suffix.lower(), base.parse_yaml)
            data = _lower(parse(base.read_source(file).text))
        except (InputError, ValueError, RecursionError):
            continue
        if _tables(data):
            return file, data
    return None


def _lower(data: Any) -> Any:
    """Keys in lower case without a tool's prefix (ORB-SLAM writes ``Camera.fx``)."""
    if not isinstance(data, Mapping):
        return data
    return {str(key).lower().removeprefix("camera."): _lower(value) for key, value in data.items()}


def _tables(data: Any) -> dict[str, Mapping[str, Any]]:
    """The tables that hold a camera: "colour", and "depth" where there is one."""
    if not isinstance(data, Mapping):
        return {}
    found = {}
    for role, names in (("colour", _COLOUR), ("depth", _DEPTH)):
        table = next((data[name] for name in names if _is_camera(data.get(name))), None)
        if table is not None:
            found[role] = table
    if "colour" not in found and _is_camera(data):
        found["colour"] = data
    return found if "colour" in found else {}


def _is_camera(table: Any) -> bool:
    return isinstance(table, Mapping) and ({"fx", "fy"} <= table.keys() or any(name in table for name in _MATRIX))


def _rig(data: Mapping[str, Any], size: Size, depth_size: Size) -> RgbdRig:
    tables = _tables(data)
    if tables["colour"] is data.get("left") and _is_camera(data.get("right")):
        raise ValueError("it is that of a stereo pair: name the camera of the images alone")
    colour = _camera(tables["colour"], data.get("distortion"), _COLOUR, size, "image")
    rig = RgbdRig(colour, units_per_m=_units(data, tables.get("depth", {})), technology=_technology(data))
    if "depth" not in tables:
        return rig
    pose = _pose(data, "ppx" in tables["colour"])
    depth = _camera(tables["depth"], data.get("distortion"), _DEPTH, depth_size, "depth")
    if pose is None and depth == colour:
        return rig
    return replace(rig, depth_camera=depth, camera_SE3_depth=pose or IDENTITY)


def _camera(table: Mapping[str, Any], listed: Any, names: tuple[str, ...], size: Size, name: str) -> Camera:
    """The camera of a table; its distortion may be ``listed`` next to the cameras under one of their names."""
    held = [table[key] for key in _DISTORTION if key in table]
    held += [listed[key] for key in names if key in listed] if isinstance(listed, Mapping) else []
    own: Any = next((value for value in held if value is not None and value != []), [])
    coefficients = base.numbers(own, f"{name} distortion", (4, 5, 8, 12, 14)) if own != [] else np.empty(0)
    if not coefficients.size and "k1" in table:
        keys = [key for key in ("k1", "k2", "p1", "p2", "k3") if key in table]
        coefficients = np.array([base.number(table[key], key) for key in keys])
    width, height = (table.get(key, table.get(f"image_{key}")) for key in ("width", "height"))
    if width is not None and height is not None:
        size = base.whole(width, "width"), base.whole(height, "height")
    lens_name = str(table.get("distortion_model", table.get("model", ""))).lower()
    model: LensModel | None = "fisheye" if "fisheye" in lens_name or "equidistant" in lens_name else None
    result = base.camera(size, _matrix(table), coefficients, model, name)
    refuse_strange_camera(result, name)
    return result


def _matrix(table: Mapping[str, Any]) -> F64:
    if "fx" in table:
        cx, cy = (table.get(a, table.get(b)) for a, b in (("cx", "ppx"), ("cy", "ppy")))
        values = {"fx": table["fx"], "fy": table["fy"], "cx": cx, "cy": cy}
        return np.array([base.number(value, name) for name, value in values.items()])
    value = next(table[name] for name in _MATRIX if name in table)
    matrix = base.numbers(value, "camera matrix", 9).reshape(3, 3)
    return np.asarray((matrix.T if matrix[0, 2] == 0 and matrix[2, 0] != 0 else matrix).ravel(), dtype=np.float64)


def _pose(data: Mapping[str, Any], by_columns: bool) -> SE3 | None:
    """camera_SE3_depth, when a key names it."""
    for key, value in data.items():
        if isinstance(value, Mapping) and (_TO_COLOUR.fullmatch(key) or _TO_DEPTH.fullmatch(key)):
            rotation = next((value[name] for name in _ROTATION if name in value), None)
            name = next((name for name in _TRANSLATION if name in value), None)
            if rotation is None or name is None:
                raise ValueError(f"expected R and T in {key}, found {', '.join(value) or 'nothing'}")
            matrix = base.numbers(rotation, f"R of {key}", 9)
            shift = base.numbers(value[name], f"T of {key}", 3)
            # No camera is 2 m away from the sensor in its own housing: such numbers are millimetres.
            unit = 1e-3 if name == "t_mm" or np.linalg.norm(shift) > 2.0 else 1.0
            pose = base.transform(matrix.reshape(3, 3).T.ravel() if by_columns else matrix, shift * unit, key)
            return pose.inverse() if _TO_DEPTH.fullmatch(key) else pose
    return None


def _units(data: Mapping[str, Any], depth: Mapping[str, Any]) -> float | None:
    """Depth values per metre; a scale below 1 is metres per value."""
    for table in (data, depth):
        for name in _SCALE:
            if name in table and not isinstance(table[name], Mapping):
                value = base.number(table[name], name)
                if value <= 0:
                    raise ValueError(f"expected a positive {name}, found {value:g}")
                return value if value >= 1.0 else 1.0 / value
    return None


def _technology(data: Mapping[str, Any]) -> DepthTechnology | None:
    """How the device that a text of the file names measures depth."""
    names = ("sensor", "device", "camera_model", "model", "name", "depth_mode", "device_name")
    text = " ".join(str(data[name]) for name in names if isinstance(data.get(name), str)).lower()
    return next((technology for technology, pattern in _TECHNOLOGIES.items() if re.search(pattern, text)), None)
