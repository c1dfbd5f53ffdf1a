"""The engine: frames in, people in metres out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, NoReturn, Protocol

from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.ground_camera import GroundCamera
from calib.types import F32, U8
from planview.checks.check import Check
from planview.checks.timing import Thumbnails
from planview.engine.config import Config
from planview.engine.info import (
    CameraInfo,
    FloorInfo,
    ground_camera_info,
    ground_floor_info,
    rigs_info,
    stereo_floor_info,
)
from planview.maps.pixels import SeenPixels
from planview.maps.recording import MapsFrame
from planview.maps.view import StereoView
from planview.tracking.base import Decision, Observation, Tracker
from planview.trajectories.state import TrackState
from stereo.depth import point_cloud
from stereo.matcher import SampledDisparity
from stereo.readers.multi_rig import MultiRigFrame
from stereo.recording import RgbdFrame, Skipped, StereoFrame, VideoFrame, prefetch

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

Frame = StereoFrame | RgbdFrame | MultiRigFrame | VideoFrame | MapsFrame

STAGES = ("read", "rectify", "match", "foreground", "maps", "track")
"""Stages timed, in order."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A frame of one rig, as far as it depends on no other frame.

    Attributes:
        image: (h, w[, 3]) uint8, rectified, at the analysis size; the left image of a pair.
        picture: makes it at the size that boxes of people are in; few callers need it.
        sampled: disparity of every pixel, or of those that foreground and maps are made of.
        thumbnails: of both rectified images; None without a pair.
    """

    image: U8
    picture: Callable[[], U8]
    sampled: SampledDisparity
    thumbnails: Thumbnails | None


@dataclass(frozen=True, eq=False)
class RigFrame:
    """What one rig measured in a frame.

    Attributes:
        name: of the rig among several.
        prepared: images.
        disparity: (h, w) float32 [px] at the analysis size.
        foreground: (h, w) uint8 mask at the analysis size.
        view: what every pixel shows.
    """

    name: str
    prepared: Prepared
    disparity: F32
    foreground: U8
    view: SeenPixels

    @property
    def image(self) -> U8:
        """(H, W[, 3]) uint8, the (rectified left) image. Made on every access."""
        return self.prepared.picture()


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything about one frame.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        tracks: people, tentative and lost ones included, with their boxes in the image of the first rig.
        decisions: why the tracker did what it did.
        observation: the tracker's input (image, foreground, maps), of a pair at the analysis size.
        stages_ms: time of every stage; reading and matching run ahead in another thread.
        rigs: what each rig measured, None for a rig without a frame at that time; empty for one camera and recorded
            maps.
        stereo: the first rig above the floor; None for one camera.
    """

    frame: int
    timestamp_s: float
    tracks: tuple[TrackState, ...]
    decisions: tuple[Decision, ...]
    observation: Observation
    stages_ms: dict[str, float]
    rigs: tuple[RigFrame | None, ...] = ()
    stereo: StereoView | None = None

    def __repr__(self) -> str:
        return f"FrameResult(frame {self.frame}, {self.timestamp_s:.2f} s, {len(self.tracks)} tracks)"

    @property
    def first(self) -> RigFrame | None:
        """What the first rig measured; None for one camera, for recorded maps, and where it has no frame."""
        return self.rigs[0] if self.rigs else None

    @property
    def image(self) -> U8 | None:
        """(H, W[, 3]) uint8, the (rectified left) image that boxes are in; None for recorded maps."""
        return self.first.image if self.first else self.observation.image

    @property
    def sampled(self) -> SampledDisparity | None:
        """Disparity of the first rig; None for one camera."""
        return self.first.prepared.sampled if self.first else None

    @property
    def disparity(self) -> F32 | None:
        """(H, W) float32 [px], NaN invalid; None for one camera."""
        return None if self.sampled is None else self.sampled.image

    def template(self, track: TrackState) -> tuple[F32, F32] | None:
        """T_H [m] and T_O [m^2] of a person, as ``PlanViewMaps.around`` gives them; None for one camera."""
        maps = self.observation.maps
        return None if maps is None else maps.around(track.x_m, track.y_m)

    def point_cloud(self) -> PointCloud:
        """What the first rig measured, as an ``open3d.geometry.PointCloud``: metres on the axes of the tracks, colours
        of the image. Raises InputError: one camera without depth, or recorded maps."""
        if self.stereo is None or self.first is None or self.disparity is None:
            raise InputError("expected a stereo pair or images with depth for a point cloud, found no disparity")
        pose = self.stereo.floor.world_SE3_left
        return point_cloud(self.disparity, self.first.image, self.stereo.geometry, pose)


class StageClock:
    """Adds up a frame's stage times [ms]."""

    def __init__(self) -> None:
        self.stages_ms: dict[str, float] = {}
        self.start()

    def start(self) -> None:
        """A stage begins now."""
        self._since = perf_counter()

    def record(self, stage: str) -> None:
        """The stage ends now, and the next one begins."""
        since = self._since
        self.start()
        self.stages_ms[stage] = self.stages_ms.get(stage, 0.0) + 1e3 * (self._since - since)


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

    def __iter__(self) -> Iterator[Frame]: ...


class Remembers(Protocol):
    """What is carried from frame to frame."""

    def reset(self) -> None: ...


class Engine(ABC):
    """Tracks people: iterate it for a FrameResult per frame of its recording, or ``step`` through frames of your own.

    Each kind of recording has a subclass with the stages around the tracker: its ``prepare`` and ``memory``.

    Attributes:
        recording: what is read.
        tracker: follows people.
        config: the full effective configuration.
        camera: the (rectified left) camera above the floor; None for one camera that is not calibrated.
        size: (width, height) of its images [px].
        views: by name, the rigs above the floor, the first over the grid of the maps; empty for one camera.
        ahead: frames that iteration prepares ahead in a thread of their own; 0 for one thread.
    """

    ahead = 0

    def __init__(
        self,
        recording: AnyRecording,
        tracker: Tracker,
        config: Config,
        camera: FloorCamera | None,
        size: tuple[int, int],
        views: Mapping[str, StereoView] = {},
    ) -> None:
        self.recording, self.tracker, self.config = recording, tracker, config
        self.camera, self.size, self.views = camera, size, views

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.recording!r}, {type(self.tracker).__name__})"

    @property
    def stereo(self) -> StereoView | None:
        """The first rig, over the grid of the maps; None for one camera."""
        return next(iter(self.views.values()), None)

    @property
    def checks(self) -> Sequence[Check]:
        """Checks of the recording so far: before its first frame, and from the frames tracked; empty where nothing is
        checked."""
        return ()

    def camera_info(self) -> CameraInfo | None:
        """The camera as ``run.json`` has it; None for one that is not calibrated."""
        if self.views:
            return rigs_info(self.views)
        return ground_camera_info(self.camera) if isinstance(self.camera, GroundCamera) else None

    def floor_info(self) -> FloorInfo | None:
        """The floor as ``run.json`` has it; None where there is no calibrated camera."""
        if self.stereo is not None:
            return stereo_floor_info(self.stereo)
        return ground_floor_info(self.camera) if isinstance(self.camera, GroundCamera) else None

    def memory(self) -> dict[str, Remembers]:
        """By name, the objects that hold all that the engine carries from frame to frame."""
        return {"tracker": self.tracker}

    def reset(self) -> None:
        """Forget all frames: people, background and feedback."""
        for part in self.memory().values():
            part.reset()

    @abstractmethod
    def prepare(self, frame: Frame, clock: StageClock) -> Callable[[], FrameResult]:
        """Do the part of the work that depends on no other frame; what is returned does the rest, in order of frames.
        Raises InputError, ValueError: as of ``step``."""

    def step(self, frame: Frame) -> FrameResult:
        """Track the next frame, of the kind that ``recording`` gives; frames come in order.

        Raises:
            InputError, ValueError: a frame of another kind of recording, or images of another size than the
                calibration's.
        """
        return self.prepare(frame, StageClock())()

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts with ``reset``."""
        self.reset()
        yield from self.after(-1)

    def after(self, frame: int) -> Iterator[FrameResult]:
        """Go on tracking after a frame, with the memory of the frames up to it."""
        with closing(prefetch(self._prepared(frame), self.ahead) if self.ahead else self._prepared(frame)) as frames:
            for track in frames:
                yield track()

    def _prepared(self, last: int) -> Generator[Callable[[], FrameResult], None, None]:
        """The frames after one. Those before are read and passed over: what could not be read is noted again."""
        clock = StageClock()
        for frame in self.recording:
            if frame.index > last:
                clock.record("read")
                yield self.prepare(frame, clock)
            clock = StageClock()


def refuse_frame(expected: str, frame: Frame) -> NoReturn:
    """Raises InputError: a frame of another kind of recording."""
    raise InputError(f"frame: expected {expected}, found a {type(frame).__name__}")
