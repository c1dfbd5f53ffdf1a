"""Stereo rigs to people: rectify, match, segment, back-project, track, feed back (Harville 2002)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from calib.errors import InputError
from calib.types import U8
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.engine.config import Config
from planview.engine.engine import Depths, Engine, Frame, Remembers, StageClock, refuse_frame
from planview.engine.feedback import Feedback
from planview.engine.setup import Setup, refuse_foreign_disparity, set_up
from planview.foreground.mixture import Foreground
from planview.maps.plan_view import joint_grid
from planview.maps.view import FloorRig, MapBuilder, View
from planview.tracking.base import Decision, Tracker
from planview.tracking.joint import JointTracker
from planview.trajectories.state import TrackState
from stereo.depth import Depth
from stereo.matcher import Matcher
from stereo.readers.multi_rig import MultiRigFrame, MultiRigRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame, StereoRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier


class RigStages:
    """The stages of one rig.

    Attributes:
        name: among several rigs.
        rig: above its floor, with its rectification.
        foreground, maps, feedback: the stages after matching.
    """

    def __init__(self, rig: Setup, config: Config, matcher: Matcher | None = None, name: str = "") -> None:
        """Compose the stages.

        Args:
            matcher: of whole pairs; SGBM over the rig's disparities when None.
        Raises:
            InputError: a matcher for images with depth.
        """
        self.name, self.rig, self._matcher = name, rig, matcher
        of_pairs = isinstance(rig.rectifier, Rectifier)
        if matcher is not None and not of_pairs:
            raise InputError(
                f"{rig.calibration}: expected a stereo pair for a matcher of your own, found images with depth"
            )
        geometry, step = rig.geometry, rig.reduction
        self.maps = MapBuilder(geometry, rig.floor.world_SE3_left, config.maps, step)
        self.foreground = Foreground(
            config.foreground, self.maps.shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )
        if of_pairs and matcher is None:
            self._sgbm = rig.matcher(config, step)
        self.feedback = Feedback(config.feedback)

    def match(self, frame: Frame, clock: StageClock) -> Depth:
        """Rectify and match a frame."""
        rectifier, step = self.rig.rectifier, self.rig.reduction
        greys: tuple[U8, U8] | None = None
        if isinstance(rectifier, RgbdRectifier):
            if not isinstance(frame, RgbdFrame):
                refuse_frame("an image with depth", frame)
            seen = rectifier(frame)
            clock.record("rectify")
            left, disparity = seen.left, rectifier.disparity(seen)
        elif not isinstance(frame, StereoFrame):
            refuse_frame("a stereo pair", frame)
        elif self._matcher is None:
            pair = rectifier.reduced(frame.left, frame.right, step)
            clock.record("rectify")
            greys = pair.left_grey, pair.right_grey
            return Depth(pair.image, self._sgbm.sampled(*greys), step, greys, pair.left)
        else:
            whole = rectifier(frame.left, frame.right)
            clock.record("rectify")
            left, greys = whole.left, (whole.left_grey, whole.right_grey)
            disparity = self._matcher(*greys)
            refuse_foreign_disparity(disparity, rectifier.geometry.size[::-1], self.rig.disparities)
        image = cv2.resize(left, self.maps.shape[::-1], interpolation=cv2.INTER_AREA) if step > 1 else left
        return Depth(
            np.asarray(image, np.uint8), np.ascontiguousarray(disparity[::step, ::step]), step, greys, lambda: left
        )

    def look(self, depth: Depth | None, now_s: float, clock: StageClock) -> View:
        """What the rig shows, from what was learned of the frames before; ``depth``: None where it has no frame."""
        if depth is None:
            return View.unknown(self.maps.shape, rays=self.maps.rays)
        mask = self.foreground.update(depth.image, depth.disparity, now_s, self.feedback.mask)
        clock.record("foreground")
        if not self.foreground.shows:
            return View.unknown(self.maps.shape, depth.image, self.maps.rays)
        renewed = None
        if self.foreground.settled and self.maps.background_due(now_s):
            renewed = self.foreground.background_disparity()
        view = self.maps.view(depth.disparity, mask, now_s, renewed, depth.image, self.foreground.exposure)
        clock.record("maps")
        return view

    def memory(self) -> dict[str, Remembers]:
        """What is carried from frame to frame."""
        return {"foreground": self.foreground, "feedback": self.feedback, "maps": self.maps}


class StereoStages:
    """The stages of one rig (a pair, or images with depth) or of several above one floor: ``Stages``."""

    ahead = 2

    def __init__(self, rigs: Sequence[RigStages]) -> None:
        """Join the maps of the rigs. Raises ValueError: the floor covered together is larger than a grid may be."""
        first = replace(rigs[0].rig, grid=joint_grid([rig.maps.grid for rig in rigs]))
        self._rigs = tuple(rigs)
        self.rigs: Mapping[str, FloorRig] = {rig.name: rig.rig for rig in rigs} | {rigs[0].name: first}
        self.camera, self.size = first.camera, first.geometry.size

    def match(self, frame: Frame, clock: StageClock) -> Depths:
        """See ``Stages``."""
        frames = frame.frames if isinstance(frame, MultiRigFrame) else (frame,)
        depths = tuple(None if f is None else r.match(f, clock) for r, f in zip(self._rigs, frames, strict=True))
        clock.record("match")
        return depths

    def look(self, frame: Frame, depths: Depths, clock: StageClock) -> tuple[View, ...]:
        """See ``Stages``."""
        return tuple(rig.look(d, frame.timestamp_s, clock) for rig, d in zip(self._rigs, depths, strict=True))

    def learn(self, views: Sequence[View], people: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        """Paint people for the next frame's foreground."""
        for rig, view in zip(self._rigs, views, strict=True):
            rig.feedback.update(people, view, decisions)

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``Stages``; those of several rigs under their names."""
        every = [(rig.name, check) for rig in self._rigs for check in rig.rig.checks]
        return tuple(replace(check, name=f"{name}: {check.name}") if name else check for name, check in every)

    def memory(self) -> dict[str, Remembers]:
        """What every rig remembers."""
        return {f"{name}{n}": part for n, rig in enumerate(self._rigs) for name, part in rig.memory().items()}


def stereo_engine(
    recording: StereoRecording | RgbdRecording | MultiRigRecording,
    config: Config | None = None,
    tracker: Tracker | None = None,
    matcher: Matcher | None = None,
    setup: Setup | None = None,
) -> Engine:
    """An engine for a recording of one pair, of images with depth, or of several rigs in one world.

    Args:
        tracker: the joint tracker when None.
        matcher: of whole pairs; SGBM when None.
        setup: of the recording of one rig; ``set_up`` finds it when None.
    Raises:
        InputError: a matcher for images with depth, a floor of which the camera sees nothing or too much, or rigs that
            are far apart.
        WorkError: no floor is visible, or a rig has no usable frame or hardly any disparity.
    """
    config = config or Config()
    if isinstance(recording, MultiRigRecording):
        rigs = [RigStages(set_up(rig.recording, config, RIGS_FILE), config, name=rig.name) for rig in recording.rigs]
    else:
        rigs = [RigStages(setup or set_up(recording, config), config, matcher)]
    try:
        stages = StereoStages(rigs)
    except ValueError as error:
        raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
    return Engine(recording, tracker or JointTracker(config.joint), config, stages)
