"""Arrays from image messages: sensor_msgs/image_encodings, JPEG and PNG, compressedDepth."""

from __future__ import annotations

import struct

import cv2
import numpy as np

from calib.types import AnyArray
from stereo.readers.bags.messages import ImageMessage
from stereo.readers.image_header import MAX_PIXELS
from stereo.readers.images import decode_image

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
_TYPES = {"8U": "u1", "8S": "i1", "16U": "u2", "16S": "i2", "32F": "f4", "64F": "f8"}
_DEPTH_HEADER = struct.Struct("<iff")


def stored_pixels(message: ImageMessage) -> AnyArray | None:
    """(H, W) or (H, W, 3) BGR, of the type in which the values were stored; None when it cannot be decoded."""
    try:
        return _raw(message) if message.step else _compressed(message)
    except (cv2.error, ValueError, KeyError, struct.error):
        return None


def _raw(message: ImageMessage) -> AnyArray | None:
    name = message.encoding.lower()
    if name in _YUV:
        pairs = _array(message, "u1", 2)
        return np.asarray(cv2.cvtColor(pairs, _YUV[name]))
    if name[:2] in ("8u", "8s", "16", "32", "64"):
        kind, channels = message.encoding.upper().split("C")
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
    height, step = message.height, message.step
    if not (message.width > 0 and height > 0 and message.width * height <= MAX_PIXELS and used <= step):
        raise ValueError("a size that no image has")
    if len(message.data) < step * (height - 1) + used:
        raise ValueError("less data than the size announces")
    padded = message.data[: step * height].ljust(step * height, b"\0")
    rows = np.frombuffer(padded, np.uint8).reshape(height, step)[:, :used]
    values = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return values if channels == 1 else values.reshape(height, message.width, channels)


def _compressed(message: ImageMessage) -> AnyArray | None:
    if "compressedDepth" not in message.encoding:
        return decode_image(message.data)
    _, quant_a, quant_b = _DEPTH_HEADER.unpack_from(message.data)
    stored = decode_image(message.data[_DEPTH_HEADER.size :])
    if stored is None or not message.encoding.upper().startswith("32FC1"):
        return stored
    # compressed_depth_image_transport codec.cpp: inverse depth, q = A / z + B; 0 where there is none.
    known = stored > 0
    depth = np.full(stored.shape, np.nan, np.float32)
    depth[known] = quant_a / (stored[known].astype(np.float32) - quant_b)
    return depth
