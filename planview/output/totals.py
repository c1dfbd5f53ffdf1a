"""What a run measures of itself: totals, stage times and failed checks."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from calib.carried import Carried
from planview.checks.check import Check
from planview.checks.examine import RecordingWatch, refuse_unless_ok
from planview.checks.registration import run_checks
from planview.checks.timing import rate_checks
from planview.counting.events import Event
from planview.counting.totals import JUMP_S, jump_note
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import RunWarning
from stereo.recording import Recorded, RgbdRecording

TIMES_MAX = 4096
"""Times of a stage that are kept, the last ones: their median is known to 2 %."""


@dataclass
class RunTotals(Carried):
    """What a run has counted so far."""

    frames: int = 0
    last_frame: int = -1
    tracks: int = 0
    """Rows."""
    people: dict[int, int] = field(default_factory=dict)
    """In how many frames each id was confirmed."""
    stages: dict[str, deque[float]] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    first_s: float = 0.0
    last_s: float = 0.0
    elapsed_s: float = 0.0
    """Time of the run up to its last checkpoint [s]."""
    jump: str = ""
    """The last jump of the clock, in words."""

    def take(self, result: FrameResult) -> None:
        if self.frames == 0:
            self.first_s = result.timestamp_s
        elif result.timestamp_s - self.last_s > JUMP_S:
            self.jump = jump_note(self.last_frame, result.frame, result.timestamp_s - self.last_s)
        self.frames += 1
        self.last_frame, self.last_s = result.frame, result.timestamp_s
        self.tracks += len(result.tracks)
        for track in result.tracks:
            if track.state == "confirmed":
                self.people[track.track_id] = self.people.get(track.track_id, 0) + 1
        for stage, duration in result.stages_ms.items():
            self.stages.setdefault(stage, deque(maxlen=TIMES_MAX)).append(duration)

    def remark(self, people: int) -> str:
        """Why there are no people, or that the clock has jumped; or nothing."""
        if people or not self.frames:
            return self.jump
        if not self.tracks:
            return f"nothing of a person's size moved in {self.frames} frames"
        return "everything that moved was too short-lived or too small for a person (decisions.csv has the reasons)"


class RunChecks:
    """Watches a run; ``strict``: raise InputError when a check fails, before the first frame and while tracking."""

    def __init__(self, engine: Engine, strict: bool) -> None:
        self._engine = engine
        self._watch = RecordingWatch(engine.stereo) if engine.stereo is not None else None
        recording = engine.recording
        self._before = rate_checks(recording) if isinstance(recording, Recorded) else []
        self._before += run_checks(recording) if isinstance(recording, RgbdRecording) else []
        self._source, self._strict, self._frames = str(engine.recording.path), strict, 0
        self.refuse()

    def update(self, result: FrameResult) -> None:
        if self._watch is not None:
            places = {t.track_id: (t.x_m, t.y_m) for t in result.tracks if t.state == "confirmed"}
            self._watch.update(result.timestamp_s, result.depth, result.views[0].foreground, places)
        self._frames += 1
        if self._frames % 60 == 0:
            self.refuse()

    def refuse(self) -> None:
        if self._strict:
            refuse_unless_ok(self._all(), self._source)

    def warnings(self) -> list[RunWarning]:
        """The checks that failed."""
        return [
            RunWarning(
                name=check.name, value=check.value if math.isfinite(check.value) else None, unit=check.unit,
                text=check.sentence,
            )
            for check in self._all() if not check.ok
        ]  # fmt: skip

    def _all(self) -> list[Check]:
        return list(self._engine.checks) + self._before + (self._watch.checks() if self._watch else [])
