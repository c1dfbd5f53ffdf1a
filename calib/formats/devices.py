"""Calibrations that come with a camera, DepthAI (OAK) and ZED, or with a published data set, KITTI and Middlebury.

DepthAI: EEPROM JSON with cameras by socket and extrinsics as a chain ``toCameraSocket``, translations in centimetres.
ZED: a section per camera and resolution, the baseline in millimetres. KITTI's calib_cam_to_cam.txt holds four cameras,
raw and rectified, with poses from camera 0; the calib.txt of odometry sequences the projections of the rectified
cameras only. Middlebury's calib.txt is that of a rectified pair, with the baseline in millimetres.
"""

from __future__ import annotations

import configparser
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.camera import Camera
from calib.formats import base
from calib.formats.base import Choice, Format, Size, Source
from calib.io import UNITS_M, size_text
from calib.pose import SE3
from calib.rig import StereoRig


def _depthai_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = base.table(base.parse_json(sources[0].text), "the file")
    listed = base.entry(data, "cameraData")
    if not isinstance(listed, list) or not all(isinstance(item, list) and len(item) == 2 for item in listed):
        raise ValueError("expected cameraData to be a list of [socket, camera]")
    cameras = {_socket(socket): base.table(values, "camera") for socket, values in listed}
    left, right = _sockets(data, cameras, choice)
    for socket in (left, right):
        if socket not in cameras:
            raise ValueError(f"expected a camera at socket {socket}, found sockets {sorted(cameras)}")
    pose = _between(cameras, left, right, choice.unit(UNITS_M["cm"]))
    one, other = (_depthai_camera(cameras[socket], socket) for socket in (left, right))
    return StereoRig(one, other, pose, sources[0].path.name)


def _sockets(data: Mapping[str, Any], cameras: Mapping[int, Any], choice: Choice) -> tuple[int, int]:
    if choice.cameras is not None:
        first, second = map(_socket, choice.cameras)
        return first, second
    stereo = data.get("stereoRectificationData")
    if isinstance(stereo, Mapping):
        pair = tuple(_socket(stereo.get(key, -1)) for key in ("leftCameraSocket", "rightCameraSocket"))
        if pair[0] != pair[1] and set(pair) <= set(cameras):
            return pair[0], pair[1]
    if not {1, 2} <= set(cameras):
        raise ValueError(
            f"expected stereoRectificationData or cameras at the sockets 1 and 2, found sockets {sorted(cameras)} and "
            "nothing that shows which of them are left and right: name the two"
        )
    return 1, 2


def _socket(name: Any) -> int:
    """A socket by its number, as CAM_A, CAM_B, ..., or by the side that it has on most boards."""
    text = str(name).upper().removeprefix("CAMERABOARDSOCKET.")
    named = {"RGB": 0, "LEFT": 1, "RIGHT": 2, "AUTO": -1}
    if len(text) == 5 and text.startswith("CAM_"):
        return ord(text[-1]) - ord("A")
    return named[text] if text in named else int(base.number(name, "socket (a number, or CAM_A to CAM_J)"))


def _depthai_camera(values: Mapping[str, Any], socket: int) -> Camera:
    size = (base.whole_at(values, "width"), base.whole_at(values, "height"))
    coefficients = base.numbers_at(values, (0, 4, 5, 8, 12, 14), "distortionCoeff")
    kind = int(base.number(values.get("cameraType", 0), "cameraType"))  # 0 perspective, 1 fisheye
    if kind not in {0, 1}:
        raise ValueError(f"expected a perspective or fisheye camera at socket {socket}, found cameraType {kind}")
    if kind == 1 and np.any(coefficients[4:]):
        raise ValueError(f"expected 4 fisheye coefficients at socket {socket}, found more")
    coefficients = coefficients[:4] if kind == 1 else coefficients
    matrix = base.numbers_at(values, 9, "intrinsicMatrix")
    return base.camera(size, matrix, coefficients, "fisheye" if kind == 1 else None, f"socket {socket}")


def _between(cameras: Mapping[int, Mapping[str, Any]], left: int, right: int, unit_m: float) -> SE3:
    """Compose the links from left to right; each is a dst_SE3_src that may be walked both ways."""
    known = {left: SE3.identity()}
    links = [link for socket in sorted(cameras) if (link := _link(socket, cameras[socket], unit_m))]
    for src, dst, dst_SE3_src in links * len(links):
        if src in known and dst not in known:
            known[dst] = dst_SE3_src @ known[src]
        elif dst in known and src not in known:
            known[src] = dst_SE3_src.inverse() @ known[dst]
    if right not in known:
        raise ValueError(f"expected extrinsics that link socket {left} to socket {right}, found none")
    return known[right]


def _link(socket: int, values: Mapping[str, Any], unit_m: float) -> tuple[int, int, SE3] | None:
    extrinsics = base.table(base.entry(values, "extrinsics"), "extrinsics")
    to = _socket(extrinsics.get("toCameraSocket", -1))
    if to < 0 or to == socket:
        return None
    t = base.table(base.entry(extrinsics, "translation"), "translation")
    translation = np.array([base.number(base.entry(t, axis), f"translation {axis}") for axis in "xyz"]) * unit_m
    rotation = base.numbers_at(extrinsics, 9, "rotationMatrix")
    return socket, to, base.transform(rotation, translation, f"rotationMatrix of socket {socket}")


_BOARD = base.lines_with(cameraData=r'\A\s*\{[\s\S]*"cameraData"')
DEPTHAI = Format("depthai", "DepthAI EEPROM JSON", (_BOARD,), base.whole_with(_BOARD), _depthai_read)


RESOLUTIONS: dict[str, Size] = {
    "4K": (3840, 2160), "QHDPLUS": (3200, 1800), "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200),
    "HD": (1280, 720), "HD1200": (1280, 1200), "SVGA": (960, 600), "VGA": (672, 376),
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
    left, right = (_zed_camera(sections, f"{side}_CAM_{name}", RESOLUTIONS[name]) for side in ("LEFT", "RIGHT"))
    pose = _pose(base.entry(sections, "STEREO"), name, choice.unit(UNITS_M["mm"]))
    return StereoRig(left, right, pose, f"{source.path.name} [{name}]{remark}")


def _resolution(sections: Mapping[str, Mapping[str, str]], size: Size | None) -> tuple[str, str]:
    """The resolution of the images: the same size, else the largest of the same shape, else the largest."""
    names = [name for name in RESOLUTIONS if f"LEFT_CAM_{name}" in sections and f"RIGHT_CAM_{name}" in sections]
    if not names:
        raise ValueError(f"expected LEFT_CAM and RIGHT_CAM sections of {', '.join(RESOLUTIONS)}, found none")
    if size is None:
        held = ", ".join(size_text(RESOLUTIONS[n]) for n in names)
        return names[0], "" if len(names) == 1 else f" (the largest of {held}; another image size selects another)"
    same = [n for n in names if RESOLUTIONS[n] == size]
    shaped = [n for n in names if RESOLUTIONS[n][0] * size[1] == RESOLUTIONS[n][1] * size[0]]
    return (same or shaped or names)[0], ""


def _zed_camera(sections: Mapping[str, Mapping[str, str]], name: str, size: Size) -> Camera:
    # Newer files keep the lens, which is the same at every resolution, in a section of its own.
    values = {**sections.get(f"{name.split('_')[0]}_DISTO", {}), **sections[name]}
    matrix = np.array([base.number(base.entry(values, key), f"{key} of {name}") for key in ("fx", "fy", "cx", "cy")])
    coefficients = np.array([base.number(values.get(key, 0.0), f"{key} of {name}") for key in _COEFFICIENTS])
    if "k4" in values and not {"p1", "p2", "k5", "k6"} & set(values):  # k1 to k4 alone: Stereolabs' fisheye lens
        return base.camera(size, matrix, coefficients[[0, 1, 4, 5]], "fisheye", name)
    return base.camera(size, matrix, coefficients if np.any(coefficients[5:]) else coefficients[:5], None, name)


def _pose(stereo: Mapping[str, str], resolution: str, unit_m: float) -> SE3:
    """Rotation vector (RX, CV, RZ) and shift (-Baseline, TY, TZ) from left to right."""

    def value(*keys: str) -> float:
        names = (full for key in keys for full in (f"{key}_{resolution}", key) if full in stereo)
        name = next(names, "")
        return base.number(stereo[name], name) if name else 0.0

    baseline = base.number_at(stereo, "Baseline", "BaseLine")
    translation = np.array([-baseline, value("TY"), value("TZ")]) * unit_m
    return SE3.from_rotvec([value("RX"), value("CV", "RY"), value("RZ")], translation)


_SECTIONS = base.lines_with(
    LEFT_CAM=r"^\s*\[LEFT_CAM_\w+\]", RIGHT_CAM=r"^\s*\[RIGHT_CAM_\w+\]", STEREO=r"^\s*\[STEREO\]"
)
ZED = Format("zed", "ZED factory conf", (_SECTIONS,), base.whole_with(_SECTIONS), _zed_read)


_KITTI_PAIRS = (("02", "03"), ("00", "01"))
_DRIVES = [base.lines_with(**{f"{k}_{n}": rf"^{k}_{n}:" for n in pair for k in "KT"}) for pair in _KITTI_PAIRS]
_ROW = r":([ \t]+[-+.\deE]+){12}\s*$"
_SEQUENCES = [base.lines_with(**{f"P{n}": rf"^P{n}{_ROW}" for n in pair}) for pair in ("23", "01")]


def _kitti_read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    source = sources[0]
    data = dict(line.split(":", 1) for line in source.text.splitlines() if ":" in line)
    if base.whole_with(*_SEQUENCES)(source) and not any(name.startswith("K_") for name in data):
        return _of_sequence(source, data, choice)

    def size(key: str) -> Size:
        return base.size_of(base.entry(data, key), key)

    found = (pair for pair in _KITTI_PAIRS if all(f"K_{name}" in data for name in pair))  # colour, else grey
    left, right = choice.cameras or next(found, ("", ""))
    if not left:
        raise ValueError("expected cameras 02 and 03, or 00 and 01, found neither")
    rectified = choice.rectified
    if rectified is None and choice.size is not None and f"S_rect_{left}" in data:
        rectified = size(f"S_rect_{left}") == choice.size != size(f"S_{left}")

    def reading(name: str) -> tuple[Camera, SE3]:
        if rectified:
            p = f"P_rect_{name}"
            return base.projected(size(f"S_rect_{name}"), base.entry(data, p), p, choice.unit())
        k, d = (base.numbers_at(data, n, f"{key}_{name}") for key, n in (("K", 9), ("D", 5)))
        rotation, shift = (base.numbers_at(data, n, f"{key}_{name}") for key, n in (("R", 9), ("T", 3)))
        pose = base.transform(rotation, shift * choice.unit(), f"R_{name}")
        return base.camera(size(f"S_{name}"), k, d, "brown", f"camera {name}"), pose

    kind = "rectified images" if rectified else "unrectified images"
    return base.joined(reading(left), reading(right), f"{source.path.name} [cameras {left} {right}, {kind}]")


def _of_sequence(source: Source, data: Mapping[str, str], choice: Choice) -> StereoRig:
    """The rectified cameras of an odometry sequence, whose image size the file does not give."""
    if choice.size is None:
        raise ValueError("expected the size of the images, which the calib.txt of a KITTI sequence does not hold")
    left, right = choice.cameras or (("2", "3") if "P3" in data else ("0", "1"))
    one, other = (
        base.projected(choice.size, base.entry(data, f"P{name}"), f"P{name}", choice.unit()) for name in (left, right)
    )
    return base.joined(one, other, f"{source.path.name} [cameras {left} {right}, rectified images]")


_KITTI_SETS = (*_DRIVES, *_SEQUENCES)
KITTI = Format("kitti", "KITTI calib_cam_to_cam", _KITTI_SETS, base.whole_with(*_KITTI_SETS), _kitti_read)


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


_SCENE = base.lines_with(**{name: rf"^\s*{name}\s*=" for name in ("cam0", "cam1", "baseline", "width", "height")})
MIDDLEBURY = Format("middlebury", "Middlebury calib.txt", (_SCENE,), base.whole_with(_SCENE), _middlebury_read)
