"""Small bags of either kind with the same messages."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from toy_recordings import H, W, picture

from calib.types import AnyArray

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

COUNT, STEP_NS, START_NS = 8, 100_000_000, 1_650_000_000_000_000_000
FOCAL = 30.0
TF = """geometry_msgs/TransformStamped[] transforms
================================================================================
MSG: geometry_msgs/TransformStamped
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
"""


class Writer:
    """Writes a bag of either kind with the same messages."""

    def __init__(self, path: Path, ros1: bool, plugin: str = "sqlite3", chunks: str = "") -> None:
        self.ros1 = ros1
        self.store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if ros1 else typesys.Stores.ROS2_HUMBLE)
        storage = {"mcap": rosbag2.StoragePlugin.MCAP, "sqlite3": rosbag2.StoragePlugin.SQLITE3}[plugin]
        self.bag = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9, storage_plugin=storage)
        if chunks:
            self.bag.set_compression(rosbag1.Writer.CompressionFormat[chunks.upper()])
        self.bag.open()
        self.connections = {}

    def write(self, topic: str, log_ns: int, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.bag.add_connection(topic, kind, typestore=self.store)
        data = self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind)
        self.bag.write(self.connections[topic], log_ns, data)

    def header(self, stamp_ns: int, frame: str = "cam") -> Any:
        types = self.store.types
        time = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        return types["std_msgs/msg/Header"](0, time, frame) if self.ros1 else types["std_msgs/msg/Header"](time, frame)

    def image(self, stamp_ns: int, pixels: AnyArray, encoding: str = "mono8") -> Any:
        data = np.frombuffer(pixels.tobytes(), np.uint8)
        step = pixels.nbytes // pixels.shape[0]
        kind = self.store.types["sensor_msgs/msg/Image"]
        return kind(self.header(stamp_ns), pixels.shape[0], pixels.shape[1], encoding, 0, step, data)

    def compressed(self, stamp_ns: int, pixels: AnyArray) -> Any:
        data = cv2.imencode(".png", pixels)[1].ravel()
        return self.store.types["sensor_msgs/msg/CompressedImage"](self.header(stamp_ns), "png", data)

    def info(self, stamp_ns: int, shift_m: float, frame: str = "cam") -> Any:
        k = np.array([FOCAL, 0, 15.5, 0, FOCAL, 11.5, 0, 0, 1.0])
        p = np.array([FOCAL, 0, 15.5, FOCAL * shift_m, 0, FOCAL, 11.5, 0, 0, 0, 1, 0.0])
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        kind, model = self.store.types["sensor_msgs/msg/CameraInfo"], "plumb_bob"
        return kind(self.header(stamp_ns, frame), H, W, model, np.zeros(5), k, np.eye(3).ravel(), p, 0, 0, roi)

    def pairs(self, frames: range, shifts_m: tuple[float, float] | None = None, frame: str = "{}_optical") -> None:
        """Images of two cameras, and their camera_info where it is given how far each is shifted [m]."""
        for i in frames:
            log = START_NS + i * STEP_NS
            for number, side in enumerate(("left", "right")):
                self.write(f"/{side}/image_raw", log, self.image(log, picture(0)))
                if shifts_m is not None:
                    self.write(f"/{side}/camera_info", log, self.info(log, shifts_m[number], frame.format(side)))

    def static_transforms(self, right_m: float) -> None:
        """Of both cameras in "base", in one message for each."""
        types = self.store.types
        if "tf2_msgs/msg/TFMessage" not in types:
            self.store.register(typesys.get_types_from_msg(TF, "tf2_msgs/msg/TFMessage"))
        no_turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        for side, x in (("left", 0.0), ("right", right_m)):
            place = types["geometry_msgs/msg/Transform"](types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0), no_turn)
            header = self.header(START_NS, "base")
            stamped = types["geometry_msgs/msg/TransformStamped"](header, f"{side}_optical", place)
            self.write("/tf_static", START_NS, self.store.types["tf2_msgs/msg/TFMessage"]([stamped]))

    def close(self) -> None:
        self.bag.close()


def changed(message: Any, fields: dict[str, Any]) -> Any:
    """The message with other fields; ROS 1 names some in capitals."""
    names = {f.name.lower(): f.name for f in dataclasses.fields(message)}
    return dataclasses.replace(message, **{names[k]: v for k, v in fields.items() if k in names})


def stereo_bag(
    path: Path,
    ros1: bool = True,
    plugin: str = "sqlite3",
    *,
    compressed: bool = False,
    baseline_m: float = 0.1,
    infos: bool = True,
    chunks: str = "",
    change: tuple[str, int, dict[str, Any]] = ("", 0, {}),
    stamps: Callable[[int, str], int | None] = lambda i, side: START_NS + i * STEP_NS,
) -> Path:
    """A small recording of two cameras.

    Args:
        chunks: "bz2" or "lz4": of a ROS 1 bag.
        change: "image" or "info", a frame, and fields that are others in the left camera's message of it.
    """
    writer = Writer(path, ros1, plugin, chunks)
    for i in range(COUNT):
        for side in ("left", "right"):
            stamp, log = stamps(i, side), START_NS + i * STEP_NS
            if stamp is None:
                continue
            name = f"/stereo/{side}/image_raw" + "/compressed" * compressed
            make = writer.compressed if compressed else writer.image
            changes = {
                key: change[2] if (change[0], change[1], side) == (key, i, "left") else {} for key in ("image", "info")
            }
            writer.write(name, log, changed(make(stamp, picture(10 * i)), changes["image"]))
            if infos and (i < 2 or changes["info"]):
                shift = -baseline_m if side == "right" else 0.0
                info = changed(writer.info(stamp, shift, f"{side}_optical"), changes["info"])
                writer.write(f"/stereo/{side}/camera_info", log, info)
    writer.close()
    return path
