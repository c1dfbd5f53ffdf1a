"""A recording made ready before its first frame: the rig as it is, disparities to search and the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import InputError, WorkError
from calib.rig import Floor
from calib.types import F32, F64
from planview.checks.check import Check
from planview.checks.registration import run_checks
from planview.checks.scene import alignment_checks, floor_checks, image_checks
from planview.engine.config import Config
from planview.maps.grid import FloorRig, Grid, floor_in_view
from stereo.depth import RectifiedGeometry
from stereo.floor import DepthFrames, FloorSearch, PairFrames, setup_frames
from stereo.matcher import DisparityRange, disparity_range
from stereo.recording import RgbdRecording, StereoRecording
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier


@dataclass(frozen=True, eq=False, kw_only=True)
class Setup(FloorRig):
    """A recording of a pair, or of images with depth, made ready.

    Attributes:
        rectifier: of a pair, of the calibration as the recording corrects it; of images with depth without distortion.
        checks: what these frames show of the calibration.
    """

    rectifier: Rectifier | RgbdRectifier
    checks: tuple[Check, ...]


def refuse_foreign_disparity(disparity: F32, shape: tuple[int, int], searched: DisparityRange) -> None:
    """Refuse what is no (H, W) float32 disparity in pixels, as a matcher of the user's may give; ``searched`` are those
    that people on the floor can have. Raises InputError: another shape or kind of number, sixteenths of a pixel, depth,
    or a number for "none"."""
    if disparity.shape != shape or disparity.dtype != np.float32:
        raise InputError(
            f"matcher: expected float32 disparities of {shape}, found {disparity.dtype} of {disparity.shape}"
        )
    few = disparity[::8, ::8]
    valid = few[np.isfinite(few)]
    if not len(valid):
        return
    largest, none = searched.first_px + searched.count, float(((valid == 0) | (valid <= -1)).mean())
    # Share of disparities of exactly 0, or below -1, from which they stand for "none" (our choice): nothing lies
    # beyond infinity, and what lies there has a disparity of about 0.
    if none > 0.2:
        raise InputError(f"matcher: expected NaN where there is no disparity, found {none:.0%} of 0 or below -1")
    if (middle := float(np.median(valid))) > largest:
        raise InputError(
            f"matcher: expected disparities in pixels, up to {largest} on this floor, found {middle:.0f} in "
            "the middle of the range: sixteenths of a pixel (divide OpenCV's by 16), or depth?"
        )


def set_up(recording: StereoRecording | RgbdRecording, config: Config, pose_file: str = "world.toml") -> Setup:
    """Find the floor in frames spread over a recording; of a pair correct the calibration first.

    Args:
        pose_file: name of the file that gave the recording its pose, where it has one.
    Raises:
        InputError: a floor of which the camera sees nothing or too much.
        WorkError: no usable frame, left and right swapped, hardly any disparity or depth, or no floor visible.
    """
    search = floor_search(config)
    if isinstance(recording, RgbdRecording):
        return _set_up_rgbd(recording, config, search, pose_file)
    seen = PairFrames(recording.rig, setup_frames(recording, search.frames), search)
    refuse_foreign(recording.path, seen.plain, seen.matches)
    light = image_checks(seen.frames)
    try:
        if recording.world_SE3_left is not None:
            floor, source = Floor(recording.world_SE3_left), pose_file
        else:
            floor, source = seen.floor(), "found"
            if floor.doubt and any(check.name == "compression" and check.failed for check in light):
                raise WorkError(f"no floor found: {floor.doubt}, and compressed blocks match like such a plane")
    except WorkError as error:
        raise _explained(error, light) from error
    checks = *light, *alignment_checks(seen), *floor_checks(floor)
    geometry = seen.rectifier.geometry
    return Setup(
        geometry, floor, source, seen.rectifier.rig.source, seen.correction.after_px,
        disparity_range(geometry, config.range, floor), *_analysed(recording.path, geometry, floor, source, config),
        correction=str(seen.correction), rectifier=seen.rectifier, checks=checks,
    )  # fmt: skip


def _explained(error: WorkError, checks: Sequence[Check]) -> WorkError:
    """A floor that is not found, behind what is wrong with the images."""
    return WorkError("; ".join([*(check.sentence for check in checks if check.failed), str(error)]))


def _set_up_rgbd(recording: RgbdRecording, config: Config, search: FloorSearch, pose_file: str) -> Setup:
    seen = DepthFrames(recording, search)
    if recording.world_SE3_left is not None:
        floor, source = Floor(recording.world_SE3_left), pose_file
    else:
        try:
            floor, source = seen.floor(), "found"
        except WorkError as error:
            raise _explained(error, run_checks(recording)[:1]) from error  # a delay by depth in another unit is none
    geometry = seen.rectifier.geometry
    return Setup(
        geometry, floor, source, recording.source, math.nan, seen.searched,
        *_analysed(recording.path, geometry, floor, source, config),
        sensor=recording.sensor, rectifier=seen.rectifier, checks=tuple(floor_checks(floor)),
    )  # fmt: skip


def _analysed(path: Path, geometry: RectifiedGeometry, floor: Floor, source: str, config: Config) -> tuple[Grid, int]:
    """Grid and reduction of a view. Raises InputError: a floor of which the camera sees nothing or too much."""
    try:
        grid = floor_in_view(geometry, floor.world_SE3_left, config.maps)
    except ValueError as error:
        raise InputError(f"{path} (floor: {source}): {error}") from error
    return grid, -(-geometry.width // config.analysis.width_px)


def floor_search(config: Config) -> FloorSearch:
    """How a run with this configuration looks for its floor."""
    frames = config.analysis.setup_frames
    return FloorSearch(frames=frames, rectify=config.rectify, range=config.range, sgbm=config.sgbm, floor=config.floor)


def refuse_foreign(path: Path, rectifier: Rectifier, matches: F64) -> None:
    """Matched corners, (N, 4) float64 [px] as from ``match_corners``, lie nearer than infinity and about on their rows
    in the images of the calibration as it is. Raises WorkError: left and right are swapped, or the calibration is
    another rig's."""
    # Fewest corners matched in both images by which they are (our choice).
    if len(matches) < 40:
        return
    beyond = float(np.mean(matches[:, 0] - matches[:, 2] <= -0.5))
    # Of swapped images nearly all are beyond (our choice).
    if beyond > 0.5:
        raise WorkError(
            f"{path}: expected the left camera's images left and the right one's right, found {beyond:.0%} of "
            "the matched corners beyond infinity: left and right are swapped, both cameras are upside down, or "
            "the calibration is wrong"
        )
    rows_deg = math.degrees(float(np.median(np.abs(matches[:, 3]))) / rectifier.geometry.focal_v_px)
    # Largest median row offset of the corners as an angle: a camera that turned by more has lost its calibration (our
    # choice; a worn factory calibration has 0.1).
    if rows_deg > 1.0:
        raise WorkError(
            f"{path}: expected matched corners on the same row, found them {rows_deg:.1f} degrees off: "
            "left and right are swapped, or the calibration is another rig's"
        )
