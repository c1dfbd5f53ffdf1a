"""Messages of bags: images and their pixels, cameras, transforms."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

from calib.errors import UnreadableError
from calib.formats.base import transform
from calib.io import size_text
from calib.pose import SE3
from calib.types import AnyArray
from stereo.readers.images import MAX_PIXELS, decode_image


@dataclass(frozen=True, eq=False)
class ImageMessage:
    """An image as it was sent: of a raw one the name of its pixels ("mono8"), its size and step [px, px, bytes], of a
    compressed one its format ("jpeg")."""

    encoding: str
    data: bytes
    width: int = -1
    height: int = 0
    step: int = 0
    bigendian: bool = False


def stamp_ns(message: Any) -> int:
    """When a message with a header was made [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def frame_id(message: Any) -> str:
    """The frame of reference of a message with a header."""
    return str(message.header.frame_id).lstrip("/")


def image_message(message: Any) -> ImageMessage:
    """A raw or compressed image."""
    data = bytes(memoryview(message.data))
    if hasattr(message, "format"):
        return ImageMessage(str(message.format), data)
    size = int(message.width), int(message.height), int(message.step)
    return ImageMessage(str(message.encoding), data, *size, bool(message.is_bigendian))


def camera_fields(message: Any) -> dict[str, Any]:
    """A camera_info as the keys of ROS's YAML files (``calib.formats.ros``): ROS 2 writes the matrices in small
    letters."""
    fields: dict[str, Any] = {"distortion_model": str(message.distortion_model)}
    for key in "DKRP":
        values = getattr(message, key if hasattr(message, key) else key.lower())
        fields[key] = np.asarray(values, dtype=np.float64).ravel().tolist()
    for key in ("width", "height", "binning_x", "binning_y"):
        fields[key] = int(getattr(message, key))
    fields["roi"] = {key: int(getattr(message.roi, key)) for key in ("x_offset", "y_offset", "width", "height")}
    return fields


def transforms(message: Any) -> Iterator[tuple[str, str, SE3]]:
    """Parent frame, child frame and parent_SE3_child of a tf message."""
    for one in message.transforms:
        yield frame_id(one), str(one.child_frame_id).lstrip("/"), pose_of(one.transform)


def pose_of(message: Any) -> SE3:
    """The pose of a transform."""
    from scipy.spatial.transform import Rotation  # a tenth of a second, and only transforms need it

    place = message.translation
    turn = message.rotation
    rotation = np.asarray(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), dtype=np.float64)
    return transform(rotation, np.array([place.x, place.y, place.z], dtype=np.float64), "rotation of tf")


_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_FROM = {
    "rgb": cv2.COLOR_RGB2BGR, "rgba": cv2.COLOR_RGBA2BGR, "bgra": cv2.COLOR_BGRA2BGR,
}  # fmt: skip
# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
_BAYER = {
    "bayer_rggb": cv2.COLOR_BayerBG2BGR, "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR, "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}  # fmt: skip
_YUV = {
    "yuv422": cv2.COLOR_YUV2BGR_UYVY, "uyvy": cv2.COLOR_YUV2BGR_UYVY, "yuv422_uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2, "yuyv": cv2.COLOR_YUV2BGR_YUY2,
}  # fmt: skip
_TYPES = {"8U": "u1", "16U": "u2", "32F": "f4"}
_DEPTH_HEADER = struct.Struct("<iff")


def stored_pixels(message: ImageMessage) -> AnyArray:
    """(H, W) or (H, W, 3) BGR, of the type in which the values were stored. Raises UnreadableError."""
    try:
        return _raw(message) if message.width >= 0 else _decompress(message)
    except UnreadableError:
        raise
    except KeyError as error:
        raise UnreadableError(
            f"pixels coded as {message.encoding!r}, which is not read: publish mono8 or bgr8"
        ) from error
    except (cv2.error, ValueError, struct.error) as error:
        raise UnreadableError(f"damaged pixels of {message.encoding!r}") from error


def _raw(message: ImageMessage) -> AnyArray:
    name = message.encoding.lower()
    if name in _YUV:
        pairs = _array(message, "u1", 2)
        return np.asarray(cv2.cvtColor(pairs, _YUV[name]))
    if name[:2] in ("8u", "16", "32"):
        kind, channels = message.encoding.upper().split("C")
        if channels not in ("", "1", "3", "4"):
            raise ValueError("channels that no image has")
        values = _array(message, _TYPES[kind], int(channels or 1))
        return values if values.ndim == 2 or values.shape[2] == 3 else np.ascontiguousarray(values[..., :3])
    wide = name.endswith("16")
    base = name.removesuffix("16").removesuffix("8")
    if base in _BAYER:
        return np.asarray(cv2.cvtColor(_array(message, "u2" if wide else "u1", 1), _BAYER[base]))
    values = _array(message, "u2" if wide else "u1", _CHANNELS[base])
    return np.asarray(cv2.cvtColor(values, _FROM[base])) if base in _FROM else values


def _array(message: ImageMessage, kind: str, channels: int) -> AnyArray:
    """(H, W) or (H, W, channels) values without what pads the rows; refuses a size that the data does not hold."""
    dtype = np.dtype((">" if message.bigendian else "<") + kind)
    used = message.width * channels * dtype.itemsize
    height = message.height
    step = message.step
    held = len(message.data)
    if not (message.width > 0 and height > 0 and message.width * height <= MAX_PIXELS):
        raise UnreadableError(f"an image of {size_text((message.width, height))} pixels")
    if held == used * height:
        step = used  # rows without padding, whatever the message calls their step
    if step < used or held < step * (height - 1) + used:
        pixels = f"{height} rows of {message.width} pixels of {message.encoding} take {used * height}"
        raise UnreadableError(f"{held} bytes in steps of {step}, where {pixels}")
    rows = as_strided(np.frombuffer(message.data, np.uint8), (height, used), (step, 1))
    values = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return values if channels == 1 else values.reshape(height, message.width, channels)


def _decompress(message: ImageMessage) -> AnyArray:
    if "compressedDepth" not in message.encoding:
        try:
            return decode_image(message.data)
        except UnreadableError as error:
            raise UnreadableError(f"images coded as {message.encoding!r} ({error})") from error
    if message.encoding.endswith("rvl"):
        raise UnreadableError("depth coded as rvl, which is not read: publish it raw, or as png")
    _, quant_a, quant_b = _DEPTH_HEADER.unpack_from(message.data)
    stored = decode_image(message.data[_DEPTH_HEADER.size :])
    if not message.encoding.upper().startswith("32FC1"):
        return stored
    # compressed_depth_image_transport codec.cpp: inverse depth, q = A / z + B; 0 where there is none.
    known = stored > 0
    depth = np.full(stored.shape, np.nan, np.float32)
    depth[known] = quant_a / (stored[known].astype(np.float32) - quant_b)
    return depth
