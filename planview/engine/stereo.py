"""Stereo rigs to people: rectify, match, segment, build maps, track, feed back (Harville 2002)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from calib.errors import InputError
from calib.pose import SE3
from calib.types import U8
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.checks.timing import STEP_PX, sampled_thumbnails, thumbnails
from planview.engine.config import Config, FeedbackParams
from planview.engine.engine import Engine, FrameResult, RigFrame, StageClock
from planview.engine.setup import Setup, set_up
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON
from planview.maps.builder import FloorPoints, MapBuilder, Raster
from planview.maps.multi_rig import joint_grid, joint_maps
from planview.maps.pixels import KeptBackground, PixelRays, SeenPixels, seen_pixels, unmatched_pixels
from planview.maps.view import StereoView
from planview.tracking.base import Observation, Tracker
from planview.tracking.joint import JointTracker
from planview.trajectories.state import TrackState
from stereo.depth import RectifiedGeometry
from stereo.matcher import Matcher, SampledDisparity
from stereo.readers.multi_rig import MultiRigFrame, MultiRigRecording
from stereo.recording import RgbdFrame, RgbdRecording, StereoFrame, StereoRecording
from stereo.rectify import RectifiedPair


class StereoFrontEnd:
    """People from one rig (a pair, or images with depth) or from several above one floor: a ``FrontEnd``.

    Attributes:
        rigs: one for a pair.
        ahead, camera, size, views: see ``FrontEnd``.
    """

    ahead = 2

    def __init__(self, rigs: Sequence[RigStages], config: Config) -> None:
        """Join the maps of the rigs.

        Raises:
            ValueError: the floor covered together is larger than a grid may be.
        """
        self.rigs = tuple(rigs)
        self._raster = Raster(joint_grid([rig.maps.grid for rig in rigs]), config.maps)
        first = replace(self.rigs[0].view, grid=self._raster.grid)
        self.views: Mapping[str, StereoView] = {rig.name: rig.view for rig in self.rigs} | {rigs[0].name: first}
        self.camera, self.size = first.camera, first.geometry.size

    def prepare(self, frame: StereoFrame | RgbdFrame | MultiRigFrame, clock: StageClock) -> tuple[RigFrame | None, ...]:
        """See ``FrontEnd``; None for a rig without a frame at that time.

        Raises:
            ValueError: images of another size than the calibration's.
        """
        recorded = frame.frames if isinstance(frame, MultiRigFrame) else (frame,)
        return tuple(
            None if one is None else rig.rectify(one, clock) for rig, one in zip(self.rigs, recorded, strict=True)
        )

    def track(
        self,
        frame: StereoFrame | RgbdFrame | MultiRigFrame,
        prepared: tuple[RigFrame | None, ...],
        tracker: Tracker,
        clock: StageClock,
    ) -> FrameResult:
        """See ``FrontEnd``."""
        now_s, first = frame.timestamp_s, prepared[0]
        seeing = [(rig, seen) for rig, seen in zip(self.rigs, prepared, strict=True) if seen is not None]
        for rig, seen in seeing:
            rig.match(seen, now_s, clock)
            rig.segment(seen, now_s, clock)
            rig.back_project(seen)
        views = tuple(rig.classify_pixels(seen, now_s) for rig, seen in seeing)
        build_maps = partial(joint_maps, [seen.points for _, seen in seeing], self._raster)
        clock.record("maps")
        image, mask = (first.analysed, first.foreground) if first else (None, None)
        observation = Observation(frame.index, now_s, image, mask, views=views, build_maps=build_maps)
        people = tracker.update(observation)
        for rig, seen in seeing:
            rig.feed_back(seen, people)
        tracks = first.tracks if first else self.rigs[0].boxes(people)
        clock.record("track")
        return FrameResult(frame.index, now_s, tracks, tracker.decisions, observation, clock.stages_ms, prepared)

    @property
    def checks(self) -> tuple[Check, ...]:
        """See ``FrontEnd``; those of several rigs under their names."""
        every = [(rig.name, check) for rig in self.rigs for check in rig.setup.checks]
        return tuple(replace(check, name=f"{name}: {check.name}") if name else check for name, check in every)

    def reset(self) -> None:
        """See ``FrontEnd``."""
        for rig in self.rigs:
            rig.reset()

    def memory(self) -> dict[str, object]:
        """See ``FrontEnd``."""
        return {f"{name}{n}": part for n, rig in enumerate(self.rigs) for name, part in rig.memory().items()}


class RigStages:
    """The stages of one rig, each adding to its frame.

    Attributes:
        name: among several rigs.
        setup: rectification, floor and disparity range.
        whole: rectifies, and finds the disparity of all pixels.
        gated: matches in part; None where every pixel is matched, or nothing.
        foreground, maps, feedback: the stages after it.
        background, rays: what the camera sees behind people.
        boxes: of people in its image.
        view: the rig above its floor.
    """

    def __init__(self, setup: Setup, config: Config, matcher: Matcher | None = None, name: str = "") -> None:
        """Compose the stages.

        Args:
            matcher: of whole pairs; SGBM over the setup's disparities when None, gated as configured.
        Raises:
            InputError: a matcher for images with depth.
        """
        self.name, self.setup = name, setup
        self.whole = setup.whole(config, matcher)
        geometry, pose = self.whole.geometry, setup.floor.world_SE3_left
        self._step = step = -(-geometry.width // config.analysis.width_px)
        self.maps = MapBuilder(geometry, pose, config.maps, step)
        shape = self.maps.shape
        self.foreground = Foreground(
            config.foreground, shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )  # fmt: skip
        self.gated = setup.gated(config, shape, step) if matcher is None else None
        self.feedback = Feedback(config.feedback)
        self.background, self.rays = KeptBackground(), PixelRays.of(geometry, pose, shape, step)
        self.view = StereoView(
            geometry, setup.floor, setup.floor_source, setup.calibration, setup.vertical_residual_px,
            setup.disparities, self.maps.grid, step, setup.sensor, str(setup.correction or ""),
        )  # fmt: skip
        self.boxes = BodyBoxes(geometry, pose)

    def rectify(self, recorded: Any, clock: StageClock) -> RigFrame:
        """Rectify a frame of the recording, and match it where that depends on no other frame."""
        if self.gated is not None:
            pair = self.gated.rectify(recorded)
            frame = RigFrame(self.name, pair.reduced, pair.left, sampled_thumbnails(*pair.samples(STEP_PX)), pair)
            clock.record("rectify")
            return frame
        rectified: Any = self.whole(recorded)
        image, size = rectified.left, self.maps.shape[::-1]
        if self._step > 1:
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        clock.record("rectify")
        disparity = self.whole.disparity(rectified)
        clock.record("match")
        small = thumbnails(rectified.left_grey, rectified.right_grey) if isinstance(rectified, RectifiedPair) else None
        frame = RigFrame(self.name, image, lambda: rectified.left, small)
        frame.sampled = SampledDisparity(disparity)
        frame.now = np.ascontiguousarray(disparity[:: self._step, :: self._step])
        return frame

    def match(self, frame: RigFrame, timestamp_s: float, clock: StageClock) -> None:
        """Disparity where the background of the frames before cannot know it."""
        if self.gated is None or frame.pair is None:
            return
        frame.sampled, frame.now, frame.measured = self.gated(frame.pair, frame.analysed, self.foreground, timestamp_s)
        clock.record("match")

    def segment(self, frame: RigFrame, timestamp_s: float, clock: StageClock) -> None:
        """Foreground by colour and depth."""
        measured = frame.measured if self.foreground.settled else None
        frame.foreground = self.foreground.update(frame.analysed, frame.now, timestamp_s, self.feedback.mask, measured)
        clock.record("foreground")

    def back_project(self, frame: RigFrame) -> None:
        """Foreground points in the world."""
        frame.points = self.maps.points(frame.now, frame.foreground, frame.analysed, self.foreground.exposure)

    def classify_pixels(self, frame: RigFrame, timestamp_s: float) -> SeenPixels:
        """What the camera saw at every analysis pixel."""
        kept, renewed = self.background, None
        if self.foreground.settled and kept.due(timestamp_s):
            renewed = self.foreground.background_disparity()
            kept.renew(renewed, self.rays, timestamp_s)
        unmatched = unmatched_pixels(frame.foreground, frame.points)
        return seen_pixels(self.rays, frame.points, unmatched, kept.range_m, self.maps.params.height_min_m, renewed)

    def feed_back(self, frame: RigFrame, tracks: Sequence[TrackState]) -> None:
        """Tell the next frame's foreground and matching where people are."""
        frame.tracks = self.boxes(tracks)
        self.feedback(frame.points, frame.tracks, self.maps.shape)
        if self.gated is not None and frame.measured is not None:
            self.gated.learn(frame.analysed, frame.foreground, frame.measured, frame.tracks)

    def reset(self) -> None:
        """Forget all frames."""
        for part in self.memory().values():
            part.reset()

    def memory(self) -> dict[str, Any]:
        """What is carried from frame to frame."""
        parts = {"foreground": self.foreground, "feedback": self.feedback, "background": self.background}
        return parts if self.gated is None else parts | {"matching": self.gated.memory}


OWN_M = 0.6
"""Foreground this near to a person's axis on the floor belongs to the person [m]: an arm's length."""
TRAVELLED_M = 0.5
"""Only a track that has moved this far since its start is protected from being learned [m]: furniture that was
mistaken for a person does not walk, and must fade into the background."""
GROUND_M = 0.12
"""Foreground lower than this and away from every person is floor under a new light [m]: a shoe's height."""


class Feedback:
    """Feedback of the tracker to the foreground model (Harville 2002, ECCV: A Framework for High-Level Feedback).

    Remembers which tracks have walked, and paints the mask for the next frame.

    Attributes:
        mask: (H, W) uint8, as the last call returned it; None at first.
    """

    def __init__(self, params: FeedbackParams) -> None:
        self.params = params
        self.reset()

    def reset(self) -> None:
        """Forget all tracks."""
        self.mask: U8 | None = None
        self._origin: dict[int, tuple[float, float]] = {}
        self._walked: set[int] = set()

    def __call__(self, points: FloorPoints, tracks: Sequence[TrackState], shape: tuple[int, int]) -> U8 | None:
        """The mask for the next frame.

        Args:
            points: foreground points of this frame; their pixels index an image of ``shape``.
            tracks: people after this frame.
        Returns:
            (H, W) uint8 of NO_FEEDBACK, PERSON and BACKGROUND; None when feedback is off.
        """
        p = self.params
        if not p.enabled:
            return None
        self._remember(tracks)
        x, y, z = np.ascontiguousarray(points.xyz.T)
        near_any, near_walker = np.zeros(len(z), np.bool_), np.zeros(len(z), np.bool_)
        for track in tracks:
            off_x, off_y = x - np.float32(track.x_m), y - np.float32(track.y_m)
            near = off_x * off_x + off_y * off_y < OWN_M**2
            near_any |= near
            if track.state == "confirmed" and track.track_id in self._walked:
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

    def _remember(self, tracks: Sequence[TrackState]) -> None:
        alive = {track.track_id for track in tracks}
        self._walked &= alive
        self._origin = {i: xy for i, xy in self._origin.items() if i in alive}
        for track in tracks:
            x, y = self._origin.setdefault(track.track_id, (track.x_m, track.y_m))
            if (track.x_m - x) ** 2 + (track.y_m - y) ** 2 >= TRAVELLED_M**2:
                self._walked.add(track.track_id)


BODY_RADIUS_M = 0.25
"""Half width of the upright prism around a standing person [m]: shoulders 0.45 m wide, and a swinging arm."""


class BodyBoxes:
    """Boxes around upright prisms of a person's width and height, clipped to the rectified left image."""

    def __init__(self, geometry: RectifiedGeometry, world_SE3_left: SE3) -> None:
        self._projection = geometry.matrix @ world_SE3_left.inverse().matrix[:3]
        self._size = geometry.size

    def __call__(self, tracks: Sequence[TrackState]) -> tuple[TrackState, ...]:
        """The tracks with ``box_px`` in pixels of the rectified left image; unchanged where they are not in view."""
        at, r = np.array([(t.x_m, t.y_m, t.height_m) for t in tracks]).reshape(-1, 1, 3), BODY_RADIUS_M
        corners = np.array([(x, y, z) for x in (-r, r) for y in (-r, r) for z in (0.0, 1.0)])
        xyz = np.concatenate([at[..., :2] + corners[:, :2], at[..., 2:] * corners[:, 2:]], axis=-1)
        u, v, depth = np.moveaxis(xyz @ self._projection[:, :3].T + self._projection[:, 3], -1, 0)
        # Corners of a body nearer to the camera's plane than this are left out [m].
        front, (width, height) = depth > 0.1, self._size
        with np.errstate(divide="ignore", invalid="ignore"):
            (left, top), (right, bottom) = (
                [least(np.where(front, part / depth, sign * np.inf), axis=1) for part in (u, v)]
                for least, sign in ((np.min, 1), (np.max, -1))
            )
        left, top = np.maximum(left, -0.5), np.maximum(top, -0.5)
        sides = np.minimum(right, width - 0.5) - left, np.minimum(bottom, height - 0.5) - top
        return tuple(
            replace(track, box_px=(x, y, w, h)) if w > 0 and h > 0 else track
            for track, x, y, w, h in zip(tracks, *(part.tolist() for part in (left, top, *sides)), strict=True)
        )


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
    rig = _stages(recording, setup or set_up(recording, config), config, matcher)
    return Engine(recording, StereoFrontEnd([rig], config), tracker or JointTracker(config.joint), config)


def multi_rig_engine(recording: MultiRigRecording, config: Config, tracker: Tracker) -> Engine:
    """An engine for the recordings of several rigs in one world.

    Raises:
        InputError: the rigs are far apart.
        WorkError: a rig has no usable frame or hardly any disparity.
    """
    rigs = [
        _stages(rig.recording, replace(set_up(rig.recording, config), floor_source=RIGS_FILE), config, name=rig.name)
        for rig in recording.rigs
    ]
    try:
        front_end = StereoFrontEnd(rigs, config)
    except ValueError as error:
        raise InputError(f"{recording.path}: expected heads of one place, found them far apart: {error}") from error
    return Engine(recording, front_end, tracker, config)


def _stages(
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
