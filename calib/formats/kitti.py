"""KITTI calib_cam_to_cam.txt: four cameras, raw and rectified, poses from camera 0; and the calib.txt of odometry
sequences, which holds the projections of the rectified cameras only."""

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
_ODOMETRY = re.compile(r"^P[0-3]:", re.MULTILINE)
_PAIRS = (("02", "03"), ("00", "01"))


def _part(source: Source) -> str | None:
    drive = _KEYS.search(source.text) and _POSES.search(source.text)
    return "whole" if drive or len(_ODOMETRY.findall(source.text)) >= 2 else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    data = dict(line.split(":", 1) for line in source.text.splitlines() if ":" in line)
    if f"K_{_PAIRS[1][0]}" not in data and _ODOMETRY.search(source.text):
        return _of_sequence(source, data, choice)
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
    return _projected(size, data, f"P_rect_{name}", unit_m)


def _of_sequence(source: Source, data: Mapping[str, str], choice: Choice) -> StereoRig:
    """The rectified cameras of an odometry sequence, whose image size the file does not say."""
    if choice.size is None:
        raise ValueError("expected the size of the images, which the calib.txt of a KITTI sequence does not hold")
    left, right = choice.cameras or next(
        (pair for pair in (("2", "3"), ("0", "1")) if f"P{pair[1]}" in data), ("0", "1")
    )
    parts = [_projected(choice.size, data, f"P{name}", choice.unit()) for name in (left, right)]
    (one, left_SE3_zero), (other, right_SE3_zero) = parts
    name = f"{source.path.name} [cameras {left} {right}, rectified images]"
    return StereoRig(one, other, right_SE3_zero @ left_SE3_zero.inverse(), name)


def _projected(size: Size, data: Mapping[str, str], key: str, unit_m: float) -> tuple[Camera, SE3]:
    """The camera of a (3, 4) projection, and its pose."""
    p = numbers(entry(data, key), key, 12).reshape(3, 4)
    one = camera(size, p[:, :3].ravel(), np.empty(0), "brown", f"camera {key}")
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
