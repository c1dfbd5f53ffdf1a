"""What readers share: decoded images, frames made of two of them, and what a reader is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, Protocol, TypeVar

import cv2
import numpy as np

from calib.images import as_colour
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F32, F64, U8
from stereo.readers.background import prefetch
from stereo.recording import RgbdRecording, Skipped, StereoFrame


@dataclass(frozen=True, eq=False)
class Decoded:
    """One frame of one camera: an image, or the reason why there is none.

    Attributes:
        index: position in the recording, from 0.
        timestamp_s: the file's own time of the frame, None when it has none.
        image: (H, W) or (H, W, 3) uint8, BGR; None when it could not be had.
        why: the reason when image is None.
    """

    index: int
    timestamp_s: float | None
    image: U8 | None
    why: str = ""


@dataclass(frozen=True, eq=False)
class DecodedDepth:
    """One depth image as stored.

    Attributes:
        index, timestamp_s: as of ``Decoded``.
        depth_m: (h, w) float32 [m] in the depth sensor's own pixels, NaN where unknown; None when it could not be had.
        why: the reason when depth_m is None.
    """

    index: int
    timestamp_s: float | None
    depth_m: F32 | None
    why: str = ""


DecodedItem = TypeVar("DecodedItem", bound=Decoded | DecodedDepth, covariant=True)


class ItemSource(Protocol[DecodedItem]):
    """What was decoded, in order; every index is yielded once, with or without an image."""

    def __iter__(self) -> Iterator[DecodedItem]: ...

    def at(self, indices: Iterable[int]) -> Iterator[DecodedItem]:
        """Only these frames, which must ascend; the iteration ends where the file does."""


class FrameSource(ItemSource[Decoded], Protocol):
    """Images of one camera in order.

    Attributes:
        size: (width, height) [px].
        n_frames: frames announced; the iteration may end earlier.
        fps: nominal rate, NaN when the files hold none.
    """

    size: tuple[int, int]
    n_frames: int
    fps: float


GREY_TOLERANCE = 4
"""Largest difference of the channels [grey levels] in a grey video: codecs that store YUV round a little."""


def is_grey(image: U8) -> bool:
    """Whether an image holds no colour: one channel, or three nearly equal ones that are not all the same value.

    A uniform picture (a black first frame) decides nothing and counts as colour, which loses nothing.
    """
    if image.ndim == 2:
        return True
    green = image[..., 1]
    difference = max(int(cv2.absdiff(image[..., c], green).max()) for c in (0, 2))
    return int(np.ptp(green)) > 4 * GREY_TOLERANCE and difference <= GREY_TOLERANCE


DEFAULT_FPS = 30.0
"""Assumed for image folders that have no timestamps.csv."""

AnyFrame = TypeVar("AnyFrame")
Second = TypeVar("Second", bound=Decoded | DecodedDepth)


class PairedFrames(ABC, Generic[AnyFrame, Second]):
    """Frames of an image and its mate, decoded ahead in the background; each iteration starts at the first frame.

    A frame that one side lacks is passed over and noted in ``skipped``; indices and times keep the gap.

    Attributes:
        path: the folder or file it came from.
        n_frames: frames announced by the files.
        fps: nominal frames per second.
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None without a table of times.
        skipped: frames passed over so far while iterating.
        notes: what the reader assumed, mended or missed, a sentence each.
        even: frames are ``fps`` apart, whatever times the decoded frames hold.
    """

    sides: tuple[str, str]
    """Names of the two, for messages."""

    def __init__(
        self,
        path: Path,
        pairs: Callable[[Sequence[int] | None], Generator[tuple[Decoded, Second], None, None]],
        n_frames: int,
        fps: float,
        times_s: F64 | None,
    ) -> None:
        """Prepare.

        Args:
            pairs: decodes the pairs of ascending indices, or all.
        """
        self.path = path
        self.n_frames = n_frames
        self.fps = fps
        self.times_s = times_s
        self.skipped: list[Skipped] = []
        self.notes: list[str] = []
        self.even = False
        self._pairs = pairs

    @abstractmethod
    def _joined(self, first: Decoded, second: Second, timestamp_s: float) -> AnyFrame | None:
        """The frame of two decoded images; None when one of them is missing."""

    def __iter__(self) -> Iterator[AnyFrame]:
        self.skipped = skipped = []
        last = -1
        with closing(self._pairs(None)) as pairs:
            for first, second in pairs:
                last = first.index
                frame = self._frame(first, second)
                if isinstance(frame, Skipped):
                    skipped.append(frame)
                else:
                    yield frame
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def sample(self, count: int) -> list[AnyFrame]:
        """Up to ``count`` usable frames spread evenly over the recording; ``skipped`` is not touched.

        For what must be known before the first frame (rig, floor, exposure) without decoding everything.
        """
        spread = np.unique(np.linspace(0, self.n_frames - 1, max(1, min(count, self.n_frames))).round().astype(int))
        return self.at([int(i) for i in spread])

    def at(self, indices: Sequence[int]) -> list[AnyFrame]:
        """The usable ones of these frames, whose indices ascend; ``skipped`` is not touched."""
        with closing(self._pairs(indices)) as pairs:
            frames = [self._frame(first, second) for first, second in pairs]
        return [frame for frame in frames if not isinstance(frame, Skipped)]

    def _frame(self, first: Decoded, second: Second) -> AnyFrame | Skipped:
        frame = self._joined(first, second, self._time(first))
        if frame is None:
            reasons = zip(self.sides, (first.why, second.why), strict=True)
            return Skipped(first.index, "; ".join(f"{side}: {why}" for side, why in reasons if why))
        return frame

    def _time(self, frame: Decoded) -> float:
        if self.times_s is not None:
            return time_at(self.times_s, frame.index, self.fps)
        return frame.index / self.fps if self.even or frame.timestamp_s is None else frame.timestamp_s


def both(
    first: ItemSource[Decoded], second: ItemSource[Second], indices: Sequence[int] | None
) -> Generator[tuple[Decoded, Second], None, None]:
    """Frames of two sources side by side, each decoded in its own thread; ends with the shorter one."""
    one, other = (first, second) if indices is None else (first.at(indices), second.at(indices))
    with closing(prefetch(one)) as a, closing(prefetch(other)) as b:
        yield from zip(a, b, strict=False)


def time_at(times_s: F64, index: int, fps: float) -> float:
    """Time of a frame; where the table has none, between its neighbours, beyond its end at the nominal rate."""
    if index < len(times_s) and math.isfinite(times_s[index]):
        return float(times_s[index])
    known = np.flatnonzero(np.isfinite(times_s))
    if index > known[-1]:
        return float(times_s[known[-1]] + (index - known[-1]) / fps)
    if index < known[0]:
        return float(times_s[known[0]] + (index - known[0]) / fps)
    return float(np.interp(index, known, times_s[known]))


def rate_of(times_s: F64) -> float:
    """Nominal frames per second of a table of times, ``DEFAULT_FPS`` when it holds fewer than two."""
    steps = np.diff(times_s)
    steps = steps[np.isfinite(steps)]
    return float(1.0 / np.median(steps)) if steps.size else DEFAULT_FPS


SAMPLE_STEP_S = 0.25
"""Frames in which a live camera's floor is looked for are so far apart [s] (our choice: 12 take 3 s)."""

DecodedPair = tuple[Decoded, Decoded]
PairsOf = Callable[[Sequence[int] | None], Generator[DecodedPair, None, None]]
"""Decodes the pairs of these ascending indices, or all."""


class StereoRecording(PairedFrames[StereoFrame, Decoded]):
    """Frames of two cameras (a ``Recording``).

    Attributes:
        rig, world_SE3_left: see ``Recording``.
        is_live: frames come from cameras as they run.
    """

    sides = ("left", "right")
    is_live = False

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        pairs: PairsOf,
        n_frames: int,
        fps: float,
        times_s: F64 | None,
        world_SE3_left: SE3 | None,
    ) -> None:
        super().__init__(path, pairs, n_frames, fps, times_s)
        self.rig = rig
        self.world_SE3_left = world_SE3_left

    def _joined(self, first: Decoded, second: Decoded, timestamp_s: float) -> StereoFrame | None:
        a, b = first.image, second.image
        if a is None or b is None:
            return None
        if a.ndim != b.ndim:
            a, b = as_colour(a), as_colour(b)
        return StereoFrame(first.index, timestamp_s, a, b)


class LiveRecording(StereoRecording):
    """Frames of two cameras as they run; every iteration begins with the next frame that comes.

    Attributes:
        waits: the source waits until its frames are read (a file behind an address), as a device does not.
    """

    is_live = True
    waits = False

    def sample(self, count: int) -> list[StereoFrame]:
        """Up to ``count`` usable frames from now on, ``SAMPLE_STEP_S`` apart."""
        frames: list[StereoFrame] = []
        with closing(self._pairs(None)) as pairs:
            for left, right in pairs:
                frame = self._frame(left, right)
                if isinstance(frame, Skipped):
                    continue
                if not frames or frame.timestamp_s - frames[-1].timestamp_s >= SAMPLE_STEP_S:
                    frames.append(frame)
                if len(frames) >= count:
                    break
        return frames


def split_pairs(
    source: ItemSource[Decoded], split: Callable[[U8], tuple[U8, U8]], indices: Sequence[int] | None
) -> Generator[DecodedPair, None, None]:
    """The left and the right view in every frame of a source that holds both."""
    with closing(prefetch(source if indices is None else source.at(indices))) as frames:
        for frame in frames:
            if frame.image is None:
                yield frame, frame
                continue
            left, right = (Decoded(frame.index, frame.timestamp_s, view) for view in split(frame.image))
            yield left, right


AnyRecording = StereoRecording | RgbdRecording
"""What a layout opens to."""


@dataclass(frozen=True)
class OpenOptions:
    """What the caller supplies about a recording.

    Attributes:
        calibration: calibration file or folder; found in the recording when None.
        fps: frames per second, in place of the recording's own times; None takes those.
        topics: names of the left and the right (or the image's and the depth's) topic of a bag; empty: chosen.
    """

    calibration: Path | None = None
    fps: float | None = None
    topics: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Stream:
    """One camera of a recording, as it was stored.

    Attributes:
        name: "left", "right", "depth", or a topic.
        size: (width, height) [px].
        n_frames: images that are there.
        times_s: (n_frames,) float64 [s] since the recording's first stamp, in order; None without stamps of its own.
        pixels: what a pixel is, e.g. "grey", "colour", "12 bits grey in 16".
    """

    name: str
    size: tuple[int, int]
    n_frames: int
    times_s: F64 | None = None
    pixels: str = ""


class Layout(Protocol):
    """What a reader found at a path; nothing is decoded yet but a first image of each camera.

    Attributes:
        kind: images of two cameras, or images with depth.
        streams: the cameras.
        n_frames: frames announced (an upper bound).
        fps: nominal frames per second.
        unpaired: frames that one of the cameras lacks.
        notes: what the reader assumed, mended or missed, a sentence each, for the summary and run.json.
    """

    @property
    def kind(self) -> Literal["stereo", "rgbd"]: ...

    @property
    def streams(self) -> tuple[Stream, ...]: ...

    @property
    def n_frames(self) -> int: ...

    @property
    def fps(self) -> float: ...

    @property
    def unpaired(self) -> int: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    def open(self) -> AnyRecording:
        """The recording with its calibration.

        Raises:
            InputError: no calibration there, or one that does not fit.
        """


@dataclass(frozen=True)
class Reader:
    """One layout of recordings.

    Attributes:
        key: short name, for ``check --quick --json``.
        name: as messages show it.
        looks_for: what makes a path this layout, for the sentence that lists what was looked for.
        fits: whether a path looks like it; reads names and first bytes only, and never raises InputError.
        find: what is there; raises InputError when it looked like it but cannot be read.
    """

    key: str
    name: str
    looks_for: str
    fits: Callable[[Path], bool]
    find: Callable[[Path, OpenOptions], Layout]
