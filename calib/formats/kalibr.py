"""Kalibr camchain: one table per camera, poses as nested rows or as 16 values in a row."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, numbers, rigid, table, whole
from calib.formats.source import Choice, Format, Source
from calib.formats.yaml_text import parse_yaml
from calib.pose import SE3
from calib.rig import StereoRig

_CAMERA = re.compile(r"^\s*[\"']?cam\d+[\"']?\s*:", re.MULTILINE)
_KEYS = re.compile(r"^\s*(camera_model|distortion_coeffs)\s*:", re.MULTILINE)
_MODELS: dict[str, tuple[LensModel, int]] = {
    "radtan": ("brown", 4),
    "equidistant": ("fisheye", 4),
    "none": ("brown", 0),
}


def _part(source: Source) -> str | None:
    return "whole" if _CAMERA.search(source.text) and _KEYS.search(source.text) else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = parse_yaml(sources[0].text)
    left, right = choice.cameras or ("cam0", "cam1")
    tables = {name: table(entry(data, name), name) for name in (left, right)}
    pose = _pose(data, left, right, choice.unit())
    return StereoRig(_camera(tables[left], left), _camera(tables[right], right), pose, sources[0].path.name)


def _camera(values: Mapping[str, Any], name: str) -> Camera:
    projection = str(values.get("camera_model", "pinhole"))
    if projection != "pinhole":
        raise ValueError(f"expected a pinhole camera_model in {name}, found {projection!r}")
    lens = str(entry(values, "distortion_model"))
    if lens not in _MODELS:
        raise ValueError(f"expected a distortion_model of {', '.join(_MODELS)} in {name}, found {lens!r}")
    model, count = _MODELS[lens]
    width, height = (float(v) for v in numbers(entry(values, "resolution"), "resolution", 2))
    coefficients = numbers(values.get("distortion_coeffs", []), f"distortion_coeffs of {name}", (count, 4))
    intrinsics = numbers(entry(values, "intrinsics"), f"intrinsics of {name}", 4)
    size = whole(width, "resolution"), whole(height, "resolution")
    return camera(size, intrinsics, coefficients, model, name)


def _pose(data: Mapping[str, Any], left: str, right: str, unit_m: float) -> SE3:
    """From T_cn_cnm1 (Kalibr's own result) where there is one, else through the IMU."""
    first, last = _index(left), _index(right)
    chain = [table(data[f"cam{i}"], f"cam{i}") for i in range(first + 1, last + 1) if f"cam{i}" in data]
    if first < last and len(chain) == last - first and all("T_cn_cnm1" in link for link in chain):
        pose = SE3.identity()
        for link in chain:
            pose = rigid(link["T_cn_cnm1"], "T_cn_cnm1", unit_m) @ pose
        return pose
    return _from_imu(data, right, unit_m) @ _from_imu(data, left, unit_m).inverse()


def _from_imu(data: Mapping[str, Any], name: str, unit_m: float) -> SE3:
    values = table(data[name], name)
    if "T_cam_imu" in values:
        return rigid(values["T_cam_imu"], f"T_cam_imu of {name}", unit_m)
    if "T_imu_cam" in values:
        return rigid(values["T_imu_cam"], f"T_imu_cam of {name}", unit_m).inverse()
    raise ValueError(f"expected T_cn_cnm1, T_cam_imu or T_imu_cam in {name}, found none")


def _index(name: str) -> int:
    match = re.fullmatch(r"cam(\d{1,3})", name)
    if match is None:
        raise ValueError(f"expected cameras named cam0, cam1, ..., found {name!r}")
    return int(match[1])


def _write(rig: StereoRig, path: Path) -> list[Path]:
    lines = [*_camera_lines("cam0", rig.left), *_camera_lines("cam1", rig.right), "  T_cn_cnm1:"]
    lines += [f"  - {row}" for row in np.asarray(rig.right_SE3_left.matrix).tolist()]
    write_whole(path, "\n".join(lines) + "\n")
    return [path]


def _camera_lines(name: str, one: Camera) -> list[str]:
    model, coefficients = held("Kalibr", one, {"brown": 4, "fisheye": 4})
    return [
        f"{name}:",
        "  camera_model: pinhole",
        f"  intrinsics: {[float(v) for v in (one.fx, one.fy, one.cx, one.cy)]}",
        f"  distortion_model: {'equidistant' if model == 'fisheye' else 'radtan'}",
        f"  distortion_coeffs: {coefficients}",
        f"  resolution: [{one.width}, {one.height}]",
    ]


FORMAT = Format("kalibr", "Kalibr camchain", _part, _read, _write, ".yaml")
