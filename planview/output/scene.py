"""The recording of a run, opened again: its images in the pixels of its boxes, and its static scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.errors import InputError, WorkError
from calib.pose import SE3
from calib.types import U8
from planview.drawing.image import ImageCamera
from planview.engine.config import Config, config_of
from planview.engine.info import FloorInfo
from planview.engine.setup import scene_cloud, set_up
from planview.output.run_folder import RunFolder
from stereo.depth import StereoFloorCamera
from stereo.readers import OpenOptions, holds_pair, open_any, open_video
from stereo.readers.base import AnyRecording
from stereo.readers.multi_rig import MultiRigRecording, open_rigs
from stereo.readers.open import is_multi_rig
from stereo.recording import RgbdRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier

if TYPE_CHECKING:
    from open3d.geometry import PointCloud

_BATCH = 16


class SceneImage(NamedTuple):
    """A frame's image: (H, W[, 3]) uint8 BGR, in whose pixels the boxes of tracks.csv are."""

    frame: int
    image: U8


class SceneFrames:
    """Images of a recording, of several rigs those of the first; ``camera`` is None where it is not calibrated."""

    def __init__(self, recording: Any, camera: ImageCamera | None, image_of: Callable[[Any], U8]) -> None:
        self.camera = camera
        self._recording, self._image_of = recording, image_of

    def at(self, frames: Sequence[int]) -> Iterator[SceneImage]:
        """The images of ascending frames, as far as they can be read."""
        if isinstance(self._recording, MultiRigRecording):
            # Recordings of several rigs are read from their beginning; pictures show no later ones.
            wanted = {frame for frame in frames if frame < 5000}
            yield from (image for image in self.through(0, max(wanted, default=-1)) if image.frame in wanted)
            return
        for start in range(0, len(frames), _BATCH):
            for frame in self._recording.at(frames[start : start + _BATCH]):
                yield SceneImage(frame.index, self._image_of(frame))

    def through(self, first: int, last: int) -> Iterator[SceneImage]:
        """All images from one frame to another, both included."""
        for moment in self._recording if last >= 0 else ():
            frame = moment.frames[0] if isinstance(self._recording, MultiRigRecording) else moment
            if moment.index > last:
                return
            if moment.index >= first and frame is not None:
                yield SceneImage(moment.index, self._image_of(frame))


def open_frames(run: RunFolder) -> SceneFrames:
    """Open the recording of a run again. Raises InputError: it is missing, or another version made the run."""
    path, info = run.recording, run.info
    if path is None or not path.exists():
        raise InputError(f"{path}: expected the recording of the run, found nothing there")
    config = config_of(info.config, "run.json")
    if is_multi_rig(path):
        rigs = open_rigs(path)
        return SceneFrames(rigs, *_of_recording(rigs.rigs[0].recording, info.floor, config))
    if info.rig is None or (info.rig.baseline_m is None and info.rig.depth_sensor is None):
        return SceneFrames(open_video(path, run.options), run.ground_camera, lambda frame: frame.image)
    recording = open_any(path, run.options)
    return SceneFrames(recording, *_of_recording(recording, info.floor, config))


def frames_or_none(run: RunFolder, warn: Callable[[str], object]) -> SceneFrames | None:
    """``open_frames``, or None and a warning."""
    try:
        return open_frames(run)
    except (InputError, WorkError) as error:
        warn(f"no images, only the floor: {error}")
        return None


def _of_recording(
    recording: AnyRecording, floor: FloorInfo | None, config: Config
) -> tuple[ImageCamera | None, Callable[[Any], U8]]:
    """The camera above the floor, and what makes the image of a frame."""
    image_of: Callable[[Any], U8]
    if isinstance(recording, RgbdRecording):
        rgbd = RgbdRectifier(recording.camera, recording.sensor, config.rectify)
        geometry, image_of = rgbd.geometry, lambda frame: rgbd(frame).left
    else:
        pair = Rectifier(recording.rig, config.rectify)
        geometry, image_of = pair.geometry, lambda frame: pair(frame.left, frame.right).left
    if floor is None or floor.world_SE3_left is None:
        return None, image_of
    pose = np.array(floor.world_SE3_left, dtype=np.float64)
    return StereoFloorCamera(geometry, SE3(pose[:3, :3], pose[:3, 3])), image_of


def scene_of(path: Path, options: OpenOptions | None = None) -> PointCloud:
    """Points of what does not move, in the world frame of the tracks, of a run's folder or a recording of one rig.
    Raises InputError: no recording of a pair or of images with depth. WorkError: no floor is visible."""
    config, recording, options = Config(), path, options or OpenOptions()
    if (path / "run.json").is_file():
        run = RunFolder(path)
        config, recording = config_of(run.info.config, str(path / "run.json")), run.recording or path
        options = options if options.calibration else run.options
    if not recording.exists() or not (options.calibration or holds_pair(recording, options)):
        raise InputError(f"{recording}: expected a recording of a stereo pair or of images with depth, found none")
    opened = open_any(recording, options)
    return scene_cloud(opened, set_up(opened, config), config)
