"""Calibrations of the world of ROS: camera_info pairs, Kalibr's camchain, and EuRoC's sensor.yaml.

camera_info is a YAML file per camera, as camera_calibration writes it or as the message is printed; camchain a table
per camera, with poses as nested rows or as 16 values in a row. EuRoC's sensor.yaml lies in each camera's folder; T_BS
maps the camera to the body.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64

_INFO = base.lines_with(
    camera_matrix=r"^\s*(camera_matrix|K|k)\s*:", distortion_model=r"^\s*distortion_model\s*:",
    rectification_matrix=r"^\s*(rectification_matrix|R|r)\s*:", projection_matrix=r"^\s*(projection_matrix|P|p)\s*:",
)  # fmt: skip
_NAME = re.compile(r"^\s*camera_name\s*:\s*(.*)$", re.MULTILINE)
_ROS_MODELS: dict[str, LensModel] = {
    "plumb_bob": "brown", "rational_polynomial": "rational", "equidistant": "fisheye", "fisheye": "fisheye",
    "kannala_brandt": "fisheye", "": "brown",
}  # fmt: skip


_ROS_COUNTS: dict[LensModel, tuple[int, ...]] = {
    "brown": (0, 4, 5, 8, 12, 14), "rational": (8, 12, 14), "fisheye": (4,),
}  # fmt: skip


def _ros_part(source: Source) -> str | None:
    if not base.whole_with(_INFO)(source):
        return None
    name = _NAME.search(source.text)
    names = (name[1] if name else "", source.path.stem, source.path.parent.name)
    return next(filter(None, map(base.side_of, names)), None)


def _ros_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    halves = []
    for source in sources:
        camera, rectified_SE3_camera = camera_from(base.parse_yaml(source.text), source.path.name, choice.unit())
        halves.append((camera, rectified_SE3_camera.inverse()))
    return base.join_cameras(halves[0], halves[1], "+".join(source.path.name for source in sources))


def camera_from(data: Mapping[str, Any], name: str, unit_m: float = 1.0) -> tuple[Camera, SE3]:
    """A camera from the fields of a camera_info, and its pose in the rectified left frame.

    P = K [I | t] sees the rectified left frame shifted by t; R turns the camera into it.
    """
    size, k, projection = sent_image(data)
    model = base.lens_of(data, _ROS_MODELS, name)
    coefficients = base.numbers_at(data, _ROS_COUNTS[model], "distortion_coefficients", "D", "d")
    if model == "brown" and len(coefficients) > 5:
        model = "rational"  # some drivers call every polynomial plumb_bob
    camera = base.camera(size, k.ravel(), coefficients, model, name)
    rotation = base.numbers_at(data, 9, "rectification_matrix", "R", "r")
    rectified = projection[:, :3]
    if abs(np.linalg.det(rectified)) < 1e-9:
        raise ValueError(f"expected a projection_matrix with focal lengths in {name}, found one that is singular")
    shift = np.asarray(np.linalg.solve(rectified, projection[:, 3]) * unit_m)
    return camera, base.transform(rotation, -shift, f"rectification_matrix of {name}")


def sent_image(data: Mapping[str, Any]) -> tuple[Size, F64, F64]:
    """Size [px], K (3, 3) and P (3, 4) of the image that was sent: region of interest first, then binning.

    K and P are of the sensor (sensor_msgs/CameraInfo); width and height may be the sensor's or the region's.
    """
    width = base.whole_at(data, "image_width", "width")
    height = base.whole_at(data, "image_height", "height")
    k = base.numbers_at(data, 9, "camera_matrix", "K", "k").reshape(3, 3)
    projection = base.numbers_at(data, 12, "projection_matrix", "P", "p").reshape(3, 4)
    region = region_of(data)
    if region is not None:
        x, y, region_width, region_height = region
        is_outside = x + region_width > width or y + region_height > height
        if is_outside and (region_width, region_height) != (width, height):
            raise ValueError(f"expected a region of interest inside {width}x{height}, found {region}")
        width = region_width
        height = region_height
        shift = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
        k = shift @ k
        projection = shift @ projection
    bin_x = max(base.number(data.get("binning_x", 0), "binning_x"), 1.0)
    bin_y = max(base.number(data.get("binning_y", 0), "binning_y"), 1.0)
    shrink = np.diag([1.0 / bin_x, 1.0 / bin_y, 1.0])
    return (int(width // bin_x), int(height // bin_y)), shrink @ k, shrink @ projection


def region_of(data: Mapping[str, Any]) -> tuple[int, int, int, int] | None:
    """Left, top, width, height [px] of the part of the sensor that the images show; None where they show all."""
    roi = base.table(data.get("roi") or {}, "roi")
    names = ("x_offset", "y_offset", "width", "height")
    x, y, width, height = (int(base.number(roi.get(key, 0), f"roi {key}")) for key in names)
    full_width = base.whole_at(data, "image_width", "width")
    full_height = base.whole_at(data, "image_height", "height")
    if x == y == 0 and (width, height) in ((0, 0), (full_width, full_height)):
        return None
    return x, y, width or full_width - x, height or full_height - y


def _ros_texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    left_rotation, right_rotation = rig.rectifying_rotations()
    focal = (rig.left.fy + rig.right.fy) / 2
    left = np.array([[focal, 0.0, rig.left.cx, 0.0], [0.0, focal, rig.left.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    right = left.copy()
    right[0, 3] = focal * -rig.baseline_m
    return {
        path / "left.yaml": _info_text("left", rig.left, left_rotation, left),
        path / "right.yaml": _info_text("right", rig.right, right_rotation, right),
    }


def _info_text(name: str, camera: Camera, rotation: F64, projection: F64) -> str:
    """A camera_info with (3, 3) rectification and (3, 4) projection."""
    model, coefficients = base.exact_lens("ROS", camera, {"brown": 5, "rational": 8, "fisheye": 4})
    lens_names = {"brown": "plumb_bob", "rational": "rational_polynomial", "fisheye": "equidistant"}
    fields: dict[str, Any] = {"image_width": camera.width, "image_height": camera.height}
    fields["camera_name"] = name
    fields["distortion_model"] = lens_names[model]
    matrices = {
        "camera_matrix": camera.matrix,
        "distortion_coefficients": np.array([coefficients]),
        "rectification_matrix": rotation,
        "projection_matrix": projection,
    }
    for key, matrix in matrices.items():
        rows, cols = matrix.shape
        fields[key] = {"rows": rows, "cols": cols, "data": matrix.ravel().tolist()}
    return base.yaml_text(fields)


ROS = Format("ros", "ROS camera_info pair", (_INFO,), _ros_part, _ros_read, _ros_texts, "")


_PINHOLE_LENSES: dict[str, LensModel] = {
    "radtan": "brown", "radial-tangential": "brown", "equidistant": "fisheye", "none": "brown",
}  # fmt: skip


def _pinhole(values: Mapping[str, Any], name: str, key: str, counts: tuple[int, ...]) -> Camera:
    """A camera of Kalibr's or EuRoC's, whose ``key`` holds these numbers of coefficients."""
    model = base.lens_of(values, _PINHOLE_LENSES, name)
    if values["distortion_model"] == "none":
        coefficients = base.numbers(values.get(key, []), f"{key} of {name}", (0, 4))
    else:
        coefficients = base.numbers(base.entry(values, key), f"{key} of {name}", counts)
    intrinsics = base.numbers(base.entry(values, "intrinsics"), f"intrinsics of {name}", 4)
    size = base.size_of(base.entry(values, "resolution"), "resolution")
    return base.camera(size, intrinsics, coefficients, model, name)


def _kalibr_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = base.parse_yaml(sources[0].text)
    cameras = []
    left, right = choice.cameras or ("cam0", "cam1")
    for name in (left, right):
        values = base.table(base.entry(data, name), name)
        model = str(values.get("camera_model", "pinhole"))
        if model != "pinhole":
            raise ValueError(f"expected a pinhole camera_model in {name}, found {model!r}")
        cameras.append(_pinhole(values, name, "distortion_coeffs", (4,)))
    return StereoRig(cameras[0], cameras[1], _pose(data, left, right, choice.unit()), sources[0].path.name)


def _pose(data: Mapping[str, Any], left: str, right: str, unit_m: float) -> SE3:
    """right_SE3_left from T_cn_cnm1 (Kalibr's own result) where there is one, else through the IMU."""
    names = [f"cam{index}" for index in range(_index(left) + 1, _index(right) + 1)]
    links = [base.table(data.get(name, {}), name) for name in names]
    if not links or not all("T_cn_cnm1" in link for link in links):
        return _from_imu(data, right, unit_m) @ _from_imu(data, left, unit_m).inverse()
    pose = SE3.identity()
    for link in links:
        pose = base.rigid(link["T_cn_cnm1"], "T_cn_cnm1", unit_m) @ pose
    return pose


def _from_imu(data: Mapping[str, Any], name: str, unit_m: float) -> SE3:
    values = base.table(data[name], name)
    if "T_cam_imu" in values:
        return base.rigid(values["T_cam_imu"], f"T_cam_imu of {name}", unit_m)
    if "T_imu_cam" in values:
        return base.rigid(values["T_imu_cam"], f"T_imu_cam of {name}", unit_m).inverse()
    raise ValueError(f"expected T_cn_cnm1, T_cam_imu or T_imu_cam in {name}, found none")


def _index(name: str) -> int:
    match = re.fullmatch(r"cam(\d{1,3})", name)
    if match is None:
        raise ValueError(f"expected cameras named cam0, cam1, ..., found {name!r}")
    return int(match[1])


def _kalibr_texts(rig: StereoRig, path: Path) -> dict[Path, str]:
    pose = {"T_cn_cnm1": rig.right_SE3_left.matrix.tolist()}
    return {path: base.yaml_text({"cam0": _kalibr_entry(rig.left), "cam1": _kalibr_entry(rig.right) | pose})}


def _kalibr_entry(one: Camera) -> dict[str, Any]:
    model, coefficients = base.exact_lens("Kalibr", one, {"brown": 4, "fisheye": 4})
    return {
        "camera_model": "pinhole", "intrinsics": [float(value) for value in (one.fx, one.fy, one.cx, one.cy)],
        "distortion_model": "equidistant" if model == "fisheye" else "radtan", "distortion_coeffs": coefficients,
        "resolution": [*one.size],
    }  # fmt: skip


_CHAIN = base.lines_with(
    cam0=r"^\s*[\"']?cam\d+[\"']?\s*:", distortion_coeffs=r"^\s*(camera_model|distortion_coeffs)\s*:"
)
KALIBR = Format("kalibr", "Kalibr camchain", (_CHAIN,), base.whole_with(_CHAIN), _kalibr_read, _kalibr_texts, ".yaml")


_SENSOR = base.lines_with(T_BS=r"^\s*T_BS\s*:", intrinsics=r"^\s*intrinsics\s*:")  # an IMU's has T_BS, too


def _euroc_part(source: Source) -> str | None:
    if not base.whole_with(_SENSOR)(source):
        return None
    return base.side_of(source.path.parent.name) or base.side_of(source.path.stem)


def _euroc_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    names = [f"{source.path.parent.name}/{source.path.name}" for source in sources]
    halves = []
    for source, name in zip(sources, names, strict=True):
        data = base.parse_yaml(source.text)
        body_SE3_camera = base.rigid(base.entry(data, "T_BS"), f"T_BS of {name}", choice.unit())
        halves.append((_pinhole(data, name, "distortion_coefficients", (0, 4)), body_SE3_camera.inverse()))
    return base.join_cameras(halves[0], halves[1], "+".join(names))


EUROC = Format("euroc", "EuRoC sensor.yaml pair", (_SENSOR,), _euroc_part, _euroc_read)
