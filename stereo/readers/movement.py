"""The rate of images without times, from how far what moves steps between frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F32, F64, U8, AnyArray, Bool
from stereo.depth import median_image
from stereo.recording import Frame, Recorded, assumed_clock

MIN_PAIRS = 4
"""With movement in fewer of them there is no rate (our choice)."""
Place = Callable[[AnyArray, F32], tuple[F64, float] | None]
"""Where something is in a picture, given the background, and the length of a unit there [m]; None without anything."""


def assume_rate(recording: Recorded[Frame], picture: Callable[[Frame], AnyArray], place: Place) -> None:
    """Give a recording without any times the rate at which what moves in its pictures is as fast as a walker, where
    that is clearly less than the usual one."""
    if not recording.clock.assumed or recording.clock.even or recording.n_frames <= MIN_PAIRS:
        return
    # Consecutive frames at 24 places in the recording are compared (our choice).
    firsts = np.unique(np.linspace(0, recording.n_frames - 2, 24).astype(int))
    pairs = [[picture(frame) for frame in recording.at([int(i), int(i) + 1])] for i in firsts]
    rate = rate_by_movement([pair for pair in pairs if len(pair) == 2], place)
    # At the usual rate people would move faster than a fast walker of 2.6 m/s (our choice).
    if rate is not None and rate < 0.5 * recording.fps:
        recording.assume(assumed_clock(round(rate, 1), why=", at which what moves is as fast as a walker"))


def rate_by_movement(pairs: Sequence[Sequence[AnyArray]], place: Place) -> float | None:
    """Frames per second at which what moves between consecutive pictures is as fast as a walker; None where too little
    moves."""
    if len(pairs) < MIN_PAIRS:
        return None
    background = median_image([image for pair in pairs for image in pair])
    found = [(place(a, background), place(b, background)) for a, b in pairs]
    steps = np.array([0.5 * (a[1] + b[1]) * np.linalg.norm(b[0] - a[0]) for a, b in found if a and b])
    # Shorter steps are noise and people who stand, longer ones are not of one person [m].
    steps = steps[(steps > 0.03) & (steps < 1.5)]
    # Comfortable walking speed of adults (Bohannon 1997, Age and Ageing 26: 1.27 to 1.46 m/s), less a little indoors.
    return float(1.3 / np.median(steps)) if len(steps) >= MIN_PAIRS else None


def largest(mask: U8) -> Bool | None:
    """The largest connected part of a mask."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if count > 1 else None


def reduced(image: U8) -> U8:
    """The image in grey, 160 px wide."""
    size = 160, max(1, round(image.shape[0] * 160 / image.shape[1]))
    return np.asarray(cv2.resize(as_grey(image), size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def place_in_image(image: AnyArray, background: F32) -> tuple[F64, float] | None:
    """See ``Place``; the longer side of what differs from the background is the height of a person, 1.7 m."""
    part = largest((np.abs(image.astype(np.float32) - background) > 30.0).astype(np.uint8))  # [grey levels], our choice
    if part is None:
        return None
    at = np.argwhere(part)
    height = int(np.ptp(at, axis=0).max()) + 1
    # A twelfth of the image is a person far away (our choice).
    return (at.mean(axis=0), 1.7 / height) if height > image.shape[0] / 12 else None
