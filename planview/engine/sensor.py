"""Sensors: what recorded a recording, made ready to measure depth, to separate the foreground and to say what shows.

A sensor is a stereo pair, a depth sensor, a camera without depth, or one whose views were recorded before. The engine
(``planview.engine.engine``) does not depend on these kinds: it calls the same four methods of every sensor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Protocol, TypeVar, runtime_checkable

import cv2
import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from calib.floor_camera import FloorCamera
from calib.ground_camera import GroundCamera
from calib.images import as_grey
from calib.types import U8, AnyArray
from planview.checks.check import Check
from planview.checks.images import standing_checks
from planview.engine.config import Config, SingleCameraParams
from planview.engine.feedback import Feedback
from planview.engine.setup import Setup
from planview.foreground.ghosts import Ghosts
from planview.foreground.mixture import Foreground
from planview.foreground.params import BACKGROUND, PERSON, WALKER
from planview.maps.grid import FloorRig
from planview.maps.recording import RecordedPoints
from planview.maps.view import View, ViewBuilder
from planview.tracking.base import Decision, ImageTracker
from planview.trajectories.state import TrackState
from stereo.depth import Depth, Matched
from stereo.recording import Frame, Shot, SingleCamera, refuse_foreign_shot
from stereo.viewpoint import Standing, Viewpoints

S = TypeVar("S")
M = TypeVar("M")
MOTION_LEVEL = 10.0
"""Change of luma, averaged over 3x3 pixels, between two frames that is motion (levels of 255). Our choice: 8-bit
video has a noise of 3 to 4 levels, 1.3 in the average and 1.9 between two frames; five times that."""
MOTION_INTERVAL_S = 0.12
"""Time between the two frames compared [s]; at least one frame. Our choice: a hand at 0.2 m/s moves 2.4 cm in it,
about a pixel, whatever the frame rate."""


class StageClock(dict[str, float]):
    """Adds up a frame's stage times [ms]."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """A stage begins now."""
        self._since = perf_counter()

    def record(self, stage: str) -> None:
        """The stage ends now, and the next one begins."""
        since = self._since
        self.start()
        self[stage] = self.get(stage, 0.0) + 1e3 * (self._since - since)


class Sensor(Protocol[S, M]):
    """Protocol of a sensor, called for every frame in this order: ``measure``, ``look``, ``protect``; ``S`` is
    what it records at one moment, ``M`` what it measures of that.

    Attributes:
        name: among several sensors.
        camera: the (rectified left) camera above the floor; None for a camera that is not calibrated.
        size: (width, height) of its images [px].
        ahead: frames that may be measured ahead in a thread of their own; 0 for none.
        records: whether its views can be recorded as plan-view maps.
        checks: of the recording so far: before its first frame, and from the frames seen.
    """

    name: str
    size: tuple[int, int]
    ahead: int
    records: bool

    @property
    def camera(self) -> FloorCamera | None: ...

    @property
    def checks(self) -> Sequence[Check]: ...

    def measure(self, shot: S, clock: StageClock) -> M:
        """Measure the range of what a shot shows; a sensor without depth returns the shot. Depends on no
        tracking, since it runs ahead.

        Raises:
            InputError, ValueError: a shot of another kind of sensor, or images of another size.
        """

    def look(self, measured: M | None, frame: Frame[S], clock: StageClock) -> View:
        """View of a frame, by what was learned from the frames before.

        Args:
            measured: what ``measure`` gave; None where the sensor has no shot in this frame.
        """

    def protect(self, people: Sequence[TrackState], view: View, decisions: Sequence[Decision]) -> None:
        """Keep the people who were found in a view from becoming background (Harville 2002, ECCV); ``decisions`` of the
        frame may give them their ids."""

    def memory(self) -> Mapping[str, Carried]:
        """By name, the objects that hold what is carried from frame to frame."""


@runtime_checkable
class DepthSensor(Sensor[S, M], Protocol[S, M]):
    """Protocol of a sensor that measures depth.

    Attributes:
        rig: it above the floor, with the grid of its maps.
    """

    @property
    def rig(self) -> FloorRig: ...


class RigSensor(Carried):
    """A pair or a depth camera above its floor: a ``DepthSensor``.

    Attributes:
        standing, foreground, views, feedback: the stages after measuring.
    """

    ahead, records = 2, True
    _measured_last: Matched | None
    """Match of the last shot, ahead of tracking."""
    _tracked_last: Matched | None
    """Match of the frame tracked last: a resumed run continues from there."""

    def __init__(self, setup: Setup, config: Config, name: str = "") -> None:
        self.name, self.rig, self._measure = name, setup, setup.measure
        geometry, step = setup.geometry, setup.reduction
        self.camera, self.size = setup.camera, geometry.size
        self.views = ViewBuilder(geometry, setup.floor.world_SE3_left, config.maps, step)
        self.foreground = Foreground(
            config.foreground, self.views.shape, geometry.disparity_std_per_px2, step, geometry.disparity_metre
        )
        self.feedback, self.standing = Feedback(config.feedback), Standing(setup.viewpoints)
        self.reset()

    def reset(self) -> None:
        """Forget the last match."""
        self._measured_last = self._tracked_last = None

    def state(self) -> dict[str, Any]:
        """Match of the frame tracked last, for a checkpoint."""
        return {"matched": None if self._tracked_last is None else list(self._tracked_last)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Continue after the frame tracked last; what was measured ahead of it is forgotten."""
        self._measured_last = self._tracked_last = state["matched"] and Matched(*state["matched"])

    @property
    def checks(self) -> list[Check]:
        """Checks of the frames in which floor and rig were found, and whether the cameras stand as they did in
        these."""
        named = f"{self.name}: " if self.name else ""
        standing = standing_checks(self.standing, "calibration and floor are of the view before")
        return [replace(check, name=named + check.name) for check in (*self.rig.checks, *standing)]

    def measure(self, shot: Shot, clock: StageClock) -> Depth:
        """Rectify a shot, and match the images of a pair in which something has moved."""
        depth = self._measure(shot, clock.record, self._measured_last)
        self._measured_last = depth.matched
        return depth

    def look(self, measured: Depth | None, frame: Frame[Shot], clock: StageClock) -> View:
        """Separate the foreground by colour and depth (Harville 2002, section 2), and put its pixels into the world
        (section 3)."""
        if measured is None:
            return View.unknown(self.views.shape, rays=self.views.rays)
        self._tracked_last = measured.matched
        foreground, now_s = self.foreground, frame.timestamp_s
        if not self.standing.update(frame.index, now_s, measured.rectified):
            clock.record("foreground")
            return View.unknown(self.views.shape, measured.image, self.views.rays, measured)
        mask = foreground.update(measured.image, measured.disparity, now_s, self.feedback.mask)
        clock.record("foreground")
        if not foreground.shows:
            return View.unknown(self.views.shape, measured.image, self.views.rays, measured)
        due = foreground.is_settled and self.views.background_due(now_s)
        background = foreground.background_disparity() if due else None
        image = measured.image if foreground.sharp else as_grey(measured.image)  # colours that are mixed are none
        points = self.views.points(measured.disparity, mask, image, foreground.exposure)
        view = self.views.view(points, mask, now_s, background, measured)
        clock.record("maps")
        return view

    def protect(self, people: Sequence[TrackState], view: View, decisions: Sequence[Decision]) -> None:
        """Remember where people are for the next frame's foreground."""
        self.feedback.update(people, view, decisions)

    def memory(self) -> dict[str, Carried]:
        """Parts that are carried from frame to frame."""
        return {
            "match": self, "standing": self.standing, "foreground": self.foreground,
            "feedback": self.feedback, "views": self.views,
        }  # fmt: skip


class CameraSensor(Carried):
    """One camera without depth, a ``Sensor``: measures nothing, and separates the foreground and what moves (Zhang et
    al. 2008, section 2)."""

    CARRIED = "_past", "_labels"
    ahead, records, name = 0, False, ""

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
            tracker: gives feedback, and says how many columns are enough: wider frames are reduced by a whole factor,
                since averaged pixels are less noisy.
            camera: calibrated above the floor; None where that is not needed.
        Raises:
            InputError: a number of columns that is none.
        """
        columns: object = None if tracker is None else tracker.foreground_columns
        if columns is not None and not (isinstance(columns, int) and columns > 0):
            raise InputError(f"expected foreground_columns above 0 or None, found {columns!r}", argument="tracker")
        factor = -(-size[0] // columns) if columns else 1
        self.size, self.camera, self._tracker = size, camera, tracker
        self._reduced = max(1, size[0] // factor), max(1, size[1] // factor)
        focal_widths = SingleCamera.focal_widths if camera is None else camera.focal_px / camera.width
        self._standing = Standing(Viewpoints([], focal_widths))
        self._foreground = Foreground(params.foreground, self._reduced[::-1])
        self._ghosts = Ghosts(self._reduced[::-1])
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self._forget_background()
        self._labels: U8 | None = None

    def _forget_background(self) -> None:
        self._foreground.reset()
        self._ghosts.reset()
        self._past: deque[tuple[float, U8]] = deque()

    @property
    def checks(self) -> list[Check]:
        """Check that the camera stands still and shows one scene, from the frames so far."""
        return standing_checks(self._standing, "the background is learned again when it stands still")

    def memory(self) -> dict[str, Carried]:
        """Foreground and other parts that are carried from frame to frame."""
        return {
            "standing": self._standing, "foreground": self._foreground, "ghosts": self._ghosts, "one camera": self,
        }  # fmt: skip

    def measure(self, shot: Shot, clock: StageClock) -> U8:
        """The image: one camera has no depth."""
        refuse_foreign_shot(shot, SingleCamera.holds)
        (image,), expected = shot, self.size
        if image.shape[1::-1] != expected:
            height, width = image.shape[:2]
            raise InputError(f"frame: expected {expected[0]}x{expected[1]} px, found {width}x{height}")
        return image

    def look(self, measured: U8 | None, frame: Frame[Shot], clock: StageClock) -> View:
        """Foreground and motion of one frame; unknown where it shows nothing, as while the camera moves."""
        if measured is None:
            return View.unknown(self._reduced[::-1])
        image = self._resize(measured, cv2.INTER_AREA)
        grey = as_grey(image)
        now_s = frame.timestamp_s
        labels = self._labels
        stands = self._standing.update(frame.index, now_s, (grey,))
        if not stands and self._standing.is_settled:
            # The background begins again with this frame; what a tracker knew is about the view before.
            self._standing.accept()
            self._forget_background()
            stands = True
            labels = None
        mask = self._foreground.update(image, None, now_s, self._known(labels), stands)
        if not self._foreground.shows:
            view = View.unknown((image.shape[0], image.shape[1]), measured)
        else:
            motion = self._motion(now_s, grey)
            walkers = None if labels is None else labels == WALKER
            self._ghosts.update(now_s, grey, self._foreground.background_luma, mask, motion, walkers)
            mask &= ~self._ghosts.mask
            view = View.of_mask(mask, motion, measured, self._foreground.shadow)
        clock.record("foreground")
        return view

    def protect(self, people: Sequence[TrackState], view: View, decisions: Sequence[Decision]) -> None:
        """Keep the tracker's labels of the pixels for the next frame."""
        feedback = None if self._tracker is None else self._tracker.feedback()
        labels = None if feedback is None else self._resize(feedback, cv2.INTER_NEAREST)
        if labels is not None and np.shape(labels) != self._reduced[::-1]:
            expected = f"expected feedback of {self._reduced[::-1]} labels"
            raise InputError(f"{expected}, found {np.shape(labels)}", argument="tracker")
        self._labels = None if labels is None else np.asarray(labels, np.uint8)

    def _resize(self, image: AnyArray, interpolation: int) -> U8:
        if self._reduced == self.size:
            return image
        return np.asarray(cv2.resize(image, self._reduced, interpolation=interpolation), dtype=np.uint8)

    def _known(self, labels: U8 | None) -> U8 | None:
        """Labels of the reduced frame's pixels from the tracker and the search for ghosts.

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


class RecordedSensor:
    """A ``DepthSensor`` whose foreground points were recorded: it has measured and looked already.

    With the parameters of the recording the tracks are the same bit for bit. With others they are an approximation:
    the feedback that the recording's tracker gave to its foreground stays in the points.
    """

    ahead, records, name = 0, False, ""
    checks: tuple[Check, ...] = ()

    def __init__(self, rig: FloorRig, config: Config, source: str) -> None:
        """``source`` names the recording in messages. Raises ValueError: the floor is larger than a grid may be."""
        self.views = ViewBuilder(rig.geometry, rig.floor.world_SE3_left, config.maps, rig.reduction)
        self.rig = replace(rig, grid=self.views.grid)
        self.camera, self.size, self._source = rig.camera, rig.geometry.size, source

    def measure(self, shot: RecordedPoints, clock: StageClock) -> RecordedPoints:
        """Nothing: recorded points have been matched."""
        if not isinstance(shot, RecordedPoints):
            raise InputError("frame: expected the points of plan-view maps, found images")
        return shot

    def look(self, measured: RecordedPoints | None, frame: Frame[RecordedPoints], clock: StageClock) -> View:
        """The view that was recorded. Raises InputError: damaged maps."""
        views = self.views
        if measured is None or len(measured.unmatched) == math.prod(views.shape):
            return View.unknown(views.shape, rays=views.rays)
        disparity, mask = np.full(views.shape, np.nan, np.float32), np.zeros(views.shape, np.uint8)
        disparity.reshape(-1)[measured.pixels] = measured.disparities
        mask.reshape(-1)[measured.pixels] = mask.reshape(-1)[measured.unmatched] = 255
        points = views.points(disparity, mask)
        if len(points.pixels) != len(measured.pixels):
            raise InputError(
                f"{self._source}: frame {frame.index}: expected {len(measured.pixels)} points in reach of the rig, "
                f"found {len(points.pixels)}: the maps are damaged or another rig's"
            )
        view = views.view(replace(points, colours=measured.colours), mask, frame.timestamp_s, measured.background)
        clock.record("maps")
        return view

    def protect(self, people: Sequence[TrackState], view: View, decisions: Sequence[Decision]) -> None:
        """Nothing: the background is recorded as well."""

    def memory(self) -> dict[str, Carried]:
        """Range of the background."""
        return {"views": self.views}
