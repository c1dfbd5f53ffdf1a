"""Frames looked at under a hypothesis: the rows of a pair, the floor in depth, the edges of depth in its image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from calib.errors import WorkError
from calib.floor.plane import MIN_PATCH
from calib.images import as_grey
from calib.rig import Floor, StereoRig
from calib.types import F32, F64
from stereo.depth import RectifiedGeometry, back_project, median_image
from stereo.doctor.hypotheses import AS_RECORDED, PLACES, Hypothesis
from stereo.floor import FITTED_STEP_PX, FloorSearch, floor_in, moved_patches
from stereo.matcher import DisparityRange, SgbmMatcher
from stereo.recording import Frame, Shot
from stereo.rectify import Rectified, Rectifier, RectifyParams, is_ideal
from stereo.rig_correction import match_corners

WIDTH = 320
"""Frames are looked at this wide [px] (for speed)."""
CORNERS, ROW_PX = 80, 1.0
"""Corners tried in a frame, and the row offset from which on one does not count [px of WIDTH]."""
MIN_CURVED, CURVED_STEPS, FITTED_WORTH = 60, 10, 0.8
"""Fewest corners that show how rows bend, steps of the robust fit of that, and what a corner is worth where rows are
fitted to them."""
VIEW_M = 0.4, 20.0
"""Median depth of views with people in them [m]; other readings of depth need no search for a floor."""
CAMERA_M, CAMERA_SPREAD = 2.5, 0.5
"""Median height of cameras above floors [m], and the deviation of its logarithm (see ``calib.floor.plane``)."""
PERSON_M, PERSON_STD_M, PERSON_STDS_MAX = 1.7, 0.15, 5.0
"""Height of the taller of what moves, mostly adults, its deviation with that of the measurement [m], and the deviations
above which it is no longer evidence against a floor: what moves may be a door."""
PEOPLE = 8.0
"""How much likelier something of that height is above a right floor than above another, where any up to 3 m are."""
REACH_PX = (16, 32)
"""Shifts of depth on its image searched down and across, each way [px of WIDTH]: a tenth of the image (our choice)."""
CHANGE_LEVEL = 20.0
"""Grey levels by which what moves differs from the usual picture (our choice)."""


class FloorView(NamedTuple):
    """The floor in some depth, None where none is found, and how plausible it is with what moves above it: the
    logarithm of its share of the depth, and of how usual the heights of camera and people are."""

    floor: Floor | None = None
    plausible: float = -math.inf

    def __str__(self) -> str:
        return f"the floor is {self.floor.height_m:.2f} m below the camera" if self.floor else "no floor is found"


def view_of(depths: Sequence[F32], geometry: RectifiedGeometry, search: FloorSearch) -> FloorView:
    """The view in (H, W) float32 depth images [m], NaN where unknown."""
    known = np.concatenate([np.empty(0), *(depth[::8, ::8].ravel() for depth in depths)])
    known = known[np.isfinite(known)]
    if not len(known) or not VIEW_M[0] < np.median(known) < VIEW_M[1]:
        return FloorView()
    try:
        floor = floor_in(depths, geometry, search.floor, "")
    except WorkError:
        return FloorView()
    grids = [back_project(depth, geometry)[::FITTED_STEP_PX, ::FITTED_STEP_PX] for depth in depths]
    moved = [floor.world_SE3_left @ patch for patch in moved_patches(grids) if len(patch) >= MIN_PATCH]
    off = math.log(floor.height_m / CAMERA_M) / CAMERA_SPREAD
    plausible = math.log(max(floor.inlier_fraction, 1e-6)) - 0.5 * off**2
    if moved:
        tall_m = float(np.percentile([np.percentile(points[:, 2], 95) for points in moved], 75))
        plausible += math.log(PEOPLE) - 0.5 * min(abs(tall_m - PERSON_M) / PERSON_STD_M, PERSON_STDS_MAX) ** 2
    return FloorView(floor, plausible)


def taken(hypothesis: Hypothesis, depths: Sequence[F32], geometry: RectifiedGeometry, search: FloorSearch) -> FloorView:
    """The view under one of ``VIEWS``."""
    for _ in range(hypothesis.turns):
        depths, g = [np.ascontiguousarray(np.rot90(depth)) for depth in depths], geometry
        geometry = replace(
            g, width=g.height, height=g.width, focal_u_px=g.focal_v_px, focal_v_px=g.focal_u_px, cu_px=g.cv_px,
            cv_px=g.width - 1 - g.cu_px, baseline_m=g.disparity_metre / g.focal_v_px,
        )  # fmt: skip
    factor = hypothesis.baseline
    geometry = replace(geometry, baseline_m=geometry.baseline_m * factor)
    return view_of([depth * np.float32(factor) for depth in depths], geometry, search)


class PairsUnder:
    """Some pairs under a hypothesis."""

    def __init__(self, hypothesis: Hypothesis, rig: StereoRig, shots: Sequence[Shot]) -> None:
        self.hypothesis = hypothesis
        self._rectifier = Rectifier(hypothesis.rig(rig) if hypothesis.rig else rig, RectifyParams(working_px=WIDTH))
        self._shots, self._matches, self._tried = shots, np.empty((0, 4)), 0
        self._rows = hypothesis.rows
        self._possible = is_ideal(rig) or self._rows == "aligned"

    def _rectified(self, shot: Shot) -> Rectified | None:
        """None where images as they would be are of another size than the calibration's."""
        images, rig = self.hypothesis.images(shot[0], shot[1]), self._rectifier.rig
        sizes = [image.shape[1::-1] for image in images]
        return self._rectifier(*images) if sizes == [rig.left.size, rig.right.size] else None

    def aligned(self, count: int) -> float:
        """Share of the corners of the first pairs that lie on their rows, nearer than infinity."""
        reach, search_px = 0.25 * WIDTH, 6 if self._rows == "aligned" else 24
        for shot in self._shots[self._tried : count]:
            self._tried += 1
            if self._possible and (pair := self._rectified(shot)) is not None:
                greys = pair.left_grey, pair.right_grey
                found = match_corners(*greys, reach, -reach, features=CORNERS, search_px=search_px)
                farthest = -0.5 if self._rows == "aligned" else -reach  # where infinity is, raw images do not show
                self._matches = np.concatenate([self._matches, found[found[:, 0] - found[:, 2] > farthest]])
        near = np.maximum(0.0, 1.0 - (self._offsets / ROW_PX) ** 2)
        return (1.0 if self._rows == "aligned" else FITTED_WORTH) * float(near.sum()) / (CORNERS * max(self._tried, 1))

    @property
    def _offsets(self) -> F64:
        """(N,) row offsets of the corners; where they may, without what changes smoothly over the image."""
        offsets = self._matches[:, 3]
        if self._rows == "shifted" and len(offsets):
            return np.asarray(offsets - np.median(offsets))
        if self._rows != "curved" or len(offsets) < MIN_CURVED:
            return offsets
        x, y, x_right = 2 * self._matches[:, :3].T / WIDTH - 1
        basis, weights = np.column_stack([x**0, x, y, x * x, x * y, y * y, x_right, x_right * y]), np.ones(len(x))
        for _ in range(CURVED_STEPS):
            smooth = basis @ np.linalg.lstsq(basis * weights[:, None], offsets * weights, rcond=None)[0]
            weights = 1.0 / (1.0 + ((offsets - smooth) / ROW_PX) ** 2)
        return np.asarray(offsets - smooth, dtype=np.float64)

    @property
    def rows_px(self) -> float:
        """Median row offset [px of 640]."""
        return 640.0 / WIDTH * float(np.median(np.abs(self._offsets))) if len(self._matches) else math.nan

    @property
    def geometry(self) -> RectifiedGeometry:
        return self._rectifier.geometry

    def depths(self) -> list[F32]:
        """(H, W) float32 depth [m], NaN where unknown, of every pair: in another unit nothing is too far."""
        searched = DisparityRange(0, 16 * math.ceil(0.25 * WIDTH / 16))
        match = SgbmMatcher(self.geometry, None, searched, self._rectifier.mask, self._rectifier.right_mask)
        pairs = [pair for shot in self._shots if (pair := self._rectified(shot)) is not None]
        found = [match(pair.left_grey, pair.right_grey) for pair in pairs]
        least, metre = np.float32(0.5), np.float32(self.geometry.disparity_metre)
        return [np.asarray(metre / np.where(d >= least, d, np.float32(np.nan)), np.float32) for d in found]


def edge_scores(frames: Sequence[Frame[Shot]]) -> F64:
    """Of depth as it is and under each of ``PLACES``: mean correlation with the image at every shift."""
    images, depths = small_images(frames), small_depths(frames)
    usual, usual_depth = median_image(images), median_image(depths)
    scores = np.zeros((1 + len(PLACES), 2 * REACH_PX[0] + 1, 2 * REACH_PX[1] + 1))
    for image, depth in zip(images, depths, strict=True):
        with np.errstate(invalid="ignore"):
            near = (usual_depth - depth > 0.2).astype(np.float32)
        moved = (np.abs(image - usual) > CHANGE_LEVEL).astype(np.float32)
        for seen, measured in ((_edges(image), _depth_edges(depth)), (moved, near)):
            for score, hypothesis in zip(scores, (AS_RECORDED, *PLACES), strict=True):
                score += _correlation(np.ascontiguousarray(hypothesis.placed(measured)), seen) / len(frames)
    return scores


def small_images(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, ``WIDTH``) grey image of each frame."""
    small = (cv2.resize(as_grey(frame.image), _small(frame), interpolation=cv2.INTER_AREA) for frame in frames)
    return [np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.float32) for image in small]


def small_depths(frames: Sequence[Frame[Shot]]) -> list[F32]:
    """(h, ``WIDTH``) depth [m] of each frame, NaN where unknown."""
    nearest = (cv2.resize(frame.images[1], _small(frame), interpolation=cv2.INTER_NEAREST) for frame in frames)
    return [np.asarray(depth, dtype=np.float32) for depth in nearest]


def _small(frame: Frame[Shot]) -> tuple[int, int]:
    rows, columns = frame.image.shape[:2]
    return WIDTH, max(1, round(rows * WIDTH / columns))


def _edges(image: F32) -> F32:
    """Strength of the edges of an image; capped at that of the strongest tenth."""
    strength = np.hypot(cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1))
    return np.asarray(np.minimum(strength, np.percentile(strength, 90)), dtype=np.float32)


def _depth_edges(depth: F32) -> F32:
    """1 where known depth jumps within three pixels, else 0."""
    known, kernel = np.isfinite(depth), np.ones((3, 3), np.uint8)
    far = cv2.dilate(np.where(known, depth, 0.0).astype(np.float32), kernel)
    near = cv2.erode(np.where(known, depth, 99.0).astype(np.float32), kernel)
    return np.asarray(far - near > 0.1 + 0.05 * near, dtype=np.float32)


def _correlation(measured: F32, seen: F32) -> F64:
    """(2 y + 1, 2 x + 1) correlation of two maps of one size, the first moved by every shift of ``REACH_PX``."""
    a, b = (one - one.mean() for one in (measured, seen))
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    (y, x), (rows, columns) = REACH_PX, seen.shape
    if norm < 1e-6:
        return np.zeros((2 * y + 1, 2 * x + 1))
    size = rows + y, columns + x
    product = np.fft.irfft2(np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size), size)
    return np.asarray(np.roll(product, (y, x), (0, 1))[: 2 * y + 1, : 2 * x + 1] / norm, dtype=np.float64)
