"""Parts that readers share: sources of images, the layout of a path before it is opened, its clock and calibration."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, cast

import numpy as np

from calib.errors import InputError
from calib.io import size_text
from calib.pose import SE3
from calib.rig import DepthTechnology, RgbdRig, StereoRig
from calib.times import rate_of_times, spread_bursts
from calib.types import F64, I64
from calib.world import load_world
from stereo.depth import Depths
from stereo.readers.images import Colour, Images, Size, Stream, bits_note, bits_of, frame_number, images_of
from stereo.readers.pairing import ONE_TIME, TimePairs, pair_stamps
from stereo.readers.times import load_timestamps, unused_times
from stereo.recording import (
    Decoded,
    DecodedPair,
    DepthCamera,
    FrameClock,
    LiveRecording,
    OpenOptions,
    Recording,
    StereoPair,
    no_clock,
    prefetch,
)


class ItemSource(Protocol):
    """Decoded images in order; every index is yielded once, with or without an image."""

    def __iter__(self) -> Iterator[Decoded]: ...

    def at(self, indices: Iterable[int]) -> Iterator[Decoded]:
        """Only these frames, which must ascend; the iteration ends where the file does."""


class FrameSource(ItemSource, Protocol):
    """Images of one camera.

    Attributes:
        size: (width, height) [px].
        n_frames: frames announced; the iteration may end earlier.
        fps: nominal rate, NaN when the files hold none.
        raw: pictures without a container, whose rate and times the decoder makes up.
        files: that hold them; none of live cameras.
    """

    size: Size
    n_frames: int
    fps: float
    raw: bool
    files: Sequence[Path]


def together(*sources: ItemSource) -> Callable[[Sequence[int] | None], Generator[Any, None, None]]:
    """Decodes these frames of sources, or all, side by side, each in a thread of its own; ends with the shortest."""

    def decode(indices: Sequence[int] | None) -> Generator[tuple[Decoded, ...], None, None]:
        with ExitStack() as stack:
            each = (source if indices is None else source.at(indices) for source in sources)
            yield from zip(*[stack.enter_context(closing(prefetch(frames))) for frames in each], strict=False)

    return decode


AnyRecording = Recording[StereoPair] | Recording[DepthCamera]
"""Recording that a layout opens."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Contents that a reader found at a path; nothing is decoded yet but a first image of each camera.

    Attributes:
        kind: images of two cameras, images with depth, or of one camera; several of these, or plan-view maps.
        n_frames: frames announced (an upper bound).
        clock: when they were taken.
        notes: what the reader assumed, repaired or missed, a sentence each, for the summary and run.json.
        unpaired: frames that one of the cameras lacks.
        open: the recording with its calibration; raises InputError where that is missing or does not fit.
    """

    kind: Literal["stereo", "rgbd", "camera", "sensors", "maps"]
    streams: tuple[Stream, ...]
    n_frames: int
    clock: FrameClock
    notes: tuple[str, ...]
    unpaired: int
    open: Callable[[], Any]


@dataclass(frozen=True)
class Reader:
    """One layout of recordings.

    Attributes:
        key, name: short, for JSON, and as messages show it.
        fits: whether a path looks like it; reads names and first bytes only, and raises InputError where it may not.
        find: what is there; raises InputError when it looked like it but cannot be read.
        config: JSON of the parameters that a run made it with; empty where no run did.
    """

    key: str
    name: str
    fits: Callable[[Path], bool]
    find: Callable[[Path, OpenOptions], Layout]
    config: Callable[[Path], str] = lambda path: ""


class FramePairs(NamedTuple):
    """Frames of two cameras: how those of ascending indices, or all, are decoded, how many are announced, how many of
    one camera the other lacks, and whether they come as they are taken."""

    decode: Callable[[Sequence[int] | None], Generator[DecodedPair, None, None]]
    n_frames: int
    unpaired: int = 0
    live: bool = False


def _files_of(streams: Sequence[Stream]) -> list[Path]:
    return list(dict.fromkeys(file for stream in streams for file in stream.files))


def stereo_layout(
    path: Path,
    pairs: FramePairs,
    streams: tuple[Stream, ...],
    clock: FrameClock,
    rig: Callable[[], StereoRig],
    notes: Iterable[str] = (),
    folder: Path | None = None,
) -> Layout:
    """Two cameras whose frames are paired; world.toml lies in the folder, or at the path."""
    remarks = (*clock.notes, *notes, *["one pair of images, in which nobody walks"] * (pairs.n_frames == 1))

    def open_recording() -> Recording[StereoPair]:
        kind = LiveRecording if pairs.live else Recording[StereoPair]
        sensor = StereoPair(rig(), world_pose(folder or path))
        return kind(path, pairs.decode, pairs.n_frames, clock, [*remarks], sensor, files=_files_of(streams))

    return Layout("stereo", streams, pairs.n_frames, clock, remarks, pairs.unpaired, open_recording)


_TIME_OF_FLIGHT = ((512, 424), (640, 576), (320, 288), (512, 512), (1024, 1024), (1024, 768))
"""Sizes of depth of Kinect 2, Azure Kinect and RealSense L515."""
_STEREO = ((848, 480), (1280, 720), (480, 270), (1280, 800), (640, 400))
"""Sizes of depth of RealSense D400 and OAK-D."""
TECHNOLOGY_OF_SIZE: dict[Size, DepthTechnology] = {
    **dict.fromkeys(_TIME_OF_FLIGHT, "time-of-flight"),
    **dict.fromkeys(_STEREO, "stereo"),
}
"""Sizes of depth images that only one kind of sensor has; all others count as structured light, 640x480 and 320x240
being those of Kinect, Xtion and Astra."""


def rgbd_layout(
    path: Path,
    images: Images,
    depths: Images,
    streams: tuple[Stream, ...],
    clock: FrameClock,
    rig: Callable[[], RgbdRig],
    notes: Iterable[str] = (),
    unpaired: int = 0,
) -> Layout:
    """Images and depth whose frames are paired; ``rig`` reads the calibration, or raises InputError."""
    remarks = (*clock.notes, *notes)

    def open_recording() -> Recording[DepthCamera]:
        from stereo.rgbd import DepthRegistration  # its kernels: only images with depth need numba here

        calibrated = rig()
        depth = depths.size
        said = list(remarks)
        if calibrated.depth_camera is None and images.size != depth:
            said.append(f"depth of {size_text(depth)} without a calibration of its own counts as registered")
            calibrated = replace(calibrated, depth_camera=calibrated.camera.scaled(*depth))
        units = cast(Depths, depths.pixels)
        if calibrated.units_per_m is not None:
            units.units_per_m = calibrated.units_per_m
        sensor = DepthCamera(
            calibrated.camera,
            calibrated.source,
            calibrated.technology or TECHNOLOGY_OF_SIZE.get(depth, "structured-light"),
            DepthRegistration(calibrated),
            world_pose(path if path.is_dir() else path.parent),
            units,
            calibrated.depth_camera,
        )
        decode = together(images, depths)
        return Recording(path, decode, images.n_frames, clock, said, sensor, files=_files_of(streams))

    return Layout("rgbd", streams, images.n_frames, clock, remarks, unpaired, open_recording)


def clock_of(
    folder: Path,
    options: OpenOptions,
    n_frames: int,
    file_fps: float = math.nan,
    raw: bool = False,
    files: Sequence[Path | None] = (),
) -> FrameClock:
    """The caller's rate, else timestamps.csv, else the files' own times, else none.

    Args:
        n_frames: frames announced, 0 when unknown.
        file_fps: rate that the files announce; NaN when they hold none.
        raw: the files hold no times, and their rate is the decoder's.
        files: an image of each frame, None where there is none.
    """
    if options.fps is not None:
        return FrameClock(options.fps, even=True)
    file = folder / "timestamps.csv"
    if file.is_file():
        there = [i for i in range(n_frames) if not files or files[i]]
        times, notes = load_timestamps(file, _numbers(files, n_frames), there)
        timed = int(np.count_nonzero(np.isfinite(times[there])))
        if timed < len(there):
            notes += (f"{file.name} has times of {timed} of {len(there)} frames: the others follow at the same rate",)
        return clock_of_times(times, (*notes, *unused_times(folder, file)))
    unused = unused_times(folder, None)
    if math.isfinite(file_fps) and not raw:
        return FrameClock(file_fps, None, unused)
    return no_clock("the frames have no times, and there is no timestamps.csv", *unused)


NUMBER_MAX = 2**53
"""Larger numbers in names count no frames."""


def _numbers(files: Sequence[Path | None], n_frames: int) -> Sequence[int]:
    """The number of every frame in the names of its image, also of those between that have none; from 0 where names
    do not count the frames."""
    there = [i for i, file in enumerate(files) if file]
    numbers = [frame_number(file) for file in files if file]
    named = [number for number in numbers if number is not None]
    if not named or len(named) < len(numbers) or max(named) > NUMBER_MAX or (np.diff(named) <= 0).any():
        return range(n_frames)
    return [round(float(number)) for number in np.interp(range(n_frames), there, named)]


def clock_of_pairs(pairs: TimePairs, options: OpenOptions) -> FrameClock:
    """The pairs' own times; even ones where the caller gives a rate."""
    if options.fps is not None:
        return FrameClock(options.fps, np.arange(len(pairs.left)) / options.fps, pairs.notes)
    return no_clock(*pairs.notes) if math.isnan(pairs.fps) else clock_of_times(pairs.times_s, pairs.notes)


def clock_of_times(times_s: F64, notes: Sequence[str] = ()) -> FrameClock:
    """Clock of (n,) times [s], NaN where unknown."""
    rate = rate_of_times(times_s)
    if rate is None:
        return no_clock(ONE_TIME, *notes)
    spread_s, note = spread_bursts(times_s, rate)
    return FrameClock(rate.fps, spread_s, (*notes, *note))


def world_pose(folder: Path) -> SE3 | None:
    """world_SE3_left of the folder's world.toml; None without that file."""
    file = folder / "world.toml"
    return load_world(file).world_SE3_left if file.is_file() else None


def same_size(a: FrameSource, b: FrameSource, left: Path | str, right: Path | str) -> Size:
    """The size of two sources."""
    if a.size != b.size:
        sizes = f"{size_text(a.size)}, found {size_text(b.size)}"
        raise InputError(f"{right}: expected images as large as {Path(left).name}'s {sizes}")
    return a.size


class TimedFiles(NamedTuple):
    """Files of one camera in the order of the recording, and (n,) int64 [ns], when each was taken."""

    folder: Path
    files: Sequence[Path]
    ns: I64


def timed_layout(
    path: Path,
    left: TimedFiles,
    right: TimedFiles,
    options: OpenOptions,
    rig: Callable[[Size], StereoRig],
    notes: Sequence[str] = (),
    folder: Path | None = None,
) -> Layout:
    """Images paired by their times; world.toml lies in the folder, or at the path."""
    for side in (left, right):
        if not side.files:
            raise InputError(f"{side.folder}: expected images, found none")
    pairs = pair_stamps(left.ns, right.ns)
    check_paired(pairs, path)
    firsts = [left.files[i] if i >= 0 else None for i in pairs.left]
    seconds = [right.files[i] if i >= 0 else None for i in pairs.right]
    times_s = own_times(left.ns), own_times(right.ns)
    return images_layout(path, firsts, seconds, clock_of_pairs(pairs, options), rig, notes, folder, times_s)


def images_layout(
    path: Path,
    left: Sequence[Path | None],
    right: Sequence[Path | None],
    clock: FrameClock,
    rig: Callable[[Size], StereoRig],
    notes: Sequence[str] = (),
    folder: Path | None = None,
    times_s: tuple[F64 | None, F64 | None] = (None, None),
) -> Layout:
    """Images of two cameras by frame, None where one lacks its own; ``times_s`` are those of each camera's images,
    where they differ."""
    bits = bits_of(left, right)
    sides = []
    for name, files, own_s in (("left", left, times_s[0]), ("right", right, times_s[1])):
        images = images_of(files, Colour(bits))
        if own_s is None:
            stream = images.stream(name, len(files) - files.count(None), clock.times_s)
        else:
            stream = images.stream(name, len(own_s), own_s)
        sides.append((images, stream))
    (a, first), (b, second) = sides
    names = a.files[0], b.files[0]
    if names[0].parent != names[1].parent:
        names = names[0].parent, names[1].parent
    size = same_size(a, b, *names)
    unpaired = sum(None in pair for pair in zip(left, right, strict=True))
    pairs = FramePairs(together(a, b), len(left), unpaired)
    remarks = (*notes, *bits_note(bits))
    return stereo_layout(path, pairs, (first, second), clock, partial(rig, size), remarks, folder)


def check_paired(pairs: TimePairs, path: Path) -> None:
    """Refuse two recordings of different times."""
    if not np.any((pairs.left >= 0) & (pairs.right >= 0)):
        raise InputError(
            f"{path}: expected frames of the two cameras within a quarter of the frame period ({250 / pairs.fps:.1f} "
            f"ms), found none: their clocks differ, or they are two recordings"
        )


def own_times(ns: I64) -> F64:
    """(n,) float64 [s] since the first."""
    return np.asarray((ns - ns[:1]) / 1e9)
