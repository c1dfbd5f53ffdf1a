"""The images of a run's recording, opened again, in the pixels of its boxes."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from pydantic import ValidationError

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.params import first_problem
from calib.pose import SE3
from calib.types import U8
from planview.drawing.image import ImageCamera
from planview.engine.config import Config
from planview.engine.info import FloorInfo
from planview.output.info import RunInfo
from planview.output.scene.source import source_of
from stereo.depth import RectifiedGeometry, StereoFloorCamera
from stereo.readers import OpenOptions, open_any, open_video
from stereo.readers.base import AnyRecording
from stereo.readers.multi_rig import HeadsRecording, open_heads
from stereo.readers.open import is_heads
from stereo.recording import RgbdRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier

HEADS_FRAMES_MAX = 5000
"""Recordings of several heads are read from their beginning; pictures are made of so many moments at most."""
_BATCH = 16


class SceneImage(NamedTuple):
    """A frame's image: (H, W[, 3]) uint8 BGR, in whose pixels the boxes of tracks.csv are."""

    frame: int
    image: U8


class SceneFrames(Protocol):
    """Images of a recording.

    Attributes:
        camera: of the images above the floor; None where it is not calibrated.
    """

    @property
    def camera(self) -> ImageCamera | None: ...

    def at(self, frames: Sequence[int]) -> Iterator[SceneImage]:
        """The images of ascending frames, as far as they can be read."""

    def through(self, first: int, last: int) -> Iterator[SceneImage]:
        """All images from one frame to another, both included."""


class RecordedFrames:
    """Images of a recording whose frames can be asked for."""

    def __init__(self, recording: Any, camera: ImageCamera | None, image_of: Callable[[Any], U8]) -> None:
        self.camera = camera
        self._recording, self._image_of = recording, image_of

    def at(self, frames: Sequence[int]) -> Iterator[SceneImage]:
        """See ``SceneFrames``."""
        for start in range(0, len(frames), _BATCH):
            for frame in self._recording.at(frames[start : start + _BATCH]):
                yield SceneImage(frame.index, self._image_of(frame))

    def through(self, first: int, last: int) -> Iterator[SceneImage]:
        """See ``SceneFrames``."""
        for frame in self._recording:
            if frame.index > last:
                return
            if frame.index >= first:
                yield SceneImage(frame.index, self._image_of(frame))


class FirstHeadFrames:
    """Images of the first of several heads."""

    def __init__(self, recording: HeadsRecording, camera: ImageCamera | None, image_of: Callable[[Any], U8]) -> None:
        self.camera = camera
        self._recording, self._image_of = recording, image_of

    def at(self, frames: Sequence[int]) -> Iterator[SceneImage]:
        """See ``SceneFrames``."""
        wanted = {frame for frame in frames if frame < HEADS_FRAMES_MAX}
        if wanted:
            yield from self._of(wanted, max(wanted))

    def through(self, first: int, last: int) -> Iterator[SceneImage]:
        """See ``SceneFrames``."""
        yield from self._of(range(first, last + 1), last)

    def _of(self, wanted: Container[int], last: int) -> Iterator[SceneImage]:
        for moment in self._recording:
            if moment.index > last:
                return
            if moment.index in wanted and moment.frames[0] is not None:
                yield SceneImage(moment.index, self._image_of(moment.frames[0]))


def open_frames(info: RunInfo) -> SceneFrames:
    """Open the recording of a run again.

    Raises:
        InputError: it is not there any more, comes from a camera that runs, or another version made the run.
    """
    path = source_of(info)
    if not info.input or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    config = _config_of(info)
    if is_heads(path):
        heads = open_heads(path)
        return FirstHeadFrames(heads, *_of_recording(heads.heads[0].recording, info.floor, config))
    if info.rig is None or (info.rig.baseline_m is None and info.rig.depth_sensor is None):
        return RecordedFrames(open_video(path), ground_camera_of(info), lambda frame: frame.image)
    recording = _opened(path, info.rig.calibration)
    return RecordedFrames(recording, *_of_recording(recording, info.floor, config))


def _config_of(info: RunInfo) -> Config:
    try:
        return Config.model_validate(info.config)
    except ValidationError as error:
        raise InputError(f"run.json: expected parameters of this version: {first_problem(error)}") from error


def _opened(path: Path, calibration: str | None) -> AnyRecording:
    """With the calibration that lies in the recording, else the one that the run was given."""
    try:
        return open_any(path)
    except InputError:
        if calibration is None or not Path(calibration).exists():
            raise
        return open_any(path, OpenOptions(Path(calibration)))


def _of_recording(
    recording: AnyRecording, floor: FloorInfo | None, config: Config
) -> tuple[ImageCamera | None, Callable[[Any], U8]]:
    """The camera above the floor, and what makes the image of a frame."""
    if isinstance(recording, RgbdRecording):
        rgbd = RgbdRectifier(recording.camera, recording.sensor, config.rectify)
        return _above(rgbd.geometry, floor), lambda frame: rgbd(frame).left
    pair = Rectifier(recording.rig, config.rectify)
    return _above(pair.geometry, floor), lambda frame: pair(frame.left, frame.right).left


def _above(geometry: RectifiedGeometry, floor: FloorInfo | None) -> ImageCamera | None:
    if floor is None or floor.world_SE3_left is None:
        return None
    pose = np.array(floor.world_SE3_left, dtype=np.float64)
    return StereoFloorCamera(geometry, SE3(pose[:3, :3], pose[:3, 3]))


def ground_camera_of(info: RunInfo) -> GroundCamera | None:
    """The camera of a run with one camera; None for one that is not calibrated.

    Raises:
        InputError: values out of their range.
    """
    rig, floor = info.rig, info.floor
    if rig is None or floor is None or rig.focal_px is None:
        return None
    tilt, roll = math.radians(floor.tilt_deg), math.radians(floor.roll_deg)
    try:
        return GroundCamera(rig.width, rig.height, rig.focal_px, floor.height_m, tilt, rig.lens or "pinhole", roll)
    except ValueError as error:
        raise InputError(f"run.json: expected a camera above the floor: {error}") from error
