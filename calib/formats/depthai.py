"""DepthAI EEPROM JSON: ``cameraData`` by socket, extrinsics to a neighbouring socket in centimetres."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import StereoRig

LEFT_SOCKET, RIGHT_SOCKET = 1, 2
_CAMERA_TYPES: dict[int, LensModel] = {0: "rational", 1: "fisheye"}


def load_rig(path: Path) -> StereoRig:
    """Read the stereo pair (socket 1 left, 2 right) of a DepthAI device.

    Raises:
        InputError: unreadable, a socket missing, or values that cannot be a rig.
    """
    try:
        entries = {int(socket): data for socket, data in json.loads(path.read_text(encoding="utf-8"))["cameraData"]}
        left, right = _camera(entries[LEFT_SOCKET]), _camera(entries[RIGHT_SOCKET])
        rig = StereoRig(left, right, _between(entries, RIGHT_SOCKET, LEFT_SOCKET), path.name)
    except KeyError as error:
        raise InputError(f"{path}: expected a DepthAI calibration with {error}, found none") from error
    except (OSError, UnicodeDecodeError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: expected a DepthAI calibration, found {error}") from error
    return rig.check(str(path))


def _camera(data: dict[str, Any]) -> Camera:
    k = np.array(data["intrinsicMatrix"], dtype=np.float64)
    if k.shape != (3, 3):
        raise ValueError(f"an intrinsicMatrix of shape {k.shape}")
    model = _CAMERA_TYPES.get(int(data.get("cameraType", 0)), "rational")
    coefficients = [float(c) for c in data["distortionCoeff"]][: 4 if model == "fisheye" else 14]
    size = int(data["width"]), int(data["height"])
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(*size, fx, fy, cx, cy, model, tuple(coefficients))


def _between(entries: dict[int, Any], target: int, source: int) -> SE3:
    """target_SE3_source, from the tree in which every socket names the socket its extrinsics lead to."""
    to_root = {}
    for start in (target, source):
        chain, socket = {start: SE3.identity()}, start
        while (link := entries[socket]["extrinsics"])["toCameraSocket"] >= 0:
            step, parent = _step(link), int(link["toCameraSocket"])
            if parent in chain:
                raise ValueError(f"extrinsics that go round in a circle at socket {parent}")
            chain[parent] = step @ chain[socket]
            socket = parent
        to_root[start] = chain
    shared = [socket for socket in to_root[source] if socket in to_root[target]]
    if not shared:
        raise ValueError(f"no extrinsics between the sockets {source} and {target}")
    return to_root[target][shared[0]].inverse() @ to_root[source][shared[0]]


def _step(link: dict[str, Any]) -> SE3:
    """toCamera_SE3_this of one entry; the file's translations are in centimetres."""
    translation = np.array([float(link["translation"][axis]) for axis in "xyz"]) / 100.0
    return SE3(np.array(link["rotationMatrix"], dtype=np.float64), translation)
