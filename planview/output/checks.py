"""The checks of a recording that a run makes itself: those of its first frames, and those of every frame."""

from __future__ import annotations

import math

from planview.checks.check import Check
from planview.checks.watch import RecordingWatch, refuse_unless_ok, sentence
from planview.engine.engine import Engine, FrameResult
from planview.output.info import RunWarning

STRICT_EVERY = 60
"""A strict run asks again after so many frames, so that it stops early."""


class RunChecks:
    """Watches a run.

    Args:
        engine: what is run; nothing is checked of plan-view maps.
        strict: raise InputError at once when a check fails, before the first frame and while tracking.
    """

    def __init__(self, engine: Engine, strict: bool) -> None:
        self._engine = engine
        self._watch = RecordingWatch(engine.stereo) if engine.stereo is not None else None
        self._source, self._strict, self._frames = str(engine.recording.path), strict, 0
        self.refuse()

    def update(self, result: FrameResult) -> None:
        """Take the next frame."""
        if self._watch is not None:
            self._watch.update(result.thumbnails, result.disparity, result.observation.foreground)
        self._frames += 1
        if self._frames % STRICT_EVERY == 0:
            self.refuse()

    def refuse(self) -> None:
        """Raise InputError when a check has failed and the run is strict."""
        if self._strict:
            refuse_unless_ok(self._all(), self._source)

    def warnings(self) -> list[RunWarning]:
        """The checks that failed."""
        return [_warning(check) for check in self._all() if not check.ok]

    def _all(self) -> list[Check]:
        return list(self._engine.checks) + (self._watch.checks() if self._watch else [])


def _warning(check: Check) -> RunWarning:
    value = check.value if math.isfinite(check.value) else None
    return RunWarning(name=check.name, value=value, unit=check.unit, text=sentence(check))
