"""Disparity from rectified pairs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from pydantic import Field

from calib.kernels import kernel
from calib.params import Params
from calib.rig import Floor
from calib.types import F32, U8, AnyArray
from stereo.depth import Matched, RectifiedGeometry, sample_means, whole_samples

DISPARITY_STEP = 16
"""SGBM counts disparities in multiples of 16, and returns sixteenths of a pixel."""

SEARCHED_FROM_M = 0.5
"""A camera that close to a head shows nothing but the head: no disparities are spent on it."""
LEVEL_MIN = 0.05
"""Rays that descend less per metre of depth meet no floor in view."""


class Matcher(Protocol):
    """Finds how far each left pixel moved.

    With an attribute ``identity``, a text that changes whenever the disparities would, a run resumes with it.
    """

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """(H, W) float32 disparity of the left pixels [px] of a rectified pair (H, W) uint8; NaN where unknown."""


class RangeParams(Params):
    """Range of disparities to search, from distances."""

    nearest_m: float = Field(default=0.7, gt=0.05, le=10.0)
    """Nearest depth to measure [m] while the floor is not known; an overhead camera at 2.7 m has a tall person's raised
    hand about that near."""
    reach_m: float = Field(default=2.0, gt=0.5, le=5.0)
    """Highest point to measure above a known floor [m]: the head of a very tall person; a hand raised right below the
    camera is not worth twice the search."""
    below_floor_m: float = Field(default=0.5, ge=0.0, le=5.0)
    """Lowest point to measure, this far below a known floor [m]: a step or a floor fitted badly."""
    max_disparities: int = Field(default=160, ge=16, le=512)
    """Most disparities to search; beyond it the nearest distance gives way, for speed."""


@dataclass(frozen=True)
class DisparityRange:
    """Disparities first_px ... first_px + count - 1; count is a multiple of 16."""

    first_px: int
    count: int


def disparity_range(
    geometry: RectifiedGeometry,
    params: RangeParams | None = None,
    floor: Floor | None = None,
) -> DisparityRange:
    """Disparities that people and the floor can have.

    Without a floor: from infinity to ``nearest_m``. With one: from the lowest visible point to the nearest place where
    a raised hand meets the image, so that an overhead camera does not search what only a cellar could have.
    """
    params = params or RangeParams()
    nearest = params.nearest_m
    farthest = math.inf
    if floor is not None:
        level, steep = _descent(geometry, floor)
        clearance = floor.height_m - params.reach_m
        if clearance > 0 and steep > 0:
            nearest = max(clearance / steep, SEARCHED_FROM_M)
        if level > LEVEL_MIN:
            farthest = (floor.height_m + params.below_floor_m) / level
    first = max(0, math.floor(geometry.disparity_at(farthest)) - 1)
    last = math.ceil(geometry.disparity_at(nearest)) + 1
    count = DISPARITY_STEP * math.ceil(max(DISPARITY_STEP, last - first) / DISPARITY_STEP)
    return DisparityRange(first, min(count, DISPARITY_STEP * (params.max_disparities // DISPARITY_STEP)))


def _descent(geometry: RectifiedGeometry, floor: Floor) -> tuple[float, float]:
    """Least and most metres that a ray of unit depth descends: between the corners of the image it is linear."""
    x, y, z = (float(part) for part in -floor.world_SE3_left.rotation[2])
    across = [x * (u - geometry.cu_px) / geometry.focal_u_px for u in (0, geometry.width - 1)]
    down = [y * (v - geometry.cv_px) / geometry.focal_v_px for v in (0, geometry.height - 1)]
    return min(across) + min(down) + z, max(across) + max(down) + z


SATURATED_LEVEL = 250
"""Blocks entirely at or above this grey level hold no texture to match."""
TEXTURE_MIN = 4
"""Smallest difference between the darkest and the brightest sample around a match [grey levels]; below it there is
nothing but sensor noise: a third of such disparities are off by more than a pixel."""


class SgbmParams(Params):
    """OpenCV's semi-global block matching (Hirschmueller 2008), in its fast three-way pass."""

    block_px: int = Field(default=5, ge=1, le=21)
    """Side of the matched block [px], odd. 5 keeps a head's outline; larger blocks fatten edges."""
    p1: int = Field(default=8, ge=0, le=200)
    """Penalty on a disparity change of 1, per pixel of the block (OpenCV's recommendation: 8)."""
    p2: int = Field(default=32, ge=1, le=800)
    """Penalty on larger changes, per pixel of the block (OpenCV's recommendation: 32)."""
    uniqueness_percent: int = Field(default=8, ge=0, le=50)
    """The best match must beat the second by this much (OpenCV's recommendation: 5-15)."""
    left_right_px: int = Field(default=1, ge=0, le=16)
    """Left-right check: largest difference of the two disparities [px]."""
    speckle_m: float = Field(default=0.10, ge=0.0, le=1.0)
    """Connected patches smaller than a square of this side at 4 m are dropped [m]: about half a head."""


ANALYSIS_PX = 320
"""Width near which images are reduced for the semi-global search: Harville's (2002, section 5)."""
EVEN_SIDE = 9
"""Side of the samples in which both cameras' brightness is made equal."""
STILL_LEVEL = 6
"""Least difference of the means of 5x5 samples from those last matched that shows movement [grey levels]. Noise and
compression of real cameras reach 3 to 5 in an empty view; an edge of 30 levels reaches 6 when it moves by one sample,
about 2 cm at 4 m."""
KEPT_MAX = 3
"""Most pairs in a row that keep a disparity. The background learns how much disparities vary from their noise, which a
kept one hides; at 30 frames per second each of its pixels learns from every fourth frame only."""
FIRST_PAIRS = 100
"""First pairs, matched whatever they show: the background begins, and every observation of it counts alike."""
SLOPE_NOISE = 12.0
"""Squared slopes that 5x5 samples of noise alone add up to [grey levels^2 / px^2]: .7 of a level each."""


def valid_mask(mask: U8, params: SgbmParams) -> U8:
    """The mask without a margin along the edges it has inside the image, where blocks would match the edge itself."""
    margin = params.block_px // 2 + 1
    kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return np.asarray(cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=255), dtype=np.uint8)


BODY_LAG = 0.006
"""People are measured farther away by this share of the distance (0.06 px at 10 px, 0.12 px at 20 px, on rendered
people): windows at a body's outline hold some of what is behind it."""


class SgbmMatcher:
    """Semi-global matching of reduced images, refined on the full-size ones; a ``Matcher``.

    OpenCV's StereoSGBM finds which surface each sample shows, at an eighth of the work of a search at twice the width.
    Two Gauss-Newton steps then find its disparity in the full-size images: they have no bias towards whole pixels.

    Attributes:
        disparities: the range searched [px].
        step: a sample is the mean of step x step pixels.
        shape: (h, w) of the samples.
    """

    def __init__(
        self,
        geometry: RectifiedGeometry,
        params: SgbmParams | None = None,
        disparities: DisparityRange | None = None,
        mask: U8 | None = None,
        right_mask: U8 | None = None,
        step: int | None = None,
        lag: float = 0.0,
    ) -> None:
        """Prepare.

        Args:
            disparities: range to search [px], ``disparity_range(geometry)`` when None.
            mask, right_mask: (H, W) uint8, 0 where the left and the right image show nothing.
            step: so that images are about ANALYSIS_PX wide when None.
            lag: share of the distance by which all is measured too far away.
        """
        self.params = p = params or SgbmParams()
        self.geometry = geometry
        self._scale = np.float32(1.0 + lag)
        self.step = n = step or max(1, round(geometry.width / ANALYSIS_PX))
        self.shape = -(-geometry.height // n), -(-geometry.width // n)
        self.disparities = found = disparities or disparity_range(geometry)
        self._first = found.first_px // n
        self._count = DISPARITY_STEP * math.ceil(
            (found.first_px + found.count - n * self._first) / (n * DISPARITY_STEP)
        )
        whole = np.full((geometry.height, geometry.width), 255, np.uint8)
        left, right = (valid_mask(whole if m is None else m, p) for m in (mask, right_mask))
        self._mask = left[::n, ::n]
        self._right_mask = right[::n, ::n]
        self._sgbm = self._make_sgbm()
        side = 15 // n | 1  # about as far as SGBM's smoothness carries a match: 15 px
        self._texture = np.ones((side, side), np.uint8)

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """See ``Matcher``. Raises ValueError: images that are not (H, W) uint8 of the geometry's size."""
        shape = self.geometry.height, self.geometry.width
        if left_grey.shape != shape or right_grey.shape != shape or left_grey.dtype != np.uint8:
            raise ValueError(f"expected two {shape} uint8 images, got {left_grey.shape} and {right_grey.shape}")
        samples = self.match(left_grey, right_grey).disparity
        n = self.step
        return np.repeat(np.repeat(samples, n, axis=0), n, axis=1)[: shape[0], : shape[1]]

    def match(self, left_grey: U8, right_grey: U8, last: Matched | None = None) -> Matched:
        """The disparity of the samples, from images as of a call; that of the last pair while nothing at all has moved
        since it was found. Not in several threads at once."""
        left = sample_means(left_grey, self.step)
        right = sample_means(right_grey, self.step)
        smooth_left = np.asarray(cv2.blur(left, (5, 5)), np.uint8)
        smooth_right = np.asarray(cv2.blur(right, (5, 5)), np.uint8)
        seen = 1 if last is None else last.seen + 1
        if last is not None and last.kept < KEPT_MAX and seen > FIRST_PAIRS:
            left_change = cv2.absdiff(smooth_left, last.left).max()
            right_change = cv2.absdiff(smooth_right, last.right).max()
            if max(left_change, right_change) < STILL_LEVEL:
                return last._replace(kept=last.kept + 1, seen=seen)
        disparity = self._disparity(left_grey, right_grey, left, right)
        return Matched(smooth_left, smooth_right, disparity, 0, seen)

    def _disparity(self, left_grey: U8, right_grey: U8, left: U8, right: U8) -> F32:
        """(h, w) float32 disparity of the samples [px], from images as of a call and their samples."""
        n = self.step
        start = self._coarse(left, right)
        coarse = left, _means(right_grey, n)
        refined = self._refine(*coarse, start, n, max(1, n // 2))
        if n <= 2:
            refined = self._refine(*coarse, refined, n, 1)
        else:
            side = 2 - n % 2
            first = slice((n - side) // 2, None, n)
            fine = np.ascontiguousarray(_means(whole_samples(left_grey, n), side)[first, first])
            refined = self._refine(fine, _means(right_grey, side), refined, side, 1)
        # What moves over half a sample, or a pixel, has left the surface that was found; no slope is known at the edge.
        inside = n * np.arange(self.shape[1]) - refined >= 1.0
        refined[~(inside & (np.abs(refined - start) <= max(0.5 * n, 1.0)))] = np.nan
        return refined * self._scale

    def _coarse(self, left: U8, right: U8) -> F32:
        """(h, w) float32 disparity [px] of the reduced images."""
        pad = self._first + self._count  # columns on the left that OpenCV leaves without disparity
        padded = (cv2.copyMakeBorder(image, 0, 0, pad, 0, cv2.BORDER_REPLICATE) for image in (left, right))
        fixed = self._sgbm.compute(*padded)[:, pad:]
        darkest = cv2.erode(left, self._texture)
        brightest = cv2.dilate(left, self._texture)
        usable = (cv2.subtract(brightest, darkest) >= TEXTURE_MIN) & (darkest < SATURATED_LEVEL)
        usable &= self._mask > 0
        disparity = np.empty(fixed.shape, np.float32)
        coarse_disparity(
            fixed, usable.view(np.uint8), self._right_mask, self.step, DISPARITY_STEP * self._first, disparity
        )
        return disparity

    def _make_sgbm(self) -> cv2.StereoSGBM:
        """OpenCV's matcher for samples, whose blocks are as wide as those of pixels as far as they have three."""
        p = self.params
        n = self.step
        block = max(min(p.block_px, 3), p.block_px // n | 1)
        speckle_px = self.geometry.focal_u_px * self.geometry.focal_v_px * (p.speckle_m / 4.0) ** 2
        return cv2.StereoSGBM.create(
            minDisparity=self._first,
            numDisparities=self._count,
            blockSize=block,
            P1=p.p1 * block**2,
            P2=max(p.p2, p.p1 + 1) * block**2,
            disp12MaxDiff=p.left_right_px,
            preFilterCap=31,
            uniquenessRatio=p.uniqueness_percent,
            speckleWindowSize=round(speckle_px / n**2),
            speckleRange=1,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def _refine(self, left: U8, right: U8, disparity: F32, side: int, apart: int) -> F32:
        """One Gauss-Newton step on means of ``side`` x ``side`` pixels: those of the left samples, and (H, W) of the
        right image from each pixel on."""
        error = np.empty_like(disparity)
        slope = np.empty_like(disparity)
        differences(left, right, disparity, (self.step - side) // 2, self.step, apart, error, slope)
        # The two cameras' gains differ, by place too.
        known = np.isfinite(disparity).astype(np.float32)
        box = EVEN_SIDE, EVEN_SIDE
        error -= cv2.blur(error, box) / np.maximum(cv2.blur(known, box), np.float32(1e-3))
        found = np.empty_like(disparity)
        shared_step(disparity, error, slope, 0.5 * self.step, SLOPE_NOISE, found)
        return found


def _means(image: U8, side: int) -> U8:
    """Means of ``side`` x ``side`` pixels from each pixel on."""
    return image if side == 1 else np.asarray(cv2.blur(image, (side, side), anchor=(0, 0)), dtype=np.uint8)


@kernel
def coarse_disparity(fixed: AnyArray, usable: U8, right_mask: U8, step: int, lowest: int, out: F32) -> None:
    """Sixteenths of a sample to pixels; NaN where nothing can have been measured.

    That is where ``usable`` is 0, where the matched right sample is masked or outside, and where the value is below
    ``lowest``. A sample is ``step`` pixels wide.
    """
    for row in range(fixed.shape[0]):
        for col in range(fixed.shape[1]):
            value = np.int32(fixed[row, col])
            right = col - (value >> 4)
            if usable[row, col] == 0 or value < lowest or right < 0 or right_mask[row, right] == 0:
                out[row, col] = np.nan
            else:
                out[row, col] = np.float32(value * step) / np.float32(16.0)


@kernel
def differences(left: U8, right: U8, disparity: F32, first: int, step: int, apart: int, error: F32, slope: F32) -> None:
    """Difference in brightness of each left sample and the right image at its disparity, and the right image's slope.

    Sample (r, c) of ``left`` (h, w) is pixel ``first`` + ``step`` (r, c) of ``right`` (H, W) without a disparity; the
    slope [1/px] is taken over ``apart`` pixels either way. Both are 0 without a disparity and where it leads out of the
    image.
    """
    height, width = right.shape
    for row in range(disparity.shape[0]):
        v = min(first + step * row, height - 1)
        for col in range(disparity.shape[1]):
            x = np.float32(first + step * col) - disparity[row, col]
            if not (x >= apart and x < width - 1 - apart):
                error[row, col] = slope[row, col] = np.float32(0.0)
                continue
            i = int(x)
            t = x - np.float32(i)
            here = np.float32(right[v, i])
            here += t * (np.float32(right[v, i + 1]) - here)
            behind = np.float32(right[v, i - apart])
            ahead = np.float32(right[v, i + apart])
            behind += t * (np.float32(right[v, i + 1 - apart]) - behind)
            ahead += t * (np.float32(right[v, i + 1 + apart]) - ahead)
            error[row, col] = np.float32(left[row, col]) - here
            slope[row, col] = (ahead - behind) / np.float32(2 * apart)


@kernel
def shared_step(disparity: F32, error: F32, slope: F32, same_px: float, noise: float, out: F32) -> None:
    """A Gauss-Newton step to the one disparity of each 5x5 samples, as far as they are within ``same_px`` of it.

    With slope g and error e of sample j: sum g_j (g_j (d_j - d) - e_j) / (sum g_j^2 + noise) is added to d (Lucas and
    Kanade 1981, along the row).
    """
    height, width = disparity.shape
    near = np.float32(same_px)
    d = np.full((height + 4, width + 4), np.float32(-1e6))  # samples without a disparity are near none
    g2 = np.zeros_like(d)
    ge = np.zeros_like(d)
    for row in range(height):
        for col in range(width):
            if not np.isnan(disparity[row, col]):
                d[row + 2, col + 2] = disparity[row, col]
                g2[row + 2, col + 2] = slope[row, col] * slope[row, col]
                ge[row + 2, col + 2] = slope[row, col] * error[row, col]
    above = np.empty(width, np.float32)
    below = np.empty(width, np.float32)
    for row in range(height):
        above[:] = np.float32(0.0)
        below[:] = np.float32(noise)
        here = d[row + 2, 2 : width + 2]
        for r in range(row, row + 5):
            for c in range(5):  # so that the loop over columns, which is the longest, runs on vectors
                there = d[r, c : c + width]
                g2_there = g2[r, c : c + width]
                ge_there = ge[r, c : c + width]
                for col in range(width):
                    apart = there[col] - here[col]
                    same = np.float32(1.0) if abs(apart) < near else np.float32(0.0)
                    above[col] += same * (g2_there[col] * apart - ge_there[col])
                    below[col] += same * g2_there[col]
        for col in range(width):
            out[row, col] = disparity[row, col] + above[col] / below[col]
