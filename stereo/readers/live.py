"""Cameras as they run: devices by their number, and addresses (RTSP, HTTP), one with both views or two."""

from __future__ import annotations

import re
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.images import as_grey
from calib.rig import StereoRig
from calib.types import U8
from stereo.readers.base import Layout, OpenOptions, Reader, Stream, pixel_text, same_size, stereo_layout
from stereo.readers.images import is_grey
from stereo.readers.side_by_side import packed_layout
from stereo.recording import DEFAULT_FPS, Decoded, DecodedPair, FrameClock, newest

TIMEOUT_MS = 10_000
"""An address that does not answer, or a stream without a frame, for this long is given up [ms] (our choice)."""
FIRST_FRAMES = 3
"""Frames read at the start to tell size and layout; cameras need some to adapt to the light."""
_DROPPED = "came while earlier frames were tracked"
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

    Raises:
        InputError: nothing answers there, or it gives no image.
    """

    n_frames = 0

    def __init__(self, address: Address) -> None:
        self.address = address
        with closing(self._capture()) as frames:
            self.first = [image for _, image in zip(range(FIRST_FRAMES), (f.image for f in frames), strict=False)]
        pictures = [image for image in self.first if image is not None]
        if not pictures:
            raise InputError(f"{address.text}: expected a camera or a stream of images, found none")
        self.pictures: list[U8] = pictures
        self.size = pictures[-1].shape[1], pictures[-1].shape[0]
        self.is_grey = is_grey(pictures[-1])

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
        capture = _open(self.address)
        rate = capture.get(cv2.CAP_PROP_FPS)
        self.fps = float(rate) if np.isfinite(rate) and 0 < rate <= 1000 else DEFAULT_FPS
        clock, index = _LiveClock(), 0
        try:
            while True:
                found, image = capture.read()
                if not found or image is None:
                    return
                pixels = np.asarray(image, dtype=np.uint8)
                yield Decoded(index, clock.now(capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3), self._as_stored(pixels))
                index += 1
        finally:
            capture.release()

    def _as_stored(self, pixels: U8) -> U8:
        return as_grey(pixels) if getattr(self, "is_grey", False) else pixels


def with_gaps(frames: Generator[Decoded, None, None]) -> Generator[Decoded, None, None]:
    """The frames, and one without an image for every index that was dropped between them."""
    next_index = 0
    with closing(frames):
        for frame in frames:
            yield from (Decoded(lost, None, None, _DROPPED) for lost in range(next_index, frame.index))
            yield frame
            next_index = frame.index + 1


class _LiveClock:
    """Seconds since the first frame by the stream's own times while these increase, else by the machine's clock."""

    def __init__(self) -> None:
        self._start_s: float | None = None
        self._zero_s = 0.0
        self._last_s = -1.0
        self._own = True

    def now(self, stream_s: float) -> float:
        if self._start_s is None:
            self._start_s, self._zero_s = time.monotonic(), stream_s
        seconds = stream_s - self._zero_s
        self._own = self._own and seconds > self._last_s
        if not self._own:
            seconds = max(time.monotonic() - self._start_s, self._last_s + 1e-3)
        self._last_s = seconds
        return seconds


def _fits(path: Path) -> bool:
    return not path.exists() and bool(_addresses(path))


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


def _open(address: Address) -> cv2.VideoCapture:
    if isinstance(address.opens, int):
        capture = cv2.VideoCapture(address.opens)
    else:
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, TIMEOUT_MS]
        capture = cv2.VideoCapture(address.opens, cv2.CAP_FFMPEG, limits)
    if not capture.isOpened():
        raise InputError(f"{address.text}: expected a camera or a stream, found nothing that answers")
    return capture


READER = Reader("live", "live cameras", "a camera's number or an address (rtsp://, http://)", _fits, _find)
