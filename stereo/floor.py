"""The floor of a stereo recording: the one estimate behind runs, their examination, calibration and benches."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from pydantic import Field

from calib.errors import WorkError
from calib.floor.find import find_floor
from calib.floor.plane import FloorParams
from calib.params import Params
from calib.rig import Floor
from calib.types import F32, F64
from stereo.depth import DepthFromDisparity, RectifiedGeometry, back_project
from stereo.matcher import RangeParams, SgbmParams, TwoWayMatcher, disparity_range
from stereo.recording import Frame, Recorded, StereoFrame
from stereo.rectify import RectifiedPair, Rectifier, RectifyParams

SETUP_FRAMES = 24
"""Frames, spread over a recording, in which floor and rig are measured (our choice)."""
STEP_PX = 3
"""The floor is fitted to every n-th row and column."""
MIN_WATCHED, NEARER = 5, 1.15
"""What moves is told in so many frames at least; it is nearer by this factor than the usual depth of its pixel: a
person half a metre in front of a wall 4 m away (our choice)."""
MIN_VALID = 0.03
"""Smallest share of pixels with disparity in the median frame: a bare room still has more, unrelated images less
(our choice)."""


_BLIND_PAIR = (
    "left and right are swapped, the calibration belongs to another rig, or the images show no texture "
    "(planview check tells)"
)
BLIND_SENSOR = "the depth has another scale than the calibration says, or everything is out of the sensor's range"


class FloorSearch(Params):
    """How the floor of a recording is looked for; the defaults are those of a run."""

    frames: int = Field(SETUP_FRAMES, ge=1, le=1000)
    """Frames to look at, spread over the recording."""
    rectify: RectifyParams = RectifyParams()
    range: RangeParams = RangeParams()
    sgbm: SgbmParams = SgbmParams()
    floor: FloorParams = FloorParams()


class FloorEstimator:
    """The floor in rectified pairs of one rig (see ``calib.floor.find.find_floor``).

    Attributes:
        rectifier: of the rig as the recording corrects it.
        disparities: range searched, from infinity to ``range.nearest_m``.
    """

    def __init__(self, rectifier: Rectifier, search: FloorSearch | None = None) -> None:
        self.rectifier = rectifier
        self._search = search or FloorSearch()
        geometry = rectifier.geometry
        self.disparities = disparity_range(geometry, self._search.range)
        masks = rectifier.mask, rectifier.right_mask
        self._match = TwoWayMatcher(geometry, self._search.sgbm, self.disparities, *masks)
        self._to_depth = DepthFromDisparity(geometry)

    def disparity(self, pair: RectifiedPair) -> F32:
        """(H, W) float32 disparity [px] of a pair, without the matcher's lag; NaN where unknown."""
        return self._match(pair.left_grey, pair.right_grey)

    def depth(self, pair: RectifiedPair) -> F32:
        """(H, W) float32 depth [m] of a pair; NaN where unknown."""
        return self._to_depth(self.disparity(pair))

    def floor(self, depths: Iterable[F32]) -> Floor:
        """The floor common to some frames.

        Args:
            depths: (H, W) float32 [m] of each, as from ``depth``.
        Raises:
            WorkError: hardly any disparity is valid, or no floor is visible.
        """
        return floor_in(depths, self.rectifier.geometry, self._search.floor, _BLIND_PAIR)

    def __call__(self, frames: Iterable[StereoFrame]) -> Floor:
        """The floor common to some frames as recorded (same errors as ``floor``)."""
        return self.floor(self.depth(self.rectifier(frame.left, frame.right)) for frame in frames)


def floor_in(depths: Iterable[F32], geometry: RectifiedGeometry, params: FloorParams, blind: str) -> Floor:
    """The floor common to the depth images of some frames.

    Args:
        depths: (H, W) float32 [m] of each, NaN where unknown.
        geometry: of those images.
        blind: what may be wrong when there is hardly any depth, for the message.
    Raises:
        WorkError: there is hardly any depth, or no floor is visible.
    """
    grids = [back_project(d, geometry)[::STEP_PX, ::STEP_PX] for d in depths]
    clouds = [grid.reshape(-1, 3) for grid in grids]
    valid = float(np.median([np.isfinite(cloud[:, 2]).mean() for cloud in clouds])) if clouds else 0.0
    if valid < MIN_VALID:
        raise WorkError(f"expected depth in at least {MIN_VALID:.0%} of the pixels, found {valid:.1%}: {blind}")
    sigma_z = None
    if geometry.depth_std_min_m > 0.0:
        share = params.disparity_std_px / geometry.disparity_std_px  # what medians leave of a frame's noise
        sigma_z = [np.float32(share) * geometry.depth_std_m(cloud[:, 2]) for cloud in clouds]
    return find_floor(
        clouds, focal_px=geometry.focal_u_px, baseline_m=geometry.baseline_m, sigma_z=sigma_z,
        moved=_moved(grids), params=params,
    )  # fmt: skip


def _moved(grids: list[F32]) -> F64 | None:
    """(M, 3) points [m] of patches in front of what is usually measured in their pixels: mostly people."""
    if len(grids) < MIN_WATCHED:
        return None
    inverse = 1.0 / np.maximum(np.stack(grids)[..., 2], 0.01)
    # Unknown depth counts as farther than all else, so that what is hardly ever measured has no usual depth.
    usual = np.median(np.nan_to_num(inverse, nan=0.0), axis=0)
    nearer = (inverse > NEARER * usual) & (usual > 0)
    patches = [cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0 for mask in nearer]
    return np.concatenate([grid[patch] for grid, patch in zip(grids, patches, strict=True)]).astype(np.float64)


def setup_frames(recording: Recorded[Frame], count: int = SETUP_FRAMES) -> list[Frame]:
    """Usable frames spread over a recording.

    Raises:
        WorkError: there is none.
    """
    frames = recording.sample(count)
    if not frames:
        raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")
    return frames
