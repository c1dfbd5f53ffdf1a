"""The pair that a reader found, and its calibration."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from calib.errors import InputError
from calib.floor.world_file import load_world
from calib.formats import load_rig
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64
from stereo.readers.pair import DEFAULT_FPS, LiveRecording, PairsOf, StereoRecording, rate_of
from stereo.readers.reader import OpenOptions, Stream
from stereo.readers.source import FrameSource
from stereo.readers.timestamps import load_timestamps

Size = tuple[int, int]


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
