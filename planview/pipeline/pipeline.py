"""The whole engine, top to bottom: a recorded stereo pair in, people in metres out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from calib.ground_camera import GroundCamera
from calib.types import F32, U8
from planview.foreground.mixture import Foreground
from planview.maps.builder import MapBuilder
from planview.pipeline.boxes import BodyBoxes
from planview.pipeline.config import Config
from planview.pipeline.feedback import Feedback
from planview.pipeline.setup import Setup, set_up
from planview.pipeline.single_camera import SingleCamera
from planview.tracking.base import Decision, ImageTracker, Observation, Tracker
from planview.tracking.template import TemplateTracker
from planview.trajectories.state import TrackState
from stereo.matcher import Matcher, SgbmMatcher
from stereo.readers import open_recording
from stereo.readers.prefetch import prefetch
from stereo.recording import Recording, Video, VideoFrame

STAGES = ("read", "rectify", "match", "foreground", "maps", "track")
"""Stages timed, in order."""


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything about one frame.

    Attributes:
        frame: index in the recording, from 0.
        timestamp_s: seconds since the first frame.
        tracks: people, tentative and lost ones included.
        decisions: why the tracker did what it did.
        observation: what the tracker saw (image, foreground, maps).
        disparity: (H, W) float32 [px], NaN invalid; None for a single camera.
        stages_ms: time of every stage; reading and matching run ahead in other threads.
    """

    frame: int
    timestamp_s: float
    tracks: tuple[TrackState, ...]
    decisions: tuple[Decision, ...]
    observation: Observation
    disparity: F32 | None
    stages_ms: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Matched:
    index: int
    timestamp_s: float
    image: U8
    disparity: F32
    stages_ms: dict[str, float]


class Pipeline:
    """Read, rectify, match, separate foreground, build maps, track; iterate it for a FrameResult per frame.

    Attributes:
        recording: what is read.
        setup: rectification, floor and disparity range.
        tracker: who follows people.
    """

    def __init__(
        self,
        recording: Recording,
        setup: Setup,
        config: Config | None = None,
        tracker: Tracker | None = None,
        matcher: Matcher | None = None,
    ) -> None:
        """Compose the stages.

        Args:
            tracker: the template tracker when None.
            matcher: SGBM over the setup's disparities when None.
        """
        self.config = c = config or Config()
        self.recording, self.setup = recording, setup
        geometry, pose = setup.rectifier.geometry, setup.floor.world_SE3_left
        self.reduction = -(-geometry.width // c.analysis.width_px)
        self.matcher = matcher or SgbmMatcher(
            geometry, c.sgbm, setup.disparities, setup.rectifier.mask, setup.rectifier.right_mask
        )
        self.maps = MapBuilder(geometry, pose, c.maps, self.reduction)
        self.foreground = Foreground(c.foreground, self.maps.shape)
        self.feedback = Feedback(c.feedback)
        self.tracker = tracker or TemplateTracker(c.template, c.maps.height_max_m)
        self._boxes = BodyBoxes(geometry, pose)

    @staticmethod
    def from_recording(path: Path | str, config: Config | None = None, calibration: Path | None = None) -> Pipeline:
        """Open a recording, find its floor and get ready.

        Raises:
            InputError: no such recording or calibration.
            WorkError: no floor is visible.
        """
        config = config or Config()
        recording = open_recording(Path(path), calibration)
        return Pipeline(recording, set_up(recording, config), config)

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts anew."""
        self.tracker.reset()
        self.foreground.reset()
        self.feedback.reset()
        opinion: U8 | None = None
        for matched in prefetch(self._matched(), 2):
            clock = _Clock(matched.stages_ms)
            image = self._reduced_image(matched.image)
            disparity = np.ascontiguousarray(matched.disparity[:: self.reduction, :: self.reduction])
            mask = self.foreground.update(image, disparity, matched.timestamp_s, opinion)
            clock.lap("foreground")
            maps = self.maps(disparity, mask, image, self.foreground.exposure)
            clock.lap("maps")
            seen = Observation(matched.index, matched.timestamp_s, matched.image, mask, None, maps)
            tracks = tuple(self._boxes(track) for track in self.tracker.update(seen))
            opinion = self.feedback(maps.points, tracks, self.maps.shape)
            clock.lap("track")
            yield FrameResult(
                matched.index, matched.timestamp_s, tracks, self.tracker.decisions, seen,
                matched.disparity, clock.stages_ms,
            )  # fmt: skip

    def _matched(self) -> Iterator[_Matched]:
        """Read, rectify and match; runs ahead in its own thread while earlier frames are tracked."""
        clock = _Clock({})
        for frame in self.recording:
            clock.lap("read")
            pair = self.setup.rectifier(frame.left, frame.right)
            clock.lap("rectify")
            disparity = self.matcher(pair.left_grey, pair.right_grey)
            clock.lap("match")
            yield _Matched(frame.index, frame.timestamp_s, pair.left, disparity, clock.stages_ms)
            clock = _Clock({})

    def _reduced_image(self, image: U8) -> U8:
        if self.reduction == 1:
            return image
        size = self.maps.shape[::-1]
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


class SingleCameraPipeline:
    """Read, separate foreground, track with one camera; iterate it for a FrameResult per frame.

    Attributes:
        recording: what is read.
        tracker: who follows people.
        camera: calibration above the floor, None where the tracker needs none.
    """

    def __init__(
        self,
        recording: Video,
        tracker: ImageTracker,
        config: Config | None = None,
        camera: GroundCamera | None = None,
    ) -> None:
        self.recording, self.tracker, self.camera = recording, tracker, camera
        self.config = config or Config()
        self._source = SingleCamera(self.config.single_camera, recording.size)

    def __iter__(self) -> Iterator[FrameResult]:
        """Track the recording from its first frame; each iteration starts anew."""
        self.tracker.reset()
        self._source.reset()
        for frame, read_ms in self._read():
            clock = _Clock({"read": read_ms})
            if self.tracker.needs_foreground:
                seen = self._source.observe(frame, self.tracker.feedback())
            else:
                seen = Observation(frame.index, frame.timestamp_s, frame.image)
            clock.lap("foreground")
            tracks = self.tracker.update(seen)
            clock.lap("track")
            yield FrameResult(
                frame.index, frame.timestamp_s, tracks, self.tracker.decisions, seen, None, clock.stages_ms
            )

    def _read(self) -> Iterator[tuple[VideoFrame, float]]:
        clock = _Clock({})
        for frame in self.recording:
            clock.lap("read")
            yield frame, clock.stages_ms["read"]
            clock = _Clock({})


class _Clock:
    """Laps in milliseconds, added to a frame's stage times."""

    def __init__(self, stages_ms: dict[str, float]) -> None:
        self.stages_ms = dict(stages_ms)
        self._since = perf_counter()

    def lap(self, stage: str) -> None:
        now = perf_counter()
        self.stages_ms[stage] = 1e3 * (now - self._since)
        self._since = now
