"""Stereo rigs to people: rectify, match, segment, back-project, track, feed back (Harville 2002)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from calib.types import U8
from calib.world import RIGS_FILE
from planview.engine.config import Config, FeedbackParams
from planview.engine.engine import Engine, Frame, RigDepths, StageClock, refuse_frame
from planview.engine.setup import Setup, refuse_foreign_disparity, set_up
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON
from planview.maps.grid import FloorRig
from planview.maps.plan_view import joint_grid, plan_view
from planview.maps.view import MapBuilder, View
from planview.tracking.base import Decision, Observation, Tracker, followed
from planview.tracking.joint import JointTracker
from planview.trajectories.state import TrackState
from stereo.depth import Depth
from stereo.matcher import BODY_LAG, Matcher, SgbmMatcher
from stereo.readers.open import MultiRigFrame, MultiRigRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame, StereoRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier

OWN_M = 0.6
"""Foreground this near to a person's axis on the floor belongs to the person [m]: an arm's length."""
TRAVELLED_M = 0.5
"""Only a track that has moved this far since its start is protected from being learned [m]: furniture that was
mistaken for a person does not walk, and must fade into the background."""
GROUND_M = 0.12
"""Foreground lower than this and away from every person is floor under a new light [m]: a shoe's height."""


class RigStages:
    """One rig: ``match`` measures depth, ``look`` separates the foreground by colour and depth (Harville 2002, section
    2) and puts its pixels into the world (section 3); ``feedback`` keeps people from becoming background.

    Attributes:
        name: among several rigs.
        rig: above its floor, with its rectification.
        foreground, maps, feedback: the stages after matching.
    """

    def __init__(self, rig: Setup, config: Config, matcher: Matcher | None = None, name: str = "") -> None:
        """Compose the stages; ``matcher`` is of whole pairs, SGBM over the rig's disparities when None. Raises
        InputError: a matcher for images with depth."""
        self.name, self.rig, self._matcher = name, rig, matcher
        geometry, step, rectifier = rig.geometry, rig.reduction, rig.rectifier
        if isinstance(rectifier, Rectifier):
            masks = rectifier.mask, rectifier.right_mask
            self._sgbm = SgbmMatcher(geometry, config.sgbm, rig.disparities, *masks, step, BODY_LAG)
        elif matcher is not None:
            raise InputError(
                f"{rig.calibration}: expected a stereo pair for a matcher of your own, found images with depth"
            )
        self.maps = MapBuilder(geometry, rig.floor.world_SE3_left, config.maps, step)
        self.foreground = Foreground(
            config.foreground, self.maps.shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )
        self.feedback = Feedback(config.feedback)

    def memory(self) -> dict[str, Carried]:
        """What is carried from frame to frame."""
        return {"foreground": self.foreground, "feedback": self.feedback, "maps": self.maps}

    def match(self, frame: Frame, clock: StageClock) -> Depth:
        """Rectify and match a frame."""
        rectifier, step = self.rig.rectifier, self.rig.reduction
        if isinstance(rectifier, RgbdRectifier):
            if not isinstance(frame, RgbdFrame):
                refuse_frame("an image with depth", frame)
            seen = rectifier(frame)
            clock.record("rectify")
            return Depth.of_whole(seen.left, rectifier.disparity(seen), step)
        if not isinstance(frame, StereoFrame):
            refuse_frame("a stereo pair", frame)
        if self._matcher is None:
            pair = rectifier.reduced(frame.left, frame.right, step)
            clock.record("rectify")
            greys = pair.left_grey, pair.right_grey
            return Depth(pair.image, self._sgbm.sampled(*greys), step, greys, pair.left)
        whole = rectifier(frame.left, frame.right)
        clock.record("rectify")
        greys = whole.left_grey, whole.right_grey
        disparity = self._matcher(*greys)
        refuse_foreign_disparity(disparity, rectifier.geometry.size[::-1], self.rig.disparities)
        return Depth.of_whole(whole.left, disparity, step, greys)

    def look(self, depth: Depth | None, now_s: float, clock: StageClock) -> View:
        """What the rig shows, from what was learned of the frames before; ``depth``: None where it has no frame."""
        if depth is None:
            return View.unknown(self.maps.shape, rays=self.maps.rays)
        foreground = self.foreground
        mask = foreground.update(depth.image, depth.disparity, now_s, self.feedback.mask)
        clock.record("foreground")
        if not foreground.shows:
            return View.unknown(self.maps.shape, depth.image, self.maps.rays)
        due = foreground.settled and self.maps.background_due(now_s)
        background = foreground.background_disparity() if due else None
        points = self.maps.points(depth.disparity, mask, depth.image, foreground.exposure)
        view = self.maps.view(points, mask, now_s, background, depth.image)
        clock.record("maps")
        return view


class StereoStages:
    """Frames of one rig (a pair, or images with depth) or of several above one floor to people: ``Stages``."""

    ahead = 2

    def __init__(self, rigs: Sequence[RigStages], tracker: Tracker) -> None:
        """Join the maps of the rigs. Raises ValueError: the floor covered together is larger than a grid may be."""
        first = replace(rigs[0].rig, grid=joint_grid([rig.maps.grid for rig in rigs]))
        self._rigs, self.tracker = tuple(rigs), tracker
        self.rigs: Mapping[str, FloorRig] = {rig.name: rig.rig for rig in rigs} | {rigs[0].name: first}
        self.camera, self.size = first.camera, first.geometry.size
        self.checks = [
            replace(check, name=f"{rig.name}: {check.name}") if rig.name else check
            for rig in rigs for check in rig.rig.checks
        ]  # fmt: skip

    def track(self, frame: Frame, depths: RigDepths, clock: StageClock) -> tuple[Observation, tuple[TrackState, ...]]:
        """What the rigs show, the people who explain it, and where these are for the next frame's foreground."""
        now_s = frame.timestamp_s
        views = tuple(rig.look(depth, now_s, clock) for rig, depth in zip(self._rigs, depths, strict=True))
        first = self._rigs[0]
        maps = partial(plan_view, [view.points for view in views], self.rigs[first.name].grid, first.maps.params)
        observation = Observation(frame.index, now_s, views, self.camera, maps)
        people = followed(self.tracker, observation)
        for rig, view in zip(self._rigs, views, strict=True):
            rig.feedback.update(people, view, self.tracker.decisions)
        return observation, people

    def match(self, frame: Frame, clock: StageClock) -> RigDepths:
        """Depth of every rig; runs ahead, since it depends on no other frame."""
        frames = frame.frames if isinstance(frame, MultiRigFrame) else (frame,)
        depths = tuple(None if f is None else r.match(f, clock) for r, f in zip(self._rigs, frames, strict=True))
        clock.record("match")
        return depths

    def memory(self) -> dict[str, Carried]:
        """What every rig remembers."""
        return {f"{name}{n}": part for n, rig in enumerate(self._rigs) for name, part in rig.memory().items()}


class Feedback(Carried):
    """Feedback of the tracker to the foreground model (Harville 2002, ECCV: A Framework for High-Level Feedback).

    Remembers which tracks have walked, and paints the mask for the next frame.

    Attributes:
        mask: (H, W) uint8, as the last call returned it; None at first.
    """

    CARRIED = "mask", "_starts"

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self.mask: U8 | None = None
        # Where each track began, None once it has walked.
        self._starts: dict[int, tuple[float, float] | None] = {}

    def update(self, tracks: Sequence[TrackState], view: View, decisions: Sequence[Decision] = ()) -> U8 | None:
        """The mask for the next frame, (H, W) uint8 of NO_FEEDBACK, PERSON and BACKGROUND: the last one where a view
        shows nothing, None when feedback is off. ``decisions`` of this frame may give people their ids."""
        p, points, shape = self.params, view.points, view.kind.shape
        if not (p.enabled and view.shows):
            return self.mask
        self._remember(tracks, decisions)
        x, y, z = np.ascontiguousarray(points.xyz.T)
        near_any, near_walker = np.zeros(len(z), np.bool_), np.zeros(len(z), np.bool_)
        for track in tracks:
            off_x, off_y = x - np.float32(track.x_m), y - np.float32(track.y_m)
            near = off_x * off_x + off_y * off_y < OWN_M**2
            near_any |= near
            if track.state == "confirmed" and self._starts[track.track_id] is None:
                near_walker |= near
        self.mask = mask = np.zeros(shape, np.uint8)
        mask.reshape(-1)[points.pixels[(z < GROUND_M) & ~near_any]] = BACKGROUND
        persons = np.zeros(shape, np.uint8)
        persons.reshape(-1)[points.pixels[near_walker]] = 1
        left, top, width, height = cv2.boundingRect(persons)
        if width:
            reach, side = p.spread_px, 2 * p.spread_px + 1
            rows, columns = (slice(max(0, low - reach), low + n + reach) for low, n in ((top, height), (left, width)))
            spread = cv2.dilate(persons[rows, columns], np.ones((side, side), dtype=np.uint8))
            # A person's pixel is no ground.
            mask[rows, columns][spread > 0] = PERSON
        return mask

    def _remember(self, tracks: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        for known in decisions:
            if known.was in self._starts:
                start = self._starts[known.was]
                self._starts[known.track_id] = start and self._starts.get(known.track_id, start)
        self._starts = {t.track_id: self._starts.get(t.track_id, (t.x_m, t.y_m)) for t in tracks}
        for track in tracks:
            start = self._starts[track.track_id]
            if start is not None and math.dist(start, (track.x_m, track.y_m)) >= TRAVELLED_M:
                self._starts[track.track_id] = None


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
        stages = StereoStages(rigs, tracker or JointTracker(config.joint))
    except ValueError as error:
        raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
    return Engine(recording, config, stages)
