"""A recording made ready before its first frame: the rig as it is, disparities to search and the floor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import InputError, WorkError
from calib.rig import Floor
from calib.world import RIGS_FILE
from planview.checks.check import Check
from planview.checks.images import image_checks
from planview.checks.motion import still_checks
from planview.checks.scene import (
    alignment_checks,
    explanation_checks,
    floor_checks,
    given_floor_check,
    run_checks,
)
from planview.engine.config import Config
from planview.maps.grid import FloorRig, Grid, floor_in_view
from stereo.depth import RectifiedGeometry
from stereo.doctor.diagnose import diagnose
from stereo.doctor.hypotheses import UNEXPLAINED
from stereo.floor import DepthFrames, FloorSearch, PairFrames, floor_in, spread_frames
from stereo.matcher import Matcher, disparity_range
from stereo.measure import DepthMeasure, Measure, PairMeasure
from stereo.recording import DepthCamera, Recording, StereoPair
from stereo.viewpoint import Viewpoints


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup(FloorRig):
    """A recording of a pair, or of images with depth, made ready.

    Attributes:
        measure: gives the depth of a shot, by the calibration as the recording corrects it.
        viewpoints: where its cameras looked in these frames.
        checks: what these frames show of the calibration.
        matcher: of the user's own; None for SGBM.
    """

    measure: Measure
    viewpoints: Viewpoints
    checks: tuple[Check, ...]
    matcher: Matcher | None = None


def set_up(
    recording: Recording[StereoPair | DepthCamera],
    config: Config,
    matcher: Matcher | None = None,
) -> Setup:
    """Find the floor in frames spread over a recording; of a pair correct the calibration first.

    Args:
        matcher: of whole pairs; SGBM when None.
    Raises:
        InputError: a given floor that the images show to be so no more, or of which the camera sees nothing or too
            much.
        WorkError: no usable frame, left and right swapped, hardly any disparity or depth, or no floor visible.
    """
    seen = spread_frames(recording, floor_search(config))
    return SETUPS[type(seen)](seen, recording, config, matcher)


def _set_up_pair(seen: PairFrames, recording: Recording[StereoPair], config: Config, matcher: Matcher | None) -> Setup:
    light = image_checks(seen.frames)
    search = floor_search(config)
    try:
        refuse_foreign(seen)
        floor, source = _floor_of(recording, seen, config)
        if floor.doubt and any(check.name == "compression" and check.failed for check in light):
            raise WorkError(f"no floor found: {floor.doubt}, and compressed blocks match like such a plane")
    except WorkError as error:
        raise _explain(error, [*light, *still_checks(seen, seen.frames)[:1]], recording, search) from error
    checks = [*light, *alignment_checks(seen), *floor_checks(floor)]
    checks += explanation_checks(recording, checks, floor, search)
    geometry = seen.rectifier.geometry
    grid, step = _analyse(recording.path, geometry, floor, source, config)
    searched = disparity_range(geometry, config.range, floor)
    return Setup(
        geometry, floor, source, seen.rectifier.rig.source, seen.correction.after_px, searched, grid, step,
        correction=str(seen.correction), checks=tuple(checks), viewpoints=seen.viewpoints,
        measure=PairMeasure(seen.rectifier, config.sgbm, searched, step, matcher), matcher=matcher,
    )  # fmt: skip


def _explain(
    error: WorkError, checks: Sequence[Check], recording: Recording[StereoPair | DepthCamera], search: FloorSearch
) -> WorkError:
    """A floor that is not found, behind what is wrong with the images and what would explain it."""
    reasons = [check.sentence for check in checks if check.failed]
    if not reasons:
        reasons.append(str(diagnose(recording, search) or UNEXPLAINED))
    return WorkError(f"{recording.path}: {'; '.join([*reasons, str(error)])}", in_pictures=True)


def refuse_matcher(path: Path, matcher: Matcher | None) -> None:
    """Raise InputError where a matcher is given for a recording that is not stereo."""
    if matcher is not None:
        raise InputError(f"{path}: a matcher of your own needs a recording of stereo pairs alone")


def _set_up_depth(
    seen: DepthFrames, recording: Recording[DepthCamera], config: Config, matcher: Matcher | None
) -> Setup:
    refuse_matcher(recording.path, matcher)
    sensor = recording.sensor
    try:
        floor, source = _floor_of(recording, seen, config)
    except WorkError as error:
        # A delay of depth in another unit is none.
        seen_in_images = run_checks(recording)[0], still_checks(seen, seen.frames)[0]
        raise _explain(error, seen_in_images, recording, floor_search(config)) from error
    geometry = seen.rectifier.geometry
    grid, step = _analyse(recording.path, geometry, floor, source, config)
    checks = [*floor_checks(floor), *run_checks(recording)]
    checks += explanation_checks(recording, checks, floor, floor_search(config))
    return Setup(
        geometry, floor, source, sensor.source, math.nan, seen.searched, grid, step,
        technology=sensor.technology, viewpoints=seen.viewpoints,
        checks=tuple(checks), measure=DepthMeasure(seen.rectifier, step),
    )  # fmt: skip


SETUPS: dict[type, Callable[..., Setup]] = {PairFrames: _set_up_pair, DepthFrames: _set_up_depth}
"""By the frames that were looked at, what makes a recording ready."""


def _floor_of(
    recording: Recording[StereoPair | DepthCamera], seen: PairFrames | DepthFrames, config: Config
) -> tuple[Floor, str]:
    """The floor of a recording and where it came from: the given one, unless the images show that it is so no more."""
    pose_file = RIGS_FILE if recording.name else "world.toml"
    given = recording.sensor.world_SE3_left
    if given is None:
        return seen.floor(), "found"
    floor = Floor(given)
    _analyse(recording.path, seen.rectifier.geometry, floor, pose_file, config)  # one out of view is refused
    with suppress(WorkError):
        # A sixth of the frames shows well enough that a floor is where it was.
        depths = [seen.depth_of(frame) for frame in seen.frames[::6]]
        there = floor_in(depths, seen.rectifier.geometry, config.floor, near=given)
        if given_floor_check(seen, given, Floor(there.world_SE3_left), pose_file).ok:
            return floor, pose_file
    with suppress(WorkError):  # a floor that is hidden is given
        check = given_floor_check(seen, given, seen.floor(), pose_file)
        if check.failed:
            raise InputError(f"{recording.path}: {check.note}")
    return floor, pose_file


def _analyse(path: Path, geometry: RectifiedGeometry, floor: Floor, source: str, config: Config) -> tuple[Grid, int]:
    """Grid and reduction of a view. Raises InputError: a floor of which the camera sees nothing or too much."""
    try:
        grid = floor_in_view(geometry, floor.world_SE3_left, config.maps)
    except ValueError as error:
        raise InputError(f"{path} (floor: {source}): {error}") from error
    return grid, -(-geometry.width // config.analysis.width_px)


def floor_search(config: Config) -> FloorSearch:
    """Search for the floor of a run with this configuration."""
    frames = config.analysis.setup_frames
    return FloorSearch(frames=frames, rectify=config.rectify, range=config.range, sgbm=config.sgbm, floor=config.floor)


def refuse_foreign(seen: PairFrames) -> None:
    """Matched corners lie nearer than infinity and about on their rows in the images of the calibration as it is.
    Raises WorkError: they do not."""
    matches = seen.matches
    # Fewest corners matched in both images by which they are (our choice).
    if len(matches) < 40:
        return
    beyond = np.mean(matches[:, 0] <= matches[:, 2] - 0.5)
    # Of swapped images nearly all are beyond (our choice).
    if beyond > 0.5:
        raise WorkError(f"expected matched corners nearer than infinity, found {beyond:.0%} of them beyond")
    rows_deg = np.degrees(np.median(np.abs(matches[:, 3])) / seen.plain.geometry.focal_v_px)
    # Largest median row offset of the corners as an angle: a camera that turned by more has lost its calibration (our
    # choice; a worn factory calibration has 0.1).
    if rows_deg > 1.0:
        raise WorkError(f"expected matched corners on the same row, found them {rows_deg:.1f} degrees off")
