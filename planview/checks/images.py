"""Checks of images alone: light, compression, and cameras that move or shake."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calib.doubt import Finding
from calib.images import as_grey
from calib.types import U8
from planview.checks.check import Check, limit_check
from stereo.matcher import SATURATED_LEVEL
from stereo.recording import Frame, Shot
from stereo.viewpoint import SWAY_DEG, SpreadView, Standing, Sway

CODED_BLOCK_PX = 8
"""Side of the blocks that JPEG, MPEG and H.264 transform."""
SHAKE_DEG = 0.1
"""Deviation of a camera's rotation from which it shakes [degrees]: 1 cm at 5 m."""


def image_checks(frames: Sequence[Frame[Shot]]) -> list[Check]:
    """Over-exposure, under-exposure, brightness of left against right, and compression, of frames as recorded."""
    lefts, rights = zip(*(frame.images for frame in frames), strict=True)
    left_level = _median_of(grey_level, lefts) + 1.0
    right_level = _median_of(grey_level, rights) + 1.0
    ratio = max(left_level, right_level) / min(left_level, right_level)
    blocks = max(_median_of(blocking, lefts), _median_of(blocking, rights))
    steps = "steps at the borders of 8x8 blocks over those inside: compress less"
    return [
        *light_checks(lefts, rights),
        # Ratio of the cameras' median brightness; block matching bears small differences only.
        limit_check("brightness match", ratio, "", "mean brightness of one camera over the other", most=2.0),
        # Grey steps at the borders of blocks over those inside, which match at the same place in both cameras and
        # pull disparities there. Images as recorded have 0.7 to 1.3, JPEG of quality 10 has 5 and loses the floor.
        limit_check("compression", blocks, "", steps, most=2.0),
    ]


def _median_of(measure: Callable[[U8], Any], images: Sequence[U8]) -> float:
    return float(np.median([measure(as_grey(image)) for image in images]))


def explained_check(name: str, finding: Finding | None, note: str, *, warns: bool = False) -> Check:
    """Fails where something is explained by what should not be so."""
    return Check(name, finding is None, math.nan, note=str(finding or note), warns=warns)


def light_checks(*cameras: Sequence[U8]) -> list[Check]:
    """Over-exposure and under-exposure, from images of one camera, or of the left and the right one."""
    saturated = [_median_of(lambda image: np.mean(image[::2, ::2] >= SATURATED_LEVEL), images) for images in cameras]
    bright = [_median_of(lambda image: np.percentile(image[::2, ::2], 90), images) for images in cameras]
    names = ["", ""] if len(cameras) == 1 else [" of the left camera", " of the right camera"]
    most_saturated = names[int(np.argmax(saturated))]
    darkest = names[int(np.argmin(bright))]
    return [
        # Share of saturated pixels that leaves enough to see people by; a sunny terrace has up to a quarter.
        limit_check(
            "over-exposure", max(saturated), "", f"share of saturated pixels{most_saturated}", most=0.35, warns=True
        ),
        # Below this grey level of the brightest tenth of a picture, sensor noise is a good part of any texture.
        limit_check("under-exposure", min(bright), "grey", f"brightest tenth of the picture{darkest}", least=40.0),
    ]


def grey_level(image: U8) -> float:
    """Mean grey level of an image."""
    return float(as_grey(image)[::8, ::8].mean())


def blocking(image: U8) -> float:
    """Mean grey step along the rows of a (H, W) image across the borders of blocks, over that inside of them."""
    steps = np.abs(np.diff(image[::4].astype(np.int16), axis=1)).mean(axis=0)
    is_border = np.arange(len(steps)) % CODED_BLOCK_PX == CODED_BLOCK_PX - 1
    if not is_border.any():
        return math.nan
    return float(steps[is_border].mean() / max(float(steps[~is_border].mean()), 1e-3))


def flicker_check(levels: Sequence[float]) -> Check:
    """Light that alternates, from the mean grey levels of consecutive frames."""
    share = math.nan
    if len(levels) > 8:
        steps = np.diff(levels)
        steps[1::2] *= -1.0
        darker = abs(float(np.median(steps)))
        share = darker / max(float(np.mean(levels)) + 0.5 * darker, 1.0)
    # A lamp's flicker and automatic exposure change a few percent.
    note = "share by which every second frame is darker: exposure or emitter alternates; both lights are followed"
    return limit_check("light from frame to frame", share, "", note, most=0.08, warns=True)


def standing_checks(standing: Standing, after: str) -> list[Check]:
    """Checks of a camera's view from the frames so far; ``after``: what follows if it has moved."""
    shake = shake_check(standing.sway)
    if standing.first is None:
        moved = Check("camera moved", True, 0.0, "frames", note="the cameras look where they looked before")
        if standing.swayed_frames:
            note = f"by more than {SWAY_DEG:g} degree in {standing.swayed_frames} frames, in which nobody is reported"
            shake = replace(shake, ok=False, note=f"{shake.note}; {note}")
        return [moved, shake]
    frame, time_s = standing.first
    paused = standing.moved_frames + standing.swayed_frames
    note = f"{standing.how} at frame {frame} ({time_s:.1f} s): {after}, and nobody is reported in {paused} frames"
    return [Check("camera moved", False, float(paused), "frames", note=note), shake]


def spread_checks(view: SpreadView) -> list[Check]:
    """The same, from frames spread over a recording."""
    note = "the same view throughout"
    if view.elsewhere:
        frame, how = next(iter(view.elsewhere.items()))
        note = f"{how} at frame {frame} or before"
    moves = float(len(view.elsewhere))
    return [Check("camera moved", not moves, moves, "frames", note=note), shake_check(view.sway)]


def shake_check(sway: Sway) -> Check:
    """A warning where cameras come and go about one view."""
    note = "rotation to and fro about one view; people are tracked, and their places err by as much: fix the mount"
    return limit_check("camera shake", sway.together_deg, "deg", note, most=SHAKE_DEG, warns=True)
