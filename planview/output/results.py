"""What a run left in its folder, and the images of its recording."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from pydantic import ValidationError

from calib.errors import InputError
from calib.ground_camera import GroundCamera
from calib.params import first_problem
from calib.pose import SE3
from calib.text import reason
from calib.types import F64, U8
from planview.counting.clock import Clock
from planview.counting.events import Event, read_events
from planview.drawing.image import ImageCamera
from planview.drawing.plan import PlanBounds, Rule, bounds_of, rules_of
from planview.engine.config import Config, config_of
from planview.engine.info import FloorInfo
from planview.engine.scene_cloud import SceneCloud, scene_cloud
from planview.engine.setup import set_up_any
from planview.output.folder import RunInfo, read_run_info
from planview.trajectories.layouts import load_truth
from planview.trajectories.table import Trajectories, read_tracks
from stereo.depth import RectifiedGeometry
from stereo.floor_camera import StereoFloorCamera
from stereo.readers import OpenOptions, holds_pair, open_any, open_video
from stereo.readers.heads import HeadsRecording, open_heads
from stereo.readers.reader import AnyRecording
from stereo.readers.several import is_heads
from stereo.recording import RgbdRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier

MAPS_OF_MAPS = 4
"""Plan-view recordings are followed so far back to the recording with the images."""


def source_of(info: RunInfo) -> Path:
    """The recording with the images: of maps.h5 that of the run that wrote it, as far as it tells."""
    path = Path(info.input)
    for _ in range(MAPS_OF_MAPS):
        beside = path.parent / "run.json"
        if not (path.is_file() and beside.is_file()):
            break
        from planview.maps.recording import is_maps  # brings HDF5

        if not is_maps(path):
            break
        path = Path(read_run_info(beside).input)
    return path


FALLBACK_FPS = 30.0
"""Where the tracks have no times."""
NEAR = 0.6
"""Cameras within this share of the size of the floor that people used are shown with it: a camera far from them would
make everything small."""


@dataclass(frozen=True, eq=False)
class RunResults:
    """The files of a run; empty where a file is missing.

    Attributes:
        folder: of the run.
        info: run.json; has_run: whether there is one.
        tracks: all rows of tracks.csv.
        events: of events.csv.
        counts: counts.json, else the counts of run.json.
        truth: of the frames tracked, where there is one.
    """

    folder: Path
    info: RunInfo
    has_run: bool
    tracks: Trajectories
    events: list[Event]
    counts: dict[str, Any]
    truth: Trajectories | None

    @cached_property
    def clock(self) -> Clock:
        """Frames to times."""
        return Clock(self.tracks, FALLBACK_FPS)

    @property
    def n_frames(self) -> int:
        """Frames of the run."""
        last = int(self.tracks.frame.max()) + 1 if len(self.tracks) else 0
        return max(last, self.info.frames_read + self.info.frames_skipped)

    @property
    def rules(self) -> list[Rule]:
        """Tripwires and zones that can be drawn."""
        return rules_of(self.rule_counts)

    @property
    def rule_counts(self) -> dict[str, Any]:
        """Of every rule by name, its kind, points and totals."""
        rules = self.counts.get("rules")
        return rules if isinstance(rules, dict) else {}

    @property
    def cameras(self) -> list[tuple[tuple[float, float], F64]]:
        """Place on the floor and outline of the view (N, 2) of every camera [m]."""
        rig = self.info.rig
        views = [] if rig is None else rig.heads or [rig]
        return [(view.at_m, np.array(view.view_m, dtype=np.float64).reshape(-1, 2)) for view in views]

    def bounds(self) -> PlanBounds:
        """Where people were, the rules, and cameras that are not far from them."""
        tracks, known = self.tracks, self.tracks.state != "tentative"
        places = [
            np.column_stack([tracks.x_m[known], tracks.y_m[known]]),
            *(rule.points for rule in self.rules if rule.on_floor),
        ]
        bounds = bounds_of(*places)
        near = [np.array([at]) for at, _ in self.cameras if _is_near(bounds, at)]
        return bounds_of(*places, *near)


def _is_near(bounds: PlanBounds, at_m: tuple[float, float]) -> bool:
    size = max(bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m)
    beyond = [bounds.x_min_m - at_m[0], at_m[0] - bounds.x_max_m, bounds.y_min_m - at_m[1], at_m[1] - bounds.y_max_m]
    return max(beyond) <= NEAR * size


def read_results(folder: Path, truth: Path | None = None) -> RunResults:
    """Read a run's folder.

    Args:
        truth: file of the true people; ``truth.csv`` of the recording where not given.
    Raises:
        InputError: no tracks.csv, or a file that is not what its name says.
    """
    run, events = folder / "run.json", folder / "events.csv"
    info = read_run_info(run) if run.is_file() else RunInfo()
    beside = source_of(info) / "truth.csv" if info.input else None
    if truth is None and beside is not None and beside.is_file():
        truth = beside
    results = RunResults(
        folder,
        info,
        run.is_file(),
        read_tracks(folder / "tracks.csv"),
        read_events(events) if events.is_file() else [],
        read_object(folder / "counts.json") or dict(info.counts),
        None,
    )
    return results if truth is None else replace(results, truth=_tracked(load_truth(truth), results.n_frames))


def _tracked(truth: Trajectories, n_frames: int) -> Trajectories:
    """The truth of the frames of the run."""
    return truth.where(truth.frame < n_frames)


def read_object(path: Path) -> dict[str, Any]:
    """A JSON object; an empty one where there is no file.

    Raises:
        InputError: something else.
    """
    if not path.is_file():
        return {}
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected JSON, found {reason(error)}") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(value).__name__}")
    return value


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


def scene_of(path: Path, options: OpenOptions | None = None) -> SceneCloud:
    """Points of what does not move, in the world frame of the run's tracks.

    Args:
        path: folder of a run, whose recording and configuration are taken, or a recording of one stereo head.
        options: how the recording is opened.
    Raises:
        InputError: no recording of a pair or of images with depth.
        WorkError: no floor is visible.
    """
    config, recording = Config(), path
    if (path / "run.json").is_file():
        info = read_run_info(path / "run.json")
        config, recording = config_of(info.config, str(path / "run.json")), source_of(info)
    calibration = options.calibration if options else None
    if not recording.exists() or not (calibration or holds_pair(recording)):
        raise InputError(f"{recording}: expected a recording of a stereo pair or of images with depth, found none")
    opened = open_any(recording, options)
    return scene_cloud(opened, set_up_any(opened, config), config)
