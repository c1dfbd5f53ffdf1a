"""What a run does besides tracking: memory returned, and things done from time to time."""

import ctypes
import sys
import time

import pytest

from planview.output.run import Schedule, return_unused_memory


class CLibrary:
    def __init__(self) -> None:
        self.kept: list[int] = []

    def malloc_trim(self, pad: int) -> None:
        self.kept.append(pad)


@pytest.mark.parametrize(("system", "calls"), [("linux", [0]), ("win32", []), ("darwin", [])])
def test_freed_memory_is_returned_to_linux_and_left_alone_elsewhere(
    monkeypatch: pytest.MonkeyPatch, system: str, calls: list[int]
) -> None:
    library = CLibrary()
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    return_unused_memory()
    assert library.kept == calls


def test_c_library_that_cannot_return_memory_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(ctypes, "CDLL", lambda name: asked.append(name) or object())
    return_unused_memory()
    assert asked == [None]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_schedule_is_due_when_its_time_has_passed_and_not_again_at_once(clock: list[float]) -> None:
    schedule = Schedule(30.0)
    assert not schedule.due()
    clock[0] += 30.0
    assert schedule.due()
    assert not schedule.due()


def test_schedule_is_due_when_the_run_stops(clock: list[float]) -> None:
    assert Schedule(30.0).due(stopping=True)


def test_schedule_of_no_time_is_never_due(clock: list[float]) -> None:
    schedule = Schedule(0.0)
    clock[0] += 1000.0
    assert not schedule.due(stopping=True)
