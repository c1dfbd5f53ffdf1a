"""Time: frames missing, gaps between them, and cameras that do not expose together."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np

from calib.types import F64, U8
from planview.doctor.check import Check, at_least, at_most
from planview.doctor.evidence import RecordingEvidence
from stereo.recording import StereoFrame
from stereo.rectify import Rectifier

MAX_GAP = 2.5
"""Longest step between frames over the usual one: one dropped frame passes, two in a row do not (our choice)."""
MIN_USABLE = 0.9
MAX_FROZEN = 0.1
"""Share of frames that repeat their predecessor in one camera while the other moves."""
MAX_LAG = 0.5
"""Cameras may be apart by half a frame: at 15 fps a walker moves 4 cm in that time, which is 1 px at 4 m."""
BANDS = 24
"""Bands of rows in which movement is summed: rows of a rectified pair see the same part of the scene."""
MOVED_LEVEL = 14
"""Grey levels by which a pixel must change to count as moved: above sensor noise and coding artefacts."""
MIN_LIKENESS = 0.5
"""Correlation of the cameras' movement below which nothing is said about their lag."""


def timing_checks(evidence: RecordingEvidence) -> list[Check]:
    """Usable frames, gaps in the timestamps, frozen camera and lag between the cameras."""
    found = len(evidence.spread) + len(evidence.run)
    usable = found / max(1, evidence.frames_asked)
    lag, frozen = motion_lag(evidence.rectifier, evidence.run)
    gap = longest_step(_times(evidence))
    return [
        at_least("usable frames", usable, MIN_USABLE, "", "share of the frames looked at that can be decoded"),
        at_most("timestamp gap", gap, MAX_GAP, "steps", "longest step between frames over the usual one"),
        at_most("frozen camera", frozen, MAX_FROZEN, "", "share of frames that stand still in one camera only"),
        at_most("synchronisation", abs(lag), MAX_LAG, "frames", f"right camera {lag:+.2f} frames late, by movement"),
    ]


def longest_step(times_s: F64) -> float:
    """Longest interval over the median one; NaN with fewer than three times."""
    steps = np.diff(times_s)
    return float(steps.max() / np.median(steps)) if len(steps) >= 2 else math.nan


def motion_lag(rectifier: Rectifier, run: list[StereoFrame]) -> tuple[float, float]:
    """By how many frames the right camera is late, and how often one camera stands still alone.

    Movement is summed in bands of rows, which see the same part of the scene in both rectified images, whatever its
    depth; the lag is where the cameras' movement over time is most alike.

    Returns:
        (lag [frames], share); the lag is NaN where too little moves or the cameras do not see the same movement.
    """
    if len(run) < 4:
        return math.nan, math.nan
    pairs = [rectifier(f.left, f.right) for f in run]
    left, right = (_movement(images) for images in zip(*((p.left_grey, p.right_grey) for p in pairs), strict=True))
    still = np.array([(m.sum(axis=1) == 0) for m in (left, right)])
    frozen = float(np.mean(still[0] != still[1]))
    return best_lag(left, right), frozen


def best_lag(left: F64, right: F64) -> float:
    """Lag [frames] of the right signals behind the left ones, NaN when they are not alike.

    Args:
        left, right: (T, bands) movement per frame.
    """
    longest = min(15, len(left) // 3)
    scores = np.array([_likeness(left, right, lag) for lag in range(-longest, longest + 1)])
    if not np.isfinite(scores).any():
        return math.nan
    best = int(np.nanargmax(scores))
    if scores[best] < MIN_LIKENESS:
        return math.nan
    # Half the curvature of the parabola through the best score and its neighbours.
    if 0 < best < len(scores) - 1:
        before, after = scores[best - 1], scores[best + 1]
        bend = before - 2.0 * scores[best] + after
        shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
        return float(best - longest + shift)
    return float(best - longest)


def _likeness(left: F64, right: F64, lag: int) -> float:
    """Correlation of two sets of signals, the right one taken ``lag`` frames later."""
    a = left[max(0, -lag) : len(left) - max(0, lag)]
    b = right[max(0, lag) : len(right) - max(0, -lag)]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    power = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / power if power > 1e-12 else math.nan


def _movement(images: tuple[U8, ...]) -> F64:
    """(T - 1, BANDS) share of pixels that changed, its root, so that near walkers do not drown far ones."""
    rows = images[0].shape[0] // BANDS * BANDS
    moved = [cv2.absdiff(b, a)[:rows] > MOVED_LEVEL for a, b in itertools.pairwise(images)]
    bands = np.stack([m.reshape(BANDS, -1).mean(axis=1) for m in moved])
    return np.asarray(np.sqrt(bands), dtype=np.float64)


def _times(evidence: RecordingEvidence) -> F64:
    times = evidence.recording.times_s
    if times is None:
        return np.array([f.timestamp_s for f in evidence.run])
    return np.asarray(times[np.isfinite(times)], dtype=np.float64)
