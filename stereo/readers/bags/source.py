"""The images of one topic as frames."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing

import numpy as np

from calib.errors import InputError
from calib.images import as_grey
from calib.length import size_text
from calib.types import I64, U8, AnyArray
from stereo.readers.bags.messages import image_message
from stereo.readers.bags.pixels import stored_pixels
from stereo.readers.bags.storage import Bag, Message, Topic
from stereo.readers.bits import FRAMES, to_8_bits, true_bits
from stereo.readers.source import Decoded, is_grey

AHEAD = 64
"""Messages that are read past rather than looked up anew (our choice)."""


class TopicImages:
    """Images of a topic by their place in it.

    Attributes:
        log_ns, stamp_ns: (n,) int64 [ns], when each was recorded and when its header says it was taken.
    Raises:
        InputError: the topic's messages cannot be read.
    """

    def __init__(self, bag: Bag, topic: Topic) -> None:
        self.bag, self.topic = bag, topic
        log, stamp = [], []
        try:
            for message in bag.messages(topic.name):
                log.append(message.log_ns)
                stamp.append(message.stamp(message.data))
        except Exception as error:  # libraries raise whatever a damaged file provokes
            if not log:
                raise InputError(f"{bag.path}: expected images in {topic.name}, found {_text(error)}") from error
        self.log_ns = np.array(log, dtype=np.int64)
        self.stamp_ns = np.array(stamp[: len(log)] + log[len(stamp) :], dtype=np.int64)

    def at(self, places: Iterable[int]) -> Generator[AnyArray | None, None, None]:
        """The stored values at these places, None where they cannot be decoded; places may be in any order."""
        stream: Iterator[Message] = iter(())
        next_place = -1
        for place in places:
            if not 0 <= place - next_place <= AHEAD or next_place < 0:
                start = int(self.log_ns[place])
                next_place = int(np.searchsorted(self.log_ns, start))
                stream = self.bag.messages(self.topic.name, start)
            yield self._read(stream, place - next_place)
            next_place = place + 1

    def sample(self) -> list[AnyArray]:
        """A few images spread over the topic, without those that cannot be decoded."""
        spread = sorted({round(float(i)) for i in np.linspace(0, len(self.log_ns) - 1, FRAMES)})
        with closing(self.at(spread)) as images:
            return [image for image in images if image is not None]

    def _read(self, stream: Iterator[Message], skip: int) -> AnyArray | None:
        try:
            for _ in range(skip):
                next(stream)
            message = next(stream)
            return stored_pixels(image_message(message.decode(message.data), self.topic.kind == "compressed"))
        except Exception:  # a damaged message is a frame that is skipped, whatever it provoked in the libraries
            return None


class TopicFrames:
    """A ``FrameSource`` of a topic's images in the order of the recording.

    Raises:
        InputError: none of a few images can be decoded.
    """

    fps = np.nan

    def __init__(self, images: TopicImages, places: I64, sample: Sequence[AnyArray], bits: int | None) -> None:
        """Args: places in the topic by frame index, -1 where the camera has none; a few of its images."""
        if not sample:
            raise InputError(
                f"{images.bag.path}: expected images in {images.topic.name}, found none that can be decoded"
            )
        self._images, self._places, self._bits = images, places, bits
        self.n_frames = len(places)
        self.size = sample[0].shape[1], sample[0].shape[0]
        self.is_grey = is_grey(to_8_bits(sample[0], bits)) if _is_image(sample[0]) else True

    def __iter__(self) -> Iterator[Decoded]:
        return self.at(range(self.n_frames))

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """See ``FrameSource``."""
        for index, stored in stored_at(self._images, self._places, indices):
            yield self._decoded(index, stored)

    def _decoded(self, index: int, stored: AnyArray | None) -> Decoded:
        name = self._images.topic.name
        if self._places[index] < 0:
            return Decoded(index, None, None, "image is missing")
        if stored is None or not _is_image(stored):
            return Decoded(index, None, None, f"a message of {name} cannot be decoded")
        if (stored.shape[1], stored.shape[0]) != self.size:
            found = size_text((stored.shape[1], stored.shape[0]))
            return Decoded(index, None, None, f"an image of {name} is {found}, not {size_text(self.size)}")
        image: U8 = to_8_bits(stored, self._bits)
        return Decoded(index, None, as_grey(image) if self.is_grey else image)


def stored_at(
    images: TopicImages, places: I64, indices: Iterable[int]
) -> Generator[tuple[int, AnyArray | None], None, None]:
    """Index and stored values of these frames; None where the camera has none, or none that can be decoded."""
    listed = list(indices)
    with closing(images.at(int(places[i]) for i in listed if places[i] >= 0)) as found:
        for index in listed:
            yield index, next(found) if places[index] >= 0 else None


def bits_in(samples: Sequence[Sequence[AnyArray]]) -> int | None:
    """Bits that the images of all cameras use; None for 8-bit images."""
    return true_bits(image for sample in samples for image in sample)


def _is_image(stored: AnyArray) -> bool:
    return stored.dtype in (np.uint8, np.uint16)


def _text(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
