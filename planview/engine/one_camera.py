"""One camera without depth to people: separate foreground and motion, track."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.images import as_grey
from calib.types import U8
from planview.checks.camera import Steadiness, Steady
from planview.checks.check import Check
from planview.engine.config import Config, SingleCameraParams
from planview.engine.engine import Engine, Frame, Remembers, RigDepths, StageClock, refuse_frame
from planview.foreground.ghosts import (
    SEARCH_INTERVAL_S,
    START_S,
    STILL_S,
    find_blobs,
    find_ghosts,
    find_still,
    find_uncovered,
    moved_lately,
)
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.maps.grid import FloorRig
from planview.maps.view import View
from planview.tracking.base import Decision, ImageTracker, Observation
from planview.trajectories.state import TrackState
from stereo.recording import Video, VideoFrame

OVERVIEW_HZ = 10.0
"""Frames per second of a recording that are looked at before it is tracked: walkers then overlap themselves from frame
to frame, and a minute of video takes two or three seconds, a third to two thirds of tracking it. Our choice."""


MOTION_LEVEL = 10.0
"""Change of luma, averaged over 3x3 pixels, between two frames that is motion (levels of 255). Our choice: 8-bit
video has a noise of 3 to 4 levels, 1.3 in the average and 1.9 between two frames; five times that."""
MOTION_INTERVAL_S = 0.12
"""Time between the two frames compared [s]; at least one frame. Our choice: a hand at 0.2 m/s moves 2.4 cm in it,
about a pixel, whatever the frame rate."""


class ImageStages(Carried):
    """Separates the foreground and the motion of one camera: ``Stages``."""

    CARRIED = "_past", "_ghosts", "_moved_s", "_searched_s", "_first_s", "_steadiness"
    ahead = 0
    rigs: Mapping[str, FloorRig] = {}

    def __init__(
        self,
        params: SingleCameraParams,
        size: tuple[int, int],
        tracker: ImageTracker | None = None,
        camera: GroundCamera | None = None,
    ) -> None:
        """Start without a background.

        Args:
            size: (width, height) of all frames [px].
            tracker: labels pixels for the foreground, and limits the columns of foreground and motion: wider frames
                are reduced by a whole factor, since averaged pixels are less noisy.
            camera: above the floor; None where it is not calibrated.
        """
        columns: object = tracker.foreground_columns if tracker is not None else None
        if columns is not None and not (isinstance(columns, int) and columns > 0):
            raise InputError(f"expected foreground_columns above 0 or None, found {columns!r}", argument="tracker")
        self.size, self.camera, self._tracker = size, camera, tracker
        factor = -(-size[0] // columns) if columns else 1
        self._reduced = max(1, size[0] // factor), max(1, size[1] // factor)
        shape = self._reduced[::-1]
        self._foreground = Foreground(params.foreground, shape)
        self._past: deque[tuple[float, U8]] = deque()
        self._ghosts: U8 = np.zeros(shape, np.uint8)
        self._moved_s = np.zeros(shape, np.float32)
        self._searched_s, self._first_s = -math.inf, math.nan
        self._steadiness = Steadiness()

    def reset(self) -> None:
        """Forget all frames."""
        self._forget_background()
        self._steadiness = Steadiness()

    def _forget_background(self) -> None:
        self._foreground.reset()
        self._past.clear()
        self._ghosts[:] = 0
        self._moved_s[:] = 0.0
        self._searched_s, self._first_s = -math.inf, math.nan

    @property
    def checks(self) -> list[Check]:
        """Whether the camera stands still and shows one scene, from the frames so far."""
        return self._steadiness.checks()

    def match(self, frame: Frame, clock: StageClock) -> RigDepths:
        """Nothing: one camera has no depth."""
        if not isinstance(frame, VideoFrame):
            refuse_frame("an image of one camera", frame)
        return ()

    def look(self, frame: VideoFrame, depths: RigDepths, clock: StageClock) -> tuple[View, ...]:
        """See ``Stages``."""
        view = self.view(frame, self._tracker.feedback() if self._tracker is not None else None)
        clock.record("foreground")
        return (view,)

    def learn(self, views: Sequence[View], people: Sequence[TrackState], decisions: Sequence[Decision]) -> None:
        """Nothing: the tracker is asked for its feedback."""

    def memory(self) -> dict[str, Remembers]:
        """What the foreground learned, and the rest."""
        return {"foreground": self._foreground, "one camera": self}

    def view(self, frame: VideoFrame, feedback: U8 | None = None) -> View:
        """Foreground and motion of one frame; unknown where it shows nothing, as while the camera moves.

        Args:
            frame: the next frame.
            feedback: (H, W) uint8, a tracker's labels of the frame's pixels (see ``Foreground``), or None.
        Raises:
            InputError: a frame of another size.
        """
        height, width = frame.image.shape[:2]
        if (width, height) != self.size:
            raise InputError(f"frame {frame.index}: expected {self.size[0]}x{self.size[1]} px, found {width}x{height}")
        image = self._resized(frame.image, cv2.INTER_AREA)
        grey = as_grey(image)
        steady = self._steadiness.update(frame.index, frame.timestamp_s, grey)
        if steady is Steady.CUT:
            # The background begins again with this frame; a tracker's feedback is about the view before.
            self._forget_background()
            feedback = None
        if steady is not Steady.BREAK:
            known, still = self._known(feedback), steady is not Steady.MOVING
            mask = self._foreground.update(image, None, frame.timestamp_s, known, still)
        if steady is Steady.BREAK or not self._foreground.shows:
            return View.unknown((image.shape[0], image.shape[1]), frame.image)
        motion = self._motion(frame.timestamp_s, grey)
        if math.isnan(self._first_s):
            self._first_s = frame.timestamp_s
        self._search_ghosts(frame.timestamp_s, grey, mask, motion, feedback)
        if cv2.countNonZero(self._ghosts):
            mask &= ~self._ghosts
        return View.of_mask(mask, motion, frame.image, self._foreground.shadow)

    def _search_ghosts(self, now_s: float, grey: U8, mask: U8, motion: U8, feedback: U8 | None) -> None:
        """Where people of the first frames have left: from time to time, and in every frame while they set out."""
        starting = now_s - self._first_s <= START_S
        if not starting and now_s - self._searched_s < SEARCH_INTERVAL_S - 5e-4:
            return
        self._searched_s = now_s
        background = self._foreground.background_luma()
        blobs = find_blobs(mask)
        self._ghosts = find_ghosts(grey, background, blobs, motion)
        if starting:
            self._ghosts |= find_uncovered(grey, background, mask)
            moved = moved_lately(motion, now_s - self._first_s, STILL_S, self._moved_s)
            self._ghosts |= find_still(blobs, moved)
        if feedback is not None:
            np.copyto(self._ghosts, np.uint8(0), where=self._resized(feedback, cv2.INTER_NEAREST) == WALKER)

    def _resized(self, image: U8, interpolation: int) -> U8:
        if self._reduced == self.size:
            return image
        return np.asarray(cv2.resize(image, self._reduced, interpolation=interpolation), dtype=np.uint8)

    def _known(self, feedback: U8 | None) -> U8 | None:
        """What the tracker and the search for ghosts know of the reduced frame's pixels.

        Ghosts are background even where a person is tracked, unless that person has been seen to walk.
        """
        haunted = cv2.countNonZero(self._ghosts) > 0
        if feedback is None and not haunted:
            return None
        known = np.zeros(self._ghosts.shape, np.uint8)
        if feedback is not None:
            labels = self._resized(feedback, cv2.INTER_NEAREST)
            if np.shape(labels) != known.shape:
                expected = f"expected feedback of {known.shape} labels"
                raise InputError(f"{expected}, found {np.shape(labels)}", argument="tracker")
            known[:] = labels
        if haunted:
            known[(self._ghosts > 0) & (known != WALKER)] = BACKGROUND
        np.copyto(known, np.uint8(PERSON), where=known == WALKER)
        return known

    def _motion(self, now_s: float, grey: U8) -> U8:
        """(H, W) uint8, 255 where the smoothed luma differs from that of MOTION_INTERVAL_S ago."""
        smooth = np.asarray(cv2.blur(grey, (3, 3)), dtype=np.uint8)
        # Half a millisecond of slack: time stamps are rounded.
        while len(self._past) > 1 and self._past[1][0] <= now_s - MOTION_INTERVAL_S + 5e-4:
            self._past.popleft()
        before = self._past[0][1] if self._past else smooth
        self._past.append((now_s, smooth))
        _, motion = cv2.threshold(cv2.absdiff(smooth, before), MOTION_LEVEL, 255, cv2.THRESH_BINARY)
        return np.asarray(motion, dtype=np.uint8)


@runtime_checkable
class LearnsFirst(Protocol):
    """A tracker that learns from a recording before its first frame is tracked."""

    def study(self, observations: Iterable[Observation]) -> None:
        """Take as many observations as are of use, in order; what is learned survives ``reset``."""


def one_camera_engine(
    recording: Video,
    tracker: ImageTracker,
    config: Config | None = None,
    camera: GroundCamera | None = None,
    overview: bool = False,
) -> Engine:
    """An engine for a video.

    Args:
        camera: calibration above the floor, None where the tracker needs none.
        overview: a tracker that can learn from the beginning of the recording sees it first; otherwise it learns
            everything while it tracks, as from a camera that runs.
    """
    config = config or Config()
    stages = ImageStages(config.single_camera, recording.size, tracker, camera)
    if overview and isinstance(tracker, LearnsFirst):
        step = max(1, round(recording.fps / OVERVIEW_HZ))
        tracker.study(
            Observation(frame.index, frame.timestamp_s, (stages.view(frame),))
            for frame in recording if frame.index % step == 0
        )  # fmt: skip
        stages.reset()
    return Engine(recording, tracker, config, stages)
