"""Disparity from rectified pairs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import local
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.rig import Floor
from calib.types import F32, U8
from stereo._kernels import disparity_from_fixed
from stereo.depth import RectifiedGeometry
from stereo.gating import Window

STEP = 16
"""SGBM counts disparities in multiples of 16, and returns sixteenths of a pixel."""

SUBPIXEL = np.array(
    [-0.077, 0.180, 0.294, 0.360, 0.402, 0.435, 0.461, 0.483, 0.497, 0.505, 0.518, 0.540, 0.567, 0.600, 0.642, 0.707],
    dtype=np.float32,
)
"""Expected fraction of a pixel where StereoSGBM returns 0/16 ... 15/16. It fits a parabola to the dissimilarity of
Birchfield and Tomasi (1998), which half a pixel of shift hardly changes, so its fractions crowd at whole pixels: 0.15
for 0.375, an error up to 0.28 px, the same for every texture. The table is the mean true fraction for each answer
over random textures (0.5-3 px, contrast 10-40, noise 2 grey levels, slopes to 0.05); it halves the error, from 0.20 to
0.10 px rms."""

NEAREST_M = 0.5
"""A camera that close to a head shows nothing but the head: no disparities are spent on it."""
LEVEL_MIN = 0.05
"""Rays that descend less per metre of depth meet no floor in view."""


class Matcher(Protocol):
    """Finds how far each left pixel moved."""

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """Match one rectified pair.

        Args:
            left_grey, right_grey: (H, W) uint8.
        Returns:
            (H, W) float32 disparity of the left pixels [px]; NaN where there is none.
        """


class SampledDisparity(NamedTuple):
    """Disparity of every n-th row and column of an image.

    Attributes:
        samples: (h, w) float32 [px of the image], NaN invalid.
        step: n.
        shape: (H, W) of the image; not asked for when every pixel is a sample.
    """

    samples: F32
    step: int = 1
    shape: tuple[int, int] = (0, 0)

    @property
    def image(self) -> F32:
        """(H, W) float32 [px]: that of the nearest sample to the left and above."""
        if self.step == 1:
            return self.samples
        height, width = self.shape
        return np.repeat(np.repeat(self.samples, self.step, axis=0), self.step, axis=1)[:height, :width]


class RangeParams(Params):
    """Which disparities to search, from distances."""

    nearest_m: float = Field(default=0.7, gt=0.05, le=10.0)
    """Nearest depth to measure [m] while the floor is not known; an overhead camera at 2.7 m has a tall person's raised
    hand about that near (our choice)."""
    reach_m: float = Field(default=2.0, gt=0.5, le=5.0)
    """Highest point to measure above a known floor [m]: the head of a very tall person; a hand raised right below the
    camera is not worth twice the search (our choice)."""
    below_floor_m: float = Field(default=0.5, ge=0.0, le=5.0)
    """Lowest point to measure, this far below a known floor [m]: a step or a floor fitted badly (our choice)."""
    max_disparities: int = Field(default=160, ge=16, le=512)
    """Most disparities to search; beyond it the nearest distance gives way, for speed (our choice)."""


@dataclass(frozen=True)
class DisparityRange:
    """Disparities first_px ... first_px + count - 1; count is a multiple of 16."""

    first_px: int
    count: int


def right_of(window: Window, disparities: DisparityRange) -> Window:
    """Where the pixels of a window can be in the right image."""
    return window._replace(left=max(0, window.left - disparities.first_px - disparities.count))


def disparity_range(
    geometry: RectifiedGeometry,
    params: RangeParams | None = None,
    floor: Floor | None = None,
    window: Window | None = None,
) -> DisparityRange:
    """Disparities that people and the floor can have, in the whole image or a window of it.

    Without a floor: from infinity to ``nearest_m``. With one: from the lowest visible point to the nearest place where
    a raised hand meets the image, so that an overhead camera does not search what only a cellar could have.
    """
    params = params or RangeParams()
    nearest, farthest = params.nearest_m, math.inf
    if floor is not None:
        level, steep = _descent(geometry, floor, window or Window(0, 0, *geometry.size))
        clearance = floor.height_m - params.reach_m
        if clearance > 0 and steep > 0:
            nearest = max(clearance / steep, NEAREST_M)
        if level > LEVEL_MIN:
            farthest = (floor.height_m + params.below_floor_m) / level
    first = max(0, math.floor(geometry.disparity_at(farthest)) - 1) if math.isfinite(farthest) else 0
    last = math.ceil(geometry.disparity_at(nearest)) + 1
    count = STEP * math.ceil(max(STEP, last - first) / STEP)
    return DisparityRange(first, min(count, STEP * (params.max_disparities // STEP)))


def _descent(geometry: RectifiedGeometry, floor: Floor, window: Window) -> tuple[float, float]:
    """Least and most metres that a ray of unit depth descends in a window: between its corners it is linear."""
    x, y, z = (float(part) for part in -floor.world_SE3_left.rotation[2])
    across = [x * (u - geometry.cu_px) / geometry.focal_u_px for u in (window.left, window.right - 1)]
    down = [y * (v - geometry.cv_px) / geometry.focal_v_px for v in (window.top, window.bottom - 1)]
    return min(across) + min(down) + z, max(across) + max(down) + z


def farthest_head_m(geometry: RectifiedGeometry, floor: Floor) -> float:
    """Depth of the farthest head over the floor in view [m]; infinite for a camera that sees the horizon."""
    level, _ = _descent(geometry, floor, Window(0, 0, *geometry.size))
    # The lowest head is that of a child of two years, 0.85 m above the floor.
    return max(floor.height_m - 0.85, NEAREST_M) / level if level > LEVEL_MIN else math.inf


SATURATED_LEVEL = 250
"""Blocks entirely at or above this grey level hold no texture to match (our choice)."""
TEXTURE_MIN = 6
"""Smallest difference between the darkest and the brightest pixel around a match [grey levels]; below it there is
nothing but sensor noise: a third of such disparities are off by more than a pixel (our choice)."""


class SgbmParams(Params):
    """OpenCV's semi-global block matching (Hirschmueller 2008), in its fast three-way pass."""

    block_px: int = Field(default=5, ge=1, le=21)
    """Side of the matched block [px], odd. 5 keeps a head's outline; larger blocks fatten edges (our choice)."""
    p1: int = Field(default=8, ge=0, le=200)
    """Penalty on a disparity change of 1, per pixel of the block (OpenCV's recommendation: 8)."""
    p2: int = Field(default=32, ge=1, le=800)
    """Penalty on larger changes, per pixel of the block (OpenCV's recommendation: 32)."""
    uniqueness_percent: int = Field(default=8, ge=0, le=50)
    """The best match must beat the second by this much (OpenCV's recommendation: 5-15)."""
    left_right_px: int = Field(default=1, ge=0, le=16)
    """Left-right check: largest difference of the two disparities [px]."""
    speckle_m: float = Field(default=0.10, ge=0.0, le=1.0)
    """Connected patches smaller than a square of this side at 4 m are dropped [m]: about half a head (our choice)."""


def speckle_px(geometry: RectifiedGeometry, params: SgbmParams) -> float:
    """Pixels that a patch must have to count."""
    return geometry.focal_u_px * geometry.focal_v_px * (params.speckle_m / 4.0) ** 2


def valid_mask(mask: U8, params: SgbmParams) -> U8:
    """The mask without a margin along the edges it has inside the image, where blocks would match the edge itself."""
    margin = params.block_px // 2 + 1
    kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
    return np.asarray(cv2.erode(mask, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=255), dtype=np.uint8)


def make_sgbm(
    geometry: RectifiedGeometry, params: SgbmParams, disparities: DisparityRange, step: int = 1
) -> cv2.StereoSGBM:
    """OpenCV's matcher itself, with pixel sizes derived from the geometry, for every ``step``-th row.

    Blocks are then as high as in the whole image, as far as 3 rows of samples are not higher.
    """
    block = max(min(params.block_px, 3), params.block_px // step | 1)
    area = block * block
    return cv2.StereoSGBM.create(
        minDisparity=disparities.first_px,
        numDisparities=disparities.count,
        blockSize=block,
        P1=params.p1 * area,
        P2=max(params.p2, params.p1 + 1) * area,
        disp12MaxDiff=params.left_right_px,
        preFilterCap=31,
        uniquenessRatio=params.uniqueness_percent,
        speckleWindowSize=round(speckle_px(geometry, params) / step),
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )


BODY_LAG_PX = 0.07
"""Semi-global matching sees people farther away by so much (rendered people of 8 to 10 px: 0.02 to 0.17):
their outlines, which match best, are as far as the body's axis and pull along the surface next to them."""


class SgbmMatcher:
    """OpenCV's StereoSGBM with invalid pixels as NaN; of the disparity only every ``step``-th row and column is kept.

    The images are padded on the left by the searched range: OpenCV leaves that band without disparity, yet only those
    of its points that are out of the right camera's view lack a match.

    Attributes:
        disparities: the range searched.
        step: n.
    """

    def __init__(
        self,
        geometry: RectifiedGeometry,
        params: SgbmParams | None = None,
        disparities: DisparityRange | None = None,
        mask: U8 | None = None,
        right_mask: U8 | None = None,
        step: int = 1,
        lag_px: float = 0.0,
    ) -> None:
        """Prepare.

        Args:
            disparities: range to search, ``disparity_range(geometry)`` when None.
            mask, right_mask: (H, W) uint8, 0 where the left and the right image show nothing.
            lag_px: added to all disparities.
        """
        self.params = p = params or SgbmParams()
        self.geometry, self.step, self._lag_px = geometry, step, np.float32(lag_px)
        self.disparities = disparities or disparity_range(geometry)
        whole = np.full((geometry.height, geometry.width), 255, np.uint8)
        left, right = (valid_mask(whole if m is None else m, p) for m in (mask, right_mask))
        self._mask, self._right_mask = left[::step, ::step], right[::step]
        self._made = local()
        # In which some texture must be found: about as far as SGBM's smoothness carries a match [px].
        self._texture = np.ones((15 // step | 1, 15), np.uint8)

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """Match one rectified pair (see ``Matcher``).

        Raises:
            ValueError: images that are not (H, W) uint8 of the geometry's size.
        """
        shape = self.geometry.height, self.geometry.width
        if left_grey.shape != shape or right_grey.shape != shape or left_grey.dtype != np.uint8:
            raise ValueError(f"expected two {shape} uint8 images, got {left_grey.shape} and {right_grey.shape}")
        # Columns before first_px have no match whatever the padding.
        whole = Window(0, 0, *self.geometry.size)
        return self._matched(left_grey, right_grey, whole, self.disparities, self.disparities.count)

    def part(self, left_grey: U8, right_grey: U8, window: Window, disparities: DisparityRange) -> F32:
        """Match a window of a rectified pair; several threads may do so at once.

        Args:
            left_grey: (h, w) uint8, every ``step``-th row of the window, whose corner is a sample.
            right_grey: (h, w') uint8, the same rows of the window and of what ``right_of`` adds to it.
            disparities: range to search.
        Returns:
            (h, w / step), rounded up, float32 disparity [px]; NaN where there is none; less sure near the edges
            of the window, which end the paths.
        """
        return self._matched(left_grey, right_grey, window, disparities, disparities.first_px + disparities.count)

    def _matched(self, left: U8, right: U8, window: Window, searched: DisparityRange, pad: int) -> F32:
        """The disparities of a window, both images padded on the left so that OpenCV has ``pad`` columns to leave."""
        padded = (
            cv2.copyMakeBorder(image, 0, 0, left.shape[1] + pad - image.shape[1], 0, cv2.BORDER_REPLICATE)
            for image in (left, right)
        )
        made: dict[DisparityRange, cv2.StereoSGBM] = self._made.__dict__.setdefault("sgbm", {})
        if searched not in made:  # it keeps buffers, so that each thread has its own
            made[searched] = make_sgbm(self.geometry, self.params, searched, self.step)
        columns = slice(None, None, self.step)
        fixed = made[searched].compute(*padded)[:, pad :: self.step]
        disparity = np.empty(fixed.shape, dtype=np.float32)
        rows = slice(window.top // self.step, window.top // self.step + len(fixed))
        seen = slice(window.left // self.step, window.left // self.step + fixed.shape[1])
        disparity_from_fixed(
            fixed,
            self._mask[rows, seen],
            self._right_mask[rows],
            np.asarray(cv2.erode(left, self._texture)[:, columns], dtype=np.uint8),
            np.asarray(cv2.dilate(left, self._texture)[:, columns], dtype=np.uint8),
            window.left,
            self.step,
            STEP * searched.first_px,
            SUBPIXEL,
            SATURATED_LEVEL,
            TEXTURE_MIN,
            disparity,
        )
        return disparity + self._lag_px


class TwoWayMatcher:
    """Mean of matching from the top down and from the bottom up; a ``Matcher``.

    The fast pass carries disparities along downwards only, so that it lags on floors that come nearer towards the
    bottom of the image: by 0.2 px at a tilt of 60 degrees, 4 cm of a camera's height. Upside down it lags the other
    way. The masks are turned with the images.
    """

    def __init__(
        self,
        geometry: RectifiedGeometry,
        params: SgbmParams | None = None,
        disparities: DisparityRange | None = None,
        mask: U8 | None = None,
        right_mask: U8 | None = None,
    ) -> None:
        """Prepare both passes (same arguments as ``SgbmMatcher``)."""
        self._down = SgbmMatcher(geometry, params, disparities, mask, right_mask)
        up, right_up = (None if m is None else np.ascontiguousarray(m[::-1]) for m in (mask, right_mask))
        self._up = SgbmMatcher(geometry, params, disparities, up, right_up)

    def __call__(self, left_grey: U8, right_grey: U8) -> F32:
        """Match one rectified pair.

        Args:
            left_grey, right_grey: (H, W) uint8.
        Returns:
            (H, W) float32 disparity [px], NaN where either pass has none or they differ by more than 2 px.
        Raises:
            ValueError: images that are not (H, W) uint8 of the geometry's size.
        """
        down = self._down(left_grey, right_grey)
        up = self._up(np.ascontiguousarray(left_grey[::-1]), np.ascontiguousarray(right_grey[::-1]))[::-1]
        with np.errstate(invalid="ignore"):
            agree = np.abs(down - up) < 2.0  # where both match the same surface (our choice)
        return np.where(agree, 0.5 * (down + up), np.float32(np.nan)).astype(np.float32)
