"""Correction of an aged calibration: how the right camera is turned by now, from matched corners."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F32, F64, U8, Bool
from stereo.depth import RectifiedGeometry

_PATCH = 7
"""Half side of a matched patch [px]."""
_SIDE = (2 * _PATCH + 1, 2 * _PATCH + 1)
_TRACKED: dict[str, Any] = {
    "winSize": _SIDE,
    "maxLevel": 0,
    "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003),
    "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
}
"""Settings for following patches from guesses on (Lucas and Kanade 1981)."""
_SIMILARITY_MIN = 0.9
"""Smallest normalised correlation of two patches that count as a match."""
_SEARCHED_PX = 640
"""Width near which images are reduced to search for a patch, which is then refined at full size."""
_SEARCH = 0.02
"""Largest row offset searched, each way, over the image's width: more is not age but a wrong calibration."""
_CELLS = 12
"""Square cells across the image, each of which counts once."""
_CELLS_MIN = 20
"""Fewest cells with matches that determine five angles."""
_MOUNT_DEG = 0.3
"""Standard deviation of the rotation of a camera in its mount since calibration, about each axis (factory
calibrations of some years have 0.1 to 0.2)."""
_LENS = 2e-4
"""Standard deviation of a lens's decentring coefficients (what calibrations with boards state)."""
_YAW_DEG = 0.15
"""Error of yaw that matches cannot show: lenses and the matcher's lag look like it (rendered right rigs: 0.23)."""
_FIXED = 1e-5
"""Deviation of pitch and roll of a rig as calibrated [rad]."""
_NOISE_MIN_PX = 0.1
"""Least noise of a cell [px]: what interpolation leaves."""
_HUBER = 2.0
"""Residuals beyond this many standard deviations count linearly."""
_ROUNDS = 8
"""Rounds of reweighted least squares: offsets are nearly linear in the angles, four settle them."""
_TURNED = 0.3
"""Share of rigs whose cameras have turned about an axis since calibration (most calibrations hold)."""


@dataclass(frozen=True, eq=False)
class RigCorrection:
    """Rotation of the right camera against its calibration.

    Attributes:
        angles: (3,) float64 rotation vector [rad] about the axes of the rectified frame: x, the baseline (pitch), y
            (yaw) and z (roll), as estimated for a rig that has turned about that axis.
        deviations: (3,) float64 standard deviation of each; NaN where nothing was estimated.
        turned: (3,) float64 probability that the rig has turned about each.
        before_px, after_px: median absolute row offset without and with the correction, of the rectified images in
            which it was measured [px]; NaN without matches.
        matches: (N, 4) float64 corners in these images, as from ``match_corners``.
    """

    angles: F64 = field(default_factory=lambda: np.zeros(3))
    deviations: F64 = field(default_factory=lambda: np.full(3, np.nan))
    turned: F64 = field(default_factory=lambda: np.zeros(3))
    before_px: float = math.nan
    after_px: float = math.nan
    matches: F64 = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def is_applied(self) -> Bool:
        """(3,) about which axes the rig has turned rather than not."""
        return np.asarray(self.turned > 0.5, dtype=np.bool_)

    @property
    def applied(self) -> F64:
        """(3,) expected angles [rad]: nearly 0 where the calibration probably holds."""
        return self.angles * self.turned

    @property
    def left_over(self) -> F64:
        """(3,) deviations [rad] of the turns that remain after the correction.

        Rows hardly show yaw: a camera that has turned about the other two axes has turned as far about this one.
        """
        if np.isnan(self.deviations).any():
            return np.full(3, math.radians(_MOUNT_DEG) * math.sqrt(2.0 * _TURNED))
        turned = np.minimum(self.turned, 1.0)
        found = np.sqrt(turned * (self.deviations**2 + (1.0 - turned) * self.angles**2))
        pitch, yaw, roll = found.tolist()
        shown = math.hypot(self.applied[0], self.applied[2]) / math.sqrt(2.0)
        return np.array([pitch, math.hypot(yaw * math.sqrt(max(turned[0], turned[2])), shown), roll])

    def __call__(self, rig: StereoRig) -> StereoRig:
        """The calibration with the right camera turned by the applied angles; the rig itself when there are none."""
        if not self.applied.any():
            return rig
        turn = SE3.from_rotvec(self.applied).rotation
        left, right = rig.rectifying_rotations()
        rotation = right.T @ turn.T @ left
        return replace(rig, right_SE3_left=SE3(rotation, -rotation @ rig.right_SE3_left.inverse().translation))

    def __str__(self) -> str:
        """One sentence."""
        if np.isnan(self.deviations).all():
            return "too little texture to compare the calibration with the images"
        names = ("pitch", "yaw", "roll")
        rows = list(zip(names, np.degrees(self.applied), np.degrees(self.deviations), self.is_applied, strict=True))
        applied = [f"{name} corrected by {a:.3f} ± {d:.3f} degrees" for name, a, d, used in rows if used]
        kept = [name for name, *_, used in rows if not used]
        if not applied:
            return "the calibration fits the images"
        return ", ".join(applied) + (f"; {' and '.join(kept)} kept" if kept else "")


def measure_correction(
    pairs: Iterable[tuple[U8, U8]], geometry: RectifiedGeometry, disparity_max_px: float
) -> RigCorrection:
    """Correction of a calibration from left and right (H, W) uint8 images, rectified by it as it is, with the largest
    disparity that can occur [px] (see ``match_corners``)."""
    search_px = math.ceil(_SEARCH * geometry.width)

    def match(pair: tuple[U8, U8]) -> F64:
        return match_corners(*pair, disparity_max_px, search_px=search_px)

    with ThreadPoolExecutor(2) as pool:  # correlation releases Python's lock
        matches = np.concatenate([np.empty((0, 4)), *pool.map(match, pairs)])
    return replace(fit_correction(matches, geometry), matches=matches)


def fit_correction(matches: F64, geometry: RectifiedGeometry) -> RigCorrection:
    """The most probable rotation of the right camera since its calibration, and its deviation.

    Least squares (Huber) on the epipolar error of the essential matrix (Hartley and Zisserman 2004, section 9.6) in
    normalised coordinates. Prior: either camera turned in its mount by a few tenths of a degree, and the lenses are
    decentred a little (Brown 1966), which looks like yaw. Matches of a place come again in every frame with the same
    texture and the same error of the lens model, so each cell of the image counts once, by its median.

    The direction of the baseline is estimated with the turn and left as it was: where all lies in one depth it cannot
    be separated from pitch, and half a degree of it is 0.2 px of row offset at a disparity of 20 px. Whether the rig
    has turned about an axis at all is uncertain, too: the result is the mean over all eight answers, weighted by
    their evidence (Laplace's approximation).

    Args:
        matches: (N, 4) as from ``match_corners``.
    """
    if len(matches) == 0:
        return RigCorrection()
    rays = _rays(matches, geometry)
    before_px = _median_offset(np.zeros(7), *rays) * geometry.focal_v_px
    cells = _cell_medians(matches, geometry.width / _CELLS)
    if len(cells) < _CELLS_MIN:
        return RigCorrection(before_px=before_px, after_px=before_px)
    cell_rays = _rays(cells, geometry)
    # Turns a, b of the cameras are independent, and so are b - a, the pose, and -(a + b) / 2, the baseline.
    mount = math.radians(_MOUNT_DEG)
    pose = [mount * math.sqrt(2.0)] * 3
    baseline = [mount * math.sqrt(0.5)] * 2
    lens = [_LENS * math.sqrt(2.0)] * 2
    prior = np.array(pose + baseline + lens)
    alike = np.array([_FIXED, math.radians(_YAW_DEG), _FIXED])
    noise_min = _NOISE_MIN_PX / geometry.focal_v_px
    noise = max(noise_min, _fit_offsets(*cell_rays, prior, noise_min).noise)  # the same for all answers
    answers = np.array(list(itertools.product((False, True), repeat=3)))
    means = np.empty((8, 3))
    variances = np.empty((8, 3))
    log_odds = np.empty(8)
    for n, is_turned in enumerate(answers):
        std = np.append(np.hypot(alike, np.where(is_turned, prior[:3], 0.0)), prior[3:])
        fit = _fit_offsets(*cell_rays, std, noise)
        means[n] = fit.values[:3]
        variances[n] = np.diag(fit.covariance)[:3] + alike**2
        log_odds[n] = fit.log_evidence + math.log(_TURNED / (1.0 - _TURNED)) * int(is_turned.sum())
    odds = np.exp(log_odds - log_odds.max())
    share = odds[:, None] * answers
    weight = share / share.sum(axis=0)
    angles = (weight * means).sum(axis=0)
    deviations = np.sqrt((weight * (variances + (means - angles) ** 2)).sum(axis=0))
    turn = RigCorrection(angles, deviations, share.sum(axis=0) / odds.sum(), before_px)
    after = _median_offset(np.append(turn.applied, np.zeros(4)), *rays)
    return replace(turn, after_px=after * geometry.focal_v_px)


class _Fit(NamedTuple):
    """The values of ``_row_offset``, their covariance, the log of their evidence, and the noise of an offset."""

    values: F64
    covariance: F64
    log_evidence: float
    noise: float


def _fit_offsets(left: F64, right: F64, prior: F64, noise_min: float) -> _Fit:
    """Fit the values of ``_row_offset`` to (N, 3) rays by reweighted least squares; their evidence is with the least
    noise.

    Args:
        prior: (7,) standard deviations of a Gaussian about 0.
        noise_min: least noise of an offset at unit depth.
    """
    values = np.zeros(7)
    small = 1e-6
    penalty = np.diag(prior**-2.0)
    for _ in range(_ROUNDS):
        error = _row_offset(values, left, right)
        moved = np.stack([_row_offset(values + step, left, right) for step in small * np.eye(7)])
        slopes = (moved - error) / small
        # The noise is known from what the last round left only.
        scale = max(1.4826 * float(np.median(np.abs(error))), noise_min)
        outlying = np.maximum(np.abs(error) / (_HUBER * scale), 1.0)
        scores = slopes / (outlying * scale**2)
        information = scores @ slopes.T + penalty
        values -= np.linalg.solve(information, scores @ error + penalty @ values)
    near = slopes[:, outlying == 1.0].T / scale
    information = near.T @ near + penalty
    off = np.abs(_row_offset(values, left, right)) / noise_min
    huber = np.where(off < _HUBER, off * off, _HUBER * (2.0 * off - _HUBER))
    cost = float(huber.sum() + values @ penalty @ values)
    occam = float(np.linalg.slogdet(penalty)[1] - np.linalg.slogdet(information)[1])
    covariance = np.asarray(np.linalg.inv(information), np.float64)
    return _Fit(values, covariance, 0.5 * (occam - cost), scale)


def _median_offset(values: F64, left: F64, right: F64) -> float:
    """Median absolute ``_row_offset``."""
    return float(np.median(np.abs(_row_offset(values, left, right))))


def _row_offset(values: F64, left: F64, right: F64) -> F64:
    """(N,) row offsets at unit depth between left and right rays of unit depth (N, 3) that values leave.

    Args:
        values: (7,) angles of a ``RigCorrection``, rotation of the baseline about y and z [rad], and decentring of the
            right lens against the left one.
    """
    u, v, w = SE3.from_rotvec(values[:3]).rotation @ right.T
    x, y, _ = left.T
    normal = v - w * y + values[4] * (w * x - u) - values[3] * (u * y - v * x)
    return np.asarray(normal / w + values[5] * (x * x + 3.0 * y * y) + values[6] * 2.0 * x * y)


def _rays(matches: F64, geometry: RectifiedGeometry) -> tuple[F64, F64]:
    u, v, right_u, offset = matches.T
    return geometry.rays(np.column_stack([u, v])), geometry.rays(np.column_stack([right_u, v + offset]))


def _cell_medians(matches: F64, side_px: float) -> F64:
    """(M, 4) the match with the median row offset in every square of the left image, of each depth seen there."""
    disparity = matches[:, 0] - matches[:, 2]
    cell = np.column_stack([matches[:, :2], 4.0 * disparity])
    _, index = np.unique(np.floor(cell / side_px), axis=0, return_inverse=True)
    index = index.reshape(-1)
    order = np.lexsort((matches[:, 3], index))
    counts = np.bincount(index)
    middles = np.cumsum(counts) - (counts + 2) // 2
    return np.asarray(matches[order[middles]])


def match_corners(
    left: U8,
    right: U8,
    disparity_max_px: float,
    disparity_min_px: float = -2.0,
    *,
    features: int = 300,
    search_px: int = 8,
) -> F64:
    """Corners of the left image and where the right one shows them, found by correlation and refined by Lucas-Kanade.

    Args:
        disparity_max_px, disparity_min_px: disparities to search [px]; negative ones show swapped images.
        features: corners tried.
        search_px: largest row offset searched, each way.
    Returns:
        (N, 4) float64 [px]: u and v in the left image, u in the right image, v_right - v_left.
    """
    # Corners whose patch is inside the picture and not saturated.
    usable = ((left > 0) & (left < 250)).astype(np.uint8)
    n = max(1, round(left.shape[1] / _SEARCHED_PX))
    side = 2 * n * (_PATCH + 1) - 1
    matchable = cv2.erode(usable, np.ones((side, side), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    corners = cv2.goodFeaturesToTrack(left, features, 0.01, 2.0 * _PATCH, mask=matchable)
    if corners is None:
        return np.empty((0, 4))
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 2)
    size = left.shape[1] // n, left.shape[0] // n
    a, b = (np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right))
    span = math.floor(disparity_min_px / n), math.ceil(disparity_max_px / n)
    places = [_search(a, b, point, span, math.ceil(search_px / n)) for point in (points + 0.5) / n - 0.5]
    guesses = np.asarray(n * (np.array(places, dtype=np.float32) + 0.5) - 0.5, dtype=np.float32)
    good = np.isfinite(guesses).all(axis=1)
    points = points[good]
    guesses = guesses[good]
    if len(points) == 0:
        return np.empty((0, 4))
    # Lucas-Kanade compares values, and each camera may expose for itself: the right image gets the brightness and
    # contrast that the left one has in matched patches.
    mean, std = _light_of(left, points)
    other_mean, other_std = _light_of(right, guesses)
    gain = std / max(other_std, 1.0)
    bright = cv2.convertScaleAbs(right, alpha=gain, beta=mean - gain * other_mean)
    # Sub-pixel places in the right image, of those that lead back to where they came from.
    there, is_there = cv2.calcOpticalFlowPyrLK(left, bright, points, guesses.copy(), **_TRACKED)[:2]
    back, is_back = cv2.calcOpticalFlowPyrLK(bright, left, there, points.copy(), **_TRACKED)[:2]
    kept = (is_there[:, 0] == 1) & (is_back[:, 0] == 1)
    there = there.astype(np.float64)
    kept &= (np.hypot(*(back - points).T) < 0.3) & (np.hypot(*(there - guesses).T) < 2.0)
    u, v = points[kept].T.astype(np.float64)
    return np.column_stack([u, v, there[kept, 0], there[kept, 1] - v])


def _light_of(image: U8, points: F32) -> tuple[float, float]:
    """Usual mean and deviation of an image around the first 50 of some points."""
    patches = [cv2.getRectSubPix(image, _SIDE, point.tolist()) for point in points[:50]]
    mean, std = np.median([cv2.meanStdDev(patch) for patch in patches], axis=0)
    return float(mean.item()), float(std.item())


def _search(left: U8, right: U8, point: F32, span: tuple[int, int], search_px: int) -> tuple[float, float]:
    """Best place of a left patch in the right image, NaN when it is at the limit, poor or not unique."""
    nothing = (math.nan, math.nan)
    u = round(float(point[0]))
    v = round(float(point[1]))
    rows, cols = left.shape
    top = max(0, v - _PATCH - search_px)
    bottom = min(rows, v + _PATCH + search_px + 1)
    start = max(0, u - _PATCH - span[1])
    end = min(cols, u + _PATCH + 1 - span[0])
    patch = left[v - _PATCH : v + _PATCH + 1, u - _PATCH : u + _PATCH + 1]
    strip = right[top:bottom, start:end]
    if strip.shape[0] <= patch.shape[0] + 2 or strip.shape[1] <= patch.shape[1] + 2:
        return nothing
    score = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (col, row) = cv2.minMaxLoc(score)
    if best < _SIMILARITY_MIN or row in (0, score.shape[0] - 1) or col in (0, score.shape[1] - 1):
        return nothing
    score[max(0, row - 3) : row + 4, max(0, col - 3) : col + 4] = -1.0
    if cv2.minMaxLoc(score)[1] > 0.5 * (1.0 + best) - 0.02:
        return nothing
    return float(start + col + _PATCH) + float(point[0]) - u, float(top + row + _PATCH) + float(point[1]) - v
