"""From names on the command line to an engine with a tracker."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast, get_args

from calib.errors import InputError
from calib.ground_camera import GroundCamera, load_ground_camera
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.kept_setup import KeptSetup
from planview.engine.pipeline import Pipeline
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from planview.maps.recording import MapsRecording, is_maps
from planview.tracking.base import ImageTracker, Tracker
from planview.tracking.harville import HarvilleTracker
from planview.tracking.template import TemplateTracker
from stereo.matcher import Matcher
from stereo.readers import OpenOptions, holds_pair, open_video
from stereo.readers.open import is_heads
from stereo.recording import Video

if TYPE_CHECKING:
    from planview.engine.heads import HeadsPipeline
    from planview.engine.maps_pipeline import MapsPipeline

TrackerName = Literal["template", "harville", "human-model", "ellipse-particle"]
FloorTrackerName = Literal["template", "harville"]
ImageTrackerName = Literal["human-model", "ellipse-particle"]
AnyTracker = TrackerName | Tracker
FloorMaker = Callable[[Config], Tracker]


def open_engine(
    path: Path,
    tracker: AnyTracker = "template",
    config: Config | None = None,
    camera: Path | None = None,
    options: OpenOptions | None = None,
    matcher: Matcher | None = None,
    kept: KeptSetup | None = None,
) -> Engine:
    """Open a recording, or the plan-view maps of one, with the tracker asked for.

    The template and harville trackers need a stereo recording, images with depth, or the maps of either; the
    human-model tracker a video and its ``camera.toml``; the ellipse-particle tracker a video.

    Args:
        tracker: a name, or a tracker of your own: an ``ImageTracker`` where the recording is of one camera without
            depth, else one of plan-view maps.
        options: calibration, rate and topics of a stereo recording that are not taken from itself.
        matcher: of stereo pairs; SGBM when None.
        kept: what an earlier run found out about a recording of one stereo pair, or where this one keeps it.
        config: the defaults when None; of plan-view maps the parameters that made them (see ``base_config``).
    Raises:
        InputError: a recording, camera or calibration that is missing or does not fit.
        WorkError: no floor is visible.
    """
    if isinstance(tracker, str) and tracker not in get_args(TrackerName):
        raise InputError(f"--tracker: expected one of {', '.join(get_args(TrackerName))}, found {tracker!r}")
    options = options or OpenOptions()
    if matcher is not None and (is_maps(path) or is_heads(path) or not is_stereo(path, options.calibration)):
        raise InputError(f"{path}: expected a recording of one stereo pair for a matcher of your own")
    on_floor, foreign = _floor_maker(tracker), camera or options.calibration
    if is_maps(path):
        return _open_maps(path, _required(on_floor, path, tracker), config, foreign)
    config = config or Config()
    if is_heads(path):
        return _open_heads(path, _required(on_floor, path, tracker), config, foreign)
    if (on_floor and not hasattr(tracker, "foreground_columns")) or is_stereo(path, options.calibration):
        on_floor = _required(on_floor, path, tracker)
        return Pipeline.from_recording(path, config, options, on_floor(config), matcher, kept=kept)
    video = open_video(path, options)
    ground_camera = _camera_for(video, camera) if camera else None
    tracker = _image_tracker(tracker, config, ground_camera)
    return SingleCameraPipeline.from_recording(video, tracker, config, ground_camera)


def _floor_maker(tracker: AnyTracker) -> FloorMaker | None:
    """What makes the tracker of plan-view maps; None for one that takes images only."""
    if isinstance(tracker, str):
        name = cast(FloorTrackerName, tracker)
        return partial(floor_tracker, name) if tracker in get_args(FloorTrackerName) else None
    return lambda config: tracker


def _required(make: FloorMaker | None, path: Path, tracker: AnyTracker) -> FloorMaker:
    if make is None:
        raise InputError(
            f"{path}: expected a tracker of stereo recordings and plan-view maps (template, harville), found "
            f"{tracker}, which tracks one camera without depth"
        )
    return make


def _image_tracker(tracker: AnyTracker, config: Config, camera: GroundCamera | None) -> ImageTracker:
    if not isinstance(tracker, str):
        return cast(ImageTracker, tracker)
    return image_tracker(cast(ImageTrackerName, tracker), config, camera)


def is_stereo(path: Path, calibration: Path | None = None) -> bool:
    """Whether a path holds a pair of cameras, or images with depth, rather than one camera."""
    return calibration is not None or holds_pair(path)


def base_config(path: Path) -> Config:
    """What parameters are changed from: those that made the plan-view maps, else the defaults.

    Raises:
        InputError: maps that cannot be read.
    """
    if not is_maps(path):
        return Config()
    from planview.engine.maps_pipeline import recorded_config

    return recorded_config(MapsRecording(path))


def _open_maps(path: Path, make: FloorMaker, config: Config | None, foreign: Path | None) -> MapsPipeline:
    if foreign is not None:
        raise InputError(f"{foreign}: expected no calibration beside plan-view maps, which hold their own")
    from planview.engine.maps_pipeline import MapsPipeline, recorded_config

    recording = MapsRecording(path)
    config = config or recorded_config(recording)
    return MapsPipeline(recording, make(config), config)


def _open_heads(path: Path, make: FloorMaker, config: Config, foreign: Path | None) -> HeadsPipeline:
    if foreign is not None:
        raise InputError(f"{foreign}: expected the calibration of every head in its own folder")
    from planview.engine.heads import HeadsPipeline

    return HeadsPipeline.from_recording(path, make(config), config)


def floor_tracker(tracker: FloorTrackerName, config: Config) -> Tracker:
    """A tracker of plan-view maps with its parameters."""
    if tracker == "template":
        return TemplateTracker(config.template)
    return HarvilleTracker(config.harville, config.maps.height_max_m)


def image_tracker(tracker: ImageTrackerName, config: Config, camera: GroundCamera | None) -> ImageTracker:
    """A tracker of one camera's images with its parameters.

    Raises:
        InputError: the human-model tracker without a camera.
    """
    if tracker == "ellipse-particle":
        from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker

        return EllipseParticleTracker(config.ellipse_particle, camera, config.seed)
    if camera is None:
        raise InputError("--camera: the human-model tracker needs a camera.toml (see planview calibrate human)")
    from planview.tracking.human_model.tracker import HumanModelTracker

    return HumanModelTracker(config.human_model, camera)


def _camera_for(video: Video, path: Path) -> GroundCamera:
    camera = load_ground_camera(path)
    if camera.size != video.size:
        (w, h), (vw, vh) = camera.size, video.size
        raise InputError(f"{path}: expected a camera for images of {vw}x{vh} px, found one for {w}x{h} px")
    return camera
