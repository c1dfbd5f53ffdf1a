"""ROS 1 bags, and ROS 2 bags in folders or SQLite files, through the library rosbags."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from calib.errors import InputError
from stereo.readers.bags.storage import Message, Topic, cdr_stamp, kind_of, require, ros1_stamp, sorted_topics


class RosBag:
    """A bag that rosbags reads (a ``Bag``).

    Raises:
        InputError: damaged, cut off, or of a kind that rosbags does not read.
    """

    def __init__(self, path: Path, ros1: bool) -> None:
        self.path = path
        self._ros1 = ros1
        self._reader = require("rosbags.rosbag1" if ros1 else "rosbags.rosbag2", path).Reader
        try:
            with self._reader(path) as reader:
                self.topics = sorted_topics(
                    [Topic(c.topic, c.msgtype, kind_of(c.msgtype), c.msgcount) for c in reader.connections]
                )
        except Exception as error:  # libraries raise whatever a damaged file provokes
            raise InputError(f"{path}: {_damage(error, ros1)}") from error

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """See ``Bag``."""
        stamp = ros1_stamp if self._ros1 else cdr_stamp
        with self._reader(self.path) as reader:
            connections = [c for c in reader.connections if c.topic == topic]
            for connection, log_ns, data in reader.messages(connections, start=start_ns):
                decode = partial(decode_ros, schema=connection.msgtype, ros1=self._ros1)
                yield Message(log_ns, data, stamp, decode)


def decode_ros(data: bytes, schema: str, ros1: bool, definition: str = "") -> Any:
    """The object that a serialised ROS message holds.

    Args:
        schema: type, e.g. "sensor_msgs/msg/Image".
        definition: of the type, for types that rosbags does not know.
    """
    store = _store(ros1)
    if schema not in store.types and definition:
        from rosbags.typesys import get_types_from_msg

        store.register(get_types_from_msg(definition, schema))
    return store.deserialize_ros1(data, schema) if ros1 else store.deserialize_cdr(data, schema)


@lru_cache
def _store(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def _damage(error: Exception, ros1: bool) -> str:
    what = "a ROS 1 bag" if ros1 else "a ROS 2 bag"
    found = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    mend = "rosbag reindex" if ros1 else "ros2 bag reindex"
    return f"expected {what}, found one that is damaged or was cut off ({found[:120]}): {mend} may mend it"
