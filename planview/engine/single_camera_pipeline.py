"""The engine for one camera, top to bottom: frames in, people out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol, runtime_checkable

from calib.ground_camera import GroundCamera
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.describe import ground_camera_info, ground_floor_info
from planview.engine.engine import FrameResult, StageClock, beyond, timed_steps
from planview.engine.info import CameraInfo, FloorInfo
from planview.engine.single_camera import SingleCamera
from planview.tracking.base import ImageTracker, Observation
from stereo.recording import Video, VideoFrame

OVERVIEW_HZ = 10.0
"""Frames per second of a recording that are looked at before it is tracked: walkers then overlap themselves from frame
to frame, and a minute of video takes two or three seconds, a third to two thirds of tracking it. Our choice."""


@runtime_checkable
class Studies(Protocol):
    """A tracker that learns from a recording before its first frame is tracked."""

    def study(self, observations: Iterable[Observation]) -> None:
        """Take as many observations as are of use, in order; what is learned survives ``reset``."""


class SingleCameraPipeline:
    """Separate foreground and track with one camera: an ``Engine`` for videos.

    Attributes:
        camera: calibration above the floor, None where the tracker needs none.
        recording, config, tracker: see ``Engine``.
    """

    stereo = None

    def __init__(
        self,
        recording: Video,
        tracker: ImageTracker,
        config: Config | None = None,
        camera: GroundCamera | None = None,
    ) -> None:
        self.recording, self.tracker, self.camera = recording, tracker, camera
        self.config = config or Config()
        self.size = recording.size
        self._source = SingleCamera(self.config.single_camera, recording.size, tracker.foreground_columns)

    @classmethod
    def from_recording(
        cls, recording: Video, tracker: ImageTracker, config: Config | None = None, camera: GroundCamera | None = None
    ) -> SingleCameraPipeline:
        """An engine whose tracker has seen the beginning of the recording, where it can learn from that.

        A tracker composed with the constructor learns everything while it tracks, as from a camera that runs.
        """
        engine = cls(recording, tracker, config, camera)
        if isinstance(tracker, Studies):
            tracker.study(engine._overview())
            engine.reset()
        return engine

    def _overview(self) -> Iterator[Observation]:
        """Observations of the recording at about ``OVERVIEW_HZ``, without anybody tracked."""
        step = max(1, round(self.recording.fps / OVERVIEW_HZ))
        for frame in self.recording:
            if frame.index % step == 0:
                yield self._source.observe(frame)

    @property
    def checks(self) -> Sequence[Check]:
        """Whether the camera stands still and shows one scene, from the frames so far."""
        return self._source.checks()

    def camera_info(self) -> CameraInfo | None:
        """See ``Engine``."""
        return ground_camera_info(self.camera) if self.camera else None

    def floor_info(self) -> FloorInfo | None:
        """See ``Engine``."""
        return ground_floor_info(self.camera) if self.camera else None

    def reset(self) -> None:
        """Forget people and background."""
        self.tracker.reset()
        self._source.reset()

    def step(self, frame: VideoFrame) -> FrameResult:
        """Track the next frame.

        Raises:
            InputError: a frame of another size.
        """
        return self._track(frame, StageClock())

    def __iter__(self) -> Iterator[FrameResult]:
        """``step`` over the recording from its first frame."""
        self.reset()
        yield from self.after(-1)

    def memory(self) -> dict[str, object]:
        """See ``Engine``."""
        return {"tracker": self.tracker, "source": self._source}

    def after(self, frame: int) -> Iterator[FrameResult]:
        """See ``Engine``."""
        yield from timed_steps(beyond(self.recording, frame), self._track)

    def _track(self, frame: VideoFrame, clock: StageClock) -> FrameResult:
        observation = self._source.observe(frame, self.tracker.feedback())
        clock.record("foreground")
        tracks = self.tracker.update(observation)
        clock.record("track")
        return FrameResult(
            frame.index, frame.timestamp_s, tracks, self.tracker.decisions, observation, None, clock.stages_ms
        )
