"""Row offset of a rectified pair: how far matches lie off their row, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from pydantic import Field

from calib.params import Params
from calib.types import F32, F64, U8, AnyArray, Bool

THREADS = 2
"""Frames that are measured at a time."""
_PATCH = 7
"""Half side of a matched patch [px]."""
_SIMILARITY_MIN = 0.9
"""Smallest normalised correlation of two patches that count as a match (our choice)."""
_MATCHES_MIN = 60
"""Smallest number of matches that justifies a correction (our choice)."""
_IMPROVEMENT_MIN_PX = 0.05
"""A correction must lower the median residual of matches it was not fitted to by this much [px]: less costs no match
(our choice)."""


@dataclass(frozen=True)
class VerticalModel:
    """Row offset v_right - v_left of matching points, affine over the right image.

    Attributes:
        offset_px: at the image's pixel (0, 0) [px].
        per_u, per_v: change per pixel along a row and down a column.
    """

    offset_px: float = 0.0
    per_u: float = 0.0
    per_v: float = 0.0

    def __call__(self, u: F64, v: F64) -> F64:
        """Offsets [px] at pixels of any shape."""
        return np.asarray(self.offset_px + self.per_u * u + self.per_v * v, dtype=np.float64)

    @property
    def matrix(self) -> F64:
        """(3, 3) homogeneous pixel (u, v) to (u, v + offset)."""
        return np.array([[1.0, 0.0, 0.0], [self.per_u, 1.0 + self.per_v, self.offset_px], [0.0, 0.0, 1.0]])


class VerticalParams(Params):
    """Measuring the vertical residual."""

    features: int = Field(default=300, ge=20, le=5000)
    """Corners tried in each frame (our choice)."""
    search_px: int = Field(default=8, ge=1, le=64)
    """Largest row offset looked for, each way [px]; more than this is not a residual but a wrong calibration."""


@dataclass(frozen=True, eq=False)
class VerticalFit:
    """What was measured.

    Attributes:
        model: correction to give to ``Rectifier``; zero when none is justified.
        matches: (N, 4) float64 [px]: u and v in the left image, u in the right image, v_right - v_left.
        before_px, after_px: median absolute row offset without and with the correction [px]; NaN without matches.
    """

    model: VerticalModel = field(default_factory=VerticalModel)
    matches: F64 = field(default_factory=lambda: np.empty((0, 4)))
    before_px: float = math.nan
    after_px: float = math.nan


def measure_vertical(
    pairs: Iterable[tuple[U8, U8]], disparity_max_px: float, params: VerticalParams | None = None
) -> VerticalFit:
    """Measure and model the row offset of rectified pairs.

    Corners of the left image are found again in the right one by correlation within the disparities that can occur and
    refined by Lucas-Kanade; saturated surroundings are left out. Of no correction, an offset and an affine one, the
    simplest is taken that lowers the residual of matches it was not fitted to.

    Args:
        pairs: left and right (H, W) uint8, rectified.
        disparity_max_px: largest disparity that can occur [px].
    """
    params = params or VerticalParams()
    with ThreadPoolExecutor(THREADS) as pool:  # correlation releases Python's lock
        found = list(pool.map(lambda pair: match_corners(pair[0], pair[1], disparity_max_px, params), pairs))
    matches = np.concatenate(found) if found else np.empty((0, 4))
    if len(matches) == 0:
        return VerticalFit()
    before = _residual(VerticalModel(), matches)
    model = _choose(matches)
    return VerticalFit(model, matches, before, _residual(model, matches))


def match_corners(
    left: U8, right: U8, disparity_max_px: float, params: VerticalParams, disparity_min_px: float = -2.0
) -> F64:
    """Corners of the left image and where the right one shows them.

    Args:
        disparity_max_px, disparity_min_px: disparities to search [px]; negative ones show swapped images.
    Returns:
        (N, 4) float64 [px]: u and v in the left image, u in the right image, v_right - v_left.
    """
    corners = cv2.goodFeaturesToTrack(left, params.features, 0.01, 2.0 * _PATCH, mask=_matchable(left))
    if corners is None:
        return np.empty((0, 4))
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 2)
    span = math.floor(disparity_min_px), math.ceil(disparity_max_px)
    guesses = np.array([_search(left, right, point, span, params) for point in points], dtype=np.float32)
    good = np.isfinite(guesses).all(axis=1)
    points, guesses = points[good], guesses[good]
    if len(points) == 0:
        return np.empty((0, 4))
    refined, kept = _refine(left, right, points, guesses)
    u, v = points[kept].T.astype(np.float64)
    return np.column_stack([u, v, refined[kept, 0], refined[kept, 1] - v])


def fit_affine(matches: F64, slopes: bool = True) -> VerticalModel:
    """Robust fit of the row offsets, by iteratively reweighted least squares (Huber).

    Args:
        matches: (N, 4) as from ``match_corners``.
        slopes: whether the offset may change over the image.
    """
    u, v, target = matches[:, 2], matches[:, 1], matches[:, 3]
    if not slopes:
        return VerticalModel(float(np.median(target)))
    columns = np.column_stack([np.ones_like(u), u - u.mean(), v - v.mean()])
    solution = np.array([np.median(target), 0.0, 0.0])
    for _ in range(20):
        residual = target - columns @ solution
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.02)
        weight = np.where(np.abs(residual) < 4.0 * scale, 1.0 / np.maximum(np.abs(residual), scale), 0.0)
        normal = columns.T @ (columns * weight[:, None])
        solution = np.linalg.lstsq(normal, columns.T @ (weight * target), rcond=None)[0]
    offset = solution[0] - solution[1] * u.mean() - solution[2] * v.mean()
    return VerticalModel(float(offset), float(solution[1]), float(solution[2]))


def _choose(matches: F64) -> VerticalModel:
    if len(matches) < _MATCHES_MIN:
        return VerticalModel()
    best, best_residual = VerticalModel(), _residual(VerticalModel(), matches)
    for slopes in (False, True):
        folds = [matches[0::2], matches[1::2]]
        held_out = [_residual(fit_affine(a, slopes), b) for a, b in (folds, folds[::-1])]
        if max(held_out) < best_residual - _IMPROVEMENT_MIN_PX:
            best, best_residual = fit_affine(matches, slopes), max(held_out)
    return best


def _residual(model: VerticalModel, matches: F64) -> float:
    return float(np.median(np.abs(matches[:, 3] - model(matches[:, 2], matches[:, 1]))))


def _matchable(image: U8) -> U8:
    """255 where a patch around a pixel is inside the picture and not saturated."""
    kernel = np.ones((2 * _PATCH + 1, 2 * _PATCH + 1), np.uint8)
    usable = ((image > 0) & (image < 250)).astype(np.uint8) * np.uint8(255)
    return np.asarray(cv2.erode(usable, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)


def _search(left: U8, right: U8, point: F32, span: tuple[int, int], params: VerticalParams) -> tuple[float, float]:
    """Best place of a left patch in the right image, NaN when it is at the limit, poor or not unique."""
    nothing = (math.nan, math.nan)
    u, v = round(float(point[0])), round(float(point[1]))
    rows, cols = left.shape
    top, bottom = max(0, v - _PATCH - params.search_px), min(rows, v + _PATCH + params.search_px + 1)
    start, end = max(0, u - _PATCH - span[1]), min(cols, u + _PATCH + 1 - span[0])
    patch = left[v - _PATCH : v + _PATCH + 1, u - _PATCH : u + _PATCH + 1]
    strip = right[top:bottom, start:end]
    if strip.shape[0] <= patch.shape[0] + 2 or strip.shape[1] <= patch.shape[1] + 2:
        return nothing
    score = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
    row, col = np.unravel_index(int(np.argmax(score)), score.shape)
    best = float(score[row, col])
    if best < _SIMILARITY_MIN or row in (0, score.shape[0] - 1) or col in (0, score.shape[1] - 1):
        return nothing
    score[max(0, row - 3) : row + 4, max(0, col - 3) : col + 4] = -1.0
    if float(score.max()) > 0.5 * (1.0 + best) - 0.02:
        return nothing
    return float(start + col + _PATCH) + float(point[0]) - u, float(top + row + _PATCH) + float(point[1]) - v


def _refine(left: U8, right: U8, points: F32, guesses: F32) -> tuple[F64, Bool]:
    """Sub-pixel places in the right image, and which of them lead back to where they came from."""
    a, b = points.reshape(-1, 1, 2), guesses.reshape(-1, 1, 2)
    there, found, _ = _track(left, right, a, b.copy())
    back, found_back, _ = _track(right, left, there, a.copy())
    there, back = there.reshape(-1, 2).astype(np.float64), back.reshape(-1, 2)
    kept = (found.reshape(-1) == 1) & (found_back.reshape(-1) == 1)
    kept &= (np.hypot(*(back - points).T) < 0.3) & (np.hypot(*(there - guesses).T) < 2.0)
    return there, np.asarray(kept, dtype=np.bool_)


def _track(source: U8, target: U8, points: F32, guesses: F32) -> tuple[AnyArray, AnyArray, AnyArray]:
    return cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        guesses,
        winSize=(2 * _PATCH + 1, 2 * _PATCH + 1),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
