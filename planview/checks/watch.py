"""The cheap checks of a recording while it is tracked: about 1 ms per frame, in constant memory."""

from __future__ import annotations

from collections import deque

import numpy as np

from calib.errors import InputError
from calib.types import F32, F64, U8
from planview.checks.check import Check, at_least
from planview.checks.motion import MotionWatch, Thumbnails
from planview.checks.people import height_check, heights_above_floor, large_heights, standing_things
from planview.checks.scene import MIN_VALID
from planview.checks.timing import motion_checks
from planview.maps.view import StereoView
from stereo.depth import DepthFromDisparity, back_project

STEP = 10
"""Depth and heights are looked at in every n-th frame (our choice, for speed)."""
KEPT = 1000
"""Things measured last that the height of people is told from."""
MIN_THINGS = 20
"""Fewest measured things by which the scale is doubted: shadows and doors are no people (our choice)."""


class RecordingWatch:
    """Looks over the shoulder of an engine: do both cameras see the same, at the same time, at a believable scale?"""

    def __init__(self, view: StereoView) -> None:
        self._view = view
        self._motion = MotionWatch()
        self._to_depth = DepthFromDisparity(view.geometry)
        self._frames = 0
        self._valid: deque[float] = deque(maxlen=KEPT)
        self._things: deque[F64] = deque(maxlen=KEPT)

    def update(self, pair: Thumbnails | None, disparity: F32 | None, foreground: U8 | None) -> None:
        """Take the next frame.

        Args:
            pair: of the rectified images.
            disparity: (H, W) float32 [px], NaN invalid.
            foreground: (h, w) uint8 at the reduced size, non-zero where people are.
        """
        if pair is not None:
            self._motion.update(pair)
        if disparity is not None and self._frames % STEP == 0:
            self._look(disparity, foreground)
        self._frames += 1

    def checks(self) -> list[Check]:
        """What is known so far."""
        valid = float(np.median(self._valid)) if self._valid else np.nan
        things = np.concatenate(self._things) if self._things else np.empty((0, 2))
        heights = large_heights(things) if len(things) >= MIN_THINGS else np.empty(0)
        return [
            *motion_checks(self._motion.findings()),
            at_least("valid disparity", valid, MIN_VALID, "", "share of the picture, median frame"),
            height_check(heights),
        ]

    def _look(self, disparity: F32, foreground: U8 | None) -> None:
        step = self._view.reduction
        self._valid.append(float(np.isfinite(disparity[::step, ::step]).mean()))
        if foreground is None:
            return
        depth = self._to_depth(disparity)
        above = heights_above_floor(back_project(depth, self._view.geometry), self._view.floor.world_SE3_left)
        self._things.append(standing_things(above[::step, ::step], depth[::step, ::step], foreground > 0))


def refuse_unless_ok(checks: list[Check], source: str) -> None:
    """Raise InputError when a check fails."""
    failed = [check for check in checks if not check.ok]
    if failed:
        raise InputError(f"{source}: --strict: {'; '.join(sentence(check) for check in failed)}")


def sentence(check: Check) -> str:
    """One clause on a check that failed."""
    limit = f"{check.limit[0]:g} to {check.limit[1]:g}" if isinstance(check.limit, tuple) else f"{check.limit:.3g}"
    rule = "" if check.rule == "between" else f"{check.rule} "
    unit = f" {check.unit}" if check.unit else ""
    return f"{check.name}: expected {rule}{limit}{unit}, found {check.value:.3g} ({check.note})"
