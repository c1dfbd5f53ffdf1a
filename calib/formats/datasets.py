"""Calibrations of published data sets: EuRoC, KITTI and Middlebury.

KITTI's calib_cam_to_cam.txt holds four cameras, raw and rectified, with poses from camera 0; the calib.txt of odometry
sequences holds the projections of the rectified cameras only. EuRoC's sensor.yaml lies in each camera's folder; T_BS
maps the camera to the body. Middlebury's calib.txt is that of a rectified pair, with the baseline in millimetres.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calib.camera import Camera, LensModel
from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.io import UNITS_M
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64

_POSE = re.compile(r"^\s*T_BS\s*:", re.MULTILINE)
_INTRINSICS = re.compile(r"^\s*intrinsics\s*:", re.MULTILINE)
_EUROC_MODELS: dict[str, LensModel] = {"radial-tangential": "brown", "radtan": "brown", "equidistant": "fisheye"}


def _euroc_part(source: Source) -> str | None:
    # An IMU's sensor.yaml has T_BS too, but no intrinsics.
    if not (_POSE.search(source.text) and _INTRINSICS.search(source.text)):
        return None
    return base.side_of(source.path.parent.name) or base.side_of(source.path.stem)


def _euroc_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    names = "+".join(f"{source.path.parent.name}/{source.path.name}" for source in sources)
    return base.joined(_half(sources[0], choice), _half(sources[1], choice), names)


def _half(source: Source, choice: Choice) -> tuple[Camera, SE3]:
    data = base.parse_yaml(source.text)
    name = f"{source.path.parent.name}/{source.path.name}"
    size, model = base.size_of(base.entry(data, "resolution"), "resolution"), base.lens_of(data, _EUROC_MODELS, name)
    lens = base.numbers_at(data, (0, 4), "distortion_coefficients")
    one = base.camera(size, base.numbers_at(data, 4, "intrinsics"), lens, model, name)
    return one, base.rigid(base.entry(data, "T_BS"), f"T_BS of {name}", choice.unit()).inverse()


def _euroc_texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    texts = {}
    poses = SE3.identity(), rig.right_SE3_left.inverse()
    for name, one, body_SE3_camera in zip(("cam0", "cam1"), (rig.left, rig.right), poses, strict=True):
        model, coefficients = base.held("EuRoC", one, {"brown": 4, "fisheye": 4})
        lens = "equidistant" if model == "fisheye" else "radial-tangential"
        texts[path / name / "sensor.yaml"] = base.yaml_text({
            "sensor_type": "camera",
            "T_BS": {"cols": 4, "rows": 4, "data": body_SE3_camera.matrix.ravel().tolist()},
            "resolution": [*one.size], "camera_model": "pinhole",
            "intrinsics": [float(v) for v in (one.fx, one.fy, one.cx, one.cy)],
            "distortion_model": lens, "distortion_coefficients": coefficients,
        })  # fmt: skip
    return texts


EUROC = Format("euroc", "EuRoC sensor.yaml pair", _euroc_part, _euroc_read, _euroc_texts, "")


_KEYS = re.compile(r"^K_\d\d:", re.MULTILINE)
_POSES = re.compile(r"^T_\d\d:", re.MULTILINE)
_ODOMETRY = re.compile(r"^P[0-3]:", re.MULTILINE)
_PAIRS = (("02", "03"), ("00", "01"))


def _kitti_part(source: Source) -> str | None:
    drive = _KEYS.search(source.text) and _POSES.search(source.text)
    return "whole" if drive or len(_ODOMETRY.findall(source.text)) >= 2 else None


def _kitti_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    data = dict(line.split(":", 1) for line in source.text.splitlines() if ":" in line)
    if f"K_{_PAIRS[1][0]}" not in data and _ODOMETRY.search(source.text):
        return _of_sequence(source, data, choice)
    found = (pair for pair in _PAIRS if all(f"K_{name}" in data for name in pair))  # colour, else grey
    left, right = choice.cameras or next(found, ("", ""))
    if not left:
        raise ValueError("expected cameras 02 and 03, or 00 and 01, found neither")
    rectified = choice.rectified
    if rectified is None and choice.size is not None and f"S_rect_{left}" in data:
        rectified = _size(data, f"S_rect_{left}") == choice.size != _size(data, f"S_{left}")

    def reading(name: str) -> tuple[Camera, SE3]:
        if not rectified:
            return _raw(data, name, choice.unit())
        p = f"P_rect_{name}"
        return base.projected(_size(data, f"S_rect_{name}"), base.entry(data, p), p, choice.unit())

    kind = "rectified images" if rectified else "unrectified images"
    return base.joined(reading(left), reading(right), f"{source.path.name} [cameras {left} {right}, {kind}]")


def _size(data: Mapping[str, str], key: str) -> Size:
    return base.size_of(base.entry(data, key), key)


def _raw(data: Mapping[str, str], name: str, unit_m: float) -> tuple[Camera, SE3]:
    size = _size(data, f"S_{name}")
    k, d = (base.numbers_at(data, 9, f"K_{name}"), base.numbers_at(data, 5, f"D_{name}"))
    rotation = base.numbers_at(data, 9, f"R_{name}")
    translation = base.numbers_at(data, 3, f"T_{name}") * unit_m
    return base.camera(size, k, d, "brown", f"camera {name}"), base.transform(rotation, translation, f"R_{name}")


def _of_sequence(source: Source, data: Mapping[str, str], choice: Choice) -> StereoRig:
    """The rectified cameras of an odometry sequence, whose image size the file does not give."""
    if choice.size is None:
        raise ValueError("expected the size of the images, which the calib.txt of a KITTI sequence does not hold")
    left, right = choice.cameras or (("2", "3") if "P3" in data else ("0", "1"))
    one, other = (
        base.projected(choice.size, base.entry(data, f"P{name}"), f"P{name}", choice.unit()) for name in (left, right)
    )
    return base.joined(one, other, f"{source.path.name} [cameras {left} {right}, rectified images]")


def _kitti_texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    lines = ["calib_time: 01-Jan-1970 00:00:00"]
    poses = (SE3.identity(), rig.right_SE3_left)
    for name, one, pose in zip(("00", "01"), (rig.left, rig.right), poses, strict=True):
        _, coefficients = base.held("KITTI", one, {"brown": 5})
        lines += [
            f"S_{name}: {one.width} {one.height}",
            f"K_{name}: {_kitti_text(one.matrix)}",
            f"D_{name}: {_kitti_text(np.array(coefficients))}",
            f"R_{name}: {_kitti_text(pose.rotation)}",
            f"T_{name}: {_kitti_text(pose.translation)}",
        ]
    return {path: "\n".join(lines) + "\n"}


def _kitti_text(values: F64) -> str:
    return " ".join(repr(float(v)) for v in values.ravel())


KITTI = Format("kitti", "KITTI calib_cam_to_cam", _kitti_part, _kitti_read, _kitti_texts, ".txt")


def _middlebury_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    lines = (line.split("=", 1) for line in sources[0].text.splitlines() if "=" in line)
    data = {key.strip(): value.strip() for key, value in lines}
    size = base.whole_at(data, "width"), base.whole_at(data, "height")
    left, right = (
        base.camera(size, base.numbers(base.entry(data, name).strip("[] "), name, 9), np.empty(0), "brown", name)
        for name in ("cam0", "cam1")
    )
    offset = base.number(data.get("doffs", right.cx - left.cx), "doffs")
    if abs(offset - (apart := right.cx - left.cx)) > 0.5:
        raise ValueError(f"expected doffs to be the principal points' distance {apart:g}, found {offset:g}")
    baseline = base.number_at(data, "baseline") * choice.unit(UNITS_M["mm"])
    return StereoRig(left, right, SE3(np.eye(3), np.array([-baseline, 0.0, 0.0])), sources[0].path.name)


def _middlebury_texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    pose = rig.right_SE3_left
    if np.abs(pose.rotation - np.eye(3)).max() > 1e-12 or np.abs(pose.translation[1:]).max() > 1e-12:
        raise ValueError("the Middlebury format holds rectified pairs only, and this pair is not rectified")
    if any(np.any(one.coefficients) or one.model == "fisheye" for one in (rig.left, rig.right)):
        raise ValueError("the Middlebury format holds no distortion, and these cameras have some")
    lines = [
        f"{name}=[{one.fx!r} 0 {one.cx!r}; 0 {one.fy!r} {one.cy!r}; 0 0 1]"
        for name, one in (("cam0", rig.left), ("cam1", rig.right))
    ]
    baseline_mm = float(-pose.translation[0]) / UNITS_M["mm"]
    lines += [f"doffs={rig.right.cx - rig.left.cx!r}", f"baseline={baseline_mm!r}"]
    lines += [f"width={rig.left.width}", f"height={rig.left.height}"]
    return {path: "\n".join(lines) + "\n"}


MIDDLEBURY = Format(
    "middlebury",
    "Middlebury calib.txt",
    base.whole_with(r"^\s*cam0\s*=\s*\["),
    _middlebury_read,
    _middlebury_texts,
    ".txt",
)
