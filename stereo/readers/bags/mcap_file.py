"""MCAP files, of ROS 1, ROS 2 and Foxglove, through the library mcap."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from calib.errors import InputError
from stereo.readers.bags.messages import stamp_ns
from stereo.readers.bags.rosbag import decode_ros
from stereo.readers.bags.storage import Message, Topic, cdr_stamp, kind_of, require, ros1_stamp, sorted_topics

MAX_RECORD_BYTES = 1 << 30
"""Larger records are damage (recorders write chunks of some megabytes)."""
_HEADED = ("sensor_msgs/",)
"""Types that begin with a std_msgs/Header."""


class McapFile:
    """An MCAP file (a ``Bag``).

    Raises:
        InputError: damaged or cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._library = require("mcap.reader", path)
        try:
            with path.open("rb") as file:
                summary = self._reader(file).get_summary()
                if summary is None or summary.statistics is None:
                    raise ValueError("it has no summary section")
                counts = summary.statistics.channel_message_counts
                self.topics = sorted_topics(
                    [_topic(channel, summary.schemas, counts) for channel in summary.channels.values()]
                )
        except Exception as error:  # libraries raise whatever a damaged file provokes
            found = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"{path}: expected an MCAP file, found one that is damaged or was cut off ({found[:120]}): "
                "mcap recover may mend it"
            ) from error

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """See ``Bag``."""
        with self.path.open("rb") as file:
            codecs: dict[int, tuple[Callable[[bytes], int], Callable[[bytes], Any]]] = {}
            for schema, channel, message in self._reader(file).iter_messages([topic], starting_at=start_ns):
                if channel.id not in codecs:
                    codecs[channel.id] = _codec(channel.message_encoding, schema, self.path)
                yield Message(message.log_time, message.data, *codecs[channel.id])

    def _reader(self, file: Any) -> Any:
        return self._library.SeekingReader(file, record_size_limit=MAX_RECORD_BYTES)


def _topic(channel: Any, schemas: Any, counts: Any) -> Topic:
    schema = schemas[channel.schema_id].name if channel.schema_id else ""
    return Topic(channel.topic, schema, kind_of(schema), counts.get(channel.id, 0))


def _codec(encoding: str, schema: Any, path: Path) -> tuple[Callable[[bytes], int], Callable[[bytes], Any]]:
    """How messages of a channel give their time, and themselves."""
    decode: Callable[[bytes], Any]
    if encoding in ("cdr", "ros1"):
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        text = schema.data.decode("utf-8", "replace") if schema.encoding in ("ros1msg", "ros2msg") else ""
        decode = partial(decode_ros, schema=name, ros1=encoding == "ros1", definition=text)
        if name.startswith(_HEADED):
            return (ros1_stamp if encoding == "ros1" else cdr_stamp), decode
    elif encoding == "json":
        decode = json.loads
    elif encoding == "protobuf":
        decode = require("mcap_protobuf.decoder", path).DecoderFactory().decoder_for(encoding, schema)
    else:
        raise InputError(f"{path}: expected messages as cdr, ros1, protobuf or json, found {encoding!r}")
    return lambda data: stamp_ns(decode(data)), decode
