"""Checks of time: gaps, frozen cameras, and cameras whose movement is out of step."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import cv2
import numpy as np

from calib.types import F64, U8
from planview.checks.check import Check, at_least, at_most
from planview.checks.recording import Evidence
from stereo.recording import Recorded
from stereo.rectify import Rectifier

STEP_PX = 2
"""Every n-th row and column is compared: a person at 8 m still has 100 pixels."""
OWN_VIEW = 8
"""The outer 1/n of each image, which the other camera may not show, is left out: a disparity of 80 px of 640."""
BANDS = 24
"""Bands of rows in which movement is summed: rows of a rectified pair show the same part of the scene."""
MOVED_LEVEL = 14
"""Grey levels by which a pixel must change to count as moved: above sensor noise and coding artefacts."""
ACTIVE_SHARE = 0.001
"""Share of moved pixels from which a picture moves: half of what a person at 8 m takes (our choice)."""
MIN_LIKENESS = 0.5
"""Correlation of the cameras' movement below which their lag is not reported."""
LONGEST_LAG = 30
"""Longest lag searched [frames]: two seconds at 15 Hz (our choice)."""
WINDOW = 120
"""Frames over which the mean movement is taken out (our choice)."""
MIN_FRAMES = 12
FRAMES_MAX = 4096
"""Frames with movement, or soon after it, that are remembered: four minutes at 15 Hz, in 1.5 MB (our choice)."""
GROUPS = 8
"""Parts of the time that are left out in turn to estimate the deviation of a lag (jackknife; our choice)."""
SURELY = 3.0
"""Deviations by which a lag must exceed its limit: less is chance."""


class Thumbnails(NamedTuple):
    """Every second pixel of a rectified pair where both cameras see the scene: (h, w) uint8 each."""

    left: U8
    right: U8


def thumbnails(left: U8, right: U8) -> Thumbnails:
    """Of rectified (H, W) grey images; rows of both still show the same part of the scene."""
    own = left.shape[1] // OWN_VIEW
    inside = left[::STEP_PX, own::STEP_PX], right[::STEP_PX, : right.shape[1] - own : STEP_PX]
    return Thumbnails(*(np.ascontiguousarray(image) for image in inside))


class Lag(NamedTuple):
    """Frames of the right camera behind the left one at which their movement over time is most alike, NaN where it is
    not; and the deviation, by the jackknife over parts of the time, NaN where one part holds most of what moves."""

    frames: float
    std: float

    @property
    def surely(self) -> float:
        """Frames by which the cameras are apart at least, ``SURELY`` deviations taken off; negative for none."""
        return abs(self.frames) - SURELY * self.std


class MotionFindings(NamedTuple):
    """What the movement in both images shows; NaN where too little moves.

    Attributes:
        lag: over all the time, or over its first or second half where that leaves less doubt.
        frozen: share of the frames with movement in which one camera stands still.
        stall: longest such stretch [frames].
        repeated: share of the frames with movement around them that repeat the pair before.
    """

    lag: Lag
    frozen: float
    stall: float
    repeated: float


class MotionWatch:
    """Follows the movement in both images of a pair."""

    def __init__(self) -> None:
        self._last: Thumbnails | None = None
        self._bands: deque[F64] = deque(maxlen=FRAMES_MAX)
        self._active = self._frozen = self._stall = self._longest = self._repeated = 0
        self._still_for = self._calm_for = 0

    def update(self, pair: Thumbnails) -> None:
        """Take the next pair."""
        before, self._last = self._last, pair
        if before is None:
            return
        both = list(zip(before, pair, strict=True))
        moved = [np.asarray(cv2.absdiff(a, b) > MOVED_LEVEL, dtype=np.bool_) for a, b in both]
        active = max(float(m.mean()) for m in moved) >= ACTIVE_SHARE
        same = [bool((a == b).all()) for a, b in both]
        # A camera that stands still repeats its image to the last bit; one in which nobody moves has noise.
        frozen = active and any(same)
        self._active += active
        self._frozen += frozen
        self._stall = self._stall + 1 if frozen else 0 if active else self._stall
        self._longest = max(self._longest, self._stall)
        # Copies of a pair between moving ones; a scene in which nothing moves may repeat for hours.
        if not all(same):
            self._repeated += self._still_for if active and self._still_for in (1, 2) else 0
        self._still_for = self._still_for + 1 if all(same) else 0 if active else 3
        self._calm_for = 0 if active else self._calm_for + 1
        if self._calm_for <= LONGEST_LAG:
            # The root of the share of pixels that changed, so that near walkers do not drown far ones.
            rows = moved[0].shape[0] // BANDS * BANDS
            self._bands.append(np.stack([np.sqrt(m[:rows].reshape(BANDS, -1).mean(axis=1)) for m in moved]))

    def findings(self) -> MotionFindings:
        """Of all pairs so far."""
        if not self._active:
            return MotionFindings(Lag(np.nan, np.nan), np.nan, np.nan, np.nan)
        signals, half = np.stack(self._bands), len(self._bands) // 2
        parts = [signals, *((signals[:half], signals[half:]) if half >= WINDOW else ())]
        # A camera may lose its step on the way: the surest lag counts.
        lags = [lag_of(part[:, 0], part[:, 1]) for part in parts]
        lag = max(lags, key=lambda lag: lag.surely if math.isfinite(lag.surely) else -math.inf)
        repeated = self._repeated / (self._active + self._repeated)
        return MotionFindings(lag, self._frozen / self._active, float(self._longest), repeated)


def lag_of(left: F64, right: F64) -> Lag:
    """Lag at which the (T, bands) movement of both cameras correlates best, and how far it moves when parts of the
    time are left out."""
    frames = len(left)
    if frames < MIN_FRAMES:
        return Lag(np.nan, np.nan)
    # Each less its mean over every WINDOW frames.
    parts = (np.array_split(signal, max(1, round(frames / WINDOW))) for signal in (left, right))
    left, right = (np.concatenate([part - part.mean(axis=0) for part in each]) for each in parts)
    longest, part_of = min(LONGEST_LAG, frames // 3), np.arange(frames) * GROUPS // frames
    # Of every part and lag: left by right that much later, and each by itself.
    sums = np.zeros((GROUPS, 2 * LONGEST_LAG + 1, 3))
    for lag in range(-longest, longest + 1):
        at = np.arange(max(0, -lag), frames - max(0, lag))
        a, b = left[at], right[at + lag]
        for k, product in enumerate((a * b, a * a, b * b)):
            sums[:, LONGEST_LAG + lag, k] = np.bincount(part_of[at], product.sum(axis=1), GROUPS)
    whole, power = sums.sum(axis=0), sums[:, LONGEST_LAG, 1:].sum(axis=1)
    if power.max() > 0.8 * power.sum():
        return Lag(_best(whole), np.nan)
    without = np.array([_best(whole - part) for part in sums])
    return Lag(_best(whole), float(np.sqrt((GROUPS - 1) / GROUPS * np.sum((without - without.mean()) ** 2))))


def _best(sums: F64) -> float:
    power = np.sqrt(np.maximum(sums[:, 1] * sums[:, 2], 0.0))
    likeness = np.where(power > 1e-9, sums[:, 0] / np.maximum(power, 1e-9), -1.0)
    best, shift = int(np.argmax(likeness)), 0.0
    if likeness[best] < MIN_LIKENESS:
        return np.nan
    # Half the curvature of the parabola through the best score and its neighbours.
    if 0 < best < len(likeness) - 1:
        before, after = likeness[best - 1], likeness[best + 1]
        bend = before - 2.0 * likeness[best] + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(best - LONGEST_LAG + shift)


MAX_GAP = 2.5
"""Longest step between frames over the usual one: one dropped frame passes, two in a row do not (our choice)."""
MIN_USABLE = 0.9
MAX_FROZEN = 0.1
"""Share of frames with movement in which one camera stands still."""
MAX_STALL = 8
"""Longest such stretch [frames]: half a second at 15 Hz (our choice); what both cameras show moves in both."""
MAX_REPEATED = 0.1
"""Share of pairs that repeat the one before while people move: a tenth spoils every velocity (our choice)."""
MAX_LAG = 0.5
"""Cameras may be apart by half a frame: at 15 fps a walker moves 4 cm in that time, which is 1 px at 4 m."""


def timing_checks(evidence: Evidence) -> list[Check]:
    """Those of ``frame_checks``; of a pair a frozen camera, and lag between the cameras."""
    checks = frame_checks(evidence.recording, evidence.spread, evidence.run, evidence.frames_asked)
    if not isinstance(evidence.rectifier, Rectifier):
        return checks
    watch = MotionWatch()
    for frame in evidence.run:
        pair = evidence.rectifier(frame.left, frame.right)
        watch.update(thumbnails(pair.left_grey, pair.right_grey))
    return [*checks, *motion_checks(watch.findings())]


def frame_checks(recording: Recorded[Any], spread: list[Any], run: list[Any], frames_asked: int) -> list[Check]:
    """Usable frames and gaps in the timestamps of any recording (see ``Evidence``)."""
    usable = (len(spread) + len(run)) / max(1, frames_asked)
    times = recording.times_s
    known = np.array([f.timestamp_s for f in run]) if times is None else times[np.isfinite(times)]
    gap = "longest step between frames over the usual one"
    return [
        at_least("usable frames", usable, MIN_USABLE, "", "share of the frames read that can be decoded"),
        at_most("timestamp gap", longest_step(known), MAX_GAP, "steps", gap, warns=True),
    ]


def motion_checks(found: MotionFindings) -> list[Check]:
    """Cameras that do not move together in time."""
    late = f"right camera {found.lag.frames:+.2f} +- {found.lag.std:.2f} frames late, by movement"
    in_step = not found.lag.surely > MAX_LAG
    return [
        at_most("frozen camera", found.frozen, MAX_FROZEN, "", "share of frames that stand still in one camera only"),
        at_most("stalled camera", found.stall, MAX_STALL, "frames", "longest time only one camera moves", warns=True),
        at_most("repeated pairs", found.repeated, MAX_REPEATED, "", "share of pairs that repeat the one before"),
        Check("synchronisation", in_step, abs(found.lag.frames), "frames", MAX_LAG, "at most", late),
    ]


def longest_step(times_s: F64) -> float:
    """Longest interval over the median one; NaN with fewer than three times."""
    steps = np.diff(times_s)
    return float(steps.max() / np.median(steps)) if len(steps) >= 2 else math.nan
