"""The engine: frames in, people in metres out."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from calib.carried import Carried, plain, restore
from calib.errors import InputError
from calib.times import unusable_time
from calib.types import F32
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo, camera_info, floor_info
from planview.engine.sensor import DepthSensor, Sensor, StageClock
from planview.maps.grid import FloorRig
from planview.maps.plan_view import joint_grid, plan_view
from planview.maps.view import View
from planview.tracking.base import Decision, ImageTracker, Observation, Tracker, track_frame
from planview.trajectories.state import TrackState
from stereo.depth import Depth, point_cloud
from stereo.recording import Frame, OpenOptions, Skipped, prefetch

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

STAGES = ("read", "rectify", "match", "foreground", "maps", "track")
"""Stages timed, in order."""
Measured = tuple[Any, ...]
"""Measurements of each sensor in a frame; None where it has no shot."""


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything about one frame.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        tracks: people, tentative and lost ones included, with their boxes in the image of the first sensor.
        decisions: why the tracker did what it did.
        observation: the tracker's input: the views and their maps.
        stages_ms: time of every stage; reading and matching run ahead in another thread.
        rigs: the sensors with depth above the floor; empty for one camera.
    """

    frame: int
    timestamp_s: float
    tracks: tuple[TrackState, ...]
    decisions: tuple[Decision, ...]
    observation: Observation
    stages_ms: dict[str, float]
    rigs: tuple[FloorRig, ...] = ()

    def __repr__(self) -> str:
        return f"FrameResult(frame {self.frame}, {self.timestamp_s:.2f} s, {len(self.tracks)} tracks)"

    @property
    def views(self) -> tuple[View, ...]:
        """View of each sensor."""
        return self.observation.views

    @property
    def depth(self) -> Depth | None:
        """Depth that the first sensor measured; None for one camera, for recorded maps, and where it has no frame."""
        return self.views[0].depth

    def template(self, track: TrackState) -> tuple[F32, F32] | None:
        """T_H [m] and T_O [m^2] of a person, as ``PlanViewMaps.around`` gives them; None for one camera."""
        maps = self.observation.maps
        return None if maps is None else maps.around(track.x_m, track.y_m)

    def point_cloud(self) -> PointCloud:
        """Points that the first sensor measured, as an ``open3d.geometry.PointCloud``: metres on the axes of the
        tracks, colours of the image. Raises InputError: one camera without depth, or recorded maps."""
        depth = self.depth
        if depth is None:
            raise InputError("expected a stereo pair or images with depth for a point cloud, found no disparity")
        rig = self.rigs[0]
        return point_cloud(depth.disparity, depth.image, rig.geometry, rig.floor.world_SE3_left, depth.step)


class Trackable(Protocol):
    """Protocol of a recording that the engine can track (see ``stereo.recording.Recording``)."""

    @property
    def path(self) -> Path: ...

    @property
    def n_frames(self) -> int: ...

    @property
    def fps(self) -> float: ...

    @property
    def skipped(self) -> Sequence[Skipped]: ...

    @property
    def files(self) -> Sequence[Path]: ...

    @property
    def notes(self) -> Sequence[str]: ...

    @property
    def options(self) -> OpenOptions: ...

    @property
    def is_live(self) -> bool: ...

    @property
    def identity(self) -> Sequence[Any]: ...

    def __iter__(self) -> Iterator[Frame[Any]]: ...


class Engine:
    """Tracks people: iterate it for a FrameResult per frame of its recording, or ``step`` through frames of your own.

    Attributes:
        recording: what is read.
        config: the full effective configuration.
        sensors: what recorded it, made ready; ``camera`` and ``size`` are those of the first, in whose image boxes are.
        tracker: follows people.
        rigs: by name, those that measure depth, the first over the grid of the maps; empty for one camera.
        ahead: frames that iteration measures ahead in a thread of their own; 0 for one thread.
        tracker_name: for run.json; "joint" and the like, else the class of the tracker.
        own_parts: by what they are ("matcher", "tracker"), the parts that the user made: no configuration describes
            them.
    """

    def __init__(
        self,
        recording: Trackable,
        config: Config,
        sensors: Sequence[Sensor[Any, Any]],
        tracker: Tracker,
        camera_source: str = "given",
        tracker_name: str = "",
        own_parts: Mapping[str, object] | None = None,
    ) -> None:
        """Join the maps of the sensors.

        Args:
            camera_source: where the calibration of a single camera is from.
            own_parts: sensors and tracker where None, as of an engine that is composed by hand.
        Raises:
            InputError: the floor that the sensors cover together is larger than a grid may be.
        """
        self.tracker_name = tracker_name or type(tracker).__name__
        by_hand = {f"sensor {sensor.name}".strip(): sensor for sensor in sensors} | {"tracker": tracker}
        self.own_parts = by_hand if own_parts is None else own_parts
        self.recording = recording
        self.config = config
        self.sensors = tuple(sensors)
        self.tracker = tracker
        self.camera = sensors[0].camera
        self.size = sensors[0].size
        self.ahead = min(sensor.ahead for sensor in sensors)
        self._last_s = -math.inf
        self._camera_source = camera_source
        self.rigs = {sensor.name: sensor.rig for sensor in sensors if isinstance(sensor, DepthSensor)}
        for name, rig in [*self.rigs.items()][:1]:
            try:
                grid = joint_grid([each.grid for each in self.rigs.values()])
            except ValueError as error:
                raise InputError(
                    f"{recording.path}: expected sensors of one place, found them far apart: {error}"
                ) from error
            self.rigs[name] = replace(rig, grid=grid)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.recording!r}, {type(self.tracker).__name__})"

    @property
    def stereo(self) -> FloorRig:
        """The first of ``rigs``. Raises InputError: one camera without depth."""
        for rig in self.rigs.values():
            return rig
        raise InputError(f"{self.recording.path}: expected a stereo pair or images with depth, found one camera")

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts with ``reset``."""
        self.reset()
        yield from self.after(-1)

    def after(self, frame: int, last: int | None = None) -> Iterator[FrameResult]:
        """Continue tracking after a frame, with the memory of the frames up to it, to a last one or to the end."""
        measured = self._measure_frames(frame, last)
        try:
            with closing(prefetch(measured, self.ahead) if self.ahead else measured) as frames:
                for each in frames:
                    yield self._track(*each)
        finally:
            self._forget_ahead()

    def step(self, frame: Frame[Any]) -> FrameResult:
        """Track the next frame, of the kind that ``recording`` gives; frames come in order.

        Raises:
            InputError, ValueError: a frame of another kind of recording or without a time after that of the frame
                before, images of another size than the calibration's, or damaged maps.
        """
        clock = StageClock()
        return self._track(frame, self._measure(frame, clock), clock)

    def _measure_frames(
        self, before: int, last: int | None
    ) -> Generator[tuple[Frame[Any], Measured, StageClock], None, None]:
        """The frames after one, to the last. Those before are read and passed over: what could not be read is noted
        again."""
        end = math.inf if last is None else last
        clock = StageClock()
        for frame in self.recording:
            if before < frame.index <= end:
                clock.record("read")
                yield frame, self._measure(frame, clock), clock
            if frame.index >= end:
                break
            clock = StageClock()

    def _measure(self, frame: Frame[Any], clock: StageClock) -> Measured:
        """Measure a frame, which may run ahead of tracking in a thread of its own."""
        if len(frame.shots) != len(self.sensors):
            raise InputError(f"frame: expected shots of {len(self.sensors)} sensors, found {len(frame.shots)}")
        pairs = zip(self.sensors, frame.shots, strict=True)
        return tuple(None if shot is None else sensor.measure(shot, clock) for sensor, shot in pairs)

    def _track(self, frame: Frame[Any], measured: Measured, clock: StageClock) -> FrameResult:
        if why := unusable_time(frame.timestamp_s, self._last_s):
            raise InputError(f"frame {frame.index}: {why}")
        clock.start()
        views = tuple(sensor.look(each, frame, clock) for sensor, each in zip(self.sensors, measured, strict=True))
        observation = self._observation(frame, views)
        people = track_frame(self.tracker, observation)
        decisions = self.tracker.decisions
        for sensor, view in zip(self.sensors, views, strict=True):
            sensor.protect(people, view, decisions)
        clock.record("track")
        self._last_s = frame.timestamp_s
        rigs = (*self.rigs.values(),)
        return FrameResult(frame.index, frame.timestamp_s, people, decisions, observation, clock, rigs)

    def _observation(self, frame: Frame[Any], views: tuple[View, ...]) -> Observation:
        if not self.rigs:
            return Observation(frame.index, frame.timestamp_s, views)
        build = partial(plan_view, [view.points for view in views], self.stereo.grid, self.config.maps)
        return Observation(frame.index, frame.timestamp_s, views, self.camera, build)

    def study(self, every: int) -> None:
        """Let a tracker of one camera look at every n-th frame before the first is tracked, as far as it wants to; what
        it learns survives ``reset``."""
        cast(ImageTracker, self.tracker).study(self._looked_at(every))
        self._reset_sensors()

    def _looked_at(self, every: int) -> Iterator[Observation]:
        for frame in self.recording:
            if frame.index % every == 0:
                clock = StageClock()
                measured = self._measure(frame, clock)
                views = (sensor.look(each, frame, clock) for sensor, each in zip(self.sensors, measured, strict=True))
                yield self._observation(frame, tuple(views))

    @property
    def checks(self) -> list[Check]:
        """Checks of the recording so far; empty where nothing is checked."""
        return [check for sensor in self.sensors for check in sensor.checks]

    def camera_info(self) -> CameraInfo | None:
        """The camera as ``run.json`` has it; None for one that is not calibrated."""
        return camera_info(self.camera, self.rigs)

    def floor_info(self) -> FloorInfo | None:
        """The floor as ``run.json`` has it; None where there is no calibrated camera."""
        return floor_info(self.camera, self.rigs, self._camera_source)

    def reset(self) -> None:
        """Forget all frames: people, background and feedback."""
        self._last_s = -math.inf
        self.tracker.reset()
        self._reset_sensors()

    def state(self) -> dict[str, dict[str, Any]]:
        """A copy of all that is carried from frame to frame, by name of the part and of the value. Raises TypeError: a
        tracker of one's own without ``state``, or with one that is not plain."""
        parts = self._memory().items()
        state = {name: part.state() if isinstance(part, Carried) else plain(part.state()) for name, part in parts}
        return {"engine": {"last_s": self._last_s}, **state}

    def set_state(self, state: Mapping[str, Mapping[str, Any]]) -> None:
        """Resume from a copy of the state of an engine that was made with the same arguments."""
        self._last_s = state["engine"]["last_s"]
        for name, part in self._memory().items():
            part.set_state(state[name] if isinstance(part, Carried) else restore(state[name]))

    def _memory(self) -> dict[str, Carried]:
        tracker: Any = self.tracker
        if not (hasattr(tracker, "state") and hasattr(tracker, "set_state")):
            raise TypeError(f"{type(tracker).__name__} has no state() and set_state()")
        memory = {f"{name}{n}": part for n, sensor in enumerate(self.sensors) for name, part in sensor.memory().items()}
        return {"tracker": tracker, **memory}

    def _forget_ahead(self) -> None:
        """The sensors remember what was tracked; who leaves an iteration early may have measured more."""
        for sensor in self.sensors:
            for part in sensor.memory().values():
                part.set_state(part.state())

    def _reset_sensors(self) -> None:
        for sensor in self.sensors:
            for part in sensor.memory().values():
                part.reset()
