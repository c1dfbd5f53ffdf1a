"""What must be known before the first frame: the rig as it is, disparities to search, the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import WorkError
from calib.rig import DepthSensor, Floor
from calib.types import F64
from planview.checks.check import Check
from planview.checks.pair import alignment_checks, image_checks
from planview.checks.scene import floor_checks
from planview.engine.config import Config
from planview.engine.front_end import RgbdFrontEnd, StereoFrontEnd
from planview.engine.gated import GatedMatching
from stereo.floor import BLIND_SENSOR, FloorEstimator, FloorSearch, floor_in, setup_frames
from stereo.matcher import DisparityRange, Matcher, SgbmMatcher, disparity_range
from stereo.recording import Recording, RgbdRecording, StereoFrame
from stereo.rectify import Rectifier, aligned_rectifier
from stereo.rgbd import RgbdRectifier
from stereo.rig_correction import MatchParams, RigCorrection, match_corners
from stereo.sampled_sgm import SampledMatcher

ORDER_FRAMES = 4
"""Setup frames in which left and right are told apart (our choice)."""
MIN_ORDER_MATCHES = 40
"""Fewest corners matched in both images by which they are (our choice)."""
ORDER_SEARCH = MatchParams(search_px=24)
"""Rows are wide apart when the wrong calibration is taken to an image."""
MIN_NEARER = 0.5
"""Smallest share of corners nearer than infinity: of swapped images nearly all are beyond (our choice)."""
MAX_ROW_OFFSET_DEG = 1.0
"""Largest median row offset of the corners as an angle: a camera that turned by more has lost its calibration (our
choice; a worn factory calibration has 0.1)."""


@dataclass(frozen=True, eq=False)
class Setup:
    """A stereo recording made ready.

    Attributes:
        rectifier: of the calibration as the recording corrects it.
        floor: found in the recording or read from ``world.toml``.
        disparities: range that people on that floor can have.
        floor_source: "found" or the file that gave it.
        correction: what the recording tells of the calibration.
        checks: what these frames tell of the calibration.
    """

    rectifier: Rectifier
    floor: Floor
    disparities: DisparityRange
    floor_source: str
    correction: RigCorrection
    sensor: DepthSensor | None = None
    checks: tuple[Check, ...] = ()

    @property
    def calibration(self) -> str:
        """File or folder the calibration came from."""
        return self.rectifier.rig.source

    @property
    def vertical_residual_px(self) -> float:
        """Row offset left after rectification [px]."""
        return self.correction.after_px

    def front_end(self, config: Config, matcher: Matcher | None = None) -> StereoFrontEnd:
        """The stages before the foreground; with SGBM over the disparities when there is no matcher."""
        return StereoFrontEnd(self.rectifier, matcher or self._sgbm(config), self.disparities)

    def gated(self, config: Config, shape: tuple[int, int], reduction: int) -> GatedMatching:
        """Matching where something may have changed; ``shape`` and ``reduction`` are those of the foreground."""
        geometry, masks = self.rectifier.geometry, (self.rectifier.mask, self.rectifier.right_mask)
        matcher = self._sgbm(config) if reduction == 1 else SampledMatcher(geometry, config.sgbm, reduction, *masks)
        return GatedMatching(self.rectifier, matcher, self.floor, config.range, config.matching, shape)

    def _sgbm(self, config: Config) -> SgbmMatcher:
        masks = self.rectifier.mask, self.rectifier.right_mask
        return SgbmMatcher(self.rectifier.geometry, config.sgbm, self.disparities, *masks)


@dataclass(frozen=True, eq=False)
class RgbdSetup:
    """A recording of images with depth made ready.

    Attributes:
        rectifier: takes the distortion out.
        floor, disparities, floor_source: as of ``Setup``, the disparities being equivalent ones.
        calibration: file or folder it came from.
        sensor: how the depth was measured.
        correction: of the calibration: none, as there is nothing to match.
    """

    rectifier: RgbdRectifier
    floor: Floor
    disparities: DisparityRange
    floor_source: str
    calibration: str
    sensor: DepthSensor
    vertical_residual_px: float = math.nan
    correction: str = ""

    @property
    def checks(self) -> tuple[Check, ...]:
        """What the first frames tell."""
        return tuple(floor_checks(self.floor))

    def front_end(self, config: Config, matcher: Matcher | None = None) -> RgbdFrontEnd:
        """The stages before the foreground; there is nothing to match."""
        return RgbdFrontEnd(self.rectifier)

    def gated(self, config: Config, shape: tuple[int, int], reduction: int) -> None:
        """There is nothing to match."""


AnySetup = Setup | RgbdSetup


def set_up_any(recording: Recording | RgbdRecording, config: Config) -> AnySetup:
    """Make a recording of a pair or of images with depth ready (errors of ``set_up`` and ``set_up_rgbd``)."""
    return set_up_rgbd(recording, config) if isinstance(recording, RgbdRecording) else set_up(recording, config)


def set_up_rgbd(recording: RgbdRecording, config: Config) -> RgbdSetup:
    """Find the floor in frames spread over a recording of images with depth.

    Raises:
        WorkError: no usable frame, hardly any depth, or no floor visible.
    """
    rectifier = RgbdRectifier(recording.camera, recording.sensor, config.rectify)
    if recording.world_SE3_camera is not None:
        floor, source = Floor(recording.world_SE3_camera), "world.toml"
    else:
        depths = [rectifier(frame).depth_m for frame in setup_frames(recording, config.analysis.setup_frames)]
        floor, source = floor_in(depths, rectifier.geometry, config.floor, BLIND_SENSOR), "found"
    return RgbdSetup(rectifier, floor, rectifier.disparities(), source, recording.source, recording.sensor)


def set_up(recording: Recording, config: Config) -> Setup:
    """Correct the calibration and find the floor in frames spread over the recording.

    Raises:
        WorkError: no usable frame, left and right swapped, hardly any disparity, or no floor visible.
    """
    search = floor_search(config)
    frames = setup_frames(recording, search.frames)
    plain = Rectifier(recording.rig, config.rectify)
    matches = _corners(plain, frames)
    refuse_foreign(recording.path, plain, matches)
    rectifier, correction = aligned_rectifier(recording.rig, frames, config.rectify)
    if recording.world_SE3_left is not None:
        floor, source = Floor(recording.world_SE3_left), "world.toml"
    else:
        floor, source = FloorEstimator(rectifier, search)(frames), "found"
    checks = *image_checks(frames), *alignment_checks(plain, matches, correction), *floor_checks(floor)
    searched = disparity_range(rectifier.geometry, config.range, floor)
    return Setup(rectifier, floor, searched, source, correction, checks=checks)


def floor_search(config: Config) -> FloorSearch:
    """How a run with this configuration looks for its floor."""
    return FloorSearch(
        frames=config.analysis.setup_frames,
        rectify=config.rectify,
        range=config.range,
        sgbm=config.sgbm,
        floor=config.floor,
    )


def refuse_foreign(path: Path, rectifier: Rectifier, matches: F64) -> None:
    """Matched corners must lie nearer than infinity and about on their rows.

    Args:
        rectifier: of the calibration as it is, without correction.
        matches: (N, 4) float64 [px] in its images, as from ``match_corners``.
    Raises:
        WorkError: left and right are swapped, or the calibration is another rig's.
    """
    if len(matches) < MIN_ORDER_MATCHES:
        return
    beyond = float(np.mean(matches[:, 0] - matches[:, 2] <= -0.5))
    if beyond > 1.0 - MIN_NEARER:
        raise WorkError(
            f"{path}: expected the left camera's images left and the right one's right, found {beyond:.0%} of "
            "the matched corners beyond infinity: left and right are swapped, or the calibration is wrong"
        )
    rows_deg = math.degrees(float(np.median(np.abs(matches[:, 3]))) / rectifier.geometry.focal_v_px)
    if rows_deg > MAX_ROW_OFFSET_DEG:
        raise WorkError(
            f"{path}: expected matched corners on the same row, found them {rows_deg:.1f} degrees off: "
            "left and right are swapped, or the calibration is another rig's (planview check tells)"
        )


def _corners(rectifier: Rectifier, frames: Sequence[StereoFrame]) -> F64:
    searched = disparity_range(rectifier.geometry)
    largest = float(searched.first_px + searched.count)
    found = [np.empty((0, 4))]
    for frame in frames[:: -(-len(frames) // ORDER_FRAMES)]:
        pair = rectifier(frame.left, frame.right)
        found.append(match_corners(pair.left_grey, pair.right_grey, largest, ORDER_SEARCH, -largest))
    return np.concatenate(found)
