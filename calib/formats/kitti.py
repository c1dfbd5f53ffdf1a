"""KITTI calib_cam_to_cam.txt: four cameras, raw and rectified, poses from camera 0."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.camera import Camera
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, numbers, transform, whole
from calib.formats.source import Choice, Format, Size, Source
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64

_KEYS = re.compile(r"^K_\d\d:", re.MULTILINE)
_POSES = re.compile(r"^T_\d\d:", re.MULTILINE)
_PAIRS = (("02", "03"), ("00", "01"))


def _part(source: Source) -> str | None:
    return "whole" if _KEYS.search(source.text) and _POSES.search(source.text) else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    data = dict(line.split(":", 1) for line in source.text.splitlines() if ":" in line)
    left, right = choice.cameras or _pair(data)
    rectified = choice.rectified
    if rectified is None:
        rectified = choice.size is not None and _size(data, f"S_rect_{left}") == choice.size != _size(data, f"S_{left}")
    read = _rectified if rectified else _raw
    (one, left_SE3_zero), (other, right_SE3_zero) = (read(data, name, choice.unit()) for name in (left, right))
    kind = "rectified images" if rectified else "unrectified images"
    name = f"{source.path.name} [cameras {left} {right}, {kind}]"
    return StereoRig(one, other, right_SE3_zero @ left_SE3_zero.inverse(), name)


def _pair(data: Mapping[str, str]) -> tuple[str, str]:
    """The colour pair, else the grey pair."""
    for left, right in _PAIRS:
        if f"K_{left}" in data and f"K_{right}" in data:
            return left, right
    raise ValueError("expected cameras 02 and 03, or 00 and 01, found neither")


def _size(data: Mapping[str, str], key: str) -> Size | None:
    if key not in data:
        return None
    width, height = (float(v) for v in numbers(data[key], key, 2))
    return whole(width, key), whole(height, key)


def _raw(data: Mapping[str, str], name: str, unit_m: float) -> tuple[Camera, SE3]:
    size = _size(data, f"S_{name}")
    if size is None:
        raise ValueError(f"expected the key S_{name}, found none")
    k, d = numbers(entry(data, f"K_{name}"), f"K_{name}", 9), numbers(entry(data, f"D_{name}"), f"D_{name}", 5)
    rotation = numbers(entry(data, f"R_{name}"), f"R_{name}", 9)
    translation = numbers(entry(data, f"T_{name}"), f"T_{name}", 3) * unit_m
    return camera(size, k, d, "brown", f"camera {name}"), transform(rotation, translation, f"R_{name}")


def _rectified(data: Mapping[str, str], name: str, unit_m: float) -> tuple[Camera, SE3]:
    size = _size(data, f"S_rect_{name}")
    if size is None:
        raise ValueError(f"expected the key S_rect_{name}, found none")
    p = numbers(entry(data, f"P_rect_{name}"), f"P_rect_{name}", 12).reshape(3, 4)
    one = camera(size, p[:, :3].ravel(), np.empty(0), "brown", f"camera {name}")
    shift = np.asarray(np.linalg.solve(p[:, :3], p[:, 3]) * unit_m, dtype=np.float64)
    return one, SE3(np.eye(3), shift)


def _write(rig: StereoRig, path: Path) -> list[Path]:
    lines = ["calib_time: 01-Jan-1970 00:00:00"]
    poses = (SE3.identity(), rig.right_SE3_left)
    for name, one, pose in zip(("00", "01"), (rig.left, rig.right), poses, strict=True):
        _, coefficients = held("KITTI", one, {"brown": 5})
        lines += [
            f"S_{name}: {one.width} {one.height}",
            f"K_{name}: {_text(one.matrix)}",
            f"D_{name}: {_text(np.array(coefficients))}",
            f"R_{name}: {_text(pose.rotation)}",
            f"T_{name}: {_text(pose.translation)}",
        ]
    write_whole(path, "\n".join(lines) + "\n")
    return [path]


def _text(values: F64) -> str:
    return " ".join(repr(float(v)) for v in values.ravel())


FORMAT = Format("kitti", "KITTI calib_cam_to_cam", _part, _read, _write, ".txt")
