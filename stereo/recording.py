"""What a recording is, whatever its layout on disk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from calib.camera import Camera
from calib.pose import SE3
from calib.rig import DepthSensor, StereoRig
from calib.types import F32, F64, U8


@dataclass(frozen=True, eq=False)
class StereoFrame:
    """One unrectified pair as recorded.

    Attributes:
        index: position in the recording, from 0; skipped frames leave gaps.
        timestamp_s: seconds since the recording's first frame.
        left, right: (H, W) or (H, W, 3) uint8, BGR.
    """

    index: int
    timestamp_s: float
    left: U8
    right: U8


@dataclass(frozen=True)
class Skipped:
    """A frame that could not be used, and why."""

    index: int
    why: str


class Recording(Protocol):
    """A stereo recording: iterate it for its usable frames.

    Attributes:
        path: the folder or file it came from.
        rig: calibration at the images' size.
        world_SE3_left: from ``world.toml``, else None (the floor is then found from the recording).
        n_frames: frames announced by the files (an upper bound when a video is truncated).
        fps: nominal frames per second.
        skipped: frames passed over so far while iterating.
    """

    path: Path
    rig: StereoRig
    world_SE3_left: SE3 | None
    n_frames: int
    fps: float
    skipped: list[Skipped]

    def __iter__(self) -> Iterator[StereoFrame]: ...

    def sample(self, count: int) -> list[StereoFrame]:
        """Up to ``count`` usable frames spread evenly over the recording, without decoding all of it."""


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One image and its depth as recorded, lens distortion included.

    Attributes:
        index: position in the recording, from 0; skipped frames leave gaps.
        timestamp_s: seconds since the recording's first frame.
        image: (H, W) or (H, W, 3) uint8, BGR.
        depth_m: (H, W) float32 [m] along the optical axis of the image's own pixels; NaN where unknown.
    """

    index: int
    timestamp_s: float
    image: U8
    depth_m: F32


@runtime_checkable
class RgbdRecording(Protocol):
    """A recording of images with registered depth: iterate it for its usable frames.

    Attributes:
        path: the folder or file it came from.
        camera: calibration of the images at their size; depth has been moved into it.
        source: where the calibration came from, for messages and run.json.
        sensor: how the depth was measured.
        world_SE3_camera: from ``world.toml``, else None (the floor is then found from the recording).
        n_frames: frames announced by the files (an upper bound).
        fps: nominal frames per second.
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None without a table of times.
        skipped: frames passed over so far while iterating.
    """

    path: Path
    camera: Camera
    source: str
    sensor: DepthSensor
    world_SE3_camera: SE3 | None
    n_frames: int
    fps: float
    times_s: F64 | None
    skipped: list[Skipped]

    def __iter__(self) -> Iterator[RgbdFrame]: ...

    def sample(self, count: int) -> list[RgbdFrame]:
        """Up to ``count`` usable frames spread evenly over the recording, without decoding all of it."""

    def at(self, indices: Sequence[int]) -> list[RgbdFrame]:
        """The usable ones of these frames, whose indices ascend."""


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame of a single camera: index from 0, seconds since the first, (H, W) or (H, W, 3) uint8 BGR."""

    index: int
    timestamp_s: float
    image: U8


class Video(Protocol):
    """A single-camera recording (video file or folder of images)."""

    path: Path
    n_frames: int
    fps: float
    size: tuple[int, int]
    skipped: list[Skipped]

    def __iter__(self) -> Iterator[VideoFrame]: ...
