"""Stereo rigs to people: rectify, match, segment, back-project, track, feed back (Harville 2002)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import F32, U8
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.checks.timing import Thumbnails, thumbnails
from planview.engine.config import Config
from planview.engine.engine import (
    AnyRecording,
    Engine,
    Frame,
    FrameResult,
    Prepared,
    Remembers,
    RigFrame,
    StageClock,
    refuse_frame,
)
from planview.engine.feedback import Feedback
from planview.engine.setup import Setup, refuse_foreign_disparity, set_up
from planview.foreground.mixture import Foreground
from planview.maps.multi_rig import joint_grid, joint_maps
from planview.maps.pixels import Cloud, SeenPixels
from planview.tracking.base import Decision, Observation, Tracker, followed
from planview.tracking.joint import JointTracker
from planview.trajectories.state import TrackState
from stereo.matcher import Matcher, SampledDisparity
from stereo.readers.multi_rig import MultiRigFrame, MultiRigRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame, StereoRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier


class RigStages:
    """The stages of one rig; what it shows depends on where people were.

    Attributes:
        name: among several rigs.
        view: the rig above its floor, with its rectification.
        foreground, cloud, feedback: the stages after it.
    """

    def __init__(self, view: Setup, config: Config, matcher: Matcher | None = None, name: str = "") -> None:
        """Compose the stages.

        Args:
            matcher: of whole pairs; SGBM over the view's disparities when None.
        Raises:
            InputError: a matcher for images with depth.
        """
        self.name, self.view, self._matcher = name, view, matcher
        of_pairs = isinstance(view.rectifier, Rectifier)
        if matcher is not None and not of_pairs:
            raise InputError(
                f"{view.calibration}: expected a stereo pair for a matcher of your own, found images with depth"
            )
        geometry, pose, step = view.geometry, view.floor.world_SE3_left, view.reduction
        self.cloud = Cloud(geometry, pose, config.maps, step)
        self.foreground = Foreground(
            config.foreground, self.cloud.shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )  # fmt: skip
        self._sgbm = view.matcher(config, step) if of_pairs and matcher is None else None
        self.feedback = Feedback(config.feedback)

    def prepare(self, frame: Frame, clock: StageClock) -> Prepared:
        """Rectify and match a frame (errors: see ``Engine.step``)."""
        rectifier = self.view.rectifier
        if isinstance(rectifier, RgbdRectifier):
            if not isinstance(frame, RgbdFrame):
                refuse_frame("an image with depth", frame)
            seen = rectifier(frame)
            clock.record("rectify")
            return self._prepared(seen.left, rectifier.disparity(seen), None, clock)
        if not isinstance(frame, StereoFrame):
            refuse_frame("a stereo pair", frame)
        if self._matcher is not None:
            whole = rectifier(frame.left, frame.right)
            clock.record("rectify")
            disparity = self._matcher(whole.left_grey, whole.right_grey)
            refuse_foreign_disparity(disparity, rectifier.geometry.size[::-1], self.view.disparities)
            small = thumbnails(whole.left_grey, whole.right_grey)
            return self._prepared(whole.left, disparity, small, clock)
        assert self._sgbm is not None
        pair = rectifier.reduced(frame.left, frame.right, self.view.reduction)
        small = thumbnails(pair.left_grey, pair.right_grey)
        clock.record("rectify")
        sampled = self._sgbm.sampled(pair.left_grey, pair.right_grey)
        clock.record("match")
        return Prepared(pair.image, pair.left, sampled, small)

    def _prepared(self, left: U8, disparity: F32, small: Thumbnails | None, clock: StageClock) -> Prepared:
        """A frame whose disparity is known at full size."""
        image = left
        if self.view.reduction > 1:
            image = np.asarray(cv2.resize(left, self.cloud.shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)
        clock.record("match")
        return Prepared(image, lambda: left, SampledDisparity(disparity), small)

    def look(self, prepared: Prepared, now_s: float, clock: StageClock) -> RigFrame:
        """What the rig shows, from what was learned of the frames before."""
        disparity = self._samples(prepared.sampled)
        mask = self.foreground.update(prepared.image, disparity, now_s, self.feedback.mask)
        clock.record("foreground")
        if not self.foreground.shows:
            return RigFrame(self.name, prepared, disparity, mask, SeenPixels.unknown(self.cloud.rays))
        renewed = self._renewed_background(now_s)
        view = self.cloud.seen(disparity, mask, now_s, renewed, prepared.image, self.foreground.exposure)
        clock.record("maps")
        return RigFrame(self.name, prepared, disparity, mask, view)

    def _samples(self, sampled: SampledDisparity) -> F32:
        """Disparity at the analysis size."""
        step = self.view.reduction // sampled.step
        return np.ascontiguousarray(sampled.samples[::step, ::step])

    def _renewed_background(self, now_s: float) -> F32 | None:
        due = self.foreground.settled and self.cloud.background.due(now_s)
        return self.foreground.background_disparity() if due else None

    def learn(self, frame: RigFrame, people: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        """Keep where people are in the rig's image for the next frame's foreground."""
        if self.foreground.shows:
            self.feedback(frame.view.points, people, self.cloud.shape, decisions)

    def memory(self) -> dict[str, Remembers]:
        """What is carried from frame to frame."""
        return {"foreground": self.foreground, "feedback": self.feedback, "background": self.cloud.background}


class StereoEngine(Engine):
    """People from one rig (a pair, or images with depth) or from several above one floor.

    Attributes:
        rigs: one for a pair.
    """

    ahead = 2

    def __init__(self, recording: AnyRecording, rigs: Sequence[RigStages], tracker: Tracker, config: Config) -> None:
        """Join the maps of the rigs.

        Raises:
            ValueError: the floor covered together is larger than a grid may be.
        """
        self.rigs = tuple(rigs)
        self._first = first = replace(rigs[0].view, grid=joint_grid([rig.cloud.grid for rig in rigs]))
        views = {rig.name: rig.view for rig in rigs} | {rigs[0].name: first}
        super().__init__(recording, tracker, config, first.camera, first.geometry.size, views)

    def prepare(self, frame: Frame, clock: StageClock) -> Callable[[], FrameResult]:
        """See ``Engine``."""
        frames = frame.frames if isinstance(frame, MultiRigFrame) else (frame,)
        prepared = tuple(None if f is None else r.prepare(f, clock) for r, f in zip(self.rigs, frames, strict=True))
        return partial(self._track, frame.index, frame.timestamp_s, prepared, clock)

    def _track(self, index: int, now_s: float, prepared: Sequence[Prepared | None], clock: StageClock) -> FrameResult:
        """Follow people; ``prepared`` is None for a rig without a frame at that time."""
        clock.start()
        shown = tuple(
            None if one is None else rig.look(one, now_s, clock) for rig, one in zip(self.rigs, prepared, strict=True)
        )
        views = tuple(
            one.view if one else SeenPixels.unknown(rig.cloud.rays) for rig, one in zip(self.rigs, shown, strict=True)
        )
        points = [view.points for view in views]
        build_maps = partial(joint_maps, points, self._first.grid, self.config.maps)
        unknown = not any(one and rig.foreground.shows for rig, one in zip(self.rigs, shown, strict=True))
        image, mask = (shown[0].prepared.image, shown[0].foreground) if shown[0] else (None, None)
        observation = Observation(
            index, now_s, image, mask, views=views, camera=self.camera, build_maps=build_maps, unknown=unknown
        )
        people = followed(self.tracker, observation)
        for rig, one in zip(self.rigs, shown, strict=True):
            if one:
                rig.learn(one, people, self.tracker.decisions)
        clock.record("track")
        return FrameResult(
            index, now_s, people, self.tracker.decisions, observation, clock.stages_ms, shown, self._first
        )

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``Engine``; those of several rigs under their names."""
        every = [(rig.name, check) for rig in self.rigs for check in rig.view.checks]
        return tuple(replace(check, name=f"{name}: {check.name}") if name else check for name, check in every)

    def memory(self) -> dict[str, Remembers]:
        """The tracker, and what every rig remembers."""
        every = {f"{name}{n}": part for n, rig in enumerate(self.rigs) for name, part in rig.memory().items()}
        return super().memory() | every


def stereo_engine(
    recording: StereoRecording | RgbdRecording,
    config: Config | None = None,
    tracker: Tracker | None = None,
    matcher: Matcher | None = None,
    setup: Setup | None = None,
) -> Engine:
    """An engine for a recording of one pair, or of images with depth.

    Args:
        tracker: the joint tracker when None.
        matcher: of whole pairs; SGBM when None.
        setup: of the recording; ``set_up`` finds it when None.
    Raises:
        InputError: a matcher for images with depth, or a floor of which the camera sees nothing or too much.
        WorkError: no floor is visible.
    """
    config = config or Config()
    rig = RigStages(setup or set_up(recording, config), config, matcher)
    return StereoEngine(recording, [rig], tracker or JointTracker(config.joint), config)


def multi_rig_engine(recording: MultiRigRecording, config: Config, tracker: Tracker) -> Engine:
    """An engine for the recordings of several rigs in one world.

    Raises:
        InputError: the rigs are far apart.
        WorkError: a rig has no usable frame or hardly any disparity.
    """
    rigs = [RigStages(set_up(rig.recording, config, RIGS_FILE), config, name=rig.name) for rig in recording.rigs]
    try:
        return StereoEngine(recording, rigs, tracker, config)
    except ValueError as error:
        raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
