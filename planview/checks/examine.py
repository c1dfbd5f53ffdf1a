"""All checks of a recording before a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from calib.errors import InputError, WorkError
from calib.formats import load_rig
from calib.formats.one_camera import holds_one_camera, load_one_camera
from calib.ground_camera import GroundCamera
from calib.io import refuse_missing
from calib.rig import Floor
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.checks.heights import height_check, person_heights
from planview.checks.images import (
    flicker_check,
    grey_level,
    image_checks,
    light_checks,
    spread_checks,
    standing_checks,
)
from planview.checks.motion import liveliest, repeated_check, still_checks
from planview.checks.scene import (
    alignment_checks,
    camera_height,
    explanation_checks,
    given_floor_check,
    registration_checks,
    scene_checks,
)
from planview.checks.sensors import watch_sensors
from planview.checks.timing import frame_checks
from stereo.floor import DepthFrames, FloorSearch, PairFrames, frames_of_one_view, spread_frames
from stereo.readers import OpenOptions, find_layout, find_reader, open_any, open_video
from stereo.readers.open import OF_TWO_IMAGES, SEVERAL, SeveralSensors, is_multi_rig, open_by
from stereo.recording import Frame, Recording, Shot, SingleCamera, refuse_untimed
from stereo.viewpoint import Standing, Viewpoints


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Every check; of a pair or images with depth also the frames that were looked at and their floor, where there is
    one; of several sensors the same of each by its name."""

    checks: tuple[Check, ...]
    seen: PairFrames | DepthFrames | None = None
    floor: Floor | None = None
    sensors: Mapping[str, Diagnosis] = field(default_factory=dict)


def examine(
    path: Path,
    options: OpenOptions | None = None,
    *,
    frames: int = 60,
    person_height_m: float | None = None,
    search: FloorSearch | None = None,
) -> Diagnosis:
    """Examine a recording; of images with depth the checks of a pair are skipped, of one camera those of depth, too.
    Several sensors are examined one by one, and whether they agree.

    A recording that is refused (its calibration or its layout) fails the check "calibration and layout" with the
    reason, and there are no other checks.

    Args:
        options: how the recording is opened.
        frames: consecutive frames to look at for movement, besides some spread over the recording.
        person_height_m: height of the people in it, when known: checks baseline and units.
        search: how a run looks for the floor, with the defaults of a run when None.
    Raises:
        InputError: there is nothing at that path, nothing gives the times of its frames, or people's height is known
            and one camera cannot measure it.
        WorkError: not one frame can be decoded.
    """
    refuse_missing(path)
    options = options or OpenOptions()
    search = search or FloorSearch()
    if is_multi_rig(path):
        return _examine_sensors(open_by([SEVERAL], path, options), frames, person_height_m, search)
    try:
        video = _video_of_one(path, options)
        camera = None
        if video is None:
            recording = open_any(path, options)
        elif options.calibration is not None:
            camera = load_one_camera(options.calibration, video.sensor.size)
    except InputError as error:
        return Diagnosis((Check("calibration and layout", False, math.nan, note=str(error)),))
    if video is None:
        return _examine_depth(recording, frames, person_height_m, search)
    if person_height_m is not None:
        raise InputError(f"{path}: expected a pair or images with depth to measure people, found one camera")
    return _examine_one(video, camera, frames, search)


def _examine_sensors(
    recording: SeveralSensors, frames: int, person_height_m: float | None, search: FloorSearch
) -> Diagnosis:
    """Every sensor on its own, and whether they agree on where people are."""
    sensors = {part.name: _examine_depth(part, frames, person_height_m, search) for part in recording.parts}
    checks = []
    for name, sensor in sensors.items():
        checks += [replace(check, name=f"{name}: {check.name}") for check in sensor.checks]
    seen = [sensor.seen for sensor in sensors.values() if sensor.seen]
    checks += watch_sensors(recording, seen, frames).checks()
    return Diagnosis(tuple(checks), sensors=sensors)


def _examine_depth(
    recording: Recording[Any], frames: int, person_height_m: float | None, search: FloorSearch
) -> Diagnosis:
    """A pair, or images with depth. Raises InputError: nothing gives the times of its frames."""
    refuse_untimed(recording)
    seen = spread_frames(recording, search)
    floor = None
    refused = ""
    try:
        floor = seen.floor()
    except WorkError as error:
        refused = str(error)
    count = max(3, min(frames, recording.n_frames))
    run = _liveliest_run(recording, seen.frames, count)
    checks = [
        Check("calibration and layout", True, math.nan, note=recording.sensor.source),
        *frame_checks(recording, seen.view.shots, run, min(search.frames, recording.n_frames) + count),
        *spread_checks(seen.view),
        *still_checks(seen, run),
        *CHECKS[type(seen)](seen, run),
    ]
    given = recording.sensor.world_SE3_left
    if given is not None and floor is not None:
        file = RIGS_FILE if recording.name else "world.toml"
        checks.append(given_floor_check(seen, given, floor, file))
    checks += scene_checks(seen, floor, refused)
    checks.append(height_check(person_heights(seen, floor), person_height_m))
    checks += explanation_checks(recording, checks, floor, search)
    return Diagnosis(tuple(checks), seen, floor)


CHECKS: dict[type, Callable[[Any, Sequence[Frame[Shot]]], list[Check]]] = {
    PairFrames: lambda seen, run: [*image_checks(seen.frames), _flicker_of_run(run), *alignment_checks(seen)],
    DepthFrames: lambda seen, run: [*_checks_of_images(seen.frames, run), *registration_checks(seen.frames, run)],
}
"""By the frames looked at, checks of the images, and of how the two images of a shot lie on each other."""


def _checks_of_images(spread: Sequence[Frame[Shot]], run: Sequence[Frame[Shot]]) -> list[Check]:
    """Copies and light of images of one camera."""
    light = light_checks([frame.image for frame in spread])
    copies = repeated_check([frame.image for frame in run])
    return [copies, *light, _flicker_of_run(run)]


def _flicker_of_run(run: Sequence[Frame[Shot]]) -> Check:
    return flicker_check([grey_level(frame.image) for frame in run])


def _liveliest_run(recording: Recording[Any], spread: Sequence[Frame[Any]], count: int) -> list[Frame[Any]]:
    """Consecutive frames around the liveliest one of some spread over the recording."""
    first = max(0, min(liveliest(spread).index - count // 2, recording.n_frames - count))
    return recording.at(range(first, min(first + count, recording.n_frames)))


def _video_of_one(path: Path, options: OpenOptions) -> Recording[SingleCamera] | None:
    """The video of one camera; None of everything else."""
    if options.calibration is not None:
        if not holds_one_camera(options.calibration):
            return None
    else:
        with suppress(InputError):
            find_reader(path, OF_TWO_IMAGES)
            return None
        with suppress(InputError):
            find_layout(path, options)
            return None  # two views in one video
        with suppress(InputError):
            load_rig(path if path.is_dir() else path.parent)
            return None  # meant as a pair
    try:
        return open_video(path, replace(options, calibration=None))
    except InputError:
        return None


def _examine_one(
    video: Recording[SingleCamera], camera: GroundCamera | None, frames: int, search: FloorSearch
) -> Diagnosis:
    """One camera: times, light, whether it stands still, and its calibration. Raises InputError: frames without
    times."""
    refuse_untimed(video)
    spread, view = frames_of_one_view(video, search.frames)
    count = max(3, min(frames, video.n_frames))
    run = _liveliest_run(video, spread, count)
    note = "one camera, no calibration: places are in pixels" if camera is None else "one camera, calibrated"
    checks = [
        Check("calibration and layout", True, math.nan, note=note),
        *frame_checks(video, view.shots, run, min(search.frames, video.n_frames) + count),
        *_checks_of_images(spread, run),
    ]
    if view.elsewhere:
        checks += spread_checks(view)
    else:
        standing = Standing(Viewpoints([], video.sensor.focal_widths))
        for frame in run:
            standing.update(frame.index, frame.timestamp_s, frame.images)
        checks += standing_checks(standing, "the view before is not shown again")
    if camera is not None:
        checks.append(camera_height(camera.height_m, "above the floor, by the calibration"))
    return Diagnosis(tuple(checks))
