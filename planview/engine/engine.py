"""The engine: frames in, people in metres out."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from calib.carried import Carried
from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.types import F32
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo, camera_info, floor_info
from planview.maps.grid import FloorRig
from planview.maps.recording import MapsFrame
from planview.maps.view import View
from planview.tracking.base import Decision, Observation, Tracker
from planview.trajectories.state import TrackState
from stereo.depth import Depth, point_cloud
from stereo.readers.open import MultiRigFrame
from stereo.recording import RgbdFrame, Skipped, StereoFrame, VideoFrame, prefetch

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

Frame = StereoFrame | RgbdFrame | MultiRigFrame | VideoFrame | MapsFrame

STAGES = ("read", "rectify", "match", "foreground", "maps", "track")
"""Stages timed, in order."""
RigDepths = tuple[Depth | None, ...]
"""Of every rig, None for one without a frame at that time; empty for one camera and recorded maps."""


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything about one frame.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        tracks: people, tentative and lost ones included, with their boxes in the image of the first rig.
        decisions: why the tracker did what it did.
        observation: the tracker's input: the views and their maps.
        stages_ms: time of every stage; reading and matching run ahead in another thread.
        depths: the rectified frames behind the views.
        stereo: the first rig above the floor; None for one camera.
    """

    frame: int
    timestamp_s: float
    tracks: tuple[TrackState, ...]
    decisions: tuple[Decision, ...]
    observation: Observation
    stages_ms: dict[str, float]
    depths: RigDepths = ()
    stereo: FloorRig | None = None

    def __repr__(self) -> str:
        return f"FrameResult(frame {self.frame}, {self.timestamp_s:.2f} s, {len(self.tracks)} tracks)"

    @property
    def views(self) -> tuple[View, ...]:
        """What each camera shows."""
        return self.observation.views

    @property
    def depth(self) -> Depth | None:
        """Of the first rig; None for one camera, for recorded maps, and where it has no frame."""
        return self.depths[0] if self.depths else None

    def template(self, track: TrackState) -> tuple[F32, F32] | None:
        """T_H [m] and T_O [m^2] of a person, as ``PlanViewMaps.around`` gives them; None for one camera."""
        maps = self.observation.maps
        return None if maps is None else maps.around(track.x_m, track.y_m)

    def point_cloud(self) -> PointCloud:
        """What the first rig measured, as an ``open3d.geometry.PointCloud``: metres on the axes of the tracks, colours
        of the image. Raises InputError: one camera without depth, or recorded maps."""
        if self.stereo is None or self.depth is None:
            raise InputError("expected a stereo pair or images with depth for a point cloud, found no disparity")
        pose, geometry = self.stereo.floor.world_SE3_left, self.stereo.geometry
        return point_cloud(self.depth.disparity, self.depth.image, geometry, pose, self.depth.step)


class StageClock(dict[str, float]):
    """Adds up a frame's stage times [ms]."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """A stage begins now."""
        self._since = perf_counter()

    def record(self, stage: str) -> None:
        """The stage ends now, and the next one begins."""
        since = self._since
        self.start()
        self[stage] = self.get(stage, 0.0) + 1e3 * (self._since - since)


class Recording(Protocol):
    """What stereo recordings, videos and recorded maps have in common (see ``stereo.recording.Recorded``)."""

    @property
    def path(self) -> Path: ...

    @property
    def n_frames(self) -> int: ...

    @property
    def fps(self) -> float: ...

    @property
    def skipped(self) -> Sequence[Skipped]: ...

    def __iter__(self) -> Iterator[Frame]: ...


class Stages(Protocol):
    """How frames of one kind of recording become people. Errors are those of ``Engine.step``.

    Attributes:
        tracker: follows people.
        ahead: frames that iteration matches ahead in a thread of their own; 0 for one thread.
        camera: the (rectified left) camera above the floor; None for one camera that is not calibrated.
        size: (width, height) of its images [px].
        rigs: by name, the rigs above the floor, the first over the grid of the maps; empty for one camera.
        checks: of the recording so far: before its first frame, and from the frames seen.
    """

    ahead: int
    size: tuple[int, int]

    @property
    def tracker(self) -> Tracker: ...

    @property
    def camera(self) -> FloorCamera | None: ...

    @property
    def rigs(self) -> Mapping[str, FloorRig]: ...

    @property
    def checks(self) -> Sequence[Check]: ...

    def match(self, frame: Any, clock: StageClock) -> RigDepths:
        """The part of the work that depends on no other frame."""

    def track(self, frame: Any, depths: RigDepths, clock: StageClock) -> tuple[Observation, tuple[TrackState, ...]]:
        """What the cameras show, by what was learned of the frames before, and the people in it."""

    def memory(self) -> dict[str, Carried]:
        """By name, the objects but the tracker that hold what is carried from frame to frame."""


class Engine:
    """Tracks people: iterate it for a FrameResult per frame of its recording, or ``step`` through frames of your own.

    Attributes:
        recording: what is read.
        config: the full effective configuration.
        stages: of a frame; ``tracker``, ``ahead``, ``camera``, ``size`` and ``rigs`` are theirs.
        stereo: the first rig, over the grid of the maps; None for one camera.
    """

    def __init__(self, recording: Recording, config: Config, stages: Stages) -> None:
        self.recording, self.config, self.stages, self.tracker = recording, config, stages, stages.tracker
        self.camera, self.size, self.rigs, self.ahead = stages.camera, stages.size, stages.rigs, stages.ahead
        self.stereo: FloorRig | None = next(iter(self.rigs.values()), None)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.recording!r}, {type(self.tracker).__name__})"

    @property
    def checks(self) -> Sequence[Check]:
        """Checks of the recording so far; empty where nothing is checked."""
        return self.stages.checks

    def camera_info(self) -> CameraInfo | None:
        """The camera as ``run.json`` has it; None for one that is not calibrated."""
        return camera_info(self.camera, self.rigs)

    def floor_info(self) -> FloorInfo | None:
        """The floor as ``run.json`` has it; None where there is no calibrated camera."""
        return floor_info(self.camera, self.stereo)

    def reset(self) -> None:
        """Forget all frames: people, background and feedback."""
        self.tracker.reset()
        for part in self.stages.memory().values():
            part.reset()

    def state(self) -> dict[str, dict[str, Any]]:
        """By name of the part and of the value, all that is carried from frame to frame. Raises TypeError: a tracker
        of one's own without ``state``."""
        return {name: part.state() for name, part in self._memory().items()}

    def set_state(self, state: Mapping[str, Mapping[str, Any]]) -> None:
        """Resume from the state of an engine that was made with the same arguments."""
        for name, part in self._memory().items():
            part.set_state(state[name])

    def _memory(self) -> dict[str, Carried]:
        tracker: Any = self.tracker
        if not (hasattr(tracker, "state") and hasattr(tracker, "set_state")):
            raise TypeError(f"{type(tracker).__name__} has no state() and set_state()")
        return {"tracker": tracker, **self.stages.memory()}

    def step(self, frame: Frame) -> FrameResult:
        """Track the next frame, of the kind that ``recording`` gives; frames come in order.

        Raises:
            InputError, ValueError: a frame of another kind of recording, images of another size than the
                calibration's, or damaged maps.
        """
        clock = StageClock()
        return self._track(frame, self.stages.match(frame, clock), clock)

    def _track(self, frame: Frame, depths: RigDepths, clock: StageClock) -> FrameResult:
        clock.start()
        observation, people = self.stages.track(frame, depths, clock)
        clock.record("track")
        at = frame.index, frame.timestamp_s
        return FrameResult(*at, people, self.tracker.decisions, observation, clock, depths, self.stereo)

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts with ``reset``."""
        self.reset()
        yield from self.after(-1)

    def after(self, frame: int) -> Iterator[FrameResult]:
        """Go on tracking after a frame, with the memory of the frames up to it."""
        with closing(prefetch(self._matched(frame), self.ahead) if self.ahead else self._matched(frame)) as frames:
            for track in frames:
                yield track()

    def _matched(self, last: int) -> Generator[Callable[[], FrameResult], None, None]:
        """The frames after one. Those before are read and passed over: what could not be read is noted again."""
        clock = StageClock()
        for frame in self.recording:
            if frame.index > last:
                clock.record("read")
                yield partial(self._track, frame, self.stages.match(frame, clock), clock)
            clock = StageClock()


def refuse_frame(expected: str, frame: Frame) -> NoReturn:
    """Raises InputError: a frame of another kind of recording."""
    raise InputError(f"frame: expected {expected}, found a {type(frame).__name__}")
