"""Checks of movement: cameras that stand still, repeat pictures, or are out of step."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.carried import Carried
from calib.images import as_grey
from calib.types import F64, U8, AnyArray, Bool
from planview.checks.check import Check, limit_check
from planview.checks.timing import GROUPS, LONGEST_LAG, SURELY, WINDOW, Lag, lag_of
from planview.evaluation.significant import runs
from stereo.floor import DepthFrames, PairFrames
from stereo.recording import Frame, Shot
from stereo.thumbnails import STEP_PX, Thumbnails

BANDS = 24
"""Bands of rows in which movement is summed: rows of a rectified pair show the same part of the scene."""
MOVED_LEVEL = 14
"""Grey levels by which a pixel must change to count as moved: above sensor noise and coding artefacts."""
ACTIVE_SHARE = 0.001
"""Share of moved pixels from which a picture moves: half of what a person at 8 m takes."""
FRAMES_MAX = 4096
"""Frames with movement, or soon after it, that are remembered: four minutes at 15 Hz, in 1.5 MB."""
MIN_TAIL = 48
"""Frames from which on a lag is searched in the last part of the time alone."""
MAX_REPEATED = 0.1
"""Share of pairs that repeat the one before while people move: a tenth spoils every velocity."""
COPIES_MAX = 2
"""Longest time in which a pair that repeats is a copy, and not a camera that stands still [frames]."""
JUMPED = 1.5
"""Images that stood still continue with this many times the movement of the frame before: people walked on meanwhile,
and who stood starts slowly."""


class PairChanges(NamedTuple):
    """Changes from each pair to the next, (N,) each: when; the share of the picture that moved, and whether that is
    more than noise; and whether the first and the second image repeat the one before to the last bit."""

    time_s: F64
    moved_share: F64
    is_active: Bool
    first_repeats: Bool
    second_repeats: Bool


class Stall(NamedTuple):
    """A time in which images stand still while people move: in how many steps, from which one until which, and whether
    the first and the second image do."""

    frames: int
    start: int
    end: int
    first: bool
    second: bool


def lone_stalls(steps: PairChanges) -> list[Stall]:
    """Times in which one image stands still while the other one moves."""
    active = np.flatnonzero(steps.is_active)
    stalls = []
    for start, end in runs(is_frozen(steps)[active]):
        last = int(active[end - 1])
        first_stands = bool(steps.first_repeats[last])
        stalls.append(Stall(end - start, int(active[start]), last, first_stands, not first_stands))
    return stalls


def common_stalls(steps: PairChanges, is_pair: bool) -> list[Stall]:
    """Times in which all images stand still, between two that move; of depth, those in which its image does."""
    stands = steps.first_repeats
    if is_pair:
        stands = stands & steps.second_repeats
    stalls = []
    for start, end in runs(stands):
        if start > 0 and end < len(stands) and steps.is_active[start - 1] and steps.is_active[end]:
            stalls.append(Stall(end - start, start, end, True, bool(steps.second_repeats[end - 1])))
    return stalls


def is_frozen(steps: PairChanges) -> Bool:
    """(N,) True where one image moves and the other one repeats to the last bit: a camera that nobody walks past has
    noise."""
    return np.asarray(steps.is_active & (steps.first_repeats | steps.second_repeats))


def longest_stall(steps: PairChanges, is_pair: bool) -> Stall | None:
    """The longest time in which images stand still while people move."""
    stalls = lone_stalls(steps)
    for stall in common_stalls(steps, is_pair):
        before = steps.moved_share[stall.start - 1]
        after = steps.moved_share[stall.end]
        if stall.frames > COPIES_MAX and after > JUMPED * before:
            stalls.append(stall)
    return max(stalls, key=lambda stall: stall.frames, default=None)


class MotionWatch(Carried):
    """Follows the movement in both images of a pair, or in an image and its depth."""

    RECORDS = (Thumbnails,)

    def __init__(self) -> None:
        self._last: Thumbnails | None = None
        self._is_pair = True
        self._rows = np.empty((64, len(PairChanges._fields)))
        self._count = 0
        self._bands: deque[F64] = deque(maxlen=FRAMES_MAX)
        self._calm_for = 0

    def update(self, pair: Thumbnails, timestamp_s: float = 0.0) -> None:
        """Take the next pair. Movement is looked for in images only: the edges of depth flicker."""
        before = self._last
        self._last = pair
        self._is_pair = pair.is_pair
        if before is None:
            return
        left_moved = moved_pixels(before.left, pair.left)
        right_moved = moved_pixels(before.right, pair.right)
        moved_share = float(left_moved.mean())
        if self._is_pair:
            moved_share = max(moved_share, float(right_moved.mean()))
        is_active = moved_share >= ACTIVE_SHARE
        left_repeats = repeats(before.left, pair.left)
        right_repeats = repeats(before.right, pair.right)
        self._append((timestamp_s, moved_share, is_active, left_repeats, right_repeats))
        self._calm_for = 0 if is_active else self._calm_for + 1
        if self._is_pair and self._calm_for <= LONGEST_LAG:
            self._bands.append(np.stack([movement_in_bands(left_moved), movement_in_bands(right_moved)]))

    def checks(self) -> list[Check]:
        """Cameras that do not move together in time, by all pairs so far; NaN where too little moves."""
        steps = self._steps()
        active = np.count_nonzero(steps.is_active)
        first, second = ("left camera", "right camera") if self._is_pair else ("image", "depth")
        frozen_share = math.nan
        longest = math.nan
        alone = f"share of frames in which the {first} or the {second} alone stands still"
        note = "longest such time"
        if active:
            frozen_share = float(np.count_nonzero(is_frozen(steps)) / active)
            longest = 0.0
            stall = longest_stall(steps, self._is_pair)
            if stall is not None:
                longest = float(stall.frames)
                from_s = steps.time_s[stall.start]
                to_s = steps.time_s[stall.end]
                where = f": {_who_stands(stall, first, second)} still from {from_s:.1f} to {to_s:.1f} s"
                note += where
                if frozen_share > 0:
                    alone += where
        copies = "share of pairs that repeat the one before"
        checks = [
            limit_check("frozen camera", frozen_share, "", alone, most=0.1),
            # Half a second at 15 Hz [frames]; what both cameras show moves in both.
            limit_check("stalled camera", longest, "frames", note, most=8, warns=True),
            limit_check("repeated pairs", self.repeated, "", copies, most=MAX_REPEATED),
        ]
        if self._is_pair:
            checks.append(self._lag().check("synchronisation", second))
        return checks

    @property
    def repeated(self) -> float:
        """Share of the frames with movement around them that repeat the pair before; NaN where nothing moves."""
        steps = self._steps()
        active = np.count_nonzero(steps.is_active)
        if not active:
            return math.nan
        copies = 0
        for stall in common_stalls(steps, self._is_pair):
            # A scene in which nothing moves may repeat for hours.
            if stall.second and stall.frames <= COPIES_MAX:
                copies += stall.frames
        return float(copies / (active + copies))

    def _append(self, row: tuple[float, ...]) -> None:
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = row
        self._count += 1

    def _steps(self) -> PairChanges:
        time_s, moved_share, *flags = self._rows[: self._count].T
        return PairChanges(time_s, moved_share, *(np.asarray(flag > 0) for flag in flags))

    def _lag(self) -> Lag:
        """The lag over all the time, or over its first half or its end where that leaves less doubt."""
        if not self._bands:
            return Lag()
        left, right = np.stack(self._bands, axis=1)
        count = len(left)
        lag = lag_of(left, right)
        if lag.gain < SURELY:
            parts = [slice(0, count // 2)] if count // 2 >= WINDOW else []
            # A camera may lose its step on the way, and stays behind to the end.
            starts = [count * k // GROUPS for k in range(2, GROUPS - 1)]
            parts += [slice(start, count) for start in starts if count - start >= MIN_TAIL]
            for part in parts:
                part_lag = lag_of(left[part], right[part])
                if part_lag.gain >= SURELY and not lag.gain >= part_lag.gain:
                    lag = part_lag
        return lag


def liveliest(spread: Sequence[Frame[Any]]) -> Frame[Any]:
    """The frame, of some spread over a recording, that differs most from the usual picture."""
    small = np.stack([frame.image[::8, ::8].reshape(-1) for frame in spread]).astype(np.float32)
    change = (np.abs(small - np.median(small, axis=0)) > 25).mean(axis=1)
    # A change of light changes everything: it is no movement.
    change[change > 0.5] = 0.0
    return spread[int(np.argmax(change))]


def moved_pixels(before: AnyArray, now: AnyArray) -> Bool:
    """(h, w) mask of the pixels that changed by more than noise."""
    return np.asarray(cv2.absdiff(before, now) > MOVED_LEVEL, dtype=np.bool_)


def repeats(before: AnyArray, now: AnyArray) -> bool:
    """True if an image is the one before to the last bit; without any depth nothing stands still."""
    return bool((before == now).all() and before.any())


def movement_in_bands(moved: Bool) -> F64:
    """(BANDS,) root of the share of pixels that moved in each band, so that near walkers do not drown far ones."""
    rows = len(moved) // BANDS * BANDS
    return np.asarray(np.sqrt(moved[:rows].reshape(BANDS, -1).mean(axis=1)))


def _who_stands(stall: Stall, first: str, second: str) -> str:
    if stall.first and stall.second:
        return f"the {first} and the {second} stand"
    return f"the {first if stall.first else second} stands"


def still_checks(seen: PairFrames | DepthFrames, frames: Sequence[Frame[Shot]]) -> list[Check]:
    """Checks of recorded frames in order: do images or depth stand still or repeat, are cameras out of step?"""
    watch = MotionWatch()
    for frame in frames:
        watch.update(seen.thumbnails(frame), frame.timestamp_s)
    return watch.checks()


def repeated_check(images: Sequence[U8]) -> Check:
    """Consecutive images of one camera that repeat the one before while something moves."""
    watch = MotionWatch()
    for image in images:
        small = as_grey(image)[::STEP_PX, ::STEP_PX]
        watch.update(Thumbnails(small, small))
    note = "share of frames that repeat the one before"
    return limit_check("repeated frames", watch.repeated, "", note, most=MAX_REPEATED, warns=True)
