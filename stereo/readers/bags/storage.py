"""Files of messages: ROS 1 bags and ROS 2 bags through rosbags, MCAP files through mcap."""

from __future__ import annotations

import bz2
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

from calib.errors import InputError
from calib.io import entries

Kind = Literal["image", "compressed", "info", "tf", "other"]

_KINDS: dict[str, Kind] = {
    "image": "image", "rawimage": "image", "compressedimage": "compressed", "camerainfo": "info",
    "cameracalibration": "info", "tfmessage": "tf", "frametransform": "tf", "frametransforms": "tf",
}  # fmt: skip
_PACKAGES = re.compile(r"(sensor_msgs|tf2_msgs|tf|foxglove|foxglove_msgs)[./](msg[./])?")


@dataclass(frozen=True)
class Topic:
    """A named series of messages, e.g. "/stereo/left/image_raw": what they are to a recording, and their number."""

    name: str
    kind: Kind
    count: int


class Message(NamedTuple):
    """One message: when it was recorded [ns], its data as stored, and what makes an object or a mapping of them."""

    log_ns: int
    data: bytes
    decode: Callable[[bytes], Any]

    def decoded(self) -> Any:
        """The object or mapping with the message's fields."""
        return self.decode(self.data)


@dataclass(frozen=True)
class Bag:
    """Files of messages, one after the other.

    Attributes:
        topics: by name; several connections of one topic count as one.
        read: the messages of a topic in a file by the time of recording, from a time on [ns]; each call opens the file
            again, so that threads do not meet.
        kept: what must live as long as the files.
    """

    path: Path
    topics: tuple[Topic, ...]
    files: Sequence[Path]
    read: Callable[[Path, str, int | None], Iterator[Message]]
    kept: object

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """Messages of a topic by the time of recording, from a time on."""
        for file in self.files:
            yield from self.read(file, topic, start_ns)


def kind_of(schema: str) -> Kind:
    """What messages of a type are, by the type's name in ROS 1, ROS 2 or Foxglove."""
    match = _PACKAGES.match(schema)
    return _KINDS.get(schema[match.end() :].lower(), "other") if match else "other"


def require(module: str, path: Path) -> Any:
    """An optional library."""
    try:
        return import_module(module)
    except ImportError as error:
        found = "which is not installed: pip install planview[ros]"
        raise InputError(f"{path}: expected the library {module.split('.')[0]} for bags, {found}") from error


def error_text(error: Exception) -> str:
    """A library's message about a damaged file, on one line."""
    return " ".join(str(error).split())[:120] or type(error).__name__


MAX_UNPACKED_BYTES = 1 << 28
"""Chunks and messages that unpack to more are damage, or made to fill the memory (recorders write some megabytes)."""
_ZSTD = b"\x28\xb5\x2f\xfd"
_TOO_LARGE = f"compressed data of more than {MAX_UNPACKED_BYTES >> 20} MB"
STORAGES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")


def open_bag(path: Path, kind: str) -> Bag:
    """Open a file ("ros1", "sqlite" or "mcap"), or a ROS 2 folder ("") by its files, which hold what its metadata.yaml
    does."""
    what, repair = {
        "ros1": ("a ROS 1 bag", "rosbag reindex"), "mcap": ("an MCAP file", "mcap recover"),
    }.get(kind, ("a ROS 2 bag", "ros2 bag reindex"))  # fmt: skip
    try:
        files = [path] if kind else [file for file in entries(path) if file.name.endswith(STORAGES)]
        if not files:
            raise ValueError("no .db3 or .mcap file in it")
        unpacked = TemporaryDirectory()
        files = [_unpacked_file(file, Path(unpacked.name)) if file.suffix == ".zstd" else file for file in files]
        read: Callable[[Path, str, int | None], Iterator[Message]]
        if files[0].suffix == ".mcap" or kind == "mcap":
            # Larger records are damage (recorders write chunks of some megabytes).
            reader = partial(require("mcap.reader", path).SeekingReader, record_size_limit=1 << 30)
            listed, read = [_mcap_topics(reader, file) for file in files], partial(_mcap_messages, reader, path)
        else:
            reader = require("rosbags.rosbag1" if kind == "ros1" else "rosbags.rosbag2", path).Reader
            listed, read = [_ros_topics(reader, file) for file in files], partial(_ros_messages, reader, kind == "ros1")
        topics = [topic for of_file in listed for topic in of_file]
        kinds = {topic.name: topic.kind for topic in reversed(topics)}
        counts = {name: sum(topic.count for topic in topics if topic.name == name) for name in kinds}
        return Bag(path, tuple(Topic(n, kinds[n], counts[n]) for n in sorted(kinds)), files, read, unpacked)
    except InputError:
        raise
    except Exception as error:  # libraries raise whatever a damaged file provokes
        found = f"one that is damaged or was cut off ({error_text(error).rstrip('.')})"
        raise InputError(f"{path}: expected {what}, found {found}: {repair} may repair it") from error


def _unpacked_file(file: Path, folder: Path) -> Path:
    """A compressed file, unpacked into a folder. Raises ValueError: it unpacks to a hundred times its size."""
    left = 100 * file.stat().st_size + MAX_UNPACKED_BYTES
    with file.open("rb") as content, (folder / file.stem).open("wb") as out:
        zstd = import_module("zstandard").ZstdDecompressor()
        with zstd.stream_reader(content, read_across_frames=True) as unpacked:
            while part := unpacked.read(1 << 20):
                left -= len(part)
                if left < 0:
                    raise ValueError("compressed data of more than a hundred times its size")
                out.write(part)
    return folder / file.stem


def _ros_topics(reader: Any, file: Path) -> list[Topic]:
    """Those of a ROS 1 bag, or of a SQLite file of a ROS 2 bag. Raises ValueError: a chunk of a ROS 1 bag unpacks to
    more than ``MAX_UNPACKED_BYTES``."""
    with reader(file) as bag, file.open("rb") as content:
        for chunk in getattr(bag, "chunks", {}).values():
            content.seek(chunk.datapos)
            data = content.read(chunk.datasize)
            if data.startswith(b"BZh"):
                stream = bz2.BZ2Decompressor()
            elif data.startswith(b"\x04\x22\x4d\x18"):
                stream = import_module("lz4.frame").LZ4FrameDecompressor()
            else:
                continue
            stream.decompress(data, MAX_UNPACKED_BYTES)
            if not stream.eof:
                raise ValueError(_TOO_LARGE)
        return [Topic(c.topic, kind_of(c.msgtype), c.msgcount) for c in bag.connections]


def _ros_messages(reader: Any, ros1: bool, file: Path, topic: str, start_ns: int | None) -> Iterator[Message]:
    with reader(file) as bag:
        connections = [c for c in bag.connections if c.topic == topic]
        for connection, log_ns, data in bag.messages(connections, start=start_ns) if connections else ():
            text = getattr(connection.msgdef, "data", connection.msgdef) if ros1 else ""
            decode = partial(decode_ros, schema=connection.msgtype, ros1=ros1, definition=text)
            yield Message(log_ns, _unpacked_message(data), decode)


def _unpacked_message(data: bytes) -> bytes:
    """A message as it was sent; some ROS 2 bags compress them one by one, and none begins like compressed data."""
    if not data.startswith(_ZSTD):
        return data
    zstandard = import_module("zstandard")
    if zstandard.frame_content_size(data) > MAX_UNPACKED_BYTES:
        raise ValueError(_TOO_LARGE)
    return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_UNPACKED_BYTES))


def decode_ros(data: bytes, schema: str, ros1: bool, definition: str = "") -> Any:
    """The object that a serialised ROS message of a type ("sensor_msgs/msg/Image") holds; its definition is for types
    that rosbags does not know."""
    store = _store(ros1)
    if schema not in store.types and definition:
        from rosbags.typesys import get_types_from_msg

        store.register(get_types_from_msg(definition, schema))
    return store.deserialize_ros1(data, schema) if ros1 else store.deserialize_cdr(data, schema)


@lru_cache
def _store(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


def _mcap_topics(reader: Any, name: Path) -> list[Topic]:
    with name.open("rb") as file:
        summary = reader(file).get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError("it has no summary section")
        for chunk in summary.chunk_indexes:  # what they unpack to, by the index and by their own headers
            size = chunk.uncompressed_size
            if chunk.compression == "zstd":
                file.seek(chunk.chunk_start_offset + 49 + len(chunk.compression))  # the fields before the data
                size = max(size, import_module("zstandard").frame_content_size(file.read(18)))
            if size > MAX_UNPACKED_BYTES:
                raise ValueError(_TOO_LARGE)
        counts = summary.statistics.channel_message_counts
        schemas = {0: "", **{key: schema.name for key, schema in summary.schemas.items()}}
        channels = summary.channels.values()
        return [Topic(c.topic, kind_of(schemas[c.schema_id]), counts.get(c.id, 0)) for c in channels]


def _mcap_messages(reader: Any, path: Path, name: Path, topic: str, start_ns: int | None) -> Iterator[Message]:
    with name.open("rb") as file:
        codecs: dict[int, Callable[[bytes], Any]] = {}
        for schema, channel, message in reader(file).iter_messages([topic], starting_at=start_ns):
            if channel.id not in codecs:
                codecs[channel.id] = _codec(channel.message_encoding, schema, path)
            yield Message(message.log_time, _unpacked_message(message.data), codecs[channel.id])


def _codec(encoding: str, schema: Any, path: Path) -> Callable[[bytes], Any]:
    """How messages of a channel are decoded."""
    if encoding in ("cdr", "ros1"):
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        text = schema.data.decode("utf-8", "replace") if schema.encoding in ("ros1msg", "ros2msg") else ""
        return partial(decode_ros, schema=name, ros1=encoding == "ros1", definition=text)
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        factory = require("mcap_protobuf.decoder", path).DecoderFactory()
        return factory.decoder_for(encoding, schema)  # type: ignore[no-any-return]
    raise InputError(f"{path}: expected messages as cdr, ros1, protobuf or json, found {encoding!r}")
