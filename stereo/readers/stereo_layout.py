"""The pair of cameras that a reader found: its calibration, its clock, and images that are files with times."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from calib.errors import InputError
from calib.formats import load_rig
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, I64
from calib.world import load_world
from stereo.readers.base import (
    DEFAULT_FPS,
    FrameSource,
    LiveRecording,
    OpenOptions,
    PairsOf,
    StereoRecording,
    Stream,
    both,
    rate_of,
)
from stereo.readers.images import ImageFiles, Size, bits_note, bits_of
from stereo.readers.pairing import TimePairs, pair_stamps
from stereo.readers.times import load_timestamps


@dataclass(frozen=True, eq=False)
class StereoLayout:
    """Two cameras whose frames are paired (a ``Layout``).

    Attributes:
        path: as given.
        folder: where calibration, times and world.toml lie.
        size: (width, height) of the images that ``pairs`` gives [px].
        pairs: decodes the pairs.
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None takes the times of the decoded frames.
        rig: reads the calibration; raises InputError.
        unpaired: frames that one of the cameras lacks.
        even: frames are taken at an even rate, whatever times the files hold.
    """

    path: Path
    folder: Path
    size: Size
    pairs: PairsOf
    streams: tuple[Stream, ...]
    n_frames: int
    fps: float
    times_s: F64 | None
    rig: Callable[[], StereoRig]
    notes: tuple[str, ...] = ()
    even: bool = False
    unpaired: int = 0
    kind: Literal["stereo"] = "stereo"

    def open(self) -> StereoRecording:
        """See ``Layout``."""
        rig = self.rig()
        recording = StereoRecording(
            self.path, rig, self.pairs, self.n_frames, self.fps, self.times_s, world_pose(self.folder)
        )
        recording.notes, recording.even = list(self.notes), self.even
        return recording


@dataclass(frozen=True, eq=False)
class LiveLayout(StereoLayout):
    """Two cameras as they run: how many frames come is not known (``n_frames`` is 0).

    Attributes:
        waits: see ``LiveRecording``.
    """

    waits: bool = False

    @staticmethod
    def of(layout: StereoLayout, rig: Callable[[], StereoRig] | None, waits: bool) -> LiveLayout:
        """The same, with another source of the calibration unless None."""
        return LiveLayout(
            layout.path, layout.folder, layout.size, layout.pairs, layout.streams, 0, layout.fps, layout.times_s,
            rig or layout.rig, layout.notes, layout.even, waits=waits,
        )  # fmt: skip

    def open(self) -> LiveRecording:
        """See ``Layout``."""
        recording = LiveRecording(self.path, self.rig(), self.pairs, 0, self.fps, None, world_pose(self.folder))
        recording.notes, recording.even, recording.waits = list(self.notes), self.even, self.waits
        return recording


@dataclass(frozen=True)
class FrameClock:
    """When the frames of a recording were taken.

    Attributes:
        fps: nominal frames per second.
        times_s: (n,) float64 [s] by frame index; None takes the times of the decoded frames.
        notes: what was assumed.
        even: the rate is the caller's, and the files' own times are not used.
    """

    fps: float
    times_s: F64 | None
    notes: tuple[str, ...] = ()
    even: bool = False


def clock_of(folder: Path, options: OpenOptions, file_fps: float) -> FrameClock:
    """``--fps``, else timestamps.csv, else the files' own times, else an assumed rate.

    Args:
        file_fps: rate that the files announce; NaN when they hold none.
    Raises:
        InputError: a timestamps.csv that cannot be read.
    """
    if options.fps is not None:
        return FrameClock(options.fps, None, even=True)
    file = folder / "timestamps.csv"
    if file.is_file():
        times, notes = load_timestamps(file)
        return FrameClock(rate_of(times), times, notes)
    if math.isfinite(file_fps):
        return FrameClock(file_fps, None)
    note = f"no timestamps: {DEFAULT_FPS:g} frames per second are assumed (--fps gives another rate)"
    return FrameClock(DEFAULT_FPS, None, (note,))


def rig_in(folder: Path, options: OpenOptions, size: Size) -> Callable[[], StereoRig]:
    """Reads the calibration that was named, or the one in the folder, at the size of the images."""
    return lambda: load_rig(options.calibration or folder, size)


def world_pose(folder: Path) -> SE3 | None:
    """world_SE3_left of the folder's world.toml; None without that file."""
    file = folder / "world.toml"
    return load_world(file).world_SE3_left if file.is_file() else None


def same_size(a: FrameSource, b: FrameSource, left: Path, right: Path) -> Size:
    """The size of both sides.

    Raises:
        InputError: they differ.
    """
    if a.size != b.size:
        raise InputError(
            f"{right}: expected images as large as {left.name}'s {a.size[0]}x{a.size[1]}, found {b.size[0]}x{b.size[1]}"
        )
    return a.size


def stream(name: str, source: FrameSource, times_s: F64 | None = None) -> Stream:
    """What a source stores."""
    return Stream(name, source.size, source.n_frames, times_s)


class TimedFiles(NamedTuple):
    """One camera.

    Attributes:
        folder: for messages.
        files: in the order of the recording.
        ns: (n,) int64 [ns], when each was taken.
    """

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
) -> StereoLayout:
    """Pair the images by their times.

    Args:
        rig: reads the calibration for images of a size.
    Raises:
        InputError: no image of a camera can be decoded, sizes differ, or nothing pairs.
    """
    for side in (left, right):
        if not side.files:
            raise InputError(f"{side.folder}: expected images, found none")
    pairs = pair_stamps(left.ns, right.ns)
    check_paired(pairs, path)
    bits = bits_of(left.files, right.files)
    a, b = (
        ImageFiles([side.files[i] if i >= 0 else None for i in order], bits)
        for side, order in ((left, pairs.left), (right, pairs.right))
    )
    size = same_size(a, b, left.folder, right.folder)
    streams = tuple(
        Stream(name, size, len(side.files), own_times(side.ns), pixel_text(source.is_grey, bits))
        for name, side, source in (("left", left, a), ("right", right, b))
    )
    times, fps = times_of(pairs, options)
    return StereoLayout(
        path, path, size, partial(both, a, b), streams, len(pairs.left), fps, times, partial(rig, size),
        (*notes, *pairs.notes, *bits_note(bits)),
        unpaired=pairs.unpaired,
    )  # fmt: skip


def check_paired(pairs: TimePairs, path: Path) -> None:
    """Refuse two recordings of different times.

    Raises:
        InputError: not one frame has a mate.
    """
    if not np.any((pairs.left >= 0) & (pairs.right >= 0)):
        raise InputError(
            f"{path}: expected frames of the two cameras within a quarter of the frame period ({250 / pairs.fps:.1f} "
            f"ms), found none: their clocks differ, or they are two recordings"
        )


def times_of(pairs: TimePairs, options: OpenOptions) -> tuple[F64, float]:
    """Times by frame index [s] and nominal rate; even ones where the caller gives a rate."""
    if options.fps is None:
        return pairs.times_s, pairs.fps
    return np.arange(len(pairs.left)) / options.fps, options.fps


def own_times(ns: I64) -> F64:
    """(n,) float64 [s] since the first."""
    return np.asarray((ns - ns[0]) / 1e9, dtype=np.float64) if len(ns) else np.empty(0)


def pixel_text(grey: bool, bits: int | None) -> str:
    """What a pixel is, for people."""
    kind = "grey" if grey else "colour"
    return kind if bits is None else f"{kind}, {bits} bits in 16"
