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
from pydantic import Field

from calib.params import Params
from calib.types import F32, U8, Bool
from planview.foreground.blobs import Blobs, find_blobs

_STEP_GAIN = 4.0
"""Response of the 3x3 Sobel operator to a step of one level."""
_WINDOW = 5
"""Side of the window in which a pixel is compared with what is around its blob [px]: averages noise and texture, and is
narrower than a limb of a person of 60 px. Our choice."""


class GhostParams(Params):
    """When foreground that does not move is a ghost; our choices."""

    interval_s: float = Field(0.5, gt=0, le=10)
    """Time between two searches for ghosts [s]."""
    edge_ratio: float = Field(1.5, ge=1, le=10)
    """Edges along a ghost's boundary are so many times stronger in the background than in the image. Edges of the
    scene behind are in both and pull the ratio towards 1."""
    edge_levels: float = Field(5.0, gt=0, le=100)
    """Smallest mean step along that boundary in the background [levels of 255]: more than noise makes."""
    area_px: int = Field(20, ge=1, le=100_000)
    """Smallest area of a ghost [px]: smaller blobs have too short a boundary to compare."""
    start_s: float = Field(6.0, ge=0, le=60)
    """Time from the first frame in which people of that frame set out [s]: ghosts are then searched in every frame, and
    told from people who overlap them. Twice the time in which the background settles."""
    still_s: float = Field(0.7, gt=0, le=10)
    """In that time, a blob that has not moved for so long is a ghost, unless a tracked person has walked there [s].
    People who come in walk: what stays for this long, half a step, and has not walked is where a person was."""
    motion: float = Field(0.02, ge=0, le=1)
    """Largest moving share of a ghost's pixels, for noise. A passer-by merges with it into one blob, which is examined
    again when the person has passed."""


def find_ghosts(luma: U8, background: U8, blobs: Blobs, motion: U8, params: GhostParams) -> U8:
    """Blobs of the foreground whose outline is in the background and not in the image.

    Args:
        luma: (H, W) uint8, the image.
        background: (H, W) uint8, luma of the learned background.
        blobs: of the foreground.
        motion: (H, W) uint8, moving pixels are not 0.
    Returns:
        (H, W) uint8, 255 in ghosts.
    """
    count, labels = len(blobs), blobs.labels
    mask = (labels > 0).astype(np.uint8)
    if count < 2:
        return mask
    rim = (mask > 0) & (cv2.erode(mask, np.ones((3, 3), np.uint8)) == 0)
    which = labels[rim]
    length = np.maximum(1, np.bincount(which, minlength=count))
    inside = _edges(luma)[rim], _edges(background)[rim]
    here, before = (np.bincount(which, values, minlength=count) / length for values in inside)
    ghost = (before >= params.edge_levels) & (before >= params.edge_ratio * here) & _still(blobs, motion, params)
    return np.asarray(np.where(ghost[labels], 255, 0), dtype=np.uint8)


def find_still(blobs: Blobs, moved: U8, params: GhostParams) -> U8:
    """Blobs of the foreground that have not moved for a while.

    Args:
        blobs: of the foreground.
        moved: (H, W) uint8, pixels that have moved are not 0.
    Returns:
        (H, W) uint8, 255 in such blobs.
    """
    return np.asarray(np.where(_still(blobs, moved, params)[blobs.labels], 255, 0), dtype=np.uint8)


def _still(blobs: Blobs, motion: U8, params: GhostParams) -> Bool:
    """(n,) whether each blob is large enough and hardly any of it moves; the background is none."""
    moving = np.bincount(blobs.labels[motion > 0], minlength=len(blobs)) / np.maximum(1, blobs.area_px)
    still = (moving <= params.motion) & (blobs.area_px >= params.area_px)
    still[0] = False
    return np.asarray(still)


def find_uncovered(luma: U8, background: U8, mask: U8, params: GhostParams) -> U8:
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
    inside = mask[rows, cols]
    # Pixels at an outline are a mixture of both sides.
    blobs = np.asarray(cv2.dilate(inside, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    if not width or blobs.all():
        return uncovered
    smooth = np.asarray(cv2.blur(luma[rows, cols], (3, 3)), dtype=np.float32)
    around = _nearest_outside(smooth, blobs)
    here, before = (_mean_difference(a[rows, cols], around, inside) for a in (luma, background))
    alike = (inside > 0) & (before >= params.edge_ratio * here + params.edge_levels)
    shown = np.where(alike, np.uint8(255), np.uint8(0))
    uncovered[rows, cols] = cv2.morphologyEx(shown, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    parts = find_blobs(uncovered)
    uncovered[parts.area_px[parts.labels] < params.area_px] = 0
    return uncovered


def _nearest_outside(values: F32, mask: U8) -> F32:
    """(H, W) float32 value at the nearest pixel where the mask is 0."""
    _, nearest = cv2.distanceTransformWithLabels(mask, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    by_label = np.zeros(int(nearest.max()) + 1, np.float32)
    by_label[nearest[mask == 0]] = values[mask == 0]
    return np.asarray(by_label[nearest])


def _mean_difference(luma: U8, around: F32, mask: U8) -> F32:
    """(H, W) float32 mean absolute difference over the foreground in a window [levels]."""
    inside = np.asarray(mask > 0, dtype=np.float32)
    difference = np.abs(luma - around) * inside
    total, count = (cv2.blur(a, (_WINDOW, _WINDOW)) for a in (difference, inside))
    return np.asarray(total / np.maximum(count, 1e-3), dtype=np.float32)


def _edges(luma: U8) -> F32:
    """(H, W) float32 steps [levels] across each pixel."""
    right, down = (cv2.Sobel(luma, cv2.CV_32F, dx, 1 - dx, ksize=3) for dx in (1, 0))
    return np.asarray(cv2.magnitude(right, down) / _STEP_GAIN, dtype=np.float32)
