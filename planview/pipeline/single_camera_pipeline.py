"""The engine for one camera, top to bottom: frames in, people out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from calib.ground_camera import GroundCamera
from planview.doctor.check import Check
from planview.pipeline.config import Config
from planview.pipeline.describe import ground_camera_info, ground_floor_info
from planview.pipeline.engine import FrameResult, StageClock, beyond, timed_steps
from planview.pipeline.info import CameraInfo, FloorInfo
from planview.pipeline.single_camera import SingleCamera
from planview.tracking.base import ImageTracker
from stereo.recording import Video, VideoFrame


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
