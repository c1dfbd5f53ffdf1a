"""Checks of time: gaps, frozen cameras, and cameras whose movement is out of step."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from calib.types import F64, U8, Bool
from planview.checks.check import Check, at_least, at_most
from planview.checks.recording import Evidence
from stereo.rectify import Rectifier

STEP_PX = 2
"""Every n-th row and column is compared: a person at 8 m still has 100 pixels."""
OWN_VIEW = 8
"""The outer 1/n of each image, which the other camera may not show, is left out: a disparity of 80 px of 640."""
BANDS = 24
"""Bands of rows in which movement is summed: rows of a rectified pair show the same part of the scene."""


class Thumbnails(NamedTuple):
    """Every second pixel of a rectified pair where both cameras see the scene: (h, w) uint8 each."""

    left: U8
    right: U8


def thumbnails(left: U8, right: U8) -> Thumbnails:
    """Of rectified (H, W) grey images; rows of both still show the same part of the scene."""
    own = left.shape[1] // OWN_VIEW
    inside = left[::STEP_PX, own::STEP_PX], right[::STEP_PX, : right.shape[1] - own : STEP_PX]
    return Thumbnails(*(np.ascontiguousarray(image) for image in inside))


def sampled_thumbnails(left: U8, right: U8) -> Thumbnails:
    """Of every STEP_PX-th row and column of a rectified pair, grey."""
    own = left.shape[1] // OWN_VIEW
    return Thumbnails(np.ascontiguousarray(left[:, own:]), np.ascontiguousarray(right[:, : right.shape[1] - own]))


class MotionFindings(NamedTuple):
    """What the movement of both cameras says; NaN where too little moves.

    Attributes:
        lag: by how many frames the right camera is late, at least for part of the time.
        frozen: share of the frames with movement in which one camera stands still.
        stall: longest such stretch [frames].
        repeated: share of the frames with movement around them that repeat the pair before.
    """

    lag: float
    frozen: float
    stall: float
    repeated: float


class MotionWatch:
    """Follows the movement in both images of a pair."""

    def __init__(self) -> None:
        self._last: Thumbnails | None = None
        self._bands: list[F64] = []
        self._lags: list[Lag] = []
        self._active = self._frozen = self._stall = self._longest = self._repeated = 0
        self._still_for = 0

    def update(self, pair: Thumbnails) -> None:
        """Take the next pair."""
        before, self._last = self._last, pair
        if before is None:
            return
        both = list(zip(before, pair, strict=True))
        # Grey levels by which a pixel must change to count as moved: above sensor noise and coding artefacts.
        moved = [np.asarray(cv2.absdiff(a, b) > 14, dtype=np.bool_) for a, b in both]
        share = [float(m.mean()) for m in moved]
        same = [bool((a == b).all()) for a, b in both]
        # Share of moved pixels from which a picture moves: half of what a person at 8 m takes (our choice).
        active = max(share) >= 0.001
        frozen = active and min(share) == 0.0
        self._active += active
        self._frozen += frozen
        self._stall = self._stall + 1 if frozen else 0 if active else self._stall
        self._longest = max(self._longest, self._stall)
        # Copies of a pair between moving ones; a scene in which nothing moves may repeat for hours.
        if all(same):
            self._still_for += 1
        else:
            if active and self._still_for in (1, 2):
                self._repeated += self._still_for
            self._still_for = 0 if active else 3
        self._bands.append(np.stack([_bands(m) for m in moved]))
        # Frames over which a lag is measured: a person crosses most views in that time (our choice).
        if len(self._bands) == 120:
            self._lags.append(self._window_lag())
            self._bands.clear()

    def findings(self) -> MotionFindings:
        """Of all pairs so far."""
        if not self._active:
            return MotionFindings(np.nan, np.nan, np.nan, np.nan)
        lag = _overall([*self._lags, self._window_lag()])
        repeated = self._repeated / (self._active + self._repeated)
        return MotionFindings(lag, self._frozen / self._active, float(self._longest), repeated)

    def _window_lag(self) -> Lag:
        if len(self._bands) < 12:
            return UNKNOWN
        left, right = np.stack(self._bands, axis=1)
        return best_lag(left, right)


class Lag(NamedTuple):
    """Where the movement of two cameras over time is most alike.

    Attributes:
        frames: of the right camera behind the left one; NaN where they are not alike.
        likeness: correlation there.
        unshifted: correlation without a lag.
    """

    frames: float
    likeness: float
    unshifted: float


UNKNOWN = Lag(np.nan, np.nan, np.nan)


def best_lag(left: F64, right: F64) -> Lag:
    """Lag of the right signals behind the left ones.

    Args:
        left, right: (T, bands) movement per frame.
    """
    # Longest lag looked for [frames]: two seconds at 15 Hz (our choice).
    longest = min(30, len(left) // 3)
    scores = np.array([_likeness(left, right, lag) for lag in range(-longest, longest + 1)])
    # Correlation of the cameras' movement below which nothing is said about their lag.
    if not np.isfinite(scores).any() or np.nanmax(scores) < 0.5:
        return UNKNOWN
    best, shift = int(np.nanargmax(scores)), 0.0
    # Half the curvature of the parabola through the best score and its neighbours.
    if 0 < best < len(scores) - 1:
        before, after = scores[best - 1], scores[best + 1]
        bend = before - 2.0 * scores[best] + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return Lag(float(best - longest + shift), float(scores[best]), float(scores[longest]))


def _likeness(left: F64, right: F64, lag: int) -> float:
    """Correlation of two sets of signals, the right one taken ``lag`` frames later."""
    a = left[max(0, -lag) : len(left) - max(0, lag)]
    b = right[max(0, lag) : len(right) - max(0, -lag)]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / power if power > 1e-12 else np.nan


def _overall(windows: list[Lag]) -> float:
    """The median lag; or that of the windows which leave no doubt that they are late, where the others are not."""
    lags = np.array([w.frames for w in windows if np.isfinite(w.frames)])
    if not len(lags):
        return np.nan
    # By so much the likeness of a window must rise with a lag for it to count alone: cameras that lost their step
    # half-way reach 0.7, those in step 0.03 (our choice).
    late = [w.frames for w in windows if abs(w.frames) > 0.5 and w.unshifted < w.likeness - 0.25]
    median = float(np.median(lags))
    return float(np.median(late)) if late and abs(median) <= 0.5 else median


def _bands(moved: Bool) -> F64:
    """(BANDS,) share of pixels that changed, its root, so that near walkers do not drown far ones."""
    rows = moved.shape[0] // BANDS * BANDS
    return np.asarray(np.sqrt(moved[:rows].reshape(BANDS, -1).mean(axis=1)), dtype=np.float64)


def timing_checks(evidence: Evidence) -> list[Check]:
    """Usable frames, gaps in the timestamps; of a pair a frozen camera, and lag between the cameras."""
    usable = (len(evidence.spread) + len(evidence.run)) / max(1, evidence.frames_asked)
    times = evidence.recording.times_s
    known = np.array([f.timestamp_s for f in evidence.run]) if times is None else times[np.isfinite(times)]
    checks = [
        at_least("usable frames", usable, 0.9, "", "share of the frames looked at that can be decoded"),
        at_most(
            # One dropped frame passes, two in a row do not (our choice).
            "timestamp gap",
            longest_step(known),
            2.5,
            "steps",
            "longest step between frames over the usual one",
        ),
    ]
    if not isinstance(evidence.rectifier, Rectifier):
        return checks
    watch = MotionWatch()
    for frame in evidence.run:
        pair = evidence.rectifier(frame.left, frame.right)
        watch.update(thumbnails(pair.left_grey, pair.right_grey))
    return [*checks, *motion_checks(watch.findings())]


def motion_checks(found: MotionFindings) -> list[Check]:
    """Cameras that do not move together in time."""
    late = f"right camera {found.lag:+.2f} frames late, by movement"
    return [
        at_most("frozen camera", found.frozen, 0.1, "", "share of frames that stand still in one camera only"),
        # Longest such stretch [frames]: half a second at 15 Hz (our choice); what both cameras show moves in both.
        at_most("stalled camera", found.stall, 8, "frames", "longest time for which only one camera moves"),
        # Share of pairs that repeat the one before while people move: a tenth spoils every velocity (our choice).
        at_most("repeated pairs", found.repeated, 0.1, "", "share of pairs that repeat the one before"),
        # Cameras may be apart by half a frame: at 15 fps a walker moves 4 cm in that time, which is 1 px at 4 m.
        at_most("synchronisation", abs(found.lag), 0.5, "frames", late),
    ]


def longest_step(times_s: F64) -> float:
    """Longest interval over the median one; NaN with fewer than three times."""
    steps = np.diff(times_s)
    return float(steps.max() / np.median(steps)) if len(steps) >= 2 else math.nan
