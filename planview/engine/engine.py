"""What every engine takes and gives: frames in, people in metres out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol, TypeVar

from calib.ground_camera import GroundCamera
from calib.types import F32, U8
from planview.checks.check import Check
from planview.checks.timing import Thumbnails
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo
from planview.maps.view import StereoView
from planview.tracking.base import Decision, Observation, Tracker
from planview.trajectories.state import TrackState
from stereo.depth import StereoFloorCamera
from stereo.matcher import SampledDisparity
from stereo.recording import Skipped

AnyFrame = TypeVar("AnyFrame")

STAGES = ("read", "rectify", "match", "foreground", "maps", "track")
"""Stages timed, in order."""


@dataclass(frozen=True, eq=False)
class HeadResult:
    """What one of several heads measured in a frame.

    Attributes:
        name: of the head.
        picture: makes its rectified left image; None when the head has no frame at that time.
        foreground: (h, w) uint8 mask at the size of foreground and maps, or None.
        sampled: its disparity, or None.
        tracks: people, with their boxes in the head's image.
        n_points: how many of the maps' points are the head's; heads follow one another in them.
    """

    name: str
    picture: Callable[[], U8] | None
    foreground: U8 | None
    sampled: SampledDisparity | None
    tracks: tuple[TrackState, ...]
    n_points: int

    @property
    def image(self) -> U8 | None:
        """(H, W[, 3]) uint8, rectified left image; None when the head has no frame at that time."""
        return None if self.picture is None else self.picture()


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything about one frame.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        tracks: people, tentative and lost ones included.
        decisions: why the tracker did what it did.
        observation: the tracker's input (image, foreground, maps), of a pair at the analysis size.
        sampled: disparity, of every pixel or of those that foreground and maps are made of; None for a single camera.
        stages_ms: time of every stage; reading and matching run ahead in other threads.
        heads: what each of several heads measured; empty for a recording of one head.
        thumbnails: of both rectified images; None without a pair.
        measured: (h, w) uint8 at the size of foreground and maps, 0 where the disparity is as measured in an earlier
            frame; None where all of it is of this one.
        picture: makes the image of the size that boxes of people are in; None where the observation has it.
    """

    frame: int
    timestamp_s: float
    tracks: tuple[TrackState, ...]
    decisions: tuple[Decision, ...]
    observation: Observation
    sampled: SampledDisparity | None
    stages_ms: dict[str, float]
    heads: tuple[HeadResult, ...] = ()
    thumbnails: Thumbnails | None = None
    measured: U8 | None = None
    picture: Callable[[], U8] | None = None

    @property
    def image(self) -> U8 | None:
        """(H, W[, 3]) uint8, the (rectified left) image; None for recorded maps. Made when it is asked for."""
        return self.observation.image if self.picture is None else self.picture()

    @property
    def disparity(self) -> F32 | None:
        """(H, W) float32 [px], NaN invalid; None for a single camera."""
        return None if self.sampled is None else self.sampled.image

    @property
    def matched_share(self) -> float:
        """Share of the pixels whose disparity was measured in this frame."""
        return 1.0 if self.measured is None else float((self.measured > 0).mean())


class AnyRecording(Protocol):
    """What stereo recordings, videos and recorded maps have in common (see ``stereo.recording.Recording``)."""

    @property
    def path(self) -> Path: ...

    @property
    def n_frames(self) -> int: ...

    @property
    def fps(self) -> float: ...

    @property
    def skipped(self) -> Sequence[Skipped]: ...

    def __iter__(self) -> Iterator[Any]: ...


class Engine(Protocol):
    """Tracks people: iterate it for a FrameResult per frame of its recording, or ``step`` through frames of your own.

    Attributes:
        recording: what is read.
        config: the full effective configuration.
        tracker: who follows people.
        camera: the (rectified left) camera above the floor; None for a single camera that is not calibrated.
        size: (width, height) of the images [px].
        stereo: the rectified pair and its maps; None for a single camera.
    """

    @property
    def recording(self) -> AnyRecording: ...

    @property
    def config(self) -> Config: ...

    @property
    def tracker(self) -> Tracker: ...

    @property
    def camera(self) -> StereoFloorCamera | GroundCamera | None: ...

    @property
    def size(self) -> tuple[int, int]: ...

    @property
    def stereo(self) -> StereoView | None: ...

    @property
    def checks(self) -> Sequence[Check]:
        """What is known of the recording so far, before its first frame or from those tracked; none where nothing is
        checked."""

    def camera_info(self) -> CameraInfo | None:
        """The camera as ``run.json`` has it; None for one that is not calibrated."""

    def floor_info(self) -> FloorInfo | None:
        """The floor as ``run.json`` has it; None where there is no calibrated camera."""

    def reset(self) -> None:
        """Forget all frames: people, background and feedback."""

    def step(self, frame: Any) -> FrameResult:
        """Track the next frame, of the kind that ``recording`` gives; frames come in order."""

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts with ``reset``."""

    def memory(self) -> dict[str, object]:
        """By name, the objects that hold all that the engine carries from frame to frame (``runs.checkpoint``)."""

    def after(self, frame: int) -> Iterator[FrameResult]:
        """Go on tracking after a frame, with the memory of the frames up to it."""


class StageClock:
    """Adds the time since the last stage to a frame's stage times [ms]."""

    def __init__(self, stages_ms: dict[str, float] | None = None) -> None:
        self.stages_ms = dict(stages_ms or {})
        self._since = perf_counter()

    def record(self, stage: str) -> None:
        """The stage ends now."""
        now = perf_counter()
        self.stages_ms[stage] = 1e3 * (now - self._since)
        self._since = now


class Indexed(Protocol):
    """A frame with its place in the recording, from 0."""

    @property
    def index(self) -> int: ...


IndexedFrame = TypeVar("IndexedFrame", bound=Indexed)


def beyond(frames: Iterable[IndexedFrame], last: int) -> Iterator[IndexedFrame]:
    """The frames after one. Those before are read and passed over: what could not be read is noted again."""
    return (frame for frame in frames if frame.index > last)


def timed_steps(
    frames: Iterable[AnyFrame], track: Callable[[AnyFrame, StageClock], FrameResult]
) -> Iterator[FrameResult]:
    """``track`` every frame with a clock that has timed its reading."""
    clock = StageClock()
    for frame in frames:
        clock.record("read")
        yield track(frame, clock)
        clock = StageClock()
