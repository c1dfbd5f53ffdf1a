"""The rate of images without times, from how far what moves steps between frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F32, U8, AnyArray
from stereo.depth import median_image
from stereo.recording import Frame, Recorded, assumed_clock

MIN_PAIRS = 4
"""With movement in fewer of them there is no rate (our choice)."""
WALK_MPS = 1.3
"""Comfortable walking speed of adults (Bohannon 1997, Age and Ageing 26: 1.27 to 1.46 m/s), less a little indoors."""
SLOW = 0.6
"""Share of the usual rate below which the one found counts: at the usual one people would move faster than a fast
walker of 2.2 m/s (our choice)."""
COLUMNS = 160
"""Width to which images are reduced [px] (our choice)."""
PERSON_M = 1.7
"""Height of what moves in an image."""


StepM = Callable[[AnyArray, AnyArray, F32], float | None]
"""How far something moved between two pictures [m], given the background; None where nothing did."""


def assume_rate(recording: Recorded[Frame], picture: Callable[[Frame], AnyArray], step_m: StepM) -> None:
    """Give a recording without any times the rate at which what moves is as fast as a walker, where that is clearly
    less than the usual one.

    Args:
        picture: the (H, W) part of a frame that shows movement.
    """
    if not recording.clock.assumed or recording.clock.even or recording.n_frames <= MIN_PAIRS:
        return
    # Consecutive frames at 24 places in the recording are compared (our choice).
    firsts = np.unique(np.linspace(0, recording.n_frames - 2, 24).astype(int))
    pairs = [[picture(frame) for frame in recording.at([int(i), int(i) + 1])] for i in firsts]
    rate = rate_by_movement([(pair[0], pair[1]) for pair in pairs if len(pair) == 2], step_m)
    if rate is not None and rate < SLOW * recording.fps:
        recording.assume(assumed_clock(round(rate, 1), why=", at which what moves is as fast as a walker"))


def rate_by_movement(pairs: Sequence[tuple[AnyArray, AnyArray]], step_m: StepM) -> float | None:
    """Frames per second at which what moves is as fast as a walker; None where too little moves.

    Args:
        pairs: pictures of consecutive frames, from all of the recording.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    background = median_image([image for pair in pairs for image in pair])
    steps = np.array([step for a, b in pairs if (step := step_m(a, b, background)) is not None])
    # Shorter steps are noise and people who stand, longer ones are not of one person [m].
    steps = steps[(steps > 0.03) & (steps < 1.5)]
    return float(WALK_MPS / np.median(steps)) if len(steps) >= MIN_PAIRS else None


def reduced(image: U8) -> U8:
    """The image in grey, ``COLUMNS`` wide."""
    rows = max(1, round(image.shape[0] * COLUMNS / image.shape[1]))
    return np.asarray(cv2.resize(as_grey(image), (COLUMNS, rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def image_step_m(first: AnyArray, second: AnyArray, background: F32) -> float | None:
    """How far the largest thing that differs from the background moves between two reduced images [m], its longer side
    taken for the height of a person; None without one that is in both."""
    before, after = (_moving(image, background) for image in (first, second))
    if not before:
        return None
    x, y, height, area = max(before, key=lambda thing: thing[3])
    near = [(float(np.hypot(u - x, v - y)), h) for u, v, h, a in after if 0.5 < a / area < 2.0]
    if not near:
        return None
    moved, other_height = min(near)
    return PERSON_M * moved / (0.5 * (height + other_height))


def _moving(image: AnyArray, background: F32) -> list[tuple[float, float, int, int]]:
    """Centre, longer side and area [px] of what differs from the background and is no speck."""
    # 30 levels are a clear difference, a twelfth of the image's height is a person far away (our choices).
    differs = (np.abs(image.astype(np.float32) - background) > 30.0).astype(np.uint8)
    joined = cv2.morphologyEx(differs, cv2.MORPH_CLOSE, np.ones((5, 3), np.uint8))
    _, _, stats, centres = cv2.connectedComponentsWithStats(joined)
    return [
        (float(u), float(v), int(max(width, height)), int(area))
        for (_, _, width, height, area), (u, v) in zip(stats[1:], centres[1:], strict=True)
        if height > image.shape[0] / 12 and area > 0.3 * width * height
    ]
