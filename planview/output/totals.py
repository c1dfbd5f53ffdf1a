"""What a run measures of itself: totals, stage times and failed checks, and how it keeps up in real time."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from planview.checks.check import Check
from planview.checks.examine import RecordingWatch, refuse_unless_ok, sentence
from planview.counting.events import Event
from planview.counting.totals import JUMP_S, jump_note
from planview.engine.engine import AnyRecording, Engine, FrameResult
from planview.output.folder import PaceInfo, RunWarning
from stereo.recording import newest


def last_times() -> deque[float]:
    """For the last 4096 times of a stage [ms]: their median is known to 2 % (our choice)."""
    return deque(maxlen=4096)


@dataclass
class RunTotals:
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
            self.stages.setdefault(stage, last_times()).append(duration)

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
        self._source, self._strict, self._frames = str(engine.recording.path), strict, 0
        self.refuse()

    def update(self, result: FrameResult) -> None:
        if self._watch is not None:
            thumbnails = result.first.prepared.thumbnails if result.first else None
            self._watch.update(thumbnails, result.sampled, result.observation.foreground)
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
                text=sentence(check),
            )
            for check in self._all() if not check.ok
        ]  # fmt: skip

    def _all(self) -> list[Check]:
        return list(self._engine.checks) + (self._watch.checks() if self._watch else [])


class Pace:
    """Plays a recording or a device in real time and measures how late tracks come.

    A frame is due when the time since the first one, by its timestamp, has passed. The newest due frame is tracked,
    earlier ones that wait are dropped. Rectifying does not run ahead of tracking here: a frame made ready ahead would
    be older when its turn comes than the newest one.

    A device gives its frames when it will: each is due as it comes. Its clock is set against the machine's by the frame
    that came with the least delay so far, so that the delay inside of the device is not part of the latency.

    Args:
        now_s: time that only grows [s].
        sleep: waits this many seconds.
    """

    def __init__(
        self, now_s: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._now_s, self._sleep = now_s, sleep
        self._latencies = last_times()
        self._start_s = math.inf
        self._dropped = 0

    def results(self, engine: Engine) -> Iterator[FrameResult]:
        """Track the newest due frame of the engine's recording, again and again until the recording ends."""
        recording = engine.recording
        is_device = getattr(recording, "is_live", False) and not getattr(recording, "waits", False)
        frames = newest(self._arriving(recording), 1, self._drop) if is_device else self._newest_due(recording)
        with closing(frames):
            for frame in frames:
                yield engine.step(frame)

    def written(self, timestamp_s: float) -> None:
        """The tracks of the frame of this time are written."""
        self._latencies.append(1e3 * (self._now_s() - self._start_s - timestamp_s))

    def info(self) -> PaceInfo:
        """Frames dropped and latencies so far."""
        if not self._latencies:
            return PaceInfo(frames_dropped=self._dropped)
        median, late, latest = np.percentile(list(self._latencies), (50, 95, 99)).tolist()
        return PaceInfo(
            frames_dropped=self._dropped, latency_median_ms=median, latency_95_ms=late, latency_99_ms=latest
        )

    def _newest_due(self, recording: AnyRecording) -> Generator[Any, None, None]:
        """Frames of a source that waits; the next one is read before this one is due."""
        frames = iter(recording)
        frame = next(frames, None)
        if frame is not None:
            self._start_s = self._now_s() - frame.timestamp_s
        while frame is not None:
            following = next(frames, None)
            self._sleep(max(0.0, -self._lateness_s(frame)))
            while following is not None and self._lateness_s(following) >= 0:
                self._drop(frame)
                frame, following = following, next(frames, None)
            yield frame
            frame = following

    def _arriving(self, recording: AnyRecording) -> Generator[Any, None, None]:
        """Frames of a device, which set its clock as they come."""
        for frame in recording:
            self._start_s = min(self._start_s, self._now_s() - frame.timestamp_s)
            yield frame

    def _lateness_s(self, frame: Any) -> float:
        return self._now_s() - self._start_s - float(frame.timestamp_s)

    def _drop(self, frame: Any) -> None:
        self._dropped += 1
