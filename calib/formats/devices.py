"""Calibrations that come with a camera, DepthAI (OAK) and ZED, or with a published data set, KITTI and Middlebury.

DepthAI: EEPROM JSON with cameras by socket and extrinsics as a chain ``toCameraSocket``, translations in centimetres.
ZED: a section per camera and resolution, the baseline in millimetres. KITTI's calib_cam_to_cam.txt holds four cameras,
raw and rectified, with poses from camera 0. Middlebury's calib.txt is that of a rectified pair, with the baseline in
millimetres.
"""

from __future__ import annotations

import configparser
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.io import UNITS_M, parse_size, size_text
from calib.pose import SE3
from calib.rig import StereoRig


def _depthai_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = base.table(base.parse_json(sources[0].text), "the file")
    listed = base.entry(data, "cameraData")
    problem = ValueError("expected cameraData to be a list of [socket, camera]")
    if not isinstance(listed, list):
        raise problem
    cameras = {}
    for item in listed:
        if not isinstance(item, list) or len(item) != 2:
            raise problem
        cameras[_socket(item[0])] = base.table(item[1], "camera")
    left, right = _sockets(data, cameras, choice)
    for socket in (left, right):
        if socket not in cameras:
            raise ValueError(f"expected a camera at socket {socket}, found sockets {sorted(cameras)}")
    pose = _pose_between(cameras, left, right, choice.unit(UNITS_M["cm"]))
    left_camera = _depthai_camera(cameras[left], left)
    right_camera = _depthai_camera(cameras[right], right)
    return StereoRig(left_camera, right_camera, pose, sources[0].path.name)


def _sockets(data: Mapping[str, Any], cameras: Mapping[int, Any], choice: Choice) -> tuple[int, int]:
    if choice.cameras is not None:
        return _socket(choice.cameras[0]), _socket(choice.cameras[1])
    stereo = data.get("stereoRectificationData")
    if isinstance(stereo, Mapping):
        left = _socket(stereo.get("leftCameraSocket", -1))
        right = _socket(stereo.get("rightCameraSocket", -1))
        if left != right and left in cameras and right in cameras:
            return left, right
    if not {1, 2} <= set(cameras):
        raise ValueError(
            f"expected stereoRectificationData or cameras at the sockets 1 and 2, found sockets {sorted(cameras)} and "
            "nothing that shows which of them are left and right: name the two"
        )
    return 1, 2


def _socket(name: Any) -> int:
    """A socket by its number, as CAM_A, CAM_B, ..., or by the side that it has on most boards."""
    text = str(name).upper().removeprefix("CAMERABOARDSOCKET.")
    numbers = {"RGB": 0, "LEFT": 1, "RIGHT": 2, "AUTO": -1}
    if text in numbers:
        return numbers[text]
    if len(text) == 5 and text.startswith("CAM_"):
        return ord(text[-1]) - ord("A")
    return int(base.number(name, "socket (a number, or CAM_A to CAM_J)"))


def _depthai_camera(values: Mapping[str, Any], socket: int) -> Camera:
    size = (base.whole_at(values, "width"), base.whole_at(values, "height"))
    coefficients = base.numbers_at(values, (0, 4, 5, 8, 12, 14), "distortionCoeff")
    kind = int(base.number(values.get("cameraType", 0), "cameraType"))
    model: LensModel | None = None
    if kind == 1:
        model = "fisheye"
        if np.any(coefficients[4:]):
            raise ValueError(f"expected 4 fisheye coefficients at socket {socket}, found more")
        coefficients = coefficients[:4]
    elif kind != 0:  # perspective
        raise ValueError(f"expected a perspective or fisheye camera at socket {socket}, found cameraType {kind}")
    matrix = base.numbers_at(values, 9, "intrinsicMatrix")
    return base.camera(size, matrix, coefficients, model, f"socket {socket}")


def _pose_between(cameras: Mapping[int, Mapping[str, Any]], left: int, right: int, unit_m: float) -> SE3:
    """Compose the links from left to right; each is a dst_SE3_src that may be walked both ways."""
    links = [link for socket in sorted(cameras) if (link := _link(socket, cameras[socket], unit_m))]
    socket_SE3_left = {left: SE3.identity()}
    for src, dst, dst_SE3_src in links * len(links):
        if src in socket_SE3_left and dst not in socket_SE3_left:
            socket_SE3_left[dst] = dst_SE3_src @ socket_SE3_left[src]
        elif dst in socket_SE3_left and src not in socket_SE3_left:
            socket_SE3_left[src] = dst_SE3_src.inverse() @ socket_SE3_left[dst]
    if right not in socket_SE3_left:
        raise ValueError(f"expected extrinsics that link socket {left} to socket {right}, found none")
    return socket_SE3_left[right]


def _link(socket: int, values: Mapping[str, Any], unit_m: float) -> tuple[int, int, SE3] | None:
    extrinsics = base.table(base.entry(values, "extrinsics"), "extrinsics")
    to = _socket(extrinsics.get("toCameraSocket", -1))
    if to < 0 or to == socket:
        return None
    shift = base.table(base.entry(extrinsics, "translation"), "translation")
    translation = np.array([base.number_at(shift, axis) for axis in "xyz"]) * unit_m
    rotation = base.numbers_at(extrinsics, 9, "rotationMatrix")
    return socket, to, base.transform(rotation, translation, f"rotationMatrix of socket {socket}")


_BOARD = base.lines_with(cameraData=r'\A\s*\{[\s\S]*"cameraData"')
DEPTHAI = Format("depthai", "DepthAI EEPROM JSON", (_BOARD,), base.whole_with(_BOARD), _depthai_read)


RESOLUTIONS = {
    name: parse_size(text)
    for name, text in {
        "4K": "3840x2160", "QHDPLUS": "3200x1800", "2K": "2208x1242", "FHD": "1920x1080", "FHD1200": "1920x1200",
        "HD": "1280x720", "HD1200": "1280x1200", "SVGA": "960x600", "VGA": "672x376",
    }.items()
}  # fmt: skip
"""Image size of one camera by the name of the section [px] (Stereolabs' video modes)."""

_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def _zed_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    parser = configparser.ConfigParser(interpolation=None, strict=False, default_section="\0")
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(source.text)
    except configparser.Error as error:
        raise ValueError(f"expected sections with key=value lines, found {' '.join(str(error).split())}") from error
    sections = {name: dict(parser[name]) for name in parser.sections()}
    name, remark = _resolution(sections, choice.size)
    left = _zed_camera(sections, "LEFT", name)
    right = _zed_camera(sections, "RIGHT", name)
    pose = _pose(base.entry(sections, "STEREO"), name, choice.unit(UNITS_M["mm"]))
    return StereoRig(left, right, pose, f"{source.path.name} [{name}]{remark}")


def _resolution(sections: Mapping[str, Mapping[str, str]], size: Size | None) -> tuple[str, str]:
    """The resolution of the images (the same size, else the largest of the same shape, else the largest), and a remark
    where no size of the images selects it."""
    sizes = {}
    for name, own_size in RESOLUTIONS.items():
        if f"LEFT_CAM_{name}" in sections and f"RIGHT_CAM_{name}" in sections:
            sizes[name] = own_size
    if not sizes:
        raise ValueError(f"expected LEFT_CAM and RIGHT_CAM sections of {', '.join(RESOLUTIONS)}, found none")
    largest = next(iter(sizes))
    if size is None:
        choice = ", ".join(map(size_text, sizes.values()))
        remark = f" (the largest of {choice}; another image size selects another)"
        return largest, remark if len(sizes) > 1 else ""
    same = [name for name in sizes if sizes[name] == size]
    shaped = [name for name, (width, height) in sizes.items() if width * size[1] == height * size[0]]
    return (same or shaped or [largest])[0], ""


def _zed_camera(sections: Mapping[str, Mapping[str, str]], side: str, resolution: str) -> Camera:
    name = f"{side}_CAM_{resolution}"
    size = RESOLUTIONS[resolution]
    # Newer files keep the lens, which is the same at every resolution, in a section of its own.
    values = {**sections.get(f"{side}_DISTO", {}), **sections[name]}
    matrix = np.array([base.number_at(values, key) for key in ("fx", "fy", "cx", "cy")])
    coefficients = np.array([base.number(values.get(key, 0.0), f"{key} of {name}") for key in _COEFFICIENTS])
    # k1 to k4 alone: Stereolabs' fisheye lens.
    if "k4" in values and not {"p1", "p2", "k5", "k6"} & set(values):
        return base.camera(size, matrix, coefficients[[0, 1, 4, 5]], "fisheye", name)
    if not np.any(coefficients[5:]):
        coefficients = coefficients[:5]
    return base.camera(size, matrix, coefficients, None, name)


def _pose(stereo: Mapping[str, str], resolution: str, unit_m: float) -> SE3:
    """Rotation vector (RX, CV, RZ) and shift (-Baseline, TY, TZ) from left to right."""

    def value(*keys: str) -> float:
        for key in keys:
            for name in (f"{key}_{resolution}", key):
                if name in stereo:
                    return base.number(stereo[name], name)
        return 0.0

    baseline = base.number_at(stereo, "Baseline", "BaseLine")
    translation = np.array([-baseline, value("TY"), value("TZ")]) * unit_m
    return SE3.from_rotvec([value("RX"), value("CV", "RY"), value("RZ")], translation)


_SECTIONS = base.lines_with(
    LEFT_CAM=r"^\s*\[LEFT_CAM_\w+\]", RIGHT_CAM=r"^\s*\[RIGHT_CAM_\w+\]", STEREO=r"^\s*\[STEREO\]"
)
ZED = Format("zed", "ZED factory conf", (_SECTIONS,), base.whole_with(_SECTIONS), _zed_read)


def _values_by_key(text: str, separator: str) -> dict[str, str]:
    """Text after the separator in each line, without brackets, by the text before."""
    values = {}
    for line in text.splitlines():
        key, mark, value = line.partition(separator)
        if mark:
            values[key.strip()] = value.strip(" []")
    return values


_DRIVES = (
    base.lines_with(K_02="^K_02:", T_02="^T_02:", K_03="^K_03:", T_03="^T_03:"),
    base.lines_with(K_00="^K_00:", T_00="^T_00:", K_01="^K_01:", T_01="^T_01:"),
)


def _kitti_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    data = _values_by_key(source.text, ":")
    left, right = choice.cameras or _kitti_pair(data)
    rectified = choice.rectified
    if rectified is None and choice.size is not None and f"S_rect_{left}" in data:
        rectified = _size_at(data, f"S_rect_{left}") == choice.size != _size_at(data, f"S_{left}")
    camera = _rectified_camera if rectified else _raw_camera
    kind = "rectified" if rectified else "unrectified"
    name = f"{source.path.name} [cameras {left} {right}, {kind} images]"
    return base.join_cameras(camera(data, left, choice), camera(data, right, choice), name)


def _kitti_pair(data: Mapping[str, str]) -> tuple[str, str]:
    """Names of the colour cameras, else of the grey ones."""
    for left, right in (("02", "03"), ("00", "01")):
        if f"K_{left}" in data and f"K_{right}" in data:
            return left, right
    raise ValueError("expected cameras 02 and 03, or 00 and 01, found neither")


def _size_at(data: Mapping[str, str], key: str) -> Size:
    return base.size_of(base.entry(data, key), key)


def _rectified_camera(data: Mapping[str, str], name: str, choice: Choice) -> tuple[Camera, SE3]:
    key = f"P_rect_{name}"
    return base.camera_from_projection(_size_at(data, f"S_rect_{name}"), base.entry(data, key), key, choice.unit())


def _raw_camera(data: Mapping[str, str], name: str, choice: Choice) -> tuple[Camera, SE3]:
    matrix = base.numbers_at(data, 9, f"K_{name}")
    distortion = base.numbers_at(data, 5, f"D_{name}")
    rotation = base.numbers_at(data, 9, f"R_{name}")
    translation = base.numbers_at(data, 3, f"T_{name}") * choice.unit()
    camera = base.camera(_size_at(data, f"S_{name}"), matrix, distortion, "brown", f"camera {name}")
    return camera, base.transform(rotation, translation, f"R_{name}")


KITTI = Format("kitti", "KITTI calib_cam_to_cam", _DRIVES, base.whole_with(*_DRIVES), _kitti_read)


def _middlebury_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = _values_by_key(sources[0].text, "=")
    size = base.whole_at(data, "width"), base.whole_at(data, "height")
    left = base.camera(size, base.numbers_at(data, 9, "cam0"), np.empty(0), "brown", "cam0")
    right = base.camera(size, base.numbers_at(data, 9, "cam1"), np.empty(0), "brown", "cam1")
    expected = right.cx - left.cx
    offset = base.number(data.get("doffs", expected), "doffs")
    if abs(offset - expected) > 0.5:
        raise ValueError(f"expected doffs to be the principal points' distance {expected:g}, found {offset:g}")
    baseline = base.number_at(data, "baseline") * choice.unit(UNITS_M["mm"])
    return StereoRig(left, right, SE3(np.eye(3), np.array([-baseline, 0.0, 0.0])), sources[0].path.name)


_SCENE = base.lines_with(**{name: rf"^\s*{name}\s*=" for name in ("cam0", "cam1", "baseline", "width", "height")})
MIDDLEBURY = Format("middlebury", "Middlebury calib.txt", (_SCENE,), base.whole_with(_SCENE), _middlebury_read)
