"""Checks during a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from calib.carried import Carried
from calib.errors import InputError
from calib.types import F64, U8
from planview.checks.check import Check
from planview.checks.heights import height_check, large_heights, standing_things
from planview.checks.images import flicker_check, grey_level
from planview.checks.motion import MotionWatch
from planview.checks.scene import disparity_check
from planview.checks.timing import SpeedWatch
from planview.maps.grid import FloorRig
from stereo.depth import Depth

EVERY_NTH_FRAME = 10
"""Depth and heights are measured in every n-th frame (for speed)."""
MEASUREMENTS_MAX = 1000
"""Measurements that the height of people depends on."""
THINGS_MIN = 20
"""Fewest measured things by which the scale is doubted: fewer may be shadows or doors."""


class RecordingWatch(Carried):
    """Watches a run: do both cameras show the same, at the same time, at a plausible scale?"""

    CARRIED = "_motion", "_speed", "_frames", "_valid", "_things", "_levels"

    def __init__(self, rig: FloorRig) -> None:
        self._rig = rig
        self._motion = MotionWatch()
        self._speed = SpeedWatch()
        self._frames = 0
        self._valid: deque[float] = deque(maxlen=MEASUREMENTS_MAX)
        self._things: deque[F64] = deque(maxlen=MEASUREMENTS_MAX)
        self._levels: deque[float] = deque(maxlen=MEASUREMENTS_MAX)

    def update(
        self, timestamp_s: float, depth: Depth | None, foreground: U8 | None, places: Mapping[int, tuple[float, float]]
    ) -> None:
        """Take the next frame, with (h, w) uint8 at its size, non-zero where people are, None where there is none, and
        where they stand [m], by id."""
        is_measured = self._frames % EVERY_NTH_FRAME == 0
        self._frames += 1
        self._speed.update(timestamp_s, places)
        if depth is None:
            return
        self._motion.update(depth.thumbnails(), timestamp_s)
        self._levels.append(grey_level(depth.rectified[0]))
        if is_measured:
            self._valid.append(float(np.isfinite(depth.disparity).mean()))
            if foreground is not None:
                rig = self._rig
                things = standing_things(depth.disparity, foreground > 0, rig.geometry, rig.floor, depth.step)
                self._things.append(things)

    def checks(self) -> list[Check]:
        """Checks of the frames so far."""
        things = np.concatenate([np.empty((0, 2)), *self._things])
        return [
            *self._motion.checks(),
            flicker_check(list(self._levels)),
            disparity_check(list(self._valid)),
            height_check(large_heights(things) if len(things) >= THINGS_MIN else np.empty(0)),
            self._speed.check(),
        ]


def refuse_unless_ok(checks: list[Check], source: str) -> None:
    """Raise InputError when a check fails; warnings pass."""
    failed = [check.sentence for check in checks if check.failed]
    if failed:
        raise InputError(f"{source}: checks failed: {'; '.join(failed)}")
