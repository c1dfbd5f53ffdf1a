"""Recordings, whatever their layout on disk: frames, decoded ahead and iterated."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

import numpy as np

from calib.camera import Camera
from calib.errors import InputError
from calib.images import as_colour
from calib.pose import SE3
from calib.rig import DepthTechnology, StereoRig
from calib.times import RunningClock
from calib.types import F32, F64, U8, AnyArray
from stereo.depth import Depths

T = TypeVar("T")
S = TypeVar("S")
Sensor = TypeVar("Sensor", covariant=True)


@dataclass
class OpenOptions:
    """Options that the caller supplies about a recording.

    Attributes:
        calibration: file or folder; found in the recording when None.
        fps: frames per second, in place of the recording's own times; None takes those.
        topics: names of the left and the right (or the image's and the depth's) topic of a bag; empty: chosen.
        right: video or folder of the right camera, where the recording is that of the left one alone.
    """

    calibration: Path | None = None
    fps: float | None = None
    topics: Sequence[str] = ()
    right: Path | None = None

    def __post_init__(self) -> None:
        """Paths may be given as text, topics with a comma between them."""
        named = self.topics.split(",") if isinstance(self.topics, str) else self.topics
        self.topics = tuple(name.strip() for name in named)
        self.calibration, self.right = (None if path is None else Path(path) for path in (self.calibration, self.right))
        if self.fps is not None and not (isinstance(self.fps, int | float) and 0.01 <= self.fps <= 10_000):
            raise InputError(f"expected 0.01 to 10000 frames per second, found {self.fps!r}", argument="fps")
        if self.topics and (len(self.topics) != 2 or not all(self.topics) or self.topics[0] == self.topics[1]):
            found = ",".join(self.topics)
            raise InputError(f"expected two topics, LEFT,RIGHT or IMAGE,DEPTH, found {found!r}", argument="topics")

    def resolve(self) -> OpenOptions:
        """With absolute paths."""
        calibration, right = (path and path.resolve() for path in (self.calibration, self.right))
        return replace(self, calibration=calibration, right=right)


Shot = tuple[AnyArray, ...]
"""Images that a sensor recorded at one moment: an image; or a left and a right one; or an image and its depth. Images
as recorded, lens distortion included, are (H, W) or (H, W, 3) uint8, BGR; depth is (H, W) float32 [m] along the optical
axis of the image's pixels, NaN where unknown."""
SHOTS: dict[tuple[type, ...], str] = {
    (np.uint8,): "one image",
    (np.uint8, np.uint8): "a left and a right image",
    (np.uint8, np.float32): "an image and its depth",
}
"""Contents of shots by the types of their numbers."""


def refuse_foreign_shot(shot: Shot, expected: tuple[type, ...]) -> None:
    """Raises InputError: a shot of another kind of sensor than ``expected``, one of ``SHOTS``."""
    types = tuple(image.dtype.type for image in shot)
    if types != expected:
        raise InputError(f"frame: expected {SHOTS[expected]}, found {SHOTS.get(types, f'{len(shot)} images')}")


@dataclass(frozen=True, eq=False)
class Frame(Generic[S]):
    """Shots that the sensors of a recording took at one moment.

    Attributes:
        index: position in the recording, from 0; skipped frames leave gaps.
        timestamp_s: seconds since the recording's first frame; NaN where nothing gives the times.
        shots: of each sensor, None where it has none.
    """

    index: int
    timestamp_s: float
    shots: tuple[S | None, ...]

    @property
    def images(self: Frame[Shot]) -> Shot:
        """Images of the first sensor, which stands for the others; empty where it has none."""
        return self.shots[0] or ()

    @property
    def image(self: Frame[Shot]) -> U8:
        """The first image, which stands for the frame."""
        return self.images[0]


@dataclass(frozen=True)
class Skipped:
    """A frame that could not be used, and why."""

    index: int
    why: str


@dataclass(frozen=True, eq=False)
class Decoded:
    """Frame ``index``, from 0, of one camera: the file's own time, where it has one, and the image, (H, W) or (H, W, 3)
    uint8 BGR, or (H, W) float32 depth [m] in the sensor's own pixels; None for the reason ``why``."""

    index: int
    timestamp_s: float | None
    image: AnyArray | None
    why: str = ""


class FrameClock(NamedTuple):
    """When the frames of a recording were taken.

    Attributes:
        fps: nominal frames per second; NaN where nothing gives the times; ``notes`` then name it.
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None takes the times of the decoded frames.
        notes: what was found about the times.
        even: frames are ``fps`` apart, whatever times the files hold.
    """

    fps: float
    times_s: F64 | None = None
    notes: tuple[str, ...] = ()
    even: bool = False

    def time(self, frame: Decoded) -> float:
        """Time of a frame [s]; where the table has none, between its neighbours, beyond its end at the nominal rate.
        NaN where nothing gives the times."""
        index, times = frame.index, self.times_s
        if times is None:
            return index / self.fps if self.even or frame.timestamp_s is None else frame.timestamp_s
        if index < len(times) and math.isfinite(times[index]):
            return float(times[index])
        known = np.flatnonzero(np.isfinite(times))
        beyond = index - np.clip(index, known[0], known[-1])
        return float(np.interp(index, known, times[known]) + beyond / self.fps)


def no_clock(*notes: str) -> FrameClock:
    """Clock of frames whose times nothing gives, as the notes say."""
    return FrameClock(math.nan, None, notes, even=True)


def prefetch(items: Iterable[T], depth: int = 8) -> Generator[T, None, None]:
    """The same items, made by a background thread up to ``depth`` ahead: 8 frames bridge a slow key frame. An exception
    of the source is raised in its place; leaving early stops the thread and closes a source that is a generator."""
    iterator, end = iter(items), object()
    with ThreadPoolExecutor(1, "ahead") as pool:
        kept = deque(pool.submit(next, iterator, end) for _ in range(depth))
        try:
            while (item := kept.popleft().result()) is not end:
                kept.append(pool.submit(next, iterator, end))
                yield cast(T, item)
        finally:
            pool.shutdown(cancel_futures=True)
            if isinstance(iterator, Generator):
                iterator.close()


DecodedPair = tuple[Decoded, Decoded]


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Two cameras with their calibration at the images' size; ``world_SE3_left`` is that of ``world.toml``, else None
    (the floor is then found)."""

    rig: StereoRig
    world_SE3_left: SE3 | None = None
    sides: ClassVar = ("left: ", "right: ")
    holds: ClassVar[tuple[type, ...]] = (np.uint8, np.uint8)
    floor_share_doubted: ClassVar = 0.0
    """Share of depth on the floor below which the floor is looked at again: rows show more of a pair."""

    @property
    def identity(self) -> list[Any]:
        """Everything that decides depth besides the images, wherever it came from."""
        return [replace(self.rig, source="")]

    @property
    def camera(self) -> Camera:
        """The left camera, whose images stand for the frames."""
        return self.rig.left

    @property
    def focal_widths(self) -> float:
        """Focal length of the left camera in widths of its image."""
        return self.camera.fx / self.camera.width

    @property
    def source(self) -> str:
        """Origin of the calibration, for messages and run.json."""
        return self.rig.source

    @property
    def lengths_m(self) -> dict[str, float]:
        """Lengths of the calibration [m]."""
        return {"baseline_m": self.rig.baseline_m}

    def shot(self, left: AnyArray, right: AnyArray) -> Shot:
        """Shot of the images as decoded: both in colour, where one is."""
        return (left, right) if left.ndim == right.ndim else (as_colour(left), as_colour(right))

    def images(self, shot: Shot) -> Shot:
        """Images of a shot that cameras took: both."""
        return shot


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """A camera with registered depth, which a sensor measured.

    Attributes:
        camera, source: calibration of the images at their size, and where it came from, for messages and run.json.
        technology: how depth is measured.
        registration: moves depth into the pixels of the image.
        world_SE3_left: of the image's camera, from ``world.toml``, else None (the floor is then found).
        depth_units: of depth as it is stored, also of frames read later.
        depth_camera: of depth as it is stored; None where it lies in the image's pixels.
    """

    camera: Camera
    source: str
    technology: DepthTechnology
    registration: Callable[[F32], F32]
    world_SE3_left: SE3 | None = None
    depth_units: Depths = field(default_factory=partial(Depths, 1.0))
    depth_camera: Camera | None = None
    sides: ClassVar = ("image: ", "depth: ")
    holds: ClassVar[tuple[type, ...]] = (np.uint8, np.float32)
    floor_share_doubted: ClassVar = 0.2
    """Depth along the ray leaves 0.1 to 0.17 of a floor that holds 0.25 (on two rooms)."""
    lengths_m: ClassVar[dict[str, float]] = {}

    @property
    def identity(self) -> list[Any]:
        """See ``StereoPair``."""
        return [self.camera, self.technology]

    @property
    def focal_widths(self) -> float:
        """Focal length in widths of the image."""
        return self.camera.fx / self.camera.width

    def shot(self, image: AnyArray, depth_m: AnyArray) -> Shot:
        """Shot of an image and depth as decoded."""
        return image, self.registration(depth_m)

    def images(self, shot: Shot) -> Shot:
        """Image of a shot that the camera took."""
        return shot[:1]


@dataclass(frozen=True, eq=False)
class SingleCamera:
    """A camera without depth, whose images are (width, height) [px] large."""

    size: tuple[int, int]
    focal_widths: ClassVar = 1.0
    """Focal length of a camera without calibration, in widths of its image: a view of 53 degrees."""
    sides: ClassVar = ("",)
    holds: ClassVar[tuple[type, ...]] = (np.uint8,)
    identity: ClassVar[list[Any]] = []

    def shot(self, image: AnyArray) -> Shot:
        """Shot of an image as decoded."""
        return (image,)

    def images(self, shot: Shot) -> Shot:
        """Image of a shot that the camera took."""
        return shot


RecordedBy = StereoPair | DepthCamera | SingleCamera


@dataclass(eq=False, repr=False)
class Recording(Generic[Sensor]):
    """Frames that one sensor recorded; each iteration starts at the first frame.

    A frame of which an image is missing, or whose time is not after that of the frame before, is passed over and noted
    in ``skipped``; indices and times keep the gap.

    Attributes:
        path: the folder or file it came from.
        decode: gives the images of ascending indices, or of all.
        n_frames: frames announced by the files (an upper bound).
        clock: when the frames were taken; ``fps`` and ``times_s`` are its.
        notes: what the reader assumed, repaired or missed, a sentence each.
        sensor: what recorded it, with its calibration.
        skipped: frames passed over so far while iterating.
        options: what it was opened with.
        files: of its images, in the order of the reader; none of live cameras.
    """

    path: Path
    decode: Callable[[Sequence[int] | None], Generator[Any, None, None]]
    n_frames: int
    clock: FrameClock
    notes: list[str]
    sensor: Sensor
    skipped: list[Skipped] = field(default_factory=list, init=False)
    options: OpenOptions = field(default_factory=OpenOptions, kw_only=True)
    files: Sequence[Path] = field(default=(), kw_only=True)
    name: str = field(default="", init=False)
    """Among several sensors."""
    is_live: ClassVar = False
    """True if frames come from cameras as they run."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self.path)!r}, {self.n_frames} frames, {self.fps:.4g} per second)"

    @property
    def parts(self) -> tuple[Recording[Sensor], ...]:
        """A recording of each sensor: itself."""
        return (self,)

    @property
    def identity(self) -> list[Any]:
        """Everything that decides results besides the images: cameras and times."""
        return [*cast(RecordedBy, self.sensor).identity, self.times_s]

    @property
    def fps(self) -> float:
        return self.clock.fps

    @property
    def times_s(self) -> F64 | None:
        return self.clock.times_s

    def __iter__(self) -> Iterator[Frame[Shot]]:
        self.skipped = skipped = []
        last = -1
        with closing(self.decode(None)) as decoded:
            for index, frame in self._frames(decoded):
                last = index
                if isinstance(frame, Skipped):
                    skipped.append(frame)
                else:
                    yield frame
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def sample(self, count: int) -> list[Frame[Shot]]:
        """Up to ``count`` usable frames spread evenly over the recording; ``skipped`` is not touched."""
        n_frames = self.n_frames
        spread = np.unique(np.linspace(0, n_frames - 1, max(1, min(count, n_frames))).round().astype(int))
        return self.at([int(i) for i in spread])

    def at(self, indices: Sequence[int]) -> list[Frame[Shot]]:
        """The usable ones of these frames, whose indices ascend; ``skipped`` is not touched."""
        with closing(self.decode(indices)) as decoded:
            return [frame for _, frame in self._frames(decoded) if not isinstance(frame, Skipped)]

    def _frames(self, decoded: Iterable[tuple[Decoded, ...]]) -> Iterator[tuple[int, Frame[Shot] | Skipped]]:
        """Indices and frames in order, with times that run on where the clock was set."""
        sensor, running = cast(RecordedBy, self.sensor), RunningClock(self.fps)
        for parts in decoded:
            index, now_s = parts[0].index, self.clock.time(parts[0])
            images = [part.image for part in parts if part.image is not None]
            if len(images) < len(parts):
                reasons = zip(sensor.sides, parts, strict=True)
                yield index, Skipped(index, "; ".join(side + part.why for side, part in reasons if part.why))
                continue
            now_s, why = (now_s, "") if math.isnan(self.fps) else running.time(index, now_s)
            yield index, Skipped(index, why) if why else Frame(index, now_s, (sensor.shot(*images),))


def refuse_untimed(recording: Any) -> None:
    """Raises InputError: nothing gives the times of the frames of a recording, without which nobody can be followed."""
    if math.isnan(recording.fps):
        raise InputError(f"{recording.path}: {'; '.join(recording.clock.notes)}", remedy="fps")


class LiveRecording(Recording[StereoPair]):
    """Frames of two cameras as they run; every iteration begins with the next frame that comes."""

    is_live = True

    def sample(self, count: int) -> list[Frame[Shot]]:
        """Up to ``count`` usable frames from now on, 0.25 s apart (12 for the floor take 3 s)."""
        frames: list[Frame[Shot]] = []
        with closing(self.decode(None)) as pairs:
            for _, frame in self._frames(pairs):
                if isinstance(frame, Frame) and (not frames or frame.timestamp_s - frames[-1].timestamp_s >= 0.25):
                    frames.append(frame)
                if len(frames) >= count:
                    break
        return frames
