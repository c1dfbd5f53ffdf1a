"""Bags of ROS 1 and ROS 2, which rosbags reads, and the images of their topics."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from calib.errors import InputError, UnreadableError
from calib.io import entries, reason
from calib.types import I64
from stereo.depth import Depths
from stereo.readers.bag_messages import image_message, stamp_ns, stored_pixels
from stereo.readers.images import FRAMES, Colour, Images, Stored

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_BEGINS = {".bag": b"#ROSBAG V2.0", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
_REPAIRS = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "ros2 bag reindex"}
_ZSTD = b"\x28\xb5\x2f\xfd"
_OTHER = (
    "expected messages of ROS 2, found others: give the .bag that it was made of, or write its images into folders "
    "left and right, or rgb and depth"
)
_UNPACKED = "expected a bag as it is recorded, found one that is compressed: ros2 bag convert writes it unpacked"
MAX_NS = 2**62
"""Latest time that counts as one: in the year 2116."""


class Topic(NamedTuple):
    """A named series of messages, e.g. "/stereo/left/image_raw": the name of their type, and how many there are."""

    name: str
    type: str
    n_messages: int

    @property
    def holds_images(self) -> bool:
        """True if its messages are images."""
        return self.type in (IMAGE, COMPRESSED) and self.n_messages > 0


class Message(NamedTuple):
    """One message: when it was recorded [ns], and what makes an object with its fields."""

    log_ns: int
    decoded: Callable[[], Any]


def bag_at(path: Path) -> Path | None:
    """The bag at a path: a file, a ROS 2 folder, or the only bag in a folder."""
    if path.is_file():
        begin = _BEGINS.get(path.suffix)
        return path if begin and _head(path, len(begin)) == begin else None
    if not path.is_dir():
        return None
    if b"rosbag2_bagfile_information" in _head(path / "metadata.yaml", 4096):
        return path
    bags = [file for file in entries(path) if file.is_file() and bag_at(file)]
    return bags[0] if len(bags) == 1 else None


def _head(file: Path, length: int) -> bytes:
    if not file.is_file():
        return b""
    try:
        with file.open("rb") as content:
            return content.read(length)
    except OSError as error:
        raise InputError(f"{file}: expected a recording, found a file that cannot be read ({reason(error)})") from error


@lru_cache
def _usual_types(ros1: bool) -> Any:
    """The types of ROS itself, for files without definitions."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)


class Bag:
    """A bag: its files, and its topics by name (several connections of one count as one)."""

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.highlevel import AnyReader
        except ImportError as error:
            found = "which is not installed: pip install planview[ros]"
            raise InputError(f"{path}: expected the library rosbags for bags, {found}") from error
        self.path = path
        self.files = [path] if path.is_file() else [file for file in entries(path) if file.suffix in (".db3", ".mcap")]
        if not self.files:
            packed = any(file.suffix == ".zstd" for file in entries(path))
            missing = "expected a ROS 2 bag, found no .db3 or .mcap file in it: ros2 bag reindex may repair it"
            raise InputError(f"{path}: {_UNPACKED if packed else missing}")
        suffix = self.files[0].suffix
        # The files are read without their metadata.yaml, which may be out of date.
        self._open = partial(AnyReader, self.files, default_typestore=_usual_types(suffix == ".bag"))
        topics: dict[str, Topic] = {}
        try:
            with self._open() as bag:
                for connection in bag.connections:
                    before = topics[connection.topic].n_messages if connection.topic in topics else 0
                    count = before + connection.msgcount
                    topics[connection.topic] = Topic(connection.topic, connection.msgtype, count)
        except Exception as error:  # the library raises whatever a damaged file provokes
            if "rofile is not ros2" in str(error):
                raise InputError(f"{path}: {_OTHER}") from error
            damage = f"one that is damaged or was cut off ({error_text(error).rstrip('.')})"
            raise InputError(f"{path}: expected a bag, found {damage}: {_REPAIRS[suffix]} may repair it") from error
        self.topics: Sequence[Topic] = [topics[name] for name in sorted(topics)]

    def messages(self, topic: str, start_ns: int | None = None) -> Iterator[Message]:
        """The messages of a topic by the time of recording, from a time on [ns] or all; each call opens the files
        again, so that threads do not meet."""
        with self._open() as bag:
            types = bag.typestore
            decode = types.deserialize_cdr if bag.is2 else types.deserialize_ros1
            connections = [connection for connection in bag.connections if connection.topic == topic]
            for connection, log_ns, data in bag.messages(connections, start=start_ns) if connections else ():
                if data[:4] == _ZSTD:  # none begins so
                    raise InputError(f"{self.path}: {_UNPACKED}")
                yield Message(log_ns, partial(decode, data, typename=connection.msgtype))


def error_text(error: Exception) -> str:
    """A library's message about a damaged file, on one line."""
    return " ".join(str(error).split())[:120] or type(error).__name__


class TopicImages:
    """Images of a topic by their place in it.

    Attributes:
        log_ns, stamp_ns: (n,) int64 [ns], when each was recorded and when it was taken by its header.
        notes: of damage that ends the topic.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, bag: Bag, topic: Topic) -> None:
        self.bag = bag
        self.topic = topic
        log: list[int] = []
        stamp: list[int] = []
        try:
            for message in bag.messages(topic.name):
                if not 0 <= message.log_ns <= MAX_NS:
                    raise ValueError(f"a message recorded at {message.log_ns} ns")
                taken = message.log_ns
                with suppress(Exception):  # a damaged header leaves the time of recording
                    taken = stamp_ns(message.decoded())
                log.append(message.log_ns)
                stamp.append(taken if abs(taken) <= MAX_NS else message.log_ns)
        except InputError:
            raise
        except Exception as error:  # the library raises whatever a damaged file provokes
            if not log:
                raise InputError(f"{bag.path}: expected images in {topic.name}, found {error_text(error)}") from error
            self.notes = (f"{topic.name} ends after {len(log)} messages in damage ({error_text(error)})",)
        if not log:
            raise InputError(f"{bag.path}: expected images in {topic.name}, found no message")
        self.log_ns: I64 = np.array(log, dtype=np.int64)
        self.stamp_ns: I64 = np.array(stamp, dtype=np.int64)

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
        spread = np.unique(np.linspace(0, len(self.log_ns) - 1, FRAMES).round()).astype(int)
        with closing(self.at(spread.tolist())) as images:
            return list(images)

    def frames(self, places: I64, pixels: Colour | Depths, sample: Sequence[Stored]) -> Images:
        """The images in the order of the recording (arguments of ``Images``)."""
        name = self.topic.name
        where = f"{self.bag.path}: {name}"
        return Images(where, places, pixels, self.at, lambda place: f"a message of {name}", sample, self.bag.files)

    def _read(self, stream: Iterator[Message], skip: int) -> Stored:
        try:
            message = next(islice(stream, skip, None))
            return stored_pixels(image_message(message.decoded()))
        except UnreadableError as error:
            return error
        except Exception as error:  # a damaged message is a frame that is skipped, whatever the library raises
            return UnreadableError(f"a damaged message ({error_text(error)})")
