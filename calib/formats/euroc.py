"""EuRoC sensor.yaml: one per camera folder, T_BS maps the camera to the body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.camera import Camera, LensModel
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, numbers, rigid, whole
from calib.formats.source import Choice, Format, Source, side_of
from calib.formats.yaml_text import parse_yaml
from calib.pose import SE3
from calib.rig import StereoRig

_POSE = re.compile(r"^\s*T_BS\s*:", re.MULTILINE)
_INTRINSICS = re.compile(r"^\s*intrinsics\s*:", re.MULTILINE)
_MODELS: dict[str, LensModel] = {"radial-tangential": "brown", "radtan": "brown", "equidistant": "fisheye"}


def _part(source: Source) -> str | None:
    # An IMU's sensor.yaml has T_BS too, but no intrinsics.
    if not (_POSE.search(source.text) and _INTRINSICS.search(source.text)):
        return None
    return side_of(source.path.parent.name) or side_of(source.path.stem)


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    (left, body_SE3_left), (right, body_SE3_right) = (_half(source, choice) for source in sources)
    names = "+".join(f"{source.path.parent.name}/{source.path.name}" for source in sources)
    return StereoRig(left, right, body_SE3_right.inverse() @ body_SE3_left, names)


def _half(source: Source, choice: Choice) -> tuple[Camera, SE3]:
    data = parse_yaml(source.text)
    name = f"{source.path.parent.name}/{source.path.name}"
    lens = str(entry(data, "distortion_model"))
    if lens not in _MODELS:
        raise ValueError(f"expected a distortion_model of {', '.join(_MODELS)} in {name}, found {lens!r}")
    width, height = (float(v) for v in numbers(entry(data, "resolution"), "resolution", 2))
    one = camera(
        (whole(width, "resolution"), whole(height, "resolution")),
        numbers(entry(data, "intrinsics"), "intrinsics", 4),
        numbers(entry(data, "distortion_coefficients"), "distortion_coefficients", (0, 4)),
        _MODELS[lens],
        name,
    )
    return one, rigid(entry(data, "T_BS"), f"T_BS of {name}", choice.unit())


def _write(rig: StereoRig, path: Path) -> list[Path]:
    paths = []
    for name, one, body_SE3_camera in (
        ("cam0", rig.left, SE3.identity()),
        ("cam1", rig.right, rig.right_SE3_left.inverse()),
    ):
        (path / name).mkdir(parents=True, exist_ok=True)
        paths.append(path / name / "sensor.yaml")
        write_whole(paths[-1], _half_text(one, body_SE3_camera))
    return paths


def _half_text(one: Camera, body_SE3_camera: SE3) -> str:
    model, coefficients = held("EuRoC", one, {"brown": 4, "fisheye": 4})
    values = [float(v) for v in np.asarray(body_SE3_camera.matrix).ravel()]
    return (
        "sensor_type: camera\n"
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: {values}\n"
        f"resolution: [{one.width}, {one.height}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: {[float(v) for v in (one.fx, one.fy, one.cx, one.cy)]}\n"
        f"distortion_model: {'equidistant' if model == 'fisheye' else 'radial-tangential'}\n"
        f"distortion_coefficients: {coefficients}\n"
    )


FORMAT = Format("euroc", "EuRoC sensor.yaml pair", _part, _read, _write, "")
