"""What the three kinds of bags have in common: topics, and their messages in the order of recording."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Protocol

from calib.errors import InputError

Kind = Literal["image", "compressed", "info", "tf", "other"]

_KINDS: dict[str, Kind] = {
    "image": "image", "rawimage": "image", "compressedimage": "compressed", "camerainfo": "info",
    "cameracalibration": "info", "tfmessage": "tf", "frametransform": "tf", "frametransforms": "tf",
}  # fmt: skip
_PACKAGES = re.compile(r"(sensor_msgs|tf2_msgs|tf|foxglove|foxglove_msgs)[./](msg[./])?")


@dataclass(frozen=True)
class Topic:
    """A series of messages.

    Attributes:
        name: e.g. "/stereo/left/image_raw".
        schema: type of the messages, as the bag has it.
        kind: what they are to a recording.
        count: number of messages.
    """

    name: str
    schema: str
    kind: Kind
    count: int


@dataclass(frozen=True)
class Message:
    """One message, not decoded yet.

    Attributes:
        log_ns: when it was recorded [ns].
        data: as stored.
        stamp: reads the header's time [ns].
        decode: gives an object or a mapping with the message's fields.
    """

    log_ns: int
    data: bytes
    stamp: Callable[[bytes], int]
    decode: Callable[[bytes], Any]


class Bag(Protocol):
    """A file or folder of messages; every iteration opens it anew, so that threads do not meet.

    Attributes:
        path: as given.
        topics: by name.
    """

    path: Path
    topics: tuple[Topic, ...]

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """Messages of a topic by the time of recording, from a time on."""


def kind_of(schema: str) -> Kind:
    """What messages of a type are, by the type's name in ROS 1, ROS 2 or Foxglove."""
    match = _PACKAGES.match(schema)
    return _KINDS.get(schema[match.end() :].lower(), "other") if match else "other"


def require(module: str, path: Path) -> Any:
    """An optional library.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"{path}: expected the library {module.split('.')[0]} for bags, which is not installed: "
            "pip install planview[ros]"
        ) from error


def ros1_stamp(data: bytes) -> int:
    """Time of a std_msgs/Header at the beginning of a ROS 1 message [ns]."""
    _, seconds, nanoseconds = struct.unpack_from("<III", data)
    return int(seconds) * 10**9 + int(nanoseconds)


def cdr_stamp(data: bytes) -> int:
    """Time of a std_msgs/Header at the beginning of a CDR message [ns] (the second byte tells the order of bytes)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def sorted_topics(topics: Sequence[Topic]) -> tuple[Topic, ...]:
    """By name; several connections of one topic count as one."""
    merged: dict[str, Topic] = {}
    for topic in topics:
        before = merged.get(topic.name)
        merged[topic.name] = (
            topic if before is None else Topic(topic.name, topic.schema, topic.kind, before.count + topic.count)
        )
    return tuple(merged[name] for name in sorted(merged))
