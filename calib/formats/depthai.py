"""DepthAI EEPROM JSON: cameras by socket, extrinsics as a chain ``toCameraSocket``, translations in centimetres."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera
from calib.files import write_whole
from calib.formats.fields import camera, entry, held, number, numbers, table, transform, whole
from calib.formats.source import Choice, Format, Source
from calib.pose import SE3
from calib.rig import StereoRig

_CENTIMETRE_M = 0.01
_FISHEYE = 1
_PERSPECTIVE = 0


def _part(source: Source) -> str | None:
    return "whole" if '"cameraData"' in source.text and source.text.lstrip().startswith("{") else None


def _read(sources: Sequence[Source], choice: Choice) -> StereoRig:
    data = table(_json(sources[0].text), "the file")
    cameras = _by_socket(data)
    left, right = _sockets(data, cameras, choice)
    for socket in (left, right):
        if socket not in cameras:
            raise ValueError(f"expected a camera at socket {socket}, found sockets {sorted(cameras)}")
    pose = _between(cameras, left, right, choice.unit(_CENTIMETRE_M))
    return StereoRig(_camera(cameras[left], left), _camera(cameras[right], right), pose, sources[0].path.name)


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("expected JSON, found nesting without end") from None


def _by_socket(data: Mapping[str, Any]) -> dict[int, Mapping[str, Any]]:
    listed = entry(data, "cameraData")
    if not isinstance(listed, list):
        raise ValueError("expected cameraData to be a list of [socket, camera]")
    cameras = {}
    for item in listed:
        if not isinstance(item, list) or len(item) != 2:
            raise ValueError("expected cameraData to be a list of [socket, camera]")
        cameras[int(number(item[0], "socket"))] = table(item[1], "camera")
    return cameras


def _sockets(data: Mapping[str, Any], cameras: Mapping[int, Any], choice: Choice) -> tuple[int, int]:
    if choice.cameras is not None:
        first, second = (int(number(name, "socket")) for name in choice.cameras)
        return first, second
    stereo = data.get("stereoRectificationData")
    if isinstance(stereo, Mapping):
        pair = tuple(int(number(stereo.get(key, -1), key)) for key in ("leftCameraSocket", "rightCameraSocket"))
        if pair[0] != pair[1] and set(pair) <= set(cameras):
            return pair[0], pair[1]
    return 1, 2


def _camera(values: Mapping[str, Any], socket: int) -> Camera:
    size = (whole(entry(values, "width"), "width"), whole(entry(values, "height"), "height"))
    coefficients = numbers(entry(values, "distortionCoeff"), "distortionCoeff", (0, 4, 5, 8, 12, 14))
    kind = int(number(values.get("cameraType", _PERSPECTIVE), "cameraType"))
    if kind not in {_PERSPECTIVE, _FISHEYE}:
        raise ValueError(f"expected a perspective or fisheye camera at socket {socket}, found cameraType {kind}")
    matrix = numbers(entry(values, "intrinsicMatrix"), "intrinsicMatrix", 9)
    if kind == _FISHEYE:
        if np.any(coefficients[4:]):
            raise ValueError(f"expected 4 fisheye coefficients at socket {socket}, found more")
        return camera(size, matrix, coefficients[:4], "fisheye", f"socket {socket}")
    return camera(size, matrix, coefficients, None, f"socket {socket}")


def _between(cameras: Mapping[int, Mapping[str, Any]], left: int, right: int, unit_m: float) -> SE3:
    """Compose the links from left to right; each is a dst_SE3_src that may be walked both ways."""
    known = {left: SE3.identity()}
    frontier = [left]
    links = [link for socket in sorted(cameras) if (link := _link(socket, cameras[socket], unit_m))]
    while frontier and right not in known:
        here = frontier.pop(0)
        for src, dst, dst_SE3_src in links:
            if src == here and dst not in known:
                known[dst] = dst_SE3_src @ known[here]
                frontier.append(dst)
            elif dst == here and src not in known:
                known[src] = dst_SE3_src.inverse() @ known[here]
                frontier.append(src)
    if right not in known:
        raise ValueError(f"expected extrinsics that link socket {left} to socket {right}, found none")
    return known[right]


def _link(socket: int, values: Mapping[str, Any], unit_m: float) -> tuple[int, int, SE3] | None:
    extrinsics = table(entry(values, "extrinsics"), "extrinsics")
    to = int(number(extrinsics.get("toCameraSocket", -1), "toCameraSocket"))
    if to < 0 or to == socket:
        return None
    t = table(entry(extrinsics, "translation"), "translation")
    translation = np.array([number(entry(t, axis), f"translation {axis}") for axis in "xyz"]) * unit_m
    rotation = numbers(entry(extrinsics, "rotationMatrix"), "rotationMatrix", 9)
    return socket, to, transform(rotation, translation, f"rotationMatrix of socket {socket}")


def _write(rig: StereoRig, path: Path) -> list[Path]:
    link = rig.right_SE3_left
    entries = [[1, _entry(rig.left, link, 2)], [2, _entry(rig.right, SE3.identity(), -1)]]
    stereo = {"leftCameraSocket": 1, "rightCameraSocket": 2}
    data = {"boardName": "", "cameraData": entries, "stereoRectificationData": stereo, "version": 7}
    write_whole(path, json.dumps(data, indent=1))
    return [path]


def _entry(one: Camera, pose: SE3, to: int) -> dict[str, Any]:
    model, coefficients = held("DepthAI", one, {"rational": 14, "brown": 14, "fisheye": 4})
    translation = dict(zip("xyz", (pose.translation / _CENTIMETRE_M).tolist(), strict=True))
    return {
        "cameraType": _FISHEYE if model == "fisheye" else _PERSPECTIVE,
        "distortionCoeff": [*coefficients, *[0.0] * (14 - len(coefficients))],
        "extrinsics": {
            "rotationMatrix": pose.rotation.tolist(),
            "specTranslation": translation,
            "toCameraSocket": to,
            "translation": translation,
        },
        "height": one.height,
        "intrinsicMatrix": one.matrix.tolist(),
        "width": one.width,
    }


FORMAT = Format("depthai", "DepthAI EEPROM JSON", _part, _read, _write, ".json")
