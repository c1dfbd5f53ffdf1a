"""A recording opened with a tracker."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal, cast, get_args

from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.formats.one_camera import NoCameraError, load_one_camera
from calib.ground_camera import GroundCamera
from planview.engine.config import Config, config_of
from planview.engine.engine import Engine
from planview.engine.sensor import CameraSensor, DepthSensor, RecordedSensor, RigSensor
from planview.engine.setup import Setup, refuse_matcher, set_up
from planview.maps.grid import floor_in_view
from planview.maps.recording import MAPS, MapsRecording, RecordedViews
from planview.tracking.base import ImageTracker, Needs, Tracker, refuse_tracker
from planview.tracking.detections import BoxTracker, DetectionTracker
from planview.tracking.joint import JointTracker
from planview.tracking.template import TemplateTracker
from planview.trajectories.detections import Detections, load_detections
from stereo.matcher import Matcher
from stereo.readers import OpenOptions
from stereo.readers.open import OF_TWO_IMAGES, ONE_CAMERA, READERS, SEVERAL, SeveralSensors, find_reader, open_by
from stereo.recording import Recording, SingleCamera, refuse_untimed

TrackerName = Literal["joint", "template", "human-model", "ellipse-particle"]
ImageTrackerName = Literal["human-model", "ellipse-particle"]
AnyTracker = TrackerName | Tracker
AnySource = Recording[Any] | SeveralSensors | MapsRecording
"""Recordings of all kinds."""
OVERVIEW_HZ = 10.0
"""Frames per second of a video that its tracker may look at before the first is tracked: walkers then overlap
themselves from frame to frame, and a minute of video takes two or three seconds, a third to two thirds of tracking it.
Our choice."""
FIXED_TABLES = ("analysis", "rectify", "range", "sgbm", "floor", "foreground", "feedback")
FIXED_MAP_PARAMETERS = ("height_max_m", "depth_std_max_m")
"""Parameters that decided which points of plan-view maps were recorded."""


def open_engine(
    path: Path | str,
    tracker: AnyTracker = "joint",
    config: Config | dict[str, Any] | None = None,
    camera: Path | str | GroundCamera | None = None,
    options: OpenOptions | None = None,
    matcher: Matcher | None = None,
    detections: Path | str | Sequence[ArrayLike] | None = None,
) -> Engine:
    """Open a recording, or the plan-view maps of one, with a tracker.

    The joint and template trackers need a stereo recording, images with depth, or the maps of either; the human-model
    tracker a video and its ``camera.toml``; the ellipse-particle tracker a video. Raises InputError: a recording,
    camera or calibration that is missing or does not fit. Raises WorkError: no floor is visible.

    Args:
        tracker: a name, or a tracker of your own: an ``ImageTracker`` where the recording is of one camera without
            depth, else one of plan-view maps.
        camera: camera.toml of one camera, its Tsai XML, or the camera itself.
        options: calibration, rate and topics of a stereo recording that are not taken from itself.
        matcher: of stereo pairs; SGBM when None.
        detections: boxes of people that another program found in a video, which are tracked in place of ``tracker``: a
            file (see ``load_detections``), or per frame (N, 4) left, top, width, height [px] or (N, 5) with a score.
        config: every parameter, or tables of those that differ; the defaults, or those that made the maps, when None.
    """
    path = Path(path)
    camera = Path(camera) if isinstance(camera, str) else camera
    config = config if isinstance(config, Config | None) else config_of(config, argument="config")
    refuse_tracker(tracker, get_args(TrackerName))
    if not isinstance(options, OpenOptions | None):
        raise InputError(f"expected OpenOptions, found {type(options).__name__}", argument="options")
    options = options or OpenOptions()
    of_images = detections is not None or _needs(tracker) == "image"
    recording = open_source(path, options, of_images)
    return engine_of(recording, tracker, config, camera=camera, matcher=matcher, detections=detections, study=True)


SOURCES = (MAPS, SEVERAL, *READERS)
IMAGE_SOURCES = (MAPS, SEVERAL, *OF_TWO_IMAGES, ONE_CAMERA)
"""Readers of all that is tracked, and those for trackers that need no depth."""


def open_source(path: Path, options: OpenOptions, of_images: bool = False) -> AnySource:
    """A recording of any kind: plan-view maps, several sensors, a pair, images with depth or, where ``of_images`` says
    that no depth is needed, one camera. Raises InputError: nothing there that can be read, or a calibration for sensors
    that have their own."""
    readers = IMAGE_SOURCES if of_images and options.calibration is None else SOURCES
    source: AnySource = open_by(readers, path, options)
    return source


def engine_of(
    recording: AnySource,
    tracker: AnyTracker = "joint",
    config: Config | None = None,
    *,
    camera: Path | GroundCamera | None = None,
    matcher: Matcher | None = None,
    detections: Path | str | Sequence[ArrayLike] | None = None,
    setup: Setup | None = None,
    study: bool = False,
) -> Engine:
    """An engine for an open recording; arguments and errors are those of ``open_engine``.

    Args:
        setup: of the recording of one sensor; ``set_up`` finds it when None.
        study: the tracker of one camera looks at the beginning of the recording first.
    """
    first = recording.parts[0].sensor
    config = config or _default_config(first, recording.path)
    if setup is not None and len(recording.parts) > 1:
        raise InputError(f"{recording.path}: a setup is of one sensor, and this recording has {len(recording.parts)}")
    name: str = tracker if isinstance(tracker, str) else ""
    own_parts: dict[str, object] = {} if name else {"tracker": tracker}
    gives = _given_by(first)
    needed = _KINDS[_needs(tracker)]
    if detections is None and needed != _KINDS[gives]:
        needing = name or type(tracker).__name__
        raise InputError(f"{recording.path}: the tracker {needing} needs {needed}, found {_KINDS[gives]}")
    if gives == "image":
        first = cast(SingleCamera, first)
        refuse_matcher(recording.path, matcher)
        ground_camera = load_one_camera(camera, first.size) if isinstance(camera, Path) else camera
        if detections is not None:
            follower: ImageTracker = _box_tracker(recording.n_frames, first, detections, config, ground_camera)
            name = "detections"
            own_parts = {"detections": detections}
        else:
            follower = _image_tracker(tracker, config, ground_camera)
        refuse_untimed(recording)
        sensor = CameraSensor(config.single_camera, first.size, follower, ground_camera)
        source = camera.name if isinstance(camera, Path) else "given"
        engine = Engine(recording, config, [sensor], follower, source, name, own_parts)
        if study:
            engine.study(max(1, round(recording.fps / OVERVIEW_HZ)))
        return engine
    if detections is not None:
        problem = f"{recording.path} is no video of one camera, and boxes are tracked in one image"
        raise InputError(problem, argument="detections")
    floor_tracker = _floor_tracker(tracker, config)
    sensors = [_sensor_above_floor(part.sensor, part, config, matcher, setup) for part in recording.parts]
    matcher = setup.matcher if setup is not None else matcher
    if matcher is not None:
        own_parts["matcher"] = matcher
    return Engine(recording, config, sensors, floor_tracker, tracker_name=name, own_parts=own_parts)


@singledispatch
def _sensor_above_floor(
    sensor: object, part: Any, config: Config, matcher: Matcher | None, setup: Setup | None
) -> DepthSensor[Any, Any]:
    """Sensor of a part of a recording, made ready: a pair or a depth camera."""
    refuse_untimed(part)
    return RigSensor(setup or set_up(part, config, matcher), config, part.name)


@_sensor_above_floor.register
def _recorded_sensor(
    sensor: RecordedViews, part: MapsRecording, config: Config, matcher: Matcher | None, _: object
) -> RecordedSensor:
    """Raises InputError: a parameter that decided which points were recorded differs, or maps of another rig."""
    path = part.path
    refuse_matcher(path, matcher)
    recorded = _recorded_config(sensor, path)
    fixed = [(name, getattr(recorded, name), getattr(config, name)) for name in FIXED_TABLES]
    fixed += [(f"maps.{n}", getattr(recorded.maps, n), getattr(config.maps, n)) for n in FIXED_MAP_PARAMETERS]
    for name, before, now in fixed:
        if before != now:
            raise InputError(f"{path}: expected {name} as recorded, found it changed: the points depend on it")
    rig = sensor.rig
    try:
        if floor_in_view(rig.geometry, rig.floor.world_SE3_left, recorded.maps) != rig.grid:
            raise ValueError("expected the grid of the rig and floor in the file, found one of another rig")
        return RecordedSensor(rig, config, str(path))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


@singledispatch
def _default_config(sensor: object, path: Path) -> Config:
    """Configuration that the given parameters change: the one that made the plan-view maps, else the defaults."""
    return Config()


@_default_config.register
def _recorded_config(sensor: RecordedViews, path: Path) -> Config:
    return _parsed_config(sensor.config, path)


def base_config(path: Path) -> Config:
    """Configuration that parameters change, of a recording that is not open yet. Raises InputError: maps that cannot be
    read."""
    return _parsed_config(find_reader(path, IMAGE_SOURCES).config(path), path)


def _parsed_config(text: str, path: Path) -> Config:
    """The parameters in JSON, the defaults where there is none. Raises InputError: those of another version."""
    try:
        return Config.model_validate_json(text or "{}")
    except ValueError as error:
        raise InputError(
            f"{path}: expected the parameters of this version, found others: another version wrote the maps"
        ) from error


def _needs(tracker: AnyTracker) -> Needs:
    if isinstance(tracker, str):
        return "image" if tracker in get_args(ImageTrackerName) else "maps"
    return tracker.needs


@singledispatch
def _given_by(sensor: object) -> Needs:
    """Input that a sensor gives to trackers: all sensors but one give plan-view maps."""
    return "maps"


@_given_by.register
def _given_by_one_camera(sensor: SingleCamera) -> Needs:
    return "image"


_WITH_DEPTH = "a stereo pair, images with depth or plan-view maps"
_KINDS = {"image": "one camera without depth", "maps": _WITH_DEPTH, "points": _WITH_DEPTH}
"""Recordings by what they give."""


def _box_tracker(
    n_frames: int,
    sensor: SingleCamera,
    detections: Path | str | Sequence[ArrayLike],
    config: Config,
    camera: GroundCamera | None,
) -> ImageTracker:
    """A tracker of another program's boxes: on the floor with a camera, in the image without one."""
    boxes = load_detections(Path(detections)) if isinstance(detections, str | Path) else Detections.of(detections)
    boxes = boxes.within(sensor.size)
    boxes = boxes.of_frames(n_frames) if n_frames > 0 else boxes
    if camera is None:
        return BoxTracker(boxes, config.detections.edge)
    return DetectionTracker(boxes, config.detections, camera)


def _floor_tracker(tracker: AnyTracker, config: Config) -> Tracker:
    """A tracker of points or maps by its name, or one's own."""
    if tracker == "template":
        return TemplateTracker(config.template, config.maps.height_max_m)
    return JointTracker(config.joint) if isinstance(tracker, str) else tracker


def _image_tracker(tracker: AnyTracker, config: Config, camera: GroundCamera | None) -> ImageTracker:
    """A tracker of one camera's images by its name, or one's own. Raises InputError: the human-model tracker without a
    camera, or nobody can be seen by it."""
    if not isinstance(tracker, str):
        return cast(ImageTracker, tracker)
    if tracker == "ellipse-particle":
        from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

        return EllipseParticleTracker(config.ellipse_particle, camera, config.seed)
    if camera is None:
        raise NoCameraError("the human-model tracker needs a calibrated camera", remedy="calibration")
    from planview.tracking.human_model.tracker import HumanModelTracker

    return HumanModelTracker(config.human_model, camera)
