"""Cameras as they run: devices by their number, and addresses (RTSP, HTTP), one with both views or two."""

from __future__ import annotations

import re
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

import cv2
import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.images import as_grey
from calib.rig import StereoRig
from stereo.readers.base import FramePairs, Layout, Reader, same_size, stereo_layout, together
from stereo.readers.images import Stream, is_grey
from stereo.readers.side_by_side import packed_layout
from stereo.recording import Decoded, FrameClock, OpenOptions

_CAMERA = re.compile(r"\d{1,3}|(?:rtsps?|https?|rtmps?|udp|tcp|srt):/.*", re.IGNORECASE)
NOMINAL_FPS = 30.0
"""Rate of most cameras; the times of the frames are their own."""


class LiveSource:
    """Images of a device or an address from now on (a ``FrameSource`` without a known end). Their times are those of
    the stream while these increase, else when they came."""

    n_frames = 0
    fps = NOMINAL_FPS
    raw = False
    is_grey = False
    files: Sequence[Path] = ()

    def __init__(self, address: str) -> None:
        self._address = address
        self.name = without_password(address)
        with closing(iter(self)) as frames:  # cameras need some frames to adapt to the light
            self.pictures = [np.asarray(f.image, dtype=np.uint8) for f in islice(frames, 3)]
        if not self.pictures:
            raise InputError(f"{self.name}: expected a camera or a stream of images, found none")
        self.size = self.pictures[-1].shape[1], self.pictures[-1].shape[0]
        self.is_grey = is_grey(self.pictures[-1])

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """As many of the frames that come from now on; none comes again."""
        return (replace(frame, index=index) for index, frame in zip(indices, self, strict=False))

    def __iter__(self) -> Generator[Decoded, None, None]:
        # An address that does not answer, or a stream without a frame, is given up after 10 s.
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 10_000]
        opens = [int(self._address)] if self._address.isdecimal() else [self._address, cv2.CAP_FFMPEG, limits]
        capture = cv2.VideoCapture(*opens)
        try:
            if not capture.isOpened():
                raise InputError(f"{self.name}: expected a camera or a stream, found nothing that answers")
            start_s = time.monotonic()
            first_s = 0.0
            last_s = -1.0
            for index in count():
                found, image = capture.read()
                if not found or image is None:
                    return
                own_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                first_s = own_s if index == 0 else first_s
                own_s -= first_s
                last_s = own_s if own_s > last_s else max(time.monotonic() - start_s, last_s + 1e-3)
                pixels = np.asarray(image, dtype=np.uint8)
                yield Decoded(index, last_s, as_grey(pixels) if self.is_grey else pixels)
        finally:
            capture.release()


def without_password(address: str) -> str:
    """An address as messages and results show it."""
    return re.sub(r"(?<=://)[^/@]*@", "", address)


def _find(path: Path, options: OpenOptions) -> Layout:
    sources = [LiveSource(address) for address in addresses(path)]
    if len(sources) > 2:
        raise InputError(f"{path}: expected one or two cameras, found {len(sources)}")
    first = sources[0]
    second = sources[-1]
    named = Path(",".join(source.name for source in sources))
    calibration = options.calibration
    folder = calibration or Path("no-calibration")
    folder = folder.parent if folder.is_file() else folder  # with the world.toml

    def rig() -> StereoRig:
        if calibration is None:
            raise InputError(f"{named}: the calibration of the cameras is missing", remedy="calibration")
        return load_rig(calibration, first.size)

    if len(sources) == 1:
        own = None if calibration else rig
        return packed_layout(named, named, folder, first, first.pictures, options, rig=own, live=True)

    size = same_size(first, second, first.name, second.name)
    streams = tuple(
        Stream(name, size, 0, None, "grey" if one.is_grey else "colour")
        for name, one in zip(("left", "right"), sources, strict=True)
    )
    clock = FrameClock(options.fps or NOMINAL_FPS, even=options.fps is not None)
    note = "two cameras that run freely: their images are paired as they come"
    return stereo_layout(named, FramePairs(together(first, second), 0, live=True), streams, clock, rig, (note,), folder)


def addresses(path: Path) -> list[str]:
    """Numbers and addresses of cameras with commas between them (a path leaves one of two slashes); else none."""
    parts = re.split(r",(?=\d|\w+:/)", str(path))
    return [re.sub(":/+", "://", part, count=1) for part in parts] if all(map(_CAMERA.fullmatch, parts)) else []


READER = Reader("live", "live cameras", lambda path: not path.exists() and bool(addresses(path)), _find)
