"""Stereo rigs to people: rectify, match, segment, back-project, track, feed back (Harville 2002)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import F32, U8
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.checks.timing import Thumbnails, thumbnails
from planview.engine.config import Config
from planview.engine.engine import Disparity, Engine, Frame, FrameResult, Prepared, RigFrame, StageClock, refuse_frame
from planview.engine.feedback import BodyBoxes, Feedback
from planview.engine.setup import Setup, refuse_foreign_disparity, set_up
from planview.foreground.mixture import Foreground
from planview.maps.builder import Raster
from planview.maps.multi_rig import joint_grid, joint_maps
from planview.maps.pixels import Cloud
from planview.maps.view import StereoView
from planview.tracking.base import Observation, Tracker, followed
from planview.tracking.joint import JointTracker
from planview.trajectories.state import TrackState
from stereo.gating import SAMPLE, GatedMatching
from stereo.matcher import Matcher, SampledDisparity
from stereo.readers.multi_rig import MultiRigFrame, MultiRigRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame, StereoRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier


class Remembers(Protocol):
    """What is carried from frame to frame."""

    def reset(self) -> None: ...


class RigStages:
    """The stages of one rig; what it shows depends on where people were.

    Attributes:
        name: among several rigs.
        setup: rectification, floor and disparity range.
        gated: matches pairs in part; None for images with depth, and with a matcher of the user's.
        foreground, cloud, feedback: the stages after it.
        boxes: of people in its image.
        view: the rig above its floor.
    """

    def __init__(self, setup: Setup, config: Config, matcher: Matcher | None = None, name: str = "") -> None:
        """Compose the stages.

        Args:
            matcher: of whole pairs; SGBM over the setup's disparities, gated as configured, when None.
        Raises:
            InputError: a matcher for images with depth.
        """
        self.name, self.setup, self._matcher = name, setup, matcher
        of_pairs = isinstance(setup.rectifier, Rectifier)
        if matcher is not None and not of_pairs:
            raise InputError(
                f"{setup.calibration}: expected a stereo pair for a matcher of your own, found images with depth"
            )
        geometry, pose = setup.rectifier.geometry, setup.floor.world_SE3_left
        self._step = step = -(-geometry.width // config.analysis.width_px)
        self.cloud = Cloud(geometry, pose, config.maps, step)
        shape = self.cloud.shape
        self.foreground = Foreground(
            config.foreground, shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )  # fmt: skip
        self.gated: GatedMatching | None = None
        if of_pairs and matcher is None:
            self.gated = GatedMatching(setup.matcher(config, step), setup.floor, config.matching)
        self.feedback = Feedback(config.feedback)
        self.view = StereoView(
            geometry, setup.floor, setup.floor_source, setup.calibration, setup.vertical_residual_px,
            setup.disparities, self.cloud.grid, step, setup.sensor, str(setup.correction or ""),
        )  # fmt: skip
        self.boxes = BodyBoxes(geometry, pose)

    def prepare(self, frame: Frame, clock: StageClock) -> Prepared:
        """Rectify a frame, and match it where that depends on no other frame (errors: see ``FrontEnd``)."""
        rectifier = self.setup.rectifier
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
            refuse_foreign_disparity(disparity, rectifier.geometry.size[::-1], self.setup.disparities)
            small = thumbnails(whole.left_grey, whole.right_grey)
            return self._prepared(whole.left, disparity, small, clock)
        assert self.gated is not None
        pair = rectifier.reduced(frame.left, frame.right, self._step)
        levels, small = self.gated.levels(pair.left_grey, pair.right_grey), thumbnails(pair.left_grey, pair.right_grey)
        clock.record("rectify")
        return Prepared(pair.image, pair.left, levels, small)

    def _prepared(self, left: U8, disparity: F32, small: Thumbnails | None, clock: StageClock) -> Prepared:
        """A frame of which all pixels have been matched."""
        image = left
        if self._step > 1:
            image = np.asarray(cv2.resize(left, self.cloud.shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)
        clock.record("match")
        return Prepared(image, lambda: left, SampledDisparity(disparity), small)

    def look(self, prepared: Prepared, now_s: float, clock: StageClock) -> RigFrame:
        """What the rig shows, from what was learned of the frames before."""
        disparity = self._match(prepared, now_s)
        clock.record("match")
        measured = disparity.measured if self.foreground.settled else None
        mask = self.foreground.update(prepared.image, disparity.now, now_s, self.feedback.mask, measured)
        clock.record("foreground")
        renewed = self._renewed_background(now_s)
        view = self.cloud(disparity.now, mask, now_s, renewed, prepared.image, self.foreground.exposure)
        clock.record("maps")
        return RigFrame(self.name, prepared, disparity, mask, view)

    def _match(self, prepared: Prepared, now_s: float) -> Disparity:
        """Disparity where the background of the frames before cannot know it."""
        if isinstance(prepared.matched, SampledDisparity):
            now = np.ascontiguousarray(prepared.matched.samples[:: self._step, :: self._step])
            return Disparity(prepared.matched, now)
        assert self.gated is not None
        changed = self.foreground.changed(prepared.image, SAMPLE) if self.foreground.settled else None
        return Disparity(*self.gated(prepared.matched, prepared.image, changed, now_s))

    def _renewed_background(self, now_s: float) -> F32 | None:
        due = self.foreground.settled and self.cloud.background.due(now_s)
        return self.foreground.background_disparity() if due else None

    def learn(self, frame: RigFrame, people: Sequence[TrackState]) -> None:
        """Keep where people are in the rig's image for the next frame's foreground and matching."""
        self.feedback(frame.view.points, people, self.cloud.shape)
        if self.gated is not None and frame.disparity.measured is not None:
            lost = [track.box_px for track in people if track.state == "lost" and not math.isnan(track.box_px[0])]
            self.gated.learn(frame.prepared.image, frame.foreground, frame.disparity.measured, lost)

    def memory(self) -> dict[str, Remembers]:
        """What is carried from frame to frame."""
        parts: dict[str, Remembers] = {"foreground": self.foreground, "feedback": self.feedback}
        parts["background"] = self.cloud.background
        return parts if self.gated is None else parts | {"matching": self.gated.memory}


class StereoFrontEnd:
    """People from one rig (a pair, or images with depth) or from several above one floor: a ``FrontEnd``.

    Attributes:
        rigs: one for a pair.
        tracker, ahead, camera, size, views: see ``FrontEnd``.
    """

    ahead = 2

    def __init__(self, rigs: Sequence[RigStages], tracker: Tracker, config: Config) -> None:
        """Join the maps of the rigs.

        Raises:
            ValueError: the floor covered together is larger than a grid may be.
        """
        self.rigs, self.tracker = tuple(rigs), tracker
        self._raster = Raster(joint_grid([rig.cloud.grid for rig in rigs]), config.maps)
        self._first = first = replace(rigs[0].view, grid=self._raster.grid)
        self.views: Mapping[str, StereoView] = {rig.name: rig.view for rig in rigs} | {rigs[0].name: first}
        self.camera, self.size = first.camera, first.geometry.size

    def prepare(self, frame: Frame, clock: StageClock) -> Callable[[], FrameResult]:
        """See ``FrontEnd``.

        Raises:
            InputError: a frame of another kind of recording.
            ValueError: images of another size than the calibration's.
        """
        frames = frame.frames if isinstance(frame, MultiRigFrame) else (frame,)
        prepared = tuple(None if f is None else r.prepare(f, clock) for r, f in zip(self.rigs, frames, strict=True))
        return partial(self._track, frame.index, frame.timestamp_s, prepared, clock)

    def _track(self, index: int, now_s: float, prepared: Sequence[Prepared | None], clock: StageClock) -> FrameResult:
        """Follow people; ``prepared`` is None for a rig without a frame at that time."""
        clock.start()
        shown = tuple(
            None if one is None else rig.look(one, now_s, clock) for rig, one in zip(self.rigs, prepared, strict=True)
        )
        views = tuple(one.view for one in shown if one)
        build_maps = partial(joint_maps, [view.points for view in views], self._raster)
        image, mask = (shown[0].prepared.image, shown[0].foreground) if shown[0] else (None, None)
        observation = Observation(index, now_s, image, mask, views=views, build_maps=build_maps)
        people = followed(self.tracker, observation)
        boxed = tuple(rig.boxes(people) for rig in self.rigs)
        for rig, one, tracks in zip(self.rigs, shown, boxed, strict=True):
            if one:
                rig.learn(one, tracks)
        clock.record("track")
        return FrameResult(
            index, now_s, boxed[0], self.tracker.decisions, observation, clock.stages_ms, shown, boxed, self._first
        )

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``FrontEnd``; those of several rigs under their names."""
        every = [(rig.name, check) for rig in self.rigs for check in rig.setup.checks]
        return tuple(replace(check, name=f"{name}: {check.name}") if name else check for name, check in every)

    def reset(self) -> None:
        """See ``FrontEnd``."""
        for rig in self.rigs:
            for part in rig.memory().values():
                part.reset()

    def memory(self) -> dict[str, object]:
        """See ``FrontEnd``."""
        return {f"{name}{n}": part for n, rig in enumerate(self.rigs) for name, part in rig.memory().items()}


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
        matcher: of whole pairs; SGBM, gated as configured, when None.
        setup: of the recording; ``set_up`` finds it when None.
    Raises:
        InputError: a matcher for images with depth, or a floor of which the camera sees nothing or too much.
        WorkError: no floor is visible.
    """
    config = config or Config()
    rig = _rig(recording, setup or set_up(recording, config), config, matcher)
    return Engine(recording, StereoFrontEnd([rig], tracker or JointTracker(config.joint), config), config)


def multi_rig_engine(recording: MultiRigRecording, config: Config, tracker: Tracker) -> Engine:
    """An engine for the recordings of several rigs in one world.

    Raises:
        InputError: the rigs are far apart.
        WorkError: a rig has no usable frame or hardly any disparity.
    """
    rigs = [
        _rig(rig.recording, replace(set_up(rig.recording, config), floor_source=RIGS_FILE), config, name=rig.name)
        for rig in recording.rigs
    ]
    try:
        front_end = StereoFrontEnd(rigs, tracker, config)
    except ValueError as error:
        raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
    return Engine(recording, front_end, config)


def _rig(
    recording: StereoRecording | RgbdRecording,
    setup: Setup,
    config: Config,
    matcher: Matcher | None = None,
    name: str = "",
) -> RigStages:
    try:
        return RigStages(setup, config, matcher, name)
    except ValueError as error:
        raise InputError(f"{recording.path} (floor: {setup.floor_source}): {error}") from error
