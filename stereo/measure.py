"""Depth of a shot: a pair is rectified and matched, a sensor's depth taken without distortion."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np

from calib.errors import InputError
from stereo.depth import Depth, Matched, sample_disparities, sample_means
from stereo.matcher import BODY_LAG, DisparityRange, Matcher, SgbmMatcher, SgbmParams
from stereo.recording import DepthCamera, Shot, StereoPair, refuse_foreign_shot
from stereo.rectify import Rectifier
from stereo.rgbd import RgbdRectifier
from stereo.thumbnails import Thumbnails

Record = Callable[[str], object]
"""Takes the name of a stage that has ended."""


def _ignore(_stage: str) -> None:
    """Times that are not recorded."""


class Measure(Protocol):
    """Gives the depth of a shot; ``last`` is how that of the shot before was matched."""

    def __call__(self, shot: Shot, record: Record = _ignore, last: Matched | None = None) -> Depth: ...


class PairMeasure:
    """Depth of pairs, matched at an n-th of their size; by a matcher of one's own at their whole size."""

    def __init__(
        self, rectifier: Rectifier, sgbm: SgbmParams, searched: DisparityRange, step: int, own: Matcher | None = None
    ) -> None:
        self._rectifier = rectifier
        self._searched = searched
        self._step = step
        self._own = own
        masks = rectifier.mask, rectifier.right_mask
        self._sgbm = SgbmMatcher(rectifier.geometry, sgbm, searched, *masks, step, BODY_LAG)

    def __call__(self, shot: Shot, record: Record = _ignore, last: Matched | None = None) -> Depth:
        """Rectify and match a left and a right image, (H, W) or (H, W, 3) uint8 as recorded. Raises InputError: another
        kind of shot, or a matcher of the user's that gives no disparity. ValueError: images of another size."""
        refuse_foreign_shot(shot, StereoPair.holds)
        left, right = shot
        if self._own is None:
            pair = self._rectifier.reduce(left, right, self._step)
            record("rectify")
            greys = pair.left_grey, pair.right_grey
            matched = self._sgbm.match(*greys, last)
            # A copy, for the matcher may give its own again: 10 us, and callers may write into what they are given.
            disparity = matched.disparity.copy()
            thumbnails = partial(Thumbnails.of_pair, *greys)
            depth = Depth(pair.image, disparity, self._step, greys, thumbnails, pair.picture, matched)
        else:
            pair = self._rectifier(left, right)
            record("rectify")
            greys = pair.left_grey, pair.right_grey
            disparity = self._own(*greys)
            refuse_foreign_disparity(disparity, self._rectifier.geometry.size[::-1], self._searched)
            image = sample_means(pair.image, self._step)
            samples = sample_disparities(disparity, self._step)
            depth = Depth(image, samples, self._step, greys, partial(Thumbnails.of_pair, *greys), pair.picture)
        record("match")
        return depth


class DepthMeasure:
    """Depth that a sensor measured, at an n-th of its image's size."""

    def __init__(self, rectifier: RgbdRectifier, step: int) -> None:
        self._rectifier = rectifier
        self._step = step

    def __call__(self, shot: Shot, record: Record = _ignore, last: Matched | None = None) -> Depth:
        """Take the distortion out of an image, (H, W) or (H, W, 3) uint8, and its depth, (H, W) float32 [m]. Raises
        InputError: another kind of shot. ValueError: images of another size."""
        refuse_foreign_shot(shot, DepthCamera.holds)
        image, depth_m = self._rectifier(*shot)
        record("rectify")
        depth = Depth.of_whole(image, self._rectifier.disparity(depth_m), self._step)
        record("match")
        return depth


def refuse_foreign_disparity(disparity: object, shape: tuple[int, int], searched: DisparityRange) -> None:
    """Refuse the result of a user's matcher that is not an (H, W) float32 disparity in pixels; ``searched`` are those
    that people on the floor can have. Raises InputError: another shape or kind of number, sixteenths of a pixel, depth,
    or a number for "none"."""
    if not isinstance(disparity, np.ndarray):
        raise InputError(f"matcher: expected an array of disparities, found {type(disparity).__name__}")
    if disparity.shape != shape or disparity.dtype != np.float32:
        raise InputError(
            f"matcher: expected float32 disparities of {shape}, found {disparity.dtype} of {disparity.shape}"
        )
    few = disparity[::8, ::8]
    valid = few[np.isfinite(few)]
    if not len(valid):
        return
    largest = searched.first_px + searched.count
    none = float(((valid == 0) | (valid <= -1)).mean())
    # Share of disparities of exactly 0, or below -1, from which they stand for "none" (our choice): nothing lies
    # beyond infinity, and what lies there has a disparity of about 0.
    if none > 0.2:
        raise InputError(f"matcher: expected NaN where there is no disparity, found {none:.0%} of 0 or below -1")
    if (middle := float(np.median(valid))) > largest:
        raise InputError(
            f"matcher: expected disparities in pixels, up to {largest} on this floor, found {middle:.0f} in "
            "the middle of the range: sixteenths of a pixel (divide OpenCV's by 16), or depth?"
        )
