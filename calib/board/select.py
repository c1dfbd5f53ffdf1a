"""Which frames of a long take are worth calibrating from: sharp ones that show the board in different places."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from calib.board.model import BoardView, Corners
from calib.types import F64, U8

MAX_VIEWS = 40
"""More views of one board add little: the error falls with the root of their number (our choice)."""
_BLURRED_SHARE = 0.6
"""Frames less sharp than this share of the take's best tenth are moved or out of focus (our choice)."""
_PATCH_PX = 4


def sharpness(grey: U8, corners: Corners) -> float:
    """Median steepness of the edges at the corners, as a share of their contrast per pixel (1: perfectly sharp)."""
    values = []
    height, width = grey.shape
    for x, y in np.rint(corners.pixels).astype(int):
        patch = grey[max(0, y - _PATCH_PX) : y + _PATCH_PX + 1, max(0, x - _PATCH_PX) : x + _PATCH_PX + 1]
        if not (0 <= x < width and 0 <= y < height) or min(patch.shape) < 3:
            continue
        smooth = cv2.GaussianBlur(patch, (3, 3), 0).astype(np.float64)
        contrast = float(np.ptp(smooth))
        if contrast > 0:
            steepest = max(np.abs(np.diff(smooth, axis=axis)).max() for axis in (0, 1))
            values.append(steepest / contrast)
    return float(np.median(values)) if values else 0.0


def select_views(
    views: Sequence[BoardView], sharp: Sequence[float], size: tuple[int, int], limit: int = MAX_VIEWS
) -> list[int]:
    """Indices of the views to use, in order.

    Blurred ones go first; then views are taken one by one, each the most different from those taken already in
    place, size and tilt of the board.

    Args:
        views: to choose from.
        sharp: of each, the lesser of both images.
        size: (width, height) [px].
    """
    if len(views) <= limit:
        return list(range(len(views)))
    floor = _BLURRED_SHARE * float(np.quantile(np.asarray(sharp), 0.9))
    good = [i for i, value in enumerate(sharp) if value >= floor]
    features = np.array([_features(view, size) for view in views])
    taken = [max(good, key=lambda i: sharp[i])]
    away = np.linalg.norm(features - features[taken[0]], axis=1)
    while len(taken) < min(limit, len(good)):
        best = max((i for i in good if i not in taken), key=lambda i: (float(away[i]), sharp[i]))
        taken.append(best)
        away = np.minimum(away, np.linalg.norm(features - features[best], axis=1))
    return sorted(taken)


def _features(view: BoardView, size: tuple[int, int]) -> F64:
    """Place, log size, slant and perspective of the board in the left image, each about one wide."""
    normal = (view.left - [size[0] / 2, size[1] / 2]) / size[0]
    centre = normal.mean(axis=0)
    spread = np.cov((normal - centre).T)
    scale = np.sqrt(np.trace(spread))
    shape = np.array([spread[0, 0] - spread[1, 1], 2 * spread[0, 1]]) / np.trace(spread)
    third = ((normal - centre) ** 3).mean(axis=0) / scale**3
    return np.concatenate([2 * centre, [np.log(scale)], shape, 2 * third])
