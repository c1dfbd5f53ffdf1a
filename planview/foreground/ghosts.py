"""Ghosts: foreground where a person stood when the background was learned, and has left since.

A person or a thing has an outline in the image that the background lacks; a ghost has it in the background. So the
stronger edges along the boundary of a blob decide between the two (Cucchiara et al. 2003 separate ghosts from objects
by optical flow; edges in its place are our choice).

As long as the person who has left overlaps the ghost, both are one blob with both outlines. Then pixels decide: a ghost
looks like what is around the blob, in the image and not in the background; a person does so in the background.
"""

from __future__ import annotations

import cv2
import numpy as np

from calib.types import F32, I32, U8, Bool
from planview.foreground import _ghost_kernels as kernels
from planview.foreground.blobs import Blobs, find_blobs

SEARCH_INTERVAL_S = 0.5
"""Time between two searches for ghosts [s]."""
EDGE_RATIO = 1.5
"""Edges along a ghost's boundary are so many times stronger in the background than in the image. Edges of the
scene behind are in both and pull the ratio towards 1."""
EDGE_LEVELS = 5.0
"""Smallest mean step along that boundary in the background [levels of 255]: more than noise makes."""
GHOST_AREA_PX = 20
"""Smallest area of a ghost [px]: smaller blobs have too short a boundary to compare."""
START_S = 6.0
"""Time from the first frame in which people of that frame set out [s]: ghosts are then searched in every frame, and
told from people who overlap them. Twice the time in which the background settles."""
STILL_S = 0.7
"""In that time, a blob that has not moved for so long is a ghost, unless a tracked person has walked there [s].
People who come in walk: what stays for this long, half a step, and has not walked is where a person was."""
GHOST_MOTION = 0.02
"""Largest moving share of a ghost's pixels, for noise. A passer-by merges with it into one blob, which is examined
again when the person has passed."""


def find_ghosts(luma: U8, background: U8, blobs: Blobs, motion: U8) -> U8:
    """Blobs of the foreground whose outline is in the background and not in the image.

    Args:
        luma: (H, W) uint8, the image.
        background: (H, W) uint8, luma of the learned background.
        blobs: of the foreground.
        motion: (H, W) uint8, moving pixels are not 0.
    Returns:
        (H, W) uint8, 255 in ghosts.
    """
    length, (here, before) = np.zeros(len(blobs), np.int64), np.zeros((2, len(blobs)))
    kernels.compare_outlines(blobs.labels, _box_of(blobs), luma, background, length, here, before)
    here, before = here / np.maximum(1, length), before / np.maximum(1, length)
    ghost = (before >= EDGE_LEVELS) & (before >= EDGE_RATIO * here)
    return _painted(blobs, ghost & _still(blobs, motion))


def moved_lately(motion: U8, now_s: float, span_s: float, moved_s: F32) -> U8:
    """(H, W) uint8, 255 where motion, (H, W) uint8, has not been 0 within a span until now [s].

    Args:
        moved_s: (H, W) times of the last motion [s], kept up to date.
    """
    moved = np.empty_like(motion)
    kernels.note_motion(motion, now_s, now_s - span_s, moved_s, moved)
    return moved


def find_still(blobs: Blobs, moved: U8) -> U8:
    """Blobs of the foreground that have not moved for a while.

    Args:
        blobs: of the foreground.
        moved: (H, W) uint8, pixels that have moved are not 0.
    Returns:
        (H, W) uint8, 255 in such blobs.
    """
    return _painted(blobs, _still(blobs, moved))


def _still(blobs: Blobs, motion: U8) -> Bool:
    """(n,) whether each blob is large enough and hardly any of it moves; the background is none."""
    moving = np.zeros(len(blobs), np.int64)
    kernels.count_moving(blobs.labels, _box_of(blobs), motion, moving)
    still = (moving / np.maximum(1, blobs.area_px) <= GHOST_MOTION) & (blobs.area_px >= GHOST_AREA_PX)
    still[0] = False
    return np.asarray(still)


def find_uncovered(luma: U8, background: U8, mask: U8) -> U8:
    """Foreground pixels that look like what is around their blob where the background does not.

    Each pixel is compared with the image at the nearest pixel outside the foreground. Texture of the scene is in both
    differences and pulls their ratio towards 1.

    Args:
        luma: (H, W) uint8, the image.
        background: (H, W) uint8, luma of the learned background.
        mask: (H, W) uint8, foreground is not 0.
    Returns:
        (H, W) uint8, 255 in uncovered places.
    """
    left, top, width, height = cv2.boundingRect(mask)
    uncovered = np.zeros(mask.shape, np.uint8)
    # One pixel more than the dilation below, so that something around every blob is inside.
    rows, cols = slice(max(0, top - 2), top + height + 2), slice(max(0, left - 2), left + width + 2)
    inside, luma, background = (np.ascontiguousarray(a[rows, cols]) for a in (mask, luma, background))
    # Pixels at an outline are a mixture of both sides.
    blobs = np.asarray(cv2.dilate(inside, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    if not width or blobs.all():
        return uncovered
    nearest, around = _around(luma, blobs)
    alike = np.zeros(blobs.shape, np.uint8)
    kernels.compare_around(luma, background, inside, nearest, around, EDGE_RATIO, EDGE_LEVELS, alike)
    if alike.any():
        parts = find_blobs(np.asarray(cv2.morphologyEx(alike, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8))
        large = parts.area_px >= GHOST_AREA_PX
        large[0] = False
        uncovered[rows, cols] = _painted(parts, large)
    return uncovered


def _around(luma: U8, mask: U8) -> tuple[I32, U8]:
    """(H, W) int32 number of the nearest pixel where the mask is 0, and the smoothed luma of each by that number."""
    _, nearest = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    around = np.zeros(mask.size + 1, np.uint8)
    kernels.by_label(np.asarray(cv2.blur(luma, (3, 3)), np.uint8), mask, around)
    return np.asarray(nearest, np.int32), around


def _painted(blobs: Blobs, chosen: Bool) -> U8:
    """(H, W) uint8, 255 in the blobs that are chosen, (n,)."""
    out = np.zeros(blobs.labels.shape, np.uint8)
    if chosen.any():
        kernels.paint_blobs(blobs.labels, _box_of(blobs), chosen, out)
    return out


def _box_of(blobs: Blobs) -> kernels.Box:
    """What holds all blobs."""
    if len(blobs) < 2:
        return kernels.Box(0, 0, 0, 0)
    low = blobs.box_px[1:, :2].min(axis=0)
    high = (blobs.box_px[1:, :2] + blobs.box_px[1:, 2:]).max(axis=0)
    return kernels.Box(int(low[0]), int(high[0]), int(low[1]), int(high[1]))
