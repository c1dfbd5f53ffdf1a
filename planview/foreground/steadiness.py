"""Whether the camera stood still."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum

import cv2
import numpy as np

from calib.carried import Carried
from calib.types import F32, F64, U8, Bool

THUMBNAIL = (160, 120)
"""(width, height) to which every frame is reduced [px]: averages noise, and keeps edges of the scene."""
BLOCK_PX = 20
"""Side of the blocks that are judged separately [px of the thumbnail]: 8 x 6 of them, whatever people do in the middle
of the image the others show of the camera."""
MOVED_PX = 1.0
"""Motion of a point from which it has moved [px of the thumbnail]: 4 px of 640, beyond what wind does to a mast."""
MOVED_SHARE = 0.85
"""Share of the tracked points that move with the camera; the others are reflections and what is mistracked."""
TEXTURED_SHARE = 0.6
"""Share of the blocks that must have texture for a result: on a plain wall all texture is people's."""
VIEW_SHARE = 0.25
"""Share of the blocks that show the same texture in two frames from which these show a view, and no damage."""
SETTLED_S = 1.0
"""Time without motion after which a camera stands still again [s]."""
BREAK_MAX_S = 1.0
"""Time with nothing of the view before after which the scene is cut [s]: a person who steps in close before the camera
hides all of it for some tenths of a second, and walks on."""
ROUNDED_S = 5e-4
"""Slack of intervals [s]: time stamps are rounded."""


class Steady(Enum):
    """A frame compared with those before it."""

    STILL = "still"
    """The same view."""
    MOVING = "moving"
    """The camera moves, or has until a second ago."""
    BREAK = "break"
    """Nothing of the last view shows: a damaged frame, a person close before the camera, or a cut."""
    CUT = "cut"
    """Nothing of the view before the break has shown for BREAK_MAX_S, and another one shows."""


class Steadiness(Carried):
    """Watches the frames of one camera: ``update`` once per frame, in order.

    Attributes:
        moving_s: how long the camera has moved [s].
        first_moving_s: time of the first frame in which it moves [s]; NaN for none.
        cuts: numbers of the frames with which another view begins.
    """

    def __init__(self) -> None:
        # Times [s] and thumbnails, one per interval: the oldest shows slow motion.
        self._kept: deque[tuple[float, U8]] = deque(maxlen=5)
        self._last: U8 | None = None
        # The last thumbnail with anything of the view, number and time [s] of the first frame without.
        self._before_break: tuple[U8, int, float] | None = None
        self._lasting: Bool = np.zeros(_BLOCKS, np.bool_)
        self._moved_s = -math.inf
        self._now_s = 0.0
        self.moving_s = 0.0
        self.first_moving_s = math.nan
        self.cuts: list[int] = []

    def update(self, frame: int, timestamp_s: float, grey: U8) -> Steady:
        """Judge the next frame, (H, W) uint8, by its index for the checks."""
        thumbnail = np.asarray(cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        step_s, self._now_s = max(0.0, timestamp_s - self._now_s), timestamp_s
        found = self._judge(frame, timestamp_s, thumbnail)
        self._last = thumbnail
        if found is Steady.MOVING:
            self.moving_s += min(step_s, SETTLED_S)
            if math.isnan(self.first_moving_s):
                self.first_moving_s = timestamp_s
        return found

    def _judge(self, frame: int, now_s: float, thumbnail: U8) -> Steady:
        last, broken = self._last, self._before_break
        self._before_break = None
        if broken is not None and unrelated(broken[0], thumbnail, self._lasting):
            lasts = last is not None and float(alike(last, thumbnail).mean()) >= VIEW_SHARE
            if now_s - broken[2] < BREAK_MAX_S - ROUNDED_S or not lasts:
                self._before_break = broken
                return Steady.BREAK
            self.cuts.append(broken[1])
            self._kept.clear()
            self._kept.append((now_s, thumbnail))
            self._moved_s = -math.inf
            self._lasting = np.zeros(_BLOCKS, np.bool_)
            return Steady.CUT
        new = broken is None and last is not None and unrelated(last, thumbnail, self._lasting)
        if new and last is not None and not moved(last, thumbnail):
            self._before_break = last, frame, now_s
            return Steady.BREAK
        # Compared with the thumbnails of an interval ago and of the oldest kept, five times a second.
        if not self._kept or now_s - self._kept[-1][0] >= 0.2 - ROUNDED_S:
            kept = [before for _, before in self._kept]
            if kept:
                self._lasting = alike(kept[-1], thumbnail)
            if any(moved(before, thumbnail) for before in [*kept[:1], *kept[1:][-1:]]):
                self._moved_s = now_s
                self._kept.clear()
            self._kept.append((now_s, thumbnail))
        return Steady.MOVING if now_s - self._moved_s < SETTLED_S else Steady.STILL


def unrelated(before: U8, after: U8, lasting: Bool) -> bool:
    """Whether two thumbnails (120, 160) uint8 have nothing in common, at whatever exposure.

    Only the (48,) blocks count whose texture was ``lasting`` before: noise in the dark is texture, too, but another one
    in every frame.
    """
    # Mean change of luma below which frames are of one scene, and nothing more is compared [levels of 255].
    if lasting.mean() < TEXTURED_SHARE or cv2.norm(before, after, cv2.NORM_L1) < 6.0 * before.size:
        return False
    # Share of the textured blocks below which a frame has nothing in common with another.
    return float(alike(before, after)[lasting].mean()) < 0.25


def moved(before: U8, after: U8) -> bool:
    """Whether the whole image moves from one thumbnail (120, 160) uint8 to the next.

    The strongest corner of each block is tracked there and back (pyramidal Lucas-Kanade, Bouguet 2001); nearly all must
    move, most of them together, and enough of them be at the border.
    """
    strength = _by_block(cv2.cornerMinEigenVal(before.astype(np.float32) / 255.0, 5).astype(np.float64))
    best, block = strength.argmax(axis=1), np.arange(_BLOCKS)
    places = [block % _COLUMNS * BLOCK_PX + best % BLOCK_PX, block // _COLUMNS * BLOCK_PX + best // BLOCK_PX]
    # Smallest eigenvalue of the structure tensor (of luma in 0 to 1, 5x5 window) of a point that can be tracked.
    points: F32 = np.column_stack(places)[strength[block, best] >= 2e-4].astype(np.float32)
    if len(points) < TEXTURED_SHARE * _BLOCKS:
        return False
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, points, np.empty_like(points), winSize=(11, 11))
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(after, before, there, np.empty_like(points), winSize=(11, 11))
    returned = np.hypot(*(back - points).T) < 0.5 * MOVED_PX
    tracked = returned & (found[:, 0] > 0) & (found_back[:, 0] > 0)
    inside = ((points >= BLOCK_PX) & (points < np.array(THUMBNAIL) - BLOCK_PX)).all(axis=1)
    # Blocks at the image's border, of 24, that must have a tracked point: a person leaves most of it free.
    if tracked.sum() < 0.5 * len(points) or (tracked & ~inside).sum() < 12:
        return False
    moving = tracked & (np.hypot(*(there - points).T) >= MOVED_PX)
    if moving.sum() / tracked.sum() < MOVED_SHARE:
        return False
    _, agreeing = cv2.estimateAffinePartial2D(points[moving], there[moving], ransacReprojThreshold=MOVED_PX)
    # Share of the moving points that one shift, turn and zoom of the image takes along, to within MOVED_PX: those of a
    # camera that also travels do not all; a crowd that fills the view walks in more than one direction.
    return agreeing is not None and float(agreeing.mean()) >= 0.6


_COLUMNS, _ROWS = THUMBNAIL[0] // BLOCK_PX, THUMBNAIL[1] // BLOCK_PX
_BLOCKS = _COLUMNS * _ROWS


def alike(before: U8, after: U8) -> Bool:
    """(48,) blocks with texture that are the same in two thumbnails (120, 160) uint8, at whatever exposure."""
    a, b = (_by_block(image.astype(np.float64)) for image in (before, after))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    deviations = a.std(axis=1), b.std(axis=1)
    scale = np.maximum(deviations[0], 1.0) * np.maximum(deviations[1], 1.0)
    # Correlation from which a block shows what it did before, and the deviation of luma with texture [levels of 255].
    return np.asarray(((a * b).mean(axis=1) >= 0.8 * scale) & (np.maximum(*deviations) >= 4.0))


def _by_block(image: F64) -> F64:
    """(blocks, pixels of each) of a thumbnail."""
    return image.reshape(_ROWS, BLOCK_PX, _COLUMNS, BLOCK_PX).swapaxes(1, 2).reshape(_BLOCKS, -1)
