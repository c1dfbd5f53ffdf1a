"""Time: frames missing, gaps between them, and cameras that do not expose together."""

from __future__ import annotations

import math

import numpy as np

from calib.types import F64
from planview.checks.check import Check, at_least, at_most
from planview.checks.evidence import RecordingEvidence, RgbdEvidence
from planview.checks.motion import MotionFindings, MotionWatch, thumbnails

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


def timing_checks(evidence: RecordingEvidence) -> list[Check]:
    """Usable frames, gaps in the timestamps, frozen camera and lag between the cameras."""
    watch = MotionWatch()
    for frame in evidence.run:
        pair = evidence.rectifier(frame.left, frame.right)
        watch.update(thumbnails(pair.left_grey, pair.right_grey))
    return [*clock_checks(evidence), *motion_checks(watch.findings())]


def clock_checks(evidence: RecordingEvidence | RgbdEvidence) -> list[Check]:
    """Usable frames, and gaps in the timestamps."""
    usable = (len(evidence.spread) + len(evidence.run)) / max(1, evidence.frames_asked)
    gap = longest_step(_times(evidence))
    return [
        at_least("usable frames", usable, MIN_USABLE, "", "share of the frames looked at that can be decoded"),
        at_most("timestamp gap", gap, MAX_GAP, "steps", "longest step between frames over the usual one"),
    ]


def motion_checks(found: MotionFindings) -> list[Check]:
    """Cameras that do not move together in time."""
    late = f"right camera {found.lag:+.2f} frames late, by movement"
    return [
        at_most("frozen camera", found.frozen, MAX_FROZEN, "", "share of frames that stand still in one camera only"),
        at_most("stalled camera", found.stall, MAX_STALL, "frames", "longest time for which only one camera moves"),
        at_most("repeated pairs", found.repeated, MAX_REPEATED, "", "share of pairs that repeat the one before"),
        at_most("synchronisation", abs(found.lag), MAX_LAG, "frames", late),
    ]


def longest_step(times_s: F64) -> float:
    """Longest interval over the median one; NaN with fewer than three times."""
    steps = np.diff(times_s)
    return float(steps.max() / np.median(steps)) if len(steps) >= 2 else math.nan


def _times(evidence: RecordingEvidence | RgbdEvidence) -> F64:
    times = evidence.recording.times_s
    if times is None:
        return np.array([f.timestamp_s for f in evidence.run])
    return np.asarray(times[np.isfinite(times)], dtype=np.float64)
