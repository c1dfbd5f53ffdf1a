"""Ghosts: foreground where a person stood when the background was learned, and has left since.

A person or a thing has an outline in the image that the background lacks; a ghost has it in the background. So the
stronger edges along the boundary of a blob decide between the two (Cucchiara et al. 2003 separate ghosts from objects
by optical flow; edges in its place are our choice).

As long as the person who has left overlaps the ghost, both are one blob with both outlines. Then pixels decide: a ghost
looks like what is around the blob, in the image and not in the background; a person does so in the background.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from calib.carried import Carried
from calib.types import F32, I32, I64, U8, Bool

SEARCH_INTERVAL_S = 0.5
"""Time between two searches for ghosts [s]."""
EDGE_RATIO = 1.5
"""Edges along a ghost's boundary, in the background over in the image: at least this much stronger. Edges of the
scene behind are in both and pull the ratio towards 1."""
EDGE_LEVELS = 5.0
"""Smallest mean step along that boundary in the background [levels of 255]: more than noise makes."""
GHOST_AREA_PX = 20
"""Smallest area of a ghost [px]: smaller blobs have too short a boundary to compare."""
START_S = 6.0
"""Time from the first frame in which people of that frame set out [s]: ghosts are then searched in every frame, and
distinguished from people who overlap them. Twice the time in which the background settles."""
STILL_S = 0.7
"""In that time, a blob that has not moved since is a ghost, unless a tracked person has walked there [s].
People who come in walk: what stays for this long, half a step, and has not walked is where a person was."""
GHOST_MOTION = 0.02
"""Largest moving share of a ghost's pixels, for noise. A passer-by merges with it into one blob, which is examined
again when the person has passed."""
_SQUARE: U8 = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class Blobs:
    """Connected groups of foreground pixels; label 0 is the background.

    Attributes:
        labels: (H, W) int32.
        area_px: (n,) int64 pixels of each label, the background's included.
        box_px: (n, 4) int32 left, top, width, height of each label.
    """

    labels: I32
    area_px: I64
    box_px: I32

    def __len__(self) -> int:
        return len(self.area_px)


def find_blobs(mask: U8) -> Blobs:
    """Group the non-zero pixels of a (H, W) uint8 mask, diagonal neighbours included."""
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    return Blobs(
        np.asarray(labels, np.int32),
        stats[:, cv2.CC_STAT_AREA].astype(np.int64),
        np.asarray(stats[:, : cv2.CC_STAT_AREA], np.int32),
    )


class Ghosts(Carried):
    """Finds where people of the first frames have left: from time to time, and in every frame while they set out.

    Attributes:
        mask: (H, W) uint8, 255 in ghosts.
    """

    CARRIED = "mask", "_moved_s", "_searched_s", "_first_s"

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        self.mask, self._moved_s = np.zeros(self._shape, np.uint8), np.zeros(self._shape, np.float32)
        self._searched_s = -math.inf
        self._first_s = math.nan

    def update(
        self, now_s: float, luma: U8, background: Callable[[], U8], mask: U8, motion: U8, walkers: Bool | None
    ) -> None:
        """Search one frame.

        Args:
            luma, mask, motion: (H, W) uint8, of the image; foreground and moving pixels are not 0.
            background: gives the (H, W) uint8 luma of the learned background.
            walkers: (H, W) bool, pixels of people who have walked; None where none is known.
        """
        if math.isnan(self._first_s):
            self._first_s = now_s
        age_s = now_s - self._first_s
        starting = age_s <= START_S
        if not starting and now_s - self._searched_s < SEARCH_INTERVAL_S - 5e-4:
            return
        self._searched_s = now_s
        behind = background()
        blobs = find_blobs(mask)
        self.mask = find_ghosts(luma, behind, blobs, motion)
        if starting:
            self._moved_s[motion > 0] = age_s
            self.mask |= find_uncovered(luma, behind, mask)
            self.mask |= find_still(blobs, self._moved_s > np.float32(age_s - STILL_S))
        if walkers is not None:
            self.mask[walkers] = 0


def find_ghosts(luma: U8, background: U8, blobs: Blobs, motion: U8) -> U8:
    """(H, W) uint8, 255 in blobs whose outline is in the background and not in the image, (H, W) uint8 luma of both;
    none that moves, where ``motion``, (H, W) uint8, is not 0."""
    mask = (blobs.labels > 0).astype(np.uint8)
    rim = (mask > 0) & (cv2.erode(mask, _SQUARE) == 0)
    which = blobs.labels[rim]
    length = np.maximum(1, np.bincount(which, minlength=len(blobs)))
    here = np.bincount(which, _steps(luma)[rim], minlength=len(blobs)) / length
    before = np.bincount(which, _steps(background)[rim], minlength=len(blobs)) / length
    is_ghost = (before >= EDGE_LEVELS) & (before >= EDGE_RATIO * here) & _is_still(blobs, motion)
    return paint_blobs(blobs, is_ghost)


def find_still(blobs: Blobs, moved: U8 | Bool) -> U8:
    """(H, W) uint8, 255 in blobs that have not moved for a while: ``moved``, (H, W), is 0 nearly all over them."""
    return paint_blobs(blobs, _is_still(blobs, moved))


def _is_still(blobs: Blobs, motion: U8 | Bool) -> Bool:
    """(n,) whether each blob is large enough and hardly any of it moves."""
    moving = np.bincount(blobs.labels[motion > 0], minlength=len(blobs)) / np.maximum(1, blobs.area_px)
    return (moving <= GHOST_MOTION) & (blobs.area_px >= GHOST_AREA_PX)


def find_uncovered(luma: U8, background: U8, mask: U8) -> U8:
    """(H, W) uint8, 255 in foreground that looks like what is around its blob where the background does not, of the
    (H, W) uint8 luma of both.

    Each pixel is compared with the image at the nearest pixel outside the foreground, by the mean difference over the
    foreground within 5x5 pixels, which average noise and texture and are narrower than a limb of a person of 60 px (our
    choice). Texture of the scene is in both differences and pulls their ratio towards 1.
    """
    left, top, width, height = cv2.boundingRect(mask)
    uncovered = np.zeros(mask.shape, np.uint8)
    # One pixel more than the dilation below, so that something around every blob is inside.
    rows = slice(max(0, top - 2), top + height + 2)
    cols = slice(max(0, left - 2), left + width + 2)
    inside, luma, background = (np.ascontiguousarray(a[rows, cols]) for a in (mask, luma, background))
    # Pixels at an outline are a mixture of both sides.
    blobs = np.asarray(cv2.dilate(inside, _SQUARE), dtype=np.uint8)
    if not width or blobs.all():
        return uncovered
    around = _around(luma, blobs)
    here = _mean_difference(luma, around, inside)
    before = _mean_difference(background, around, inside)
    alike = np.where((inside > 0) & (before >= EDGE_RATIO * here + EDGE_LEVELS), np.uint8(255), np.uint8(0))
    if alike.any():
        parts = find_blobs(np.asarray(cv2.morphologyEx(alike, cv2.MORPH_OPEN, _SQUARE), np.uint8))
        uncovered[rows, cols] = paint_blobs(parts, parts.area_px >= GHOST_AREA_PX)
    return uncovered


def _around(luma: U8, mask: U8) -> F32:
    """(H, W) float32 smoothed luma of the nearest pixel where the mask is 0."""
    _, nearest = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    outside = mask == 0
    by_label = np.zeros(int(nearest.max()) + 1, np.float32)
    by_label[nearest[outside]] = cv2.blur(luma, (3, 3))[outside]
    return np.asarray(by_label[nearest])


def _mean_difference(luma: U8, around: F32, mask: U8) -> F32:
    """(H, W) float32 mean difference of luma to what is around, over the masked pixels of a window."""
    inside = (mask > 0).astype(np.float32)
    total = cv2.blur(np.abs(luma - around) * inside, (5, 5))
    count = cv2.blur(inside, (5, 5))
    return np.asarray(total / np.maximum(count, np.float32(1e-3)))


def _steps(luma: U8) -> F32:
    """(H, W) float32 step [levels] across each pixel, by the 3x3 Sobel operators, whose gain is 4."""
    across = cv2.Sobel(luma, cv2.CV_32F, 1, 0, ksize=3)
    along = cv2.Sobel(luma, cv2.CV_32F, 0, 1, ksize=3)
    return cv2.magnitude(across, along) / np.float32(4.0)


def paint_blobs(blobs: Blobs, chosen: Bool) -> U8:
    """(H, W) uint8, 255 in the blobs that are chosen, (n,); the background is none."""
    chosen = chosen & (np.arange(len(blobs)) > 0)
    return np.where(chosen, np.uint8(255), np.uint8(0))[blobs.labels]
