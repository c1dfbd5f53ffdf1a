"""A recording opened with a tracker."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, cast, get_args

from numpy.typing import ArrayLike

from calib.errors import InputError
from calib.formats.one_camera import load_one_camera
from calib.ground_camera import GroundCamera
from planview.engine.config import Config, config_of
from planview.engine.engine import Engine
from planview.engine.one_camera import one_camera_engine
from planview.engine.replay import recorded_config, replay_engine
from planview.engine.stereo import stereo_engine
from planview.maps.recording import MapsRecording, is_maps
from planview.tracking.base import ImageTracker, Tracker, refuse_tracker
from planview.tracking.detections import BoxTracker, DetectionTracker
from planview.tracking.joint import JointTracker
from planview.tracking.template import TemplateTracker
from planview.trajectories.boxes import Detections, load_detections
from stereo.matcher import Matcher
from stereo.readers import OpenOptions, holds_pair, open_any, open_video
from stereo.readers.open import is_multi_rig, open_rigs
from stereo.recording import Video

TrackerName = Literal["joint", "template", "human-model", "ellipse-particle"]
ImageTrackerName = Literal["human-model", "ellipse-particle"]
AnyTracker = TrackerName | Tracker


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
    path, camera = Path(path), Path(camera) if isinstance(camera, str) else camera
    config = config if isinstance(config, Config | None) else config_of(config, argument="config")
    refuse_tracker(tracker, get_args(TrackerName))
    if not isinstance(options, OpenOptions | None):
        raise InputError(f"expected OpenOptions, found {type(options).__name__}", argument="options")
    options = options or OpenOptions()
    stereo = bool(options.calibration or options.right) or holds_pair(path)
    if matcher is not None and (is_maps(path) or is_multi_rig(path) or not stereo):
        raise InputError(f"{path}: expected a recording of one stereo pair for a matcher of your own")
    foreign = camera or options.calibration
    if is_maps(path):
        if foreign is not None:
            raise InputError(f"{foreign}: expected no calibration for plan-view maps, which hold their own")
        recording = MapsRecording(path)
        config = config or recorded_config(recording)
        return replay_engine(recording, _map_tracker(tracker, config, path), config)
    config = config or Config()
    if detections is not None and holds_pair(path, options):
        raise InputError(f"{path} is a stereo recording, and boxes are tracked in one image", argument="detections")
    if is_multi_rig(path):
        if foreign is not None:
            raise InputError(f"{foreign}: expected the calibration of every head in its own folder")
        return stereo_engine(open_rigs(path), config, _map_tracker(tracker, config, path))
    of_images = tracker in get_args(ImageTrackerName) or hasattr(tracker, "foreground_columns")
    if stereo or not (of_images or detections is not None):
        return stereo_engine(open_any(path, options), config, _map_tracker(tracker, config, path), matcher)
    video = open_video(path, options)
    ground_camera = load_one_camera(camera, video.size) if isinstance(camera, Path) else camera
    if detections is not None:
        tracker = _box_tracker(video, detections, config, ground_camera)
    elif isinstance(tracker, str):
        tracker = image_tracker(cast(ImageTrackerName, tracker), config, ground_camera)
    return one_camera_engine(video, cast(ImageTracker, tracker), config, ground_camera, overview=True)


def _box_tracker(
    video: Video, detections: Path | str | Sequence[ArrayLike], config: Config, camera: GroundCamera | None
) -> ImageTracker:
    """A tracker of another program's boxes: on the floor with a camera, in the image without one."""
    boxes = load_detections(Path(detections)) if isinstance(detections, str | Path) else Detections.of(detections)
    boxes = boxes.within(video.size)
    boxes = boxes.of_frames(video.n_frames) if video.n_frames > 0 else boxes
    if camera is None:
        return BoxTracker(boxes, config.detections.edge)
    return DetectionTracker(boxes, config.detections, camera)


def _map_tracker(tracker: AnyTracker, config: Config, path: Path) -> Tracker:
    """A tracker of plan-view maps by its name, or one's own."""
    if tracker in get_args(ImageTrackerName):
        raise InputError(
            f"{path}: expected a tracker of stereo recordings and plan-view maps (joint, template), found "
            f"{tracker}, which tracks one camera without depth"
        )
    if tracker == "template":
        return TemplateTracker(config.template, config.maps.height_max_m)
    return JointTracker(config.joint) if tracker == "joint" else cast(Tracker, tracker)


def base_config(path: Path) -> Config:
    """What parameters are changed from: those that made the plan-view maps, else the defaults. Raises InputError: maps
    that cannot be read."""
    return recorded_config(MapsRecording(path)) if is_maps(path) else Config()


def image_tracker(tracker: ImageTrackerName, config: Config, camera: GroundCamera | None) -> ImageTracker:
    """A tracker of one camera's images with its parameters. Raises InputError: the human-model tracker without a
    camera, or nobody can be seen by it."""
    if tracker == "ellipse-particle":
        from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

        return EllipseParticleTracker(config.ellipse_particle, camera, config.seed)
    if camera is None:
        raise InputError("the human-model tracker needs a calibrated camera", remedy="camera")
    from planview.tracking.human_model.tracker import HumanModelTracker

    return HumanModelTracker(config.human_model, camera)
