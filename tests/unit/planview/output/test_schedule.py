"""What a run does from time to time."""

import time

import pytest

from planview.output.run import Schedule


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
