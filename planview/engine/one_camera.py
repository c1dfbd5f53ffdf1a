"""One camera without depth to people: separate foreground and motion, track."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

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
from planview.engine.engine import Engine, Frame, RigDepths, StageClock, refuse_frame
from planview.foreground.ghosts import Ghosts
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.maps.grid import FloorRig
from planview.maps.view import View
from planview.tracking.base import ImageTracker, Observation, followed
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


class ImageForeground(Carried):
    """Separates the foreground and the motion of one camera."""

    CARRIED = "_past", "_steadiness"

    def __init__(self, params: SingleCameraParams, size: tuple[int, int], columns: int | None = None) -> None:
        """Start without a background.

        Args:
            size: (width, height) of all frames [px].
            columns: of foreground and motion that are enough; wider frames are reduced by a whole factor, since
                averaged pixels are less noisy.
        """
        factor = -(-size[0] // columns) if columns else 1
        self._size, self._reduced = size, (max(1, size[0] // factor), max(1, size[1] // factor))
        self._foreground = Foreground(params.foreground, self._reduced[::-1])
        self._ghosts = Ghosts(self._reduced[::-1])
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._forget_background()
        self._steadiness = Steadiness()

    def _forget_background(self) -> None:
        self._foreground.reset()
        self._ghosts.reset()
        self._past: deque[tuple[float, U8]] = deque()

    def checks(self) -> list[Check]:
        """Whether the camera stands still and shows one scene, from the frames so far."""
        return self._steadiness.checks()

    def memory(self) -> dict[str, Carried]:
        """What the foreground learned, and the rest."""
        return {"foreground": self._foreground, "ghosts": self._ghosts, "one camera": self}

    def view(self, frame: VideoFrame, feedback: U8 | None = None) -> View:
        """Foreground and motion of one frame; unknown where it shows nothing, as while the camera moves.

        Args:
            frame: the next frame.
            feedback: (H, W) uint8, a tracker's labels of the frame's pixels (see ``Foreground``), or None.
        Raises:
            InputError: a frame of another size.
        """
        (height, width), expected = frame.image.shape[:2], self._size
        if (width, height) != expected:
            raise InputError(f"frame {frame.index}: expected {expected[0]}x{expected[1]} px, found {width}x{height}")
        image = self._resized(frame.image, cv2.INTER_AREA)
        grey = as_grey(image)
        steady = self._steadiness.update(frame.index, frame.timestamp_s, grey)
        if steady is Steady.CUT:
            # The background begins again with this frame; a tracker's feedback is about the view before.
            self._forget_background()
            feedback = None
        labels = None if feedback is None else self._labels(feedback)
        if steady is not Steady.BREAK:
            known, still = self._known(labels), steady is not Steady.MOVING
            mask = self._foreground.update(image, None, frame.timestamp_s, known, still)
        if steady is Steady.BREAK or not self._foreground.shows:
            return View.unknown((image.shape[0], image.shape[1]), frame.image)
        motion = self._motion(frame.timestamp_s, grey)
        walkers = None if labels is None else labels == WALKER
        self._ghosts.update(frame.timestamp_s, grey, self._foreground.background_luma, mask, motion, walkers)
        mask &= ~self._ghosts.mask
        return View.of_mask(mask, motion, frame.image, self._foreground.shadow)

    def _resized(self, image: U8, interpolation: int) -> U8:
        if self._reduced == self._size:
            return image
        return np.asarray(cv2.resize(image, self._reduced, interpolation=interpolation), dtype=np.uint8)

    def _labels(self, feedback: U8) -> U8:
        labels, shape = self._resized(feedback, cv2.INTER_NEAREST), self._reduced[::-1]
        if np.shape(labels) != shape:
            raise InputError(f"expected feedback of {shape} labels, found {np.shape(labels)}", argument="tracker")
        return np.asarray(labels, np.uint8)

    def _known(self, labels: U8 | None) -> U8 | None:
        """What the tracker and the search for ghosts know of the reduced frame's pixels.

        Ghosts are background even where a person is tracked, unless that person has been seen to walk.
        """
        ghosts = self._ghosts.mask > 0
        if labels is None and not ghosts.any():
            return None
        known = np.zeros(ghosts.shape, np.uint8) if labels is None else labels.copy()
        known[ghosts & (known != WALKER)] = BACKGROUND
        known[known == WALKER] = PERSON
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


class ImageStages:
    """Frames of one camera to people: ``Stages``."""

    ahead = 0
    rigs: Mapping[str, FloorRig] = {}

    def __init__(
        self, params: SingleCameraParams, size: tuple[int, int], tracker: ImageTracker, camera: GroundCamera | None
    ) -> None:
        columns: object = tracker.foreground_columns
        if columns is not None and not (isinstance(columns, int) and columns > 0):
            raise InputError(f"expected foreground_columns above 0 or None, found {columns!r}", argument="tracker")
        self.size, self.camera, self.tracker = size, camera, tracker
        self.foreground = ImageForeground(params, size, columns)

    @property
    def checks(self) -> list[Check]:
        """Whether the camera stands still and shows one scene, from the frames so far."""
        return self.foreground.checks()

    def match(self, frame: Frame, clock: StageClock) -> RigDepths:
        """Nothing: one camera has no depth."""
        if not isinstance(frame, VideoFrame):
            refuse_frame("an image of one camera", frame)
        return ()

    def track(
        self, frame: VideoFrame, depths: RigDepths, clock: StageClock
    ) -> tuple[Observation, tuple[TrackState, ...]]:
        """See ``Stages``."""
        view = self.foreground.view(frame, self.tracker.feedback())
        clock.record("foreground")
        observation = Observation(frame.index, frame.timestamp_s, (view,))
        return observation, followed(self.tracker, observation)

    def memory(self) -> dict[str, Carried]:
        """What the foreground learned."""
        return self.foreground.memory()


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
        overview: a tracker with ``study(observations)`` sees the beginning of the recording first, and what it learns
            survives ``reset``; otherwise it learns everything while it tracks, as from a camera that runs.
    """
    config = config or Config()
    stages = ImageStages(config.single_camera, recording.size, tracker, camera)
    study = getattr(tracker, "study", None)
    if overview and study is not None:
        step = max(1, round(recording.fps / OVERVIEW_HZ))
        study(
            Observation(frame.index, frame.timestamp_s, (stages.foreground.view(frame),))
            for frame in recording if frame.index % step == 0
        )  # fmt: skip
        stages.foreground.reset()
    return Engine(recording, config, stages)
