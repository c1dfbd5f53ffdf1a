"""Some pairs of a recording under a calibration, and how well their rows and fields agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from calib.doubt import Score
from calib.rig import StereoRig
from calib.types import F64, AnyArray
from stereo.doctor.scenes import DepthScene
from stereo.matcher import DisparityRange, SgbmMatcher
from stereo.rectify import Rectified, Rectifier, RectifyParams, is_ideal
from stereo.rig_correction import match_corners

WIDTH = 320
"""Frames are looked at this wide [px] (for speed)."""
CORNERS = 80
"""Corners tried in a frame."""
ROW_PX = 1.0
"""Row offset from which on a corner does not count [px of WIDTH]."""
LEAST_ALIGNED = 0.1
"""Least share of the corners on their rows: healthy pairs have 0.35 or more, unrelated images below 0.02."""
ROWS_WEIGHT = 10.0
"""Corners on their rows are worth this many times as much as points on a floor of the same share: a mirrored view of a
camera that looks straight down has a floor, and on its rows are a tenth fewer corners, of some hundred."""
MIN_CURVED = 60
"""Fewest corners that show how rows bend."""
CURVED_STEPS = 10
"""Steps of the robust fit of that."""
FITTED_WORTH = 0.8
"""Weight of a corner where rows are fitted to it."""
CHANGE_LEVEL = 20.0
"""Grey levels by which what moves differs from the usual picture (our choice)."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Recorded pairs, their calibration, and what row offsets may be: none, alike for the whole image ("shifted"), or
    smooth over it ("curved"), as lenses and turned cameras make them where the calibration is that of rectified images.
    """

    rig: StereoRig
    shots: Sequence[tuple[AnyArray, AnyArray]]
    rows: Literal["aligned", "shifted", "curved"] = "aligned"

    def first(self, count: int) -> Pairs:
        return replace(self, shots=self.shots[:count])

    @cached_property
    def _rectifier(self) -> Rectifier:
        return Rectifier(self.rig, RectifyParams(working_px=WIDTH))

    @cached_property
    def _rectified_pairs(self) -> list[Rectified]:
        """Without pairs whose images, as they would be, are of another size than the calibration's."""
        rectified = []
        for left, right in self.shots:
            sizes = left.shape[1::-1], right.shape[1::-1]
            if sizes == (self.rig.left.size, self.rig.right.size):
                rectified.append(self._rectifier(np.ascontiguousarray(left), np.ascontiguousarray(right)))
        return rectified

    @cached_property
    def _matches(self) -> F64:
        """(N, 4) corners in both images, nearer than infinity where that is known."""
        reach = 0.25 * WIDTH
        is_aligned = self.rows == "aligned"
        farthest = -0.5 if is_aligned else -reach  # where infinity is, raw images do not show
        search_px = 6 if is_aligned else 24
        matches = [np.empty((0, 4))]
        for pair in self._rectified_pairs:
            found = match_corners(pair.left_grey, pair.right_grey, reach, -reach, features=CORNERS, search_px=search_px)
            matches.append(found[found[:, 0] - found[:, 2] > farthest])
        return np.concatenate(matches)

    @cached_property
    def _offsets(self) -> F64:
        """(N,) row offsets of the corners, without what they may be."""
        offsets = self._matches[:, 3]
        if self.rows == "shifted" and len(offsets):
            return np.asarray(offsets - np.median(offsets))
        if self.rows == "curved" and len(offsets) >= MIN_CURVED:
            return offsets - _smooth(self._matches)
        return offsets

    @property
    def aligned_share(self) -> float:
        """Share of the corners that lie on their rows."""
        if not self.shots or not (is_ideal(self.rig) or self.rows == "aligned"):
            return 0.0
        near = np.maximum(0.0, 1.0 - (self._offsets / ROW_PX) ** 2)
        worth = 1.0 if self.rows == "aligned" else FITTED_WORTH
        return worth * float(near.sum()) / (CORNERS * len(self.shots))

    @property
    def rows_px(self) -> float:
        """Median row offset [px of 640]."""
        if not len(self._offsets):
            return math.nan
        return 640.0 / WIDTH * float(np.median(np.abs(self._offsets)))

    @property
    def scene(self) -> DepthScene:
        """The depth that matching gives: in another unit nothing is too far."""
        geometry = self._rectifier.geometry
        searched = DisparityRange(0, 16 * math.ceil(0.25 * WIDTH / 16))
        match = SgbmMatcher(geometry, None, searched, self._rectifier.mask, self._rectifier.right_mask)
        depths = []
        for pair in self._rectified_pairs:
            disparity = match(pair.left_grey, pair.right_grey)
            known = np.where(disparity >= 0.5, disparity, np.float32(np.nan))
            depths.append(np.asarray(np.float32(geometry.disparity_metre) / known, dtype=np.float32))
        return DepthScene(depths, geometry)


def _smooth(matches: F64) -> F64:
    """(N,) part of the row offsets that changes smoothly over the images."""
    x, y, x_right = 2 * matches[:, :3].T / WIDTH - 1
    offsets = matches[:, 3]
    basis = np.column_stack([x**0, x, y, x * x, x * y, y * y, x_right, x_right * y])
    weights = np.ones(len(x))
    for _ in range(CURVED_STEPS):
        smooth = basis @ np.linalg.lstsq(basis * weights[:, None], offsets * weights, rcond=None)[0]
        weights = 1.0 / (1.0 + ((offsets - smooth) / ROW_PX) ** 2)
    return np.asarray(smooth)


def rows_score(pairs: Pairs) -> Score:
    """Corners that lie on their rows."""
    share = pairs.aligned_share
    value = ROWS_WEIGHT * math.log(share) if share >= LEAST_ALIGNED else -math.inf
    return Score(value, f"matched corners are on their rows within {pairs.rows_px:.1f} px of 640")
