"""A recording played in real time: frames come when they are due, and those that the engine cannot keep up with go."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from typing import Any

from planview.engine.engine import AnyRecording, Engine, FrameResult
from planview.output.folder import PaceInfo
from planview.output.totals import StageTimes
from stereo.recording import newest


class Pace:
    """Plays a recording or a device in real time and measures how late tracks come.

    A frame is due when as much time has passed since the first one as its timestamp says. The newest due frame is
    tracked, earlier ones that wait are dropped. Rectifying does not run ahead of tracking here: a frame made ready
    ahead would be older when its turn comes than the newest one.

    A device gives its frames when it will: each is due as it comes. Its clock is set against the machine's by the frame
    that came with the least delay so far, so that the delay inside of the device is not part of the latency.

    Args:
        now_s: time that only grows [s].
        sleep: waits so many seconds.
    """

    def __init__(
        self, now_s: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._now_s, self._sleep = now_s, sleep
        self._latencies = StageTimes()
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
        self._latencies.add(1e3 * (self._now_s() - self._start_s - timestamp_s))

    def info(self) -> PaceInfo:
        """Frames dropped and latencies so far."""
        if not self._latencies.times_ms:
            return PaceInfo(frames_dropped=self._dropped)
        median, late, latest = (self._latencies.percentile_ms(percent) for percent in (50, 95, 99))
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
