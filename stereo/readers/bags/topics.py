"""Which topics of a bag are the cameras or the image and its depth, and their images as frames."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from itertools import islice, takewhile
from typing import Literal, NamedTuple

import numpy as np

from calib.errors import InputError, UnreadableError
from calib.types import I64
from stereo.depth import Depths
from stereo.readers.bags.messages import image_message, stamp_ns, stored_pixels
from stereo.readers.bags.storage import Bag, Message, Topic, error_text
from stereo.readers.images import FRAMES, Colour, Images, Stored
from stereo.readers.pairing import split_sides

_TRANSPORT = re.compile(r"/(compressed|compressedDepth|theora|ffmpeg|zstd)$")
_DEPTH = re.compile(r"depth|disparity", re.IGNORECASE)
_COLOUR = re.compile(r"rgb|colou?r", re.IGNORECASE)
_PREFERENCE = ("image_raw", "image_color", "image_rect_color", "image_rect", "image_mono")
"""Of one camera's topics the first is taken: what the driver sent before what was made of it."""


class TopicChoice(NamedTuple):
    """Two topics and what they are."""

    kind: Literal["stereo", "rgbd"]
    first: str
    second: str


def choose_topics(bag: Bag, named: Sequence[str]) -> TopicChoice:
    """The topics that were named, else the pair that is clear from names and types: left and right before depth."""
    there = [topic for topic in bag.topics if topic.kind in ("image", "compressed") and topic.count]
    if named:
        for name in named:
            if name not in [topic.name for topic in there]:
                expected = f"expected image topics of {bag.path.name} ({_listed(there)})"
                raise InputError(f"{expected}, found {name!r}", argument="topics")
        first, second = named
        depths = _depths(bag, [topic for topic in there if topic.name in named])
        if first in depths and second not in depths:
            first, second = second, first
        return TopicChoice("rgbd" if second in depths else "stereo", first, second)
    coded = [topic for topic in bag.topics if topic.kind == "coded" and topic.count]
    if not there:
        empty = [topic for topic in bag.topics if topic.kind in ("image", "compressed")]
        found = f"no message in {_listed(empty)}" if empty else _listed(bag.topics)
        if coded:
            found = f"images coded as video or objects, which are not read ({_coded(coded)}): {_REPUBLISH}"
        raise InputError(f"{bag.path}: expected image topics of two cameras, found {found}")
    by_base: dict[str, Topic] = {}  # each image once: raw before compressed
    for topic in sorted(there, key=lambda topic: topic.kind == "compressed"):
        by_base.setdefault(_TRANSPORT.sub("", topic.name), topic)
    pairs = _stereo(list(by_base))
    if not pairs:
        depths = _depths(bag, list(by_base.values()))
        pairs = _rgbd(list(by_base), {base for base, topic in by_base.items() if topic.name in depths})
    if not pairs and len(there) == 1:
        raise InputError(
            f"{bag.path}: expected image topics of two cameras, or an image and its depth, "
            f"found only {there[0].name}: one camera{_also(coded)}"
        )
    if len(pairs) != 1:
        what = f"{len(pairs)} pairs" if pairs else "no clear pair"
        found = f"found {what} among {_listed(there)}{_also(coded)}"
        raise InputError(f"{bag.path}: expected one pair of image topics, {found}", remedy="topics")
    kind, first, second = pairs[0]
    return TopicChoice(kind, by_base[first].name, by_base[second].name)


_REPUBLISH = "ros2 run image_transport republish writes them as raw or compressed images, to be recorded again"


def _coded(topics: Sequence[Topic]) -> str:
    return ", ".join(f"{topic.name} of {topic.schema}" for topic in topics[:4])


def _also(coded: Sequence[Topic]) -> str:
    return f"; not read are {_coded(coded)}" if coded else ""


def info_topic(topics: Iterable[Topic], image: str) -> str | None:
    """The camera_info topic of an image topic: of the same camera, else the one that shares most of its name."""
    infos = [topic.name for topic in topics if topic.kind == "info" and topic.count]
    base = _TRANSPORT.sub("", image)
    for name in (f"{base.rsplit('/', 1)[0]}/camera_info", f"{base}/camera_info"):
        if name in infos:
            return name

    def shared(name: str) -> int:
        parts = zip(name.strip("/").split("/"), base.strip("/").split("/"), strict=False)
        return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))

    best = max(map(shared, infos), default=0)
    if len(infos) > 1 and not best:
        return None
    return min((name for name in infos if shared(name) == best), key=len, default=None)


def _depths(bag: Bag, topics: Sequence[Topic]) -> set[str]:
    """Names of the topics that hold depth by their name, or by the encoding of their first image where not all of the
    topics have it (drivers of infrared pairs send 16UC1, too)."""
    named = {topic.name for topic in topics if _DEPTH.search(topic.name)}
    encoded = {topic.name for topic in topics if _is_encoded_depth(bag, topic)}
    return named | encoded if len(encoded) < len(topics) else named


def _is_encoded_depth(bag: Bag, topic: Topic) -> bool:
    try:
        message = next(iter(bag.messages(topic.name)))
        found = image_message(message.decoded(), topic.kind == "compressed").encoding
    except Exception:  # a damaged message has no encoding; reading the topic reports it
        return False
    return found.upper() in ("16UC1", "32FC1") or "compressedDepth" in found


def _stereo(bases: Sequence[str]) -> list[TopicChoice]:
    """Left and right topics whose names differ in the side alone, one pair for each rig."""
    images = [base for base in bases if not _DEPTH.search(base) and not _COLOUR.search(base.rsplit("/", 1)[0])]
    parts = [image.split("/") for image in images]
    # What all have in common is no side, such as the numbers of a device and its sensor.
    shared = sum(1 for _ in takewhile(lambda same: len(set(same)) == 1, zip(*parts, strict=False)))
    sided = split_sides(["/".join(own[shared:]) for own in parts])
    if sided is None:
        return []
    rights = {sided.rest[i]: images[i] for i in sided.right}
    pairs = {sided.rest[i]: TopicChoice("stereo", images[i], rights[sided.rest[i]])
             for i in sided.left if sided.rest[i] in rights}  # fmt: skip
    return [pairs[rest] for rest in _preferred(pairs)]


def _rgbd(bases: Sequence[str], depth_bases: set[str]) -> list[TopicChoice]:
    """Images of colour, or whatever is not depth, with the depth topic of the same camera."""
    depths = _preferred([base for base in bases if base in depth_bases])
    images = [base for base in bases if base not in depth_bases]
    images = _preferred([base for base in images if _COLOUR.search(base)] or images)
    return [TopicChoice("rgbd", image, depth) for image in images for depth in depths]


def _preferred(names: Iterable[str]) -> list[str]:
    """One topic of each camera, by what drivers call it."""
    by_camera: dict[str, list[str]] = {}
    for name in names:
        by_camera.setdefault(name.rsplit("/", 1)[0], []).append(name)
    rank = {word: i for i, word in enumerate(_PREFERENCE)}
    return [min(own, key=lambda name: rank.get(name.rsplit("/", 1)[-1], len(rank))) for own in by_camera.values()]


def _listed(topics: Sequence[Topic]) -> str:
    names = ", ".join(topic.name for topic in topics[:8]) or "no topics"
    return names + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")


MAX_NS = 2**62
"""Times beyond the year 2116 are no clock's."""


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

    def _read(self, stream: Iterator[Message], skip: int) -> Stored:
        try:
            message = next(islice(stream, skip, None))
            return stored_pixels(image_message(message.decoded(), self.topic.kind == "compressed"))
        except UnreadableError as error:
            return error
        except Exception as error:  # a damaged message is a frame that is skipped, whatever the libraries raise
            return UnreadableError(f"a damaged message ({error_text(error)})")


def frames_of_topic(images: TopicImages, places: I64, pixels: Colour | Depths, sample: Sequence[Stored]) -> Images:
    """The images of a topic in the order of the recording (arguments of ``Images``)."""
    name = images.topic.name
    return Images(f"{images.bag.path}: {name}", places, pixels, images.at, lambda place: f"a message of {name}", sample)
