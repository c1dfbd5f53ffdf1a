"""Runs in real time, by a clock that moves only when something takes time."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from say import Refused

from planview.engine.open import open_engine
from planview.output.folder import PaceInfo, read_run_info
from planview.output.run import RunOptions, run
from planview.output.totals import Pace


class FakeClock:
    def __init__(self) -> None:
        self.time_s = 100.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


def paced(clock: FakeClock) -> Pace:
    return Pace(clock.now_s, clock.sleep)


class Engine:
    """Takes the same time for every frame; its recording's first timestamp is not 0."""

    def __init__(self, clock: FakeClock, step_s: float, recording: Any) -> None:
        self._clock, self._step_s, self.recording = clock, step_s, recording

    def step(self, frame: Any) -> Any:
        self._clock.sleep(self._step_s)
        return frame


def frames_of(times_s: Iterable[float]) -> list[SimpleNamespace]:
    return [SimpleNamespace(frame=n, timestamp_s=time_s) for n, time_s in enumerate(times_s)]


def played(step_s: float, times_s: Iterable[float]) -> tuple[list[int], PaceInfo, float]:
    """Frames tracked, what is told of them, and how long it took [s]."""
    clock = FakeClock()
    pace = paced(clock)
    tracked = []
    for result in pace.results(Engine(clock, step_s, frames_of(times_s))):  # type: ignore[arg-type]
        pace.written(result.timestamp_s)
        tracked.append(result.frame)
    return tracked, pace.info(), clock.time_s - 100.0


EIGHT_HZ = [2.0 + n / 8 for n in range(9)]


def test_engine_in_time_drops_nothing_and_is_as_late_as_a_frame_takes() -> None:
    tracked, info, took_s = played(1 / 16, EIGHT_HZ)
    assert tracked == list(range(9))
    assert info == PaceInfo(frames_dropped=0, latency_median_ms=62.5, latency_95_ms=62.5, latency_99_ms=62.5)
    assert took_s == 1.0625


def test_engine_twice_too_slow_drops_every_second_frame() -> None:
    tracked, info, took_s = played(1 / 4, EIGHT_HZ)
    assert tracked == [0, 2, 4, 6, 8]
    assert info == PaceInfo(frames_dropped=4, latency_median_ms=250.0, latency_95_ms=250.0, latency_99_ms=250.0)
    assert took_s == 1.25


def test_latency_counts_from_when_the_frame_was_due_and_not_from_when_it_was_taken() -> None:
    tracked, info, _ = played(3 / 16, EIGHT_HZ[:4])
    # Frame 0 at 0 to 3/16; 1 (due 2/16) at 3/16 to 6/16; 3 (due 6/16; 2 was due 4/16) at 6/16 to 9/16.
    assert tracked == [0, 1, 3] and info.frames_dropped == 1
    assert info.latency_median_ms == 187.5
    assert info.latency_99_ms == pytest.approx(187.5 + 0.98 * 62.5)  # of 187.5, 250 and 187.5


def test_frame_after_a_pause_is_waited_for() -> None:
    tracked, info, took_s = played(1 / 4, [0.0, 10.0])
    assert tracked == [0, 1] and took_s == 10.25 and info.latency_99_ms == 250.0


def test_recording_without_frames_has_no_latency() -> None:
    assert played(1.0, []) == ([], PaceInfo(), 0.0)


class Device:
    """Frames of every second that come late by the delays given."""

    is_live = True

    def __init__(self, clock: FakeClock, delays_s: list[float]) -> None:
        self._clock, self._delays_s = clock, delays_s

    def __iter__(self) -> Iterator[SimpleNamespace]:
        for n, delay_s in enumerate(self._delays_s):
            self._clock.time_s = 100.0 + n + delay_s
            yield SimpleNamespace(frame=n, timestamp_s=float(n))


def test_clock_of_a_device_is_set_by_its_least_delayed_frame() -> None:
    clock = FakeClock()
    pace = paced(clock)
    list(pace.results(Engine(FakeClock(), 0.0, Device(clock, [0.5, 0.25, 0.75]))))  # type: ignore[arg-type]
    pace.written(2.0)
    assert clock.time_s == 102.75 and pace.info().latency_median_ms == 500.0


def test_run_in_real_time_keeps_its_pace_in_run_json_and_writes_no_checkpoint(street: Path, tmp_path: Path) -> None:
    out = tmp_path / "paced"
    out.mkdir()
    options = RunOptions("ellipse-particle", max_frames=3, checkpoint_every_s=1e-9, pace=paced(FakeClock()))
    run(open_engine(tmp_path / "street", "ellipse-particle"), out, options)
    info = read_run_info(out / "run.json")
    assert info.frames_read == 3 and info.pace is not None and info.pace.frames_dropped == 0
    assert info.pace.latency_99_ms == pytest.approx(0.0, abs=1e-6)
    assert sorted(path.name for path in out.iterdir()) == ["decisions.csv", "run.json", "tracks.csv"]


def test_run_in_real_time_cannot_be_resumed(street: Path, tmp_path: Path, refused: Refused) -> None:
    told = refused("run", tmp_path / "street", "--out", tmp_path / "paced", "--set", "run.real_time=true", "--resume")
    assert "expected --resume or run.real_time, found both" in told
