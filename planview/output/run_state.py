"""Counts and checks of a run so far, which a checkpoint keeps."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from calib.carried import Carried
from calib.times import PAUSE_S, jump_note
from planview.checks.check import Check
from planview.checks.sensors import SensorsWatch
from planview.checks.watch import RecordingWatch, refuse_unless_ok
from planview.counting.events import Event
from planview.engine.engine import Engine, FrameResult
from planview.output.folder import RunWarning

TIMES_MAX = 4096
"""Times of a stage that are kept, the last ones: their median is known to 2 %."""


@dataclass
class RunTotals(Carried):
    """Counts of a run so far."""

    RECORDS = (Event,)
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
        """Count a frame."""
        if self.frames == 0:
            self.first_s = result.timestamp_s
        elif result.timestamp_s - self.last_s > PAUSE_S:
            self.jump = jump_note(self.last_frame, result.frame, result.timestamp_s - self.last_s)
        self.frames += 1
        self.last_frame = result.frame
        self.last_s = result.timestamp_s
        self.tracks += len(result.tracks)
        for track in result.tracks:
            if track.state == "confirmed":
                self.people[track.track_id] = self.people.get(track.track_id, 0) + 1
        for stage, duration in result.stages_ms.items():
            self.stages.setdefault(stage, deque(maxlen=TIMES_MAX)).append(duration)

    def remark(self, people: int) -> str:
        """Sentence on why there are no people, or on a jump of the clock; or nothing."""
        if people or not self.frames:
            return self.jump
        if not self.tracks:
            return f"nothing of a person's size moved in {self.frames} frames"
        return "everything that moved was too short-lived or too small for a person (decisions.csv has the reasons)"


class RunChecks(Carried):
    """Watches a run; ``strict``: raise InputError when a check fails, before the first frame and while tracking."""

    CARRIED = "_watch", "_sensors", "_frames"

    def __init__(self, engine: Engine, strict: bool) -> None:
        self._engine = engine
        self._strict = strict
        self._watch = RecordingWatch(engine.stereo) if engine.rigs else None
        self._sensors = SensorsWatch({name: rig.camera for name, rig in engine.rigs.items()})
        self._frames = 0
        self.refuse()

    def update(self, result: FrameResult) -> None:
        """Take a frame, and refuse the recording of a strict run once a check has failed."""
        if self._watch is not None:
            confirmed = [person for person in result.tracks if person.state == "confirmed"]
            places = {person.track_id: (person.x_m, person.y_m) for person in confirmed}
            self._watch.update(result.timestamp_s, result.depth, result.views[0].foreground, places)
        if len(self._engine.rigs) > 1:
            self._sensors.update(result.timestamp_s, [view.points for view in result.views])
        self._frames += 1
        if self._frames % 60 == 0:
            self.refuse()

    def refuse(self) -> None:
        """Raise InputError in a strict run once a check has failed."""
        if self._strict:
            refuse_unless_ok(self._all(), str(self._engine.recording.path))

    def warnings(self) -> list[RunWarning]:
        """The checks that failed."""
        warnings = []
        for check in self._all():
            if not check.ok:
                value = check.value if math.isfinite(check.value) else None
                warnings.append(RunWarning(name=check.name, value=value, unit=check.unit, text=check.sentence))
        return warnings

    def _all(self) -> list[Check]:
        watched = [] if self._watch is None else self._watch.checks()
        return [*self._engine.checks, *watched, *self._sensors.checks()]
