"""Cameras as they run: devices by their number, and addresses (RTSP, HTTP), one with both views or two."""

from __future__ import annotations

import re
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.images import as_grey
from calib.rig import StereoRig
from stereo.readers.base import Layout, OpenOptions, Reader, Stream, pixel_text, same_size, stereo_layout
from stereo.readers.images import is_grey
from stereo.readers.side_by_side import packed_layout
from stereo.recording import DEFAULT_FPS, Decoded, DecodedPair, FrameClock, newest

_ADDRESS = re.compile(r"(rtsps?|https?|rtmps?|udp|tcp|srt):/+", re.IGNORECASE)
_DEVICE = re.compile(r"\d{1,3}")
_PASSWORD = re.compile(r"(?<=://)[^/@]*@")


class Address(NamedTuple):
    """A device's number or a stream's address.

    Attributes:
        drops: frames that come while the last ones are tracked are dropped; a file served over HTTP waits instead.
    """

    opens: int | str
    drops: bool

    @property
    def text(self) -> str:
        """For messages and results: without name and password."""
        return _PASSWORD.sub("", str(self.opens))


class LiveSource:
    """Images of a camera from now on (a ``FrameSource`` whose end is not known).

    Their times are the stream's own while these increase, else the machine's clock.

    Attributes:
        pictures: the first ones.
    Raises:
        InputError: nothing answers there, or it gives no image.
    """

    n_frames = 0
    is_grey = False

    def __init__(self, address: Address) -> None:
        self.address, self.fps, self.raw = address, DEFAULT_FPS, False
        # The first frames tell size and layout; cameras need some to adapt to the light.
        with closing(self._capture()) as frames:
            self.pictures = [np.asarray(f.image, dtype=np.uint8) for f in islice(frames, 3)]
        if not self.pictures:
            raise InputError(f"{address.text}: expected a camera or a stream of images, found none")
        self.size = self.pictures[-1].shape[1], self.pictures[-1].shape[0]
        self.is_grey = is_grey(self.pictures[-1])

    def __iter__(self) -> Iterator[Decoded]:
        return with_gaps(newest(self._capture())) if self.address.drops else self._capture()

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """These of the frames that come from now on."""
        wanted = set(indices)
        with closing(self._capture()) as frames:
            for frame in frames:
                if frame.index in wanted:
                    yield frame
                if not wanted or frame.index >= max(wanted):
                    return

    def _capture(self) -> Generator[Decoded, None, None]:
        if isinstance(self.address.opens, int):
            capture = cv2.VideoCapture(self.address.opens)
        else:
            # An address that does not answer, or a stream without a frame, is given up after 10 s (our choice).
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 10_000]
            capture = cv2.VideoCapture(self.address.opens, cv2.CAP_FFMPEG, limits)
        try:
            if not capture.isOpened():
                raise InputError(f"{self.address.text}: expected a camera or a stream, found nothing that answers")
            rate = capture.get(cv2.CAP_PROP_FPS)
            self.fps = float(rate) if np.isfinite(rate) and 0 < rate <= 1000 else DEFAULT_FPS
            start_s = zero_s = last_s = 0.0
            own = True
            for index in count():
                found, image = capture.read()
                if not found or image is None:
                    return
                now_s, stream_s = time.monotonic(), capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                if index == 0:
                    start_s, zero_s, last_s = now_s, stream_s, -1.0
                own = own and stream_s - zero_s > last_s
                last_s = stream_s - zero_s if own else max(now_s - start_s, last_s + 1e-3)
                pixels = np.asarray(image, dtype=np.uint8)
                yield Decoded(index, last_s, as_grey(pixels) if self.is_grey else pixels)
        finally:
            capture.release()


def with_gaps(frames: Generator[Decoded, None, None]) -> Generator[Decoded, None, None]:
    """The frames, and one without an image for every index that was dropped between them."""
    next_index = 0
    with closing(frames):
        for frame in frames:
            for lost in range(next_index, frame.index):
                yield Decoded(lost, None, None, "came while earlier frames were tracked")
            yield frame
            next_index = frame.index + 1


def _find(path: Path, options: OpenOptions) -> Layout:
    addresses, calibration = _addresses(path), options.calibration
    if len(addresses) > 2:
        raise InputError(f"{path}: expected one or two cameras, found {len(addresses)}")
    named = Path(",".join(address.text for address in addresses))
    waits = not any(address.drops for address in addresses)
    folder = Path("no-calibration")  # where world.toml lies: beside the calibration
    if calibration is not None:
        folder = calibration if calibration.is_dir() else calibration.parent
    sources = tuple(LiveSource(address) for address in addresses)

    def rig() -> StereoRig:
        if calibration is None:
            raise InputError(
                f"{named}: expected the calibration of the cameras, found none: --calibration FILE gives it"
            )
        return load_rig(calibration, sources[0].size)

    if len(sources) == 1:
        return packed_layout(
            named, named, folder, sources[0], sources[0].pictures, options,
            rig=None if calibration else rig, live_waits=waits,
        )  # fmt: skip
    size = same_size(sources[0], sources[1], addresses[0].text, addresses[1].text)
    streams = tuple(
        Stream(name, size, 0, None, pixel_text(source.is_grey, None))
        for name, source in zip(("left", "right"), sources, strict=True)
    )
    clock = FrameClock(options.fps or sources[0].fps, even=options.fps is not None)
    note = "two cameras that run freely: their images are paired as they come"
    return stereo_layout(
        named, partial(_together, sources), streams, 0, clock, rig, (note,), folder=folder, live_waits=waits
    )


def _together(sources: Sequence[LiveSource], indices: Sequence[int] | None) -> Generator[DecodedPair, None, None]:
    one, other = (iter(source) if indices is None else source.at(indices) for source in sources)
    for left, right in zip(one, other, strict=False):
        yield left, Decoded(left.index, right.timestamp_s, right.image, right.why)


def _addresses(path: Path) -> list[Address]:
    """Addresses of the cameras; a path leaves one slash of an address's two."""
    parts = re.split(r",(?=\d|\w+:/)", str(path))
    if all(_DEVICE.fullmatch(part) for part in parts):
        return [Address(int(part), True) for part in parts]
    if not all(_ADDRESS.match(part) for part in parts):
        return []
    addresses = [_ADDRESS.sub(lambda match: f"{match[1]}://", part, count=1) for part in parts]
    return [Address(address, not address.lower().startswith("http")) for address in addresses]


READER = Reader(
    "live",
    "live cameras",
    "a camera's number or an address (rtsp://, http://)",
    lambda path: not path.exists() and bool(_addresses(path)),
    _find,
)
