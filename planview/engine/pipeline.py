"""The whole engine, top to bottom: recorded images in, people in metres out."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from calib.types import U8
from planview.checks.check import Check
from planview.checks.timing import STEP_PX, sampled_thumbnails, thumbnails
from planview.engine.boxes import BodyBoxes
from planview.engine.config import Config
from planview.engine.describe import StereoDescription
from planview.engine.engine import FrameResult, StageClock, beyond
from planview.engine.feedback import Feedback
from planview.engine.frames import MatchedFrame, Separated
from planview.engine.front_end import FrontEnd
from planview.engine.setup import AnySetup, set_up_any
from planview.foreground.mixture import Foreground
from planview.maps.builder import MapBuilder
from planview.maps.pixels import KeptBackground, PixelRays, SeenPixels, seen_pixels, unmatched_pixels
from planview.maps.view import StereoView
from planview.tracking.base import Observation, Tracker
from planview.tracking.template import TemplateTracker
from planview.trajectories.state import TrackState
from stereo.matcher import Matcher
from stereo.readers import OpenOptions, open_any
from stereo.readers.background import prefetch
from stereo.recording import Recording, RgbdFrame, RgbdRecording, StereoFrame
from stereo.rectify import RectifiedPair
from stereo.sampled_sgm import SampledDisparity

AHEAD = 2
"""Frames read and rectified ahead of the tracker."""


class Pipeline(StereoDescription):
    """Rectify, match, separate foreground, build maps, track: an ``Engine`` for stereo pairs and images with depth.

    Attributes:
        setup: rectification, floor and disparity range.
        front_end, foreground, maps, feedback: the stages between reading and tracking.
        gated: matches in part; None where every pixel is matched, or nothing.
        ahead: frames that iteration reads and rectifies ahead in a thread of their own; 0 for one thread.
        recording, config, tracker, stereo: see ``Engine``.
    """

    def __init__(
        self,
        recording: Recording | RgbdRecording,
        setup: AnySetup,
        config: Config | None = None,
        tracker: Tracker | None = None,
        matcher: Matcher | None = None,
    ) -> None:
        """Compose the stages.

        Args:
            tracker: the template tracker when None.
            matcher: of whole pairs; SGBM over the setup's disparities when None, gated as configured.
        """
        self.config = c = config or Config()
        self.recording, self.setup = recording, setup
        self.front_end: FrontEnd = setup.front_end(c, matcher)
        geometry, floor = self.front_end.geometry, setup.floor
        reduction = -(-geometry.width // c.analysis.width_px)
        self.maps = MapBuilder(geometry, floor.world_SE3_left, c.maps, reduction)
        self.foreground = Foreground(c.foreground, self.maps.shape, geometry.disparity_std_per_px2, reduction)
        self.feedback = Feedback(c.feedback)
        self.tracker = tracker or TemplateTracker(c.template)
        self.background = KeptBackground()
        self.rays = PixelRays.of(geometry, floor.world_SE3_left, self.maps.shape, reduction)
        self.stereo = StereoView(
            geometry, floor, setup.floor_source, setup.calibration, setup.vertical_residual_px, setup.disparities,
            self.maps.grid, reduction, setup.sensor, str(setup.correction),
        )  # fmt: skip
        self.gated = setup.gated(c, self.maps.shape, reduction) if matcher is None and c.matching.gated else None
        self._boxes = BodyBoxes(geometry, floor.world_SE3_left)
        self.ahead = AHEAD

    @staticmethod
    def from_recording(
        path: Path | str,
        config: Config | None = None,
        options: OpenOptions | None = None,
        tracker: Tracker | None = None,
        matcher: Matcher | None = None,
    ) -> Pipeline:
        """Open a recording, find its floor and get ready.

        Args:
            options: how the recording is opened (calibration, rate, topics).
            tracker, matcher: see the constructor.
        Raises:
            InputError: no such recording or calibration.
            WorkError: no floor is visible.
        """
        config = config or Config()
        recording = open_any(Path(path), options)
        return Pipeline(recording, set_up_any(recording, config), config, tracker, matcher)

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``Engine``."""
        return self.setup.checks

    def reset(self) -> None:
        """Forget people, background and feedback."""
        self.tracker.reset()
        self.foreground.reset()
        self.feedback.reset()
        self.background.reset()
        if self.gated is not None:
            self.gated.memory.reset()

    def step(self, frame: StereoFrame | RgbdFrame) -> FrameResult:
        """Track the next frame, of the recording's kind.

        Raises:
            ValueError: images of another size than the calibration's.
        """
        return self.track(self.prepare(frame))

    def __iter__(self) -> Iterator[FrameResult]:
        """``step`` over the recording from its first frame, but reading and rectifying may run in a thread."""
        self.reset()
        yield from self.after(-1)

    def memory(self) -> dict[str, object]:
        """See ``Engine``."""
        memory: dict[str, object] = {"tracker": self.tracker, "foreground": self.foreground, "feedback": self.feedback}
        memory["background"] = self.background
        return memory if self.gated is None else memory | {"matching": self.gated.memory}

    def after(self, frame: int) -> Iterator[FrameResult]:
        """See ``Engine``."""
        with closing(prefetch(self._prepared(frame), self.ahead) if self.ahead else self._prepared(frame)) as frames:
            for matched in frames:
                yield self.track(matched)

    def prepare(self, frame: StereoFrame | RgbdFrame, clock: StageClock | None = None) -> MatchedFrame:
        """What of a frame depends on no other frame: its rectification, and its disparity unless that is gated.

        Args:
            clock: with the times of earlier stages.
        """
        if self.gated is None or isinstance(frame, RgbdFrame):
            return self.match(frame, clock)
        clock = clock or StageClock()
        pair = self.gated.rectify(frame)
        small = sampled_thumbnails(*pair.samples(STEP_PX))
        clock.record("rectify")
        return MatchedFrame(frame.index, frame.timestamp_s, pair.reduced, None, clock.stages_ms, small, pair, pair.left)

    def match(self, frame: StereoFrame | RgbdFrame, clock: StageClock | None = None) -> MatchedFrame:
        """Rectify a frame and find the disparity of all its pixels; depends on no other frame.

        Args:
            clock: with the times of earlier stages.
        """
        clock = clock or StageClock()
        rectified = self.front_end.rectify(frame)
        image = self.reduced_image(rectified.left)
        clock.record("rectify")
        disparity = self.front_end.disparity(rectified)
        clock.record("match")
        small = thumbnails(rectified.left_grey, rectified.right_grey) if isinstance(rectified, RectifiedPair) else None
        return MatchedFrame(
            frame.index, frame.timestamp_s, image, disparity, clock.stages_ms, small, None, lambda: rectified.left
        )

    def track(self, matched: MatchedFrame) -> FrameResult:
        """Foreground, maps and people of the next frame."""
        clock = StageClock(matched.stages_ms)
        found = self.separate(matched, clock)
        maps = self.maps.of(found.points)
        clock.record("maps")
        observation = Observation(
            matched.frame,
            matched.timestamp_s,
            matched.image,
            found.mask,
            None,
            maps,
            views=(self.seen(found, matched.timestamp_s),),
        )
        tracks = tuple(self._boxes(track) for track in self.tracker.update(observation))
        self.learn(found, tracks)
        clock.record("track")
        return FrameResult(
            matched.frame, matched.timestamp_s, tracks, self.tracker.decisions, observation,
            found.sampled, clock.stages_ms, thumbnails=matched.thumbnails, measured=found.measured,
            picture=matched.picture,
        )  # fmt: skip

    def separate(self, matched: MatchedFrame, clock: StageClock) -> Separated:
        """Foreground of the next pair."""
        step, image, measured = self.stereo.reduction, matched.image, None
        if matched.disparity is None:
            assert self.gated is not None and matched.pair is not None
            sampled, now, measured = self.gated(matched.pair, image, self.foreground, matched.timestamp_s)
            clock.record("match")
        else:
            sampled = SampledDisparity(matched.disparity)
            now = np.ascontiguousarray(matched.disparity[::step, ::step])
        known = measured if self.foreground.settled else None
        mask = self.foreground.update(image, now, matched.timestamp_s, self.feedback.mask, known)
        clock.record("foreground")
        points = self.maps.points(now, mask, image, self.foreground.exposure)
        return Separated(image, mask, points, sampled, measured)

    def seen(self, found: Separated, timestamp_s: float) -> SeenPixels:
        """What the camera saw of every analysis pixel."""
        kept, renewed = self.background, self.foreground.settled and self.background.due(timestamp_s)
        if renewed:
            kept.renew(self.foreground.background_disparity(), timestamp_s)
        unmatched = unmatched_pixels(found.mask, found.points)
        lowest_m = self.config.maps.height_min_m
        return seen_pixels(self.rays, found.points, unmatched, kept.disparity, lowest_m, renewed)

    def learn(self, found: Separated, tracks: Sequence[TrackState]) -> None:
        """Tell the next frame's foreground and matching where people are, with their boxes in this image."""
        self.feedback(found.points, tracks, self.maps.shape)
        if self.gated is not None and found.measured is not None:
            self.gated.learn(found.image, found.mask, found.measured, tracks)

    def _prepared(self, after: int) -> Generator[MatchedFrame, None, None]:
        frames: Iterable[StereoFrame | RgbdFrame] = self.recording
        clock = StageClock()
        for frame in beyond(frames, after):
            clock.record("read")
            yield self.prepare(frame, clock)
            clock = StageClock()

    def reduced_image(self, image: U8) -> U8:
        """The image that the foreground gets."""
        whole, size = self.stereo.reduction == 1, self.maps.shape[::-1]
        return image if whole else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
