"""Checks of images with depth: whether depth is mirrored, shifted or late against its own colour image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from calib.images import as_grey
from calib.types import F32, F64, I64, U8, AnyArray
from planview.checks.check import Check
from planview.checks.timing import SURELY, Lag, jackknife, lag_of, repeated_check
from stereo.depth import median_image
from stereo.recording import Frame, Recording, Shot

WIDTH = 320
"""Images are compared at this width [px]."""
REACH_PX = (16, 32)
"""Shifts searched down and across, each way [px of ``WIDTH``]: a tenth of the image (our choice)."""
MAX_SHIFT_PX = 12.0
"""Depth may lie this far from its image [px of 640]: registered depth of Kinects lies 8 px to one side, since it ends
where the light's shadow begins."""
CORRELATION_MIN = 0.15
"""Sum of the correlations of edges and of what moves from which they are judged; what belongs together has 0.5 or more
(our choice)."""
FLIPS = {"mirrored": (1, -1), "upside down": (-1, 1), "turned by 180 degrees": (-1, -1)}
"""Steps down and across that flip depth back onto its image."""
SCALES = (0.72, 0.84, 0.92, 1.09, 1.19, 1.39)
"""Sizes of unregistered depth in the image, whose camera has another lens: 0.92 of Kinects, 0.72 of RealSense."""
PX = 640.0 / WIDTH
"""Pixels of 640 in one of ``WIDTH``."""
CELLS = (6, 8)
"""Parts of the image, down and across, in which movement is compared over time."""
CHANGE_LEVEL = 20.0
"""Grey levels by which what moves differs from the usual picture (our choice)."""
CONSECUTIVE = 48
"""Frames in a row in which a delay is searched (our choice)."""


def registration_checks(spread: Sequence[Frame[Shot]], run: Sequence[Frame[Shot]]) -> list[Check]:
    """Of frames spread over a recording, and of consecutive ones."""
    place, is_flipped = place_check(spread)
    lag = Lag() if is_flipped else delay_of(run)
    return [place, lag.check("depth delay", "depth", " of its image", apart=lag.apart)]


def run_checks(recording: Recording[Any]) -> list[Check]:
    """The checks on frames of a recording that is about to be tracked."""
    first = max(0, recording.n_frames // 2 - CONSECUTIVE // 2)
    run = recording.at(list(range(first, min(recording.n_frames, first + CONSECUTIVE))))
    return [*registration_checks(recording.sample(16), run), repeated_check([frame.image for frame in run])]


def place_check(frames: Sequence[Frame[Shot]]) -> tuple[Check, bool]:
    """Where depth lies best on its image, and whether it does flipped: of the ways to lay it there, that which fits
    better than it does as it is by ``SURELY`` deviations (jackknife over frames)."""
    name, scores = "depth on its image", _scores(frames) if len(frames) >= 4 else np.zeros((1, 1, 1, 1))
    whole = scores.mean(axis=0)
    if whole.max() < CORRELATION_MIN:
        return Check(name, True, math.nan, note="too few edges to compare"), False
    without = (scores.sum(axis=0) - scores) / (len(frames) - 1)
    best = _places(whole)
    peaks = np.array([[one[n][tuple(best[n])] for n in range(len(best))] for one in without])
    own, mean, sizes = peaks[:, 0], peaks.mean(axis=0), 1 + len(FLIPS)
    flip, size = int(np.argmax(mean[1:sizes])), int(np.argmax(mean[sizes:]))
    if (gain := _gain(peaks[:, 1 + flip] - own)) >= SURELY:
        how = f"{list(FLIPS)[flip]} against its image: flipped back, it fits better by {gain:.1f} deviations"
        return Check(name, False, math.nan, note=f"depth is {how}"), True
    if _gain(peaks[:, sizes + size] - own) >= SURELY:
        note = f"depth is not registered to its image: {SCALES[size]:g} of its size fits better"
        return Check(name, False, math.nan, note=note, warns=True), False
    shift = (best[0] - REACH_PX) * PX
    places = np.array([_places(one)[0] for one in without])
    std = max(jackknife(places[:, int(np.argmax(np.abs(shift)))].tolist()), 0.5) * PX
    ok = not (np.abs(shift).max() > MAX_SHIFT_PX and _gain(own - without[:, 0, *REACH_PX]) >= SURELY)
    where = f"best fit of edges and people: {shift[1]:+.0f} px to the right, {shift[0]:+.0f} down, +- {std:.0f}, of 640"
    note = where if ok else f"depth is not registered to its image ({where})"
    return Check(name, ok, float(np.abs(shift).max()), "px", MAX_SHIFT_PX, "at most", note, warns=True), False


def _scores(frames: Sequence[Frame[Shot]]) -> F64:
    """Of each frame and of depth as it is, flipped and in other sizes: correlation with the image at every shift."""
    images = [small_image(frame.image) for frame in frames]
    depths = [small_depth(frame.images[1]) for frame in frames]
    usual, usual_depth = median_image(images), median_image(depths)
    scores = np.zeros((len(frames), 1 + len(FLIPS) + len(SCALES), 2 * REACH_PX[0] + 1, 2 * REACH_PX[1] + 1))
    for k, (image, depth) in enumerate(zip(images, depths, strict=True)):
        with np.errstate(invalid="ignore"):
            near = (usual_depth - depth > 0.2).astype(np.float32)
        moved = (np.abs(image - usual) > CHANGE_LEVEL).astype(np.float32)
        for seen, measured in ((edges(image), depth_edges(depth)), (moved, near)):
            flipped = [measured[::down, ::across] for down, across in FLIPS.values()]
            for n, own in enumerate((measured, *flipped, *(_scaled(measured, scale) for scale in SCALES))):
                scores[k, n] += correlation(np.ascontiguousarray(own), seen)
    return scores


def _gain(gains: AnyArray) -> float:
    return float(gains.mean()) / max(jackknife(gains.tolist()), 1e-6)


def _scaled(image: F32, scale: float) -> F32:
    """The map at another size, around its middle."""
    height, width = image.shape
    to = np.array([[scale, 0.0, (1 - scale) * width / 2], [0.0, scale, (1 - scale) * height / 2]])
    return np.asarray(cv2.warpAffine(image, to, (width, height), flags=cv2.INTER_LINEAR), dtype=np.float32)


def _places(scores: F64) -> I64:
    """(n, 2) row and column of the best score of each of n maps."""
    return np.array([np.unravel_index(int(np.argmax(one)), one.shape) for one in scores])


def delay_of(frames: Sequence[Frame[Shot]]) -> Lag:
    """Frames by which depth moves after its image (see ``lag_of``)."""
    if len(frames) < 2:
        return Lag()
    images = [small_image(frame.image) for frame in frames]
    depths = [small_depth(frame.images[1]) for frame in frames]
    moved = [_cells(np.abs(b - a) > CHANGE_LEVEL) for a, b in pairwise(images)]
    with np.errstate(invalid="ignore"):
        stepped = [_cells(np.abs(b - a) > 0.1 + 0.02 * a**2) for a, b in pairwise(depths)]
    return lag_of(np.stack(moved), np.stack(stepped))


def _cells(mask: F32) -> F64:
    """The root of the share of a mask in each part of the image."""
    share = cv2.resize(mask.astype(np.float32), CELLS[::-1], interpolation=cv2.INTER_AREA)
    return np.sqrt(share.astype(np.float64)).ravel()


def small_image(image: U8) -> F32:
    """The image in grey, ``WIDTH`` wide."""
    size = WIDTH, max(1, round(image.shape[0] * WIDTH / image.shape[1]))
    small = cv2.resize(as_grey(image), size, interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (0, 0), 1.0).astype(np.float32)


def small_depth(depth_m: F32) -> F32:
    """Depth [m] of ``WIDTH`` columns, NaN where unknown."""
    size = WIDTH, max(1, round(depth_m.shape[0] * WIDTH / depth_m.shape[1]))
    return np.asarray(cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST), dtype=np.float32)


def edges(image: F32) -> F32:
    """Strength of the edges of an image; beyond that of the strongest tenth it counts no more."""
    strength = np.hypot(cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1))
    return np.asarray(np.minimum(strength, np.percentile(strength, 90)), dtype=np.float32)


def depth_edges(depth: F32) -> F32:
    """1 where known depth jumps within three pixels, else 0."""
    known, kernel = np.isfinite(depth), np.ones((3, 3), np.uint8)
    far = cv2.dilate(np.where(known, depth, 0.0).astype(np.float32), kernel)
    near = cv2.erode(np.where(known, depth, 99.0).astype(np.float32), kernel)
    return np.asarray(far - near > 0.1 + 0.05 * near, dtype=np.float32)


def correlation(measured: F32, seen: F32) -> F64:
    """(2 y + 1, 2 x + 1) correlation of two maps of one size, the first moved by every shift of ``REACH_PX``."""
    a, b = (one - one.mean() for one in (measured, seen))
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    (y, x), (rows, columns) = REACH_PX, seen.shape
    if norm < 1e-6:
        return np.zeros((2 * y + 1, 2 * x + 1))
    size = rows + y, columns + x
    product = np.fft.irfft2(np.conj(np.fft.rfft2(a, size)) * np.fft.rfft2(b, size), size)
    return np.asarray(np.roll(product, (y, x), (0, 1))[: 2 * y + 1, : 2 * x + 1] / norm, dtype=np.float64)
