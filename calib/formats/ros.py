"""ROS camera_info: one YAML file per camera, as camera_calibration writes it or as the message is printed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, number, numbers, transform, whole
from calib.formats.source import Choice, Format, Source, side_of
from calib.formats.yaml_text import parse_yaml
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64

_MATRIX = re.compile(r"^\s*(projection_matrix|P|p)\s*:", re.MULTILINE)
_MODEL = re.compile(r"^\s*distortion_model\s*:", re.MULTILINE)
_NAME = re.compile(r"^\s*camera_name\s*:\s*(.*)$", re.MULTILINE)
_MODELS: dict[str, LensModel] = {
    "plumb_bob": "brown", "rational_polynomial": "rational", "equidistant": "fisheye", "fisheye": "fisheye",
    "kannala_brandt": "fisheye", "": "brown",
}  # fmt: skip


def _part(source: Source) -> str | None:
    if not (_MATRIX.search(source.text) and _MODEL.search(source.text)) or "opencv-matrix" in source.text:
        return None
    name = _NAME.search(source.text)
    return (side_of(name[1]) if name else None) or side_of(source.path.stem) or side_of(source.path.parent.name)


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    (left, rectified_SE3_left), (right, rectified_SE3_right) = (_half(source, choice) for source in sources)
    pose = rectified_SE3_right.inverse() @ rectified_SE3_left
    return StereoRig(left, right, pose, "+".join(source.path.name for source in sources))


def _half(source: Source, choice: Choice) -> tuple[Camera, SE3]:
    return camera_from(parse_yaml(source.text), source.path.name, choice.unit())


def camera_from(data: Mapping[str, Any], name: str, unit_m: float = 1.0) -> tuple[Camera, SE3]:
    """A camera from the fields of a camera_info, and its pose in the rectified left frame.

    P = K [I | t] sees the rectified left frame shifted by t; R turns the camera into it.

    Args:
        data: fields as the YAML file or the message names them.
        name: for messages.
    Raises:
        ValueError: fields missing, of a camera that is not calibrated, or of an unknown lens.
    """
    _refuse_crops(data)
    size = (
        whole(entry(data, "image_width", "width"), "image_width"),
        whole(entry(data, "image_height", "height"), "image_height"),
    )
    lens = str(entry(data, "distortion_model"))
    if lens not in _MODELS:
        raise ValueError(f"expected a distortion_model of {', '.join(_MODELS)} in {name}, found {lens!r}")
    model = _MODELS[lens]
    counts = {"brown": (0, 4, 5, 8, 12, 14), "rational": (8, 12, 14), "fisheye": (4,)}[model]
    coefficients = numbers(entry(data, "distortion_coefficients", "D", "d"), "distortion_coefficients", counts)
    if model == "brown" and len(coefficients) > 5:
        model = "rational"  # some drivers call every polynomial plumb_bob
    one = camera(size, numbers(entry(data, "camera_matrix", "K", "k"), "camera_matrix", 9), coefficients, model, name)
    rotation = numbers(entry(data, "rectification_matrix", "R", "r"), "rectification_matrix", 9)
    projection = numbers(entry(data, "projection_matrix", "P", "p"), "projection_matrix", 12).reshape(3, 4)
    if abs(np.linalg.det(projection[:, :3])) < 1e-9:
        raise ValueError(f"expected a projection_matrix with focal lengths in {name}, found one that is singular")
    shift = np.asarray(np.linalg.solve(projection[:, :3], projection[:, 3]) * unit_m, dtype=np.float64)
    return one, transform(rotation, -shift, f"rectification_matrix of {name}")


def _refuse_crops(data: Mapping[str, Any]) -> None:
    for key in ("binning_x", "binning_y"):
        if number(data.get(key, 0), key) > 1:
            raise ValueError(f"expected a calibration of the full image, found {key} {data[key]}")


def _write(rig: StereoRig, path: Path) -> list[Path]:
    path.mkdir(parents=True, exist_ok=True)
    left_rotation, right_rotation = rig.rectifying_rotations()
    focal = (rig.left.fy + rig.right.fy) / 2
    paths = []
    for name, one, rotation, shift in (
        ("left", rig.left, left_rotation, 0.0),
        ("right", rig.right, right_rotation, -rig.baseline_m),
    ):
        k = np.array([[focal, 0.0, rig.left.cx], [0.0, focal, rig.left.cy], [0.0, 0.0, 1.0]])
        projection = np.column_stack([k, [focal * shift, 0.0, 0.0]])
        paths.append(path / f"{name}.yaml")
        write_whole(paths[-1], _half_text(name, one, rotation, projection))
    return paths


def _half_text(name: str, one: Camera, rotation: F64, projection: F64) -> str:
    model, coefficients = held("ROS", one, {"brown": 5, "rational": 8, "fisheye": 4})
    lens = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}[model]
    blocks = [
        f"image_width: {one.width}\nimage_height: {one.height}\ncamera_name: {name}\n",
        _block("camera_matrix", one.matrix),
        f"distortion_model: {lens}\n",
        _block("distortion_coefficients", np.array([coefficients])),
        _block("rectification_matrix", rotation),
        _block("projection_matrix", projection),
    ]
    return "".join(blocks)


def _block(name: str, matrix: F64) -> str:
    rows, cols = matrix.shape
    return f"{name}:\n  rows: {rows}\n  cols: {cols}\n  data: {[float(v) for v in matrix.ravel()]}\n"


FORMAT = Format("ros", "ROS camera_info pair", _part, _read, _write, "")
