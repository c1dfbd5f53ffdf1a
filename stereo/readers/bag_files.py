"""Bags: ROS 1 bags and ROS 2 databases through rosbags, MCAP files through mcap; and the images of their topics."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

import numpy as np

from calib.errors import InputError, UnreadableError
from calib.io import entries, file_size
from calib.types import I64
from stereo.depth import Depths
from stereo.readers.bag_messages import MAX_NS, image_message, stamp_ns, stored_pixels
from stereo.readers.images import FRAMES, Colour, Images, Stored

Kind = Literal["image", "compressed", "coded", "info", "tf", "other"]

_KINDS: dict[str, Kind] = {
    "image": "image", "rawimage": "image", "compressedimage": "compressed", "camerainfo": "info",
    "cameracalibration": "info", "tfmessage": "tf", "frametransform": "tf", "frametransforms": "tf",
    "compressedvideo": "coded", "ffmpegpacket": "coded", "packet": "coded", "disparityimage": "coded", "rgbd": "coded",
}  # fmt: skip
_PACKAGES = re.compile(
    r"(sensor_msgs|tf2_msgs|tf|foxglove|foxglove_msgs|ffmpeg_image_transport_msgs|theora_image_transport|stereo_msgs|"
    r"realsense2_camera_msgs)[./](msg[./])?"
)


@dataclass(frozen=True)
class Topic:
    """A named series of messages, e.g. "/stereo/left/image_raw": what they are to a recording, their number, and the
    name of their type."""

    name: str
    kind: Kind
    count: int
    schema: str = ""


class Message(NamedTuple):
    """One message: when it was recorded [ns], and what makes an object or a mapping with its fields."""

    log_ns: int
    decoded: Callable[[], Any]


class Bag(NamedTuple):
    """Files of messages: where they are; topics by name (several connections of one count as one); the messages of a
    topic by the time of recording, from a time on [ns] or all, each call opening the files again, so that threads do
    not meet; and what must live as long as the files."""

    path: Path
    files: Sequence[Path]
    topics: tuple[Topic, ...]
    messages: Callable[..., Iterator[Message]]
    kept: object


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
ZSTD = b"\x28\xb5\x2f\xfd"
_TOO_LARGE = f"compressed data of more than {MAX_UNPACKED_BYTES >> 20} MB"
STORAGES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
"""Endings of the files of a ROS 2 bag."""


def open_bag(path: Path, kind: str) -> Bag:
    """Open a file ("ros1", "sqlite" or "mcap"), or a ROS 2 folder ("") by its files, which hold what its metadata.yaml
    does."""
    what, repair = {
        "ros1": ("a ROS 1 bag", "rosbag reindex"), "mcap": ("an MCAP file", "mcap recover"),
    }.get(kind, ("a ROS 2 bag", "ros2 bag reindex"))  # fmt: skip
    try:
        stored = files = [path] if kind else [file for file in entries(path) if file.name.endswith(STORAGES)]
        if not files:
            raise ValueError("no .db3 or .mcap file in it")
        unpacked = TemporaryDirectory()
        files = [_unpacked_file(file, Path(unpacked.name)) if file.suffix == ".zstd" else file for file in files]
        if kind == "ros1" and path.suffix != ".bag":  # the library goes by the name
            (Path(unpacked.name) / "a.bag").symlink_to(path.resolve())
            files = [Path(unpacked.name) / "a.bag"]
        source: _RosFiles | _McapFiles
        if files[0].suffix == ".mcap" or kind == "mcap":
            source = _McapFiles(path, files, require("mcap.reader", path).SeekingReader)
        else:
            source = _RosFiles(files, require("rosbags.highlevel", path).AnyReader)
        counts: dict[str, tuple[str, int]] = {}
        for name, schema, count in source.topics():
            counts[name] = schema, count + counts.get(name, ("", 0))[1]
        topics = (Topic(name, kind_of(counts[name][0]), counts[name][1], counts[name][0]) for name in sorted(counts))
        return Bag(path, stored, tuple(topics), source.messages, unpacked)
    except InputError:
        raise
    except Exception as error:  # libraries raise whatever a damaged file provokes
        found = f"one that is damaged or was cut off ({error_text(error).rstrip('.')})"
        raise InputError(f"{path}: expected {what}, found {found}: {repair} may repair it") from error


def _unpacked_file(file: Path, folder: Path) -> Path:
    """A compressed file, unpacked into a folder. Raises ValueError: it unpacks to a hundred times its size."""
    left = 100 * file_size(file) + MAX_UNPACKED_BYTES
    with file.open("rb") as content, (folder / file.stem).open("wb") as out:
        zstd = import_module("zstandard").ZstdDecompressor()
        with zstd.stream_reader(content, read_across_frames=True) as unpacked:
            while part := unpacked.read(1 << 20):
                left -= len(part)
                if left < 0:
                    raise ValueError("compressed data of more than a hundred times its size")
                out.write(part)
    return folder / file.stem


def _unpacked_message(data: bytes) -> bytes:
    """A message as it was sent; some ROS 2 bags compress them one by one, and none begins like compressed data."""
    if not data.startswith(ZSTD):
        return data
    zstandard = import_module("zstandard")
    if zstandard.frame_content_size(data) > MAX_UNPACKED_BYTES:
        raise ValueError(_TOO_LARGE)
    return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_UNPACKED_BYTES))


@lru_cache
def _usual_types(ros1: bool) -> Any:
    """Those of ROS itself, for files without definitions."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


class _RosFiles:
    """ROS 1 bags or ROS 2 databases."""

    def __init__(self, files: Sequence[Path], reader: Any) -> None:
        self._open = partial(reader, files, default_typestore=_usual_types(files[0].suffix == ".bag"))

    def topics(self) -> list[tuple[str, str, int]]:
        """Name, type and number of messages of each."""
        with self._open() as bag:
            return [(c.topic, c.msgtype, c.msgcount) for c in bag.connections]

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """See ``Bag``."""
        with self._open() as bag:
            types, connections = bag.typestore, [c for c in bag.connections if c.topic == topic]
            decode = types.deserialize_cdr if bag.is2 else types.deserialize_ros1
            for connection, log_ns, data in bag.messages(connections, start=start_ns) if connections else ():
                yield Message(log_ns, partial(decode, _unpacked_message(data), typename=connection.msgtype))


class _McapFiles:
    """MCAP files, one after the other."""

    def __init__(self, path: Path, files: Sequence[Path], reader: Any) -> None:
        # Larger records are damage (recorders write chunks of some megabytes).
        self._path, self._files, self._reader = path, files, partial(reader, record_size_limit=1 << 30)

    def topics(self) -> Iterator[tuple[str, str, int]]:
        """Name, type and number of messages of each."""
        for name in self._files:
            with name.open("rb") as file:
                summary = self._reader(file).get_summary()
            if summary is None or summary.statistics is None:
                raise ValueError("it has no summary section")
            if any(chunk.uncompressed_size > MAX_UNPACKED_BYTES for chunk in summary.chunk_indexes):
                raise ValueError(_TOO_LARGE)
            counts, schemas = summary.statistics.channel_message_counts, summary.schemas
            for c in summary.channels.values():
                yield c.topic, schemas[c.schema_id].name if c.schema_id else "", counts.get(c.id, 0)

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """See ``Bag``."""
        for name in self._files:
            with name.open("rb") as file:
                codecs: dict[int, Callable[[bytes], Any]] = {}
                for schema, channel, message in self._reader(file).iter_messages([topic], starting_at=start_ns):
                    if channel.id not in codecs:
                        codecs[channel.id] = _codec(channel.message_encoding, schema, self._path)
                    yield Message(message.log_time, partial(codecs[channel.id], _unpacked_message(message.data)))


def _codec(encoding: str, schema: Any, path: Path) -> Callable[[bytes], Any]:
    """How messages of a channel are decoded."""
    if encoding in ("cdr", "ros1"):
        types = _usual_types(encoding == "ros1")
        name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        if name not in types.types and schema.encoding in ("ros1msg", "ros2msg"):
            types.register(import_module("rosbags.typesys").get_types_from_msg(schema.data.decode(), name))
        return partial(types.deserialize_ros1 if encoding == "ros1" else types.deserialize_cdr, typename=name)
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        factory = require("mcap_protobuf.decoder", path).DecoderFactory()
        return factory.decoder_for(encoding, schema)  # type: ignore[no-any-return]
    raise InputError(f"{path}: expected messages as cdr, ros1, protobuf or json, found {encoding!r}")


class TopicImages:
    """Images of a topic by their place in it.

    Attributes:
        log_ns, stamp_ns: (n,) int64 [ns], when each was recorded and when it was taken by its header.
        notes: of damage that ends the topic.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, bag: Bag, topic: Topic) -> None:
        self.bag, self.topic = bag, topic
        log, stamp = [], []
        try:
            for message in bag.messages(topic.name):
                if not 0 <= message.log_ns <= MAX_NS:
                    raise ValueError(f"a message recorded at {message.log_ns} ns")
                taken = message.log_ns
                with suppress(Exception):  # a damaged header leaves the time of recording
                    taken = stamp_ns(message.decoded())
                log.append(message.log_ns)
                stamp.append(taken if abs(taken) <= MAX_NS else message.log_ns)
        except Exception as error:  # libraries raise whatever a damaged file provokes
            if not log:
                raise InputError(f"{bag.path}: expected images in {topic.name}, found {error_text(error)}") from error
            self.notes = (f"{topic.name} ends after {len(log)} messages in damage ({error_text(error)})",)
        if not log:
            raise InputError(f"{bag.path}: expected images in {topic.name}, found no message")
        self.log_ns, self.stamp_ns = np.array(log, dtype=np.int64), np.array(stamp, dtype=np.int64)

    def at(self, places: Iterable[int]) -> Generator[Stored, None, None]:
        """The stored values at these places, which may be in any order."""
        stream: Iterator[Message] = iter(())
        next_place = -1
        for place in places:
            # Up to 64 messages are read past rather than looked up again.
            if not 0 <= place - next_place <= 64 or next_place < 0:
                start = int(self.log_ns[place])
                next_place = int(np.searchsorted(self.log_ns, start))
                stream = self.bag.messages(self.topic.name, start)
            yield self._read(stream, place - next_place)
            next_place = place + 1

    def sample(self) -> list[Stored]:
        """A few images spread over the topic."""
        spread = sorted({round(float(i)) for i in np.linspace(0, len(self.log_ns) - 1, FRAMES)})
        with closing(self.at(spread)) as images:
            return list(images)

    def frames(self, places: I64, pixels: Colour | Depths, sample: Sequence[Stored]) -> Images:
        """The images in the order of the recording (arguments of ``Images``)."""
        name, where = self.topic.name, f"{self.bag.path}: {self.topic.name}"
        return Images(where, places, pixels, self.at, lambda place: f"a message of {name}", sample, self.bag.files)

    def _read(self, stream: Iterator[Message], skip: int) -> Stored:
        try:
            message = next(islice(stream, skip, None))
            image = image_message(message.decoded(), self.topic.kind == "compressed")
            return stored_pixels(image)
        except UnreadableError as error:
            return error
        except Exception as error:  # a damaged message is a frame that is skipped, whatever the libraries raise
            return UnreadableError(f"a damaged message ({error_text(error)})")
