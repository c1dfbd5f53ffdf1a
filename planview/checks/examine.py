"""All checks of a recording, before and during a run, with pictures for people."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import singledispatch
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calib.carried import Carried
from calib.errors import InputError, WorkError
from calib.formats import load_rig
from calib.formats.one_camera import holds_one_camera, load_one_camera
from calib.ground_camera import GroundCamera
from calib.images import as_colour, as_grey, write_image
from calib.io import missing
from calib.rig import Floor
from calib.types import F64, U8
from calib.world import RIGS_FILE
from planview.checks.check import Check, limited
from planview.checks.motion import MotionWatch, repeated_check, still_checks
from planview.checks.scene import (
    VALID_SHARE_MIN,
    alignment_checks,
    camera_height,
    explanation_checks,
    fields_checks,
    flicker_check,
    given_floor_check,
    grey_level,
    height_check,
    heights_above_floor,
    image_checks,
    large_heights,
    light_checks,
    person_heights,
    registration_checks,
    scene_checks,
    spread_checks,
    standing_checks,
    standing_things,
)
from planview.checks.sensors import watch_sensors
from planview.checks.timing import SpeedWatch, frame_checks
from planview.drawing.style import Entry, Rgb, as_bgr, disparity_colours, with_colour_bar, with_legend
from planview.maps.grid import FloorRig
from stereo.depth import Depth, back_project, median_image
from stereo.floor import DepthFrames, FloorSearch, PairFrames, frames_of_one_view, spread_frames
from stereo.matcher import SATURATED_LEVEL
from stereo.readers import OpenOptions, find_layout, holds_pair, open_any, open_video
from stereo.readers.open import SeveralSensors, is_multi_rig, open_rigs
from stereo.recording import Frame, Recording, Shot, SingleCamera, refuse_untimed
from stereo.viewpoint import SpreadView, Standing, Viewpoints

LINE_STEP_PX = 25
FLOOR_BAND_M = 0.10
ROW: Rgb = (0, 220, 0)
ABOVE: Rgb = (230, 40, 40)
BELOW: Rgb = (60, 90, 255)
SATURATED: Rgb = (255, 0, 255)


def write_pictures(seen: PairFrames | DepthFrames, floor: Floor | None, folder: Path) -> list[Path]:
    """Write PNG pictures of the frame in the middle of the recording.

    Returns:
        ``rows.png`` (of a pair: rectified, with horizontal lines and matched corners), ``disparity.png``, ``floor.png``
        (what lies on the floor green, above it red, below it blue) and ``exposure.png`` (saturated pixels magenta).
    """
    folder.mkdir(parents=True, exist_ok=True)
    middle = len(seen.frames) // 2
    first_px = seen.searched.first_px
    last_px = seen.searched.first_px + seen.searched.count
    turbo = disparity_colours(seen.disparities[middle], first_px, last_px)
    ends = f"far: {first_px} px", f"near: {last_px} px"
    pictures = {
        "disparity.png": with_colour_bar(turbo, cv2.COLORMAP_TURBO, *ends, [Entry((0, 0, 0), "unknown")]),
        "floor.png": floor_picture(seen, floor),
        "exposure.png": np.hstack([_saturated(as_grey(image)) for image in seen.recorded[middle]]),
        **row_pictures(seen, middle),
    }
    for name, picture in pictures.items():
        write_image(folder / name, picture)
    return [folder / name for name in pictures]


@singledispatch
def row_pictures(seen: PairFrames | DepthFrames, middle: int) -> dict[str, U8]:
    """A picture of the rows of a pair; none of images with depth."""
    return {}


@row_pictures.register
def _row_pictures_of_pair(seen: PairFrames, middle: int) -> dict[str, U8]:
    pair = seen.rectified[middle]
    rows = as_colour(np.hstack([pair.left_grey, pair.right_grey]))
    rows[LINE_STEP_PX // 2 :: LINE_STEP_PX] = as_bgr(ROW)
    return {"rows.png": with_legend(rows, [Entry(ROW, "one row: the same point is on it in both images")])}


def floor_picture(seen: PairFrames | DepthFrames, floor: Floor | None) -> U8:
    """The left image, median of the frames, tinted green where it shows the floor, red above it and blue below it."""
    picture = as_colour(median_image(seen.greys).astype(np.uint8))
    if floor is None:
        return with_legend(picture, [Entry(ABOVE, "no floor was found")])
    geometry = seen.rectifier.geometry
    points = back_project(geometry.depth(median_image(seen.disparities)), geometry)
    above = heights_above_floor(points, floor.world_SE3_left)
    with np.errstate(invalid="ignore"):
        slope = floor.height_m / points[..., 2]  # height above the floor by depth, along the ray of a pixel
        within = FLOOR_BAND_M + 2 * slope * geometry.depth_std_m(points[..., 2])
        bands = {
            Entry(ROW, f"on the floor, within {100 * FLOOR_BAND_M:.0f} cm and noise"): np.abs(above) <= within,
            Entry(ABOVE, "above it"): above > within,
            Entry(BELOW, "below it: wrong floor or depth"): above < -within,
        }
    for band, mask in bands.items():
        picture[mask] = (0.5 * picture[mask] + 0.5 * np.array(as_bgr(band.colour))).astype(np.uint8)
    return with_legend(picture, [*bands, Entry((255, 255, 255), "no tint: depth unknown")])


def _saturated(image: U8) -> U8:
    picture = as_colour(image).copy()
    picture[image >= SATURATED_LEVEL] = as_bgr(SATURATED)
    return with_legend(picture, [Entry(SATURATED, f"saturated: {SATURATED_LEVEL:.0f} or brighter")])


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found: every check; of a pair or images with depth also the frames that were looked at and their floor,
    where there is one; of several sensors the same of each by its name."""

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
    if not path.exists():
        raise missing(path)
    options = options or OpenOptions()
    search = search or FloorSearch()
    if is_multi_rig(path):
        return _examine_sensors(open_rigs(path, options.fps), frames, person_height_m, search)
    try:
        recording = _video_of_one(path, options) or open_any(path, options)
    except InputError as error:
        return Diagnosis((Check("calibration and layout", False, math.nan, note=str(error)),))
    if isinstance(recording, tuple):
        if person_height_m is not None:
            raise InputError(f"{path}: expected a pair or images with depth to measure people, found one camera")
        return Diagnosis(tuple(_checks_of_one(*recording, frames, search)))
    return _examine_depth(recording, frames, person_height_m, search)


def _examine_sensors(
    recording: SeveralSensors, frames: int, person_height_m: float | None, search: FloorSearch
) -> Diagnosis:
    """Every sensor on its own, and whether they agree on where people are."""
    sensors = {part.name: _examine_depth(part, frames, person_height_m, search) for part in recording.parts}
    checks = []
    for name, sensor in sensors.items():
        checks += [replace(check, name=f"{name}: {check.name}") for check in sensor.checks]
    seen = [sensor.seen for sensor in sensors.values() if sensor.seen is not None]
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
    given = recording.sensor.world_SE3_left
    file = RIGS_FILE if recording.name else "world.toml"
    run, times = _run_of(recording, seen.frames, seen.view, frames, search)
    seen_in_images, geometry = _checks_of_kind(seen, run)
    checks = [
        Check("calibration and layout", True, math.nan, note=recording.sensor.source),
        *times,
        *spread_checks(seen.view),
        *still_checks(seen, run),
        *seen_in_images,
        flicker_check([grey_level(frame.image) for frame in run]),
        *geometry,
        *([given_floor_check(seen, given, floor, file)] if given is not None and floor is not None else []),
        *scene_checks(seen, floor, refused),
        height_check(person_heights(seen, floor), person_height_m),
    ]
    checks += explanation_checks(recording, checks, floor, search)
    return Diagnosis(tuple(checks), seen, floor)


@singledispatch
def _checks_of_kind(seen: PairFrames | DepthFrames, run: Sequence[Frame[Shot]]) -> tuple[list[Check], list[Check]]:
    """Checks of the images, and of how the two images of a shot lie on each other."""
    raise NotImplementedError


@_checks_of_kind.register
def _checks_of_pair(seen: PairFrames, run: Sequence[Frame[Shot]]) -> tuple[list[Check], list[Check]]:
    return image_checks(seen.frames), alignment_checks(seen)


@_checks_of_kind.register
def _checks_of_depth(seen: DepthFrames, run: Sequence[Frame[Shot]]) -> tuple[list[Check], list[Check]]:
    return _image_checks(seen.frames, run), registration_checks(seen.frames, run)


def _run_of(
    recording: Recording[Any], spread: Sequence[Any], view: SpreadView, count: int, search: FloorSearch
) -> tuple[list[Any], list[Check]]:
    """Consecutive frames around the one of some spread over the recording that differs most from the usual picture,
    and the checks of times."""
    small = np.stack([frame.image[::8, ::8].reshape(-1) for frame in spread]).astype(np.float32)
    change = (np.abs(small - np.median(small, axis=0)) > 25).mean(axis=1)
    # A change of light changes everything: it is no movement.
    change[change > 0.5] = 0.0
    count = max(3, min(count, recording.n_frames))
    first = max(0, min(spread[int(np.argmax(change))].index - count // 2, recording.n_frames - count))
    run = recording.at(list(range(first, min(first + count, recording.n_frames))))
    return run, frame_checks(recording, view.shots, run, min(search.frames, recording.n_frames) + count)


def _image_checks(spread: Sequence[Any], run: Sequence[Any]) -> list[Check]:
    """Copies and light of images that are no pair."""
    light = light_checks([frame.image for frame in spread])
    return [repeated_check([frame.image for frame in run]), *light, *fields_checks(spread)]


def _video_of_one(path: Path, options: OpenOptions) -> tuple[Recording[SingleCamera], GroundCamera | None] | None:
    """The video of one camera and its camera.toml where one is given; None of everything else. Raises InputError: a
    camera.toml that is not of this video."""
    if options.calibration is not None:
        if not holds_one_camera(options.calibration):
            return None
    elif holds_pair(path, options):
        return None
    else:
        with suppress(InputError):
            find_layout(path, options)
            return None  # two views in one video
        with suppress(InputError):
            load_rig(path if path.is_dir() else path.parent)
            return None  # meant as a pair
    try:
        video = open_video(path, replace(options, calibration=None))
    except InputError:
        return None
    return video, load_one_camera(options.calibration, video.sensor.size) if options.calibration else None


def _checks_of_one(
    video: Recording[SingleCamera], camera: GroundCamera | None, frames: int, search: FloorSearch
) -> list[Check]:
    """Checks of one camera: times, light, whether it stands still, and its calibration. Raises InputError: frames
    without times."""
    refuse_untimed(video)
    spread, view = frames_of_one_view(video, search.frames)
    run, times = _run_of(video, spread, view, frames, search)
    standing = Standing(Viewpoints([], video.sensor.focal_widths))
    for frame in run:
        standing.update(frame.index, frame.timestamp_s, frame.images)
    note = "one camera, no calibration: places are in pixels" if camera is None else "one camera, calibrated"
    return [
        Check("calibration and layout", True, math.nan, note=note),
        *times,
        *_image_checks(spread, run),
        flicker_check([grey_level(frame.image) for frame in run]),
        *(spread_checks(view) if view.elsewhere else standing_checks(standing, "the view before is not shown again")),
        *([camera_height(camera.height_m, "above the floor, by the calibration")] if camera else []),
    ]


EVERY_NTH_FRAME = 10
"""Depth and heights are measured in every n-th frame (for speed)."""
MEASUREMENTS_MAX = 1000
"""Measurements that the height of people depends on."""


class RecordingWatch(Carried):
    """Watches a run: do both cameras show the same, at the same time, at a plausible scale?"""

    CARRIED = "_motion", "_speed", "_frames", "_valid", "_things", "_levels"

    def __init__(self, rig: FloorRig) -> None:
        self._rig = rig
        self._motion = MotionWatch()
        self._speed = SpeedWatch()
        self._frames = 0
        self._valid: deque[float] = deque(maxlen=MEASUREMENTS_MAX)
        self._things: deque[F64] = deque(maxlen=MEASUREMENTS_MAX)
        self._levels: deque[float] = deque(maxlen=MEASUREMENTS_MAX)

    def update(
        self, timestamp_s: float, depth: Depth | None, foreground: U8 | None, places: Mapping[int, tuple[float, float]]
    ) -> None:
        """Take the next frame, with (h, w) uint8 at its size, non-zero where people are, None where there is none, and
        where they stand [m], by id."""
        self._speed.update(timestamp_s, places)
        if depth is not None:
            self._motion.update(depth.thumbnails(), timestamp_s)
            self._levels.append(grey_level(depth.rectified[0]))
        if depth is not None and self._frames % EVERY_NTH_FRAME == 0:
            self._valid.append(float(np.isfinite(depth.disparity).mean()))
            if foreground is not None:
                rig = self._rig
                things = standing_things(depth.disparity, foreground > 0, rig.geometry, rig.floor, depth.step)
                self._things.append(things)
        self._frames += 1

    def checks(self) -> list[Check]:
        """What is known so far."""
        valid = float(np.median(self._valid)) if self._valid else np.nan
        things = np.concatenate(self._things) if self._things else np.empty((0, 2))
        # Fewest measured things by which the scale is doubted: shadows and doors are no people.
        heights = large_heights(things) if len(things) >= 20 else np.empty(0)
        return [
            *self._motion.checks(),
            flicker_check(list(self._levels)),
            limited("valid disparity", valid, "", "share of the picture, median frame", least=VALID_SHARE_MIN),
            height_check(heights),
            self._speed.check(),
        ]


def refuse_unless_ok(checks: list[Check], source: str) -> None:
    """Raise InputError when a check fails; warnings pass."""
    if failed := [check for check in checks if check.failed]:
        raise InputError(f"{source}: checks failed: {'; '.join(check.sentence for check in failed)}")
