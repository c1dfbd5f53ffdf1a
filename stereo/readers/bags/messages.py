"""The fields of image, camera and transform messages, whatever wrote them: ROS 1, ROS 2, protobuf or JSON."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.formats.fields import transform
from calib.pose import SE3


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """An image as it was sent.

    Attributes:
        encoding: of a raw image the name of its pixels, e.g. "mono8"; of a compressed one its format, e.g. "jpeg".
        width, height, step: of a raw image [px, px, bytes]; 0 of a compressed one.
    """

    encoding: str
    data: bytes
    width: int = 0
    height: int = 0
    step: int = 0
    bigendian: bool = False


def field(message: Any, *names: str) -> Any:
    """The first of these fields that a message has.

    Raises:
        ValueError: it has none of them.
    """
    for name in names:
        if isinstance(message, Mapping):
            if name in message:
                return message[name]
        elif hasattr(message, name):
            return getattr(message, name)
    raise ValueError(f"expected a message with {' or '.join(names)}, found none")


def stamp_ns(message: Any) -> int:
    """When the message was made [ns]."""
    holder = message if _has(message, "timestamp") else field(message, "header")
    time = field(holder, "timestamp", "stamp")
    seconds, rest = field(time, "sec", "seconds"), field(time, "nanosec", "nsec", "nanos")
    return int(seconds) * 10**9 + int(rest)


def frame_id(message: Any) -> str:
    """The frame of reference that the message names."""
    holder = message if _has(message, "frame_id") else field(message, "header")
    return str(field(holder, "frame_id"))


def image_message(message: Any, compressed: bool) -> ImageMessage:
    """A raw or compressed image.

    Raises:
        ValueError: fields that no image has.
    """
    data = field(message, "data")
    content = base64.b64decode(data, validate=True) if isinstance(data, str) else bytes(memoryview(data))
    if compressed:
        return ImageMessage(str(field(message, "format")), content)
    width, height, step = (int(field(message, name)) for name in ("width", "height", "step"))
    bigendian = bool(field(message, "is_bigendian")) if _has(message, "is_bigendian") else False
    return ImageMessage(str(field(message, "encoding")), content, width, height, step, bigendian)


def camera_fields(message: Any) -> dict[str, Any]:
    """A camera_info or CameraCalibration as the keys of ROS's YAML files (``calib.formats.ros``)."""
    fields: dict[str, Any] = {
        key: np.asarray(field(message, key, key.lower()), dtype=np.float64).ravel().tolist() for key in "DKRP"
    }
    fields |= {key: int(field(message, key)) for key in ("width", "height")}
    fields |= {key: int(getattr(message, key, 0) or 0) for key in ("binning_x", "binning_y")}
    return fields | {"distortion_model": str(field(message, "distortion_model"))}


def transforms(message: Any) -> Iterator[tuple[str, str, SE3]]:
    """Parent frame, child frame and parent_SE3_child of a tf message."""
    listed = field(message, "transforms") if _has(message, "transforms") else [message]
    for one in listed:
        if _has(one, "transform"):
            pose = field(one, "transform")
            parent, child = frame_id(one), str(field(one, "child_frame_id"))
        else:
            pose, parent, child = one, str(field(one, "parent_frame_id")), str(field(one, "child_frame_id"))
        translation = np.array([float(field(field(pose, "translation"), axis)) for axis in "xyz"])
        quaternion = np.array([float(field(field(pose, "rotation"), axis)) for axis in "xyzw"])
        yield parent.lstrip("/"), child.lstrip("/"), transform(_rotation(quaternion), translation, "rotation of tf")


def _rotation(q: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(3, 3) rotation of a quaternion (x, y, z, w), normalised."""
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _has(message: Any, name: str) -> bool:
    return name in message if isinstance(message, Mapping) else hasattr(message, name)
