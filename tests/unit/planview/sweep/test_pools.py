import os
import signal
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
from inline_pool import InlinePool

from calib.errors import InputError, WorkError
from planview.sweep.work import DEATHS_MAX, ClusterPool, ProcessPool, run_tasks


def test_processes_are_replaced_when_one_is_killed_and_its_task_is_tried_again(tmp_path: Path) -> None:
    killed = tmp_path / "killed"

    def die_once(argument: object) -> int:
        if argument == 2 and not killed.exists():
            killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()

    pool = ProcessPool(2)
    try:
        ended = list(run_tasks(die_once, by_key(range(4)), pool))
    finally:
        pool.close()
    assert killed.exists()
    assert sorted(d.key for d in ended) == ["0", "1", "2", "3"]
    assert all(not d.error and d.value != os.getpid() for d in ended)


def test_processes_are_limited_to_one_thread_of_numerical_libraries() -> None:
    pool = ProcessPool(1)
    try:
        (ended,) = run_tasks(os.getenv, {"threads": "OMP_NUM_THREADS"}, pool)
    finally:
        pool.close()
    assert ended.value == "1"


def test_no_process_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        ProcessPool(0)


def test_cluster_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planview.sweep.work.CONNECT_S", 0.2)
    with pytest.raises(InputError, match="expected a Dask scheduler"):
        ClusterPool("tcp://127.0.0.1:9")


def by_key(numbers: Iterable[int]) -> dict[str, int]:
    return {str(n): n for n in numbers}


def double(argument: object) -> int:
    assert isinstance(argument, int)
    if argument < 0:
        raise WorkError("expected a number from 0")
    return 2 * argument // argument


class DyingPool(InlinePool):
    """Its process dies whenever it gets ``deadly``, at most ``deaths`` times."""

    def __init__(self, deadly: int, deaths: int) -> None:
        super().__init__(at_once=2)
        self.deadly, self.deaths = deadly, deaths

    def submit(self, function: Callable[..., object], *arguments: object) -> Future[object]:
        if arguments[1] == self.deadly and self.deaths > 0:
            self.deaths -= 1
            future: Future[object] = Future()
            future.set_exception(BrokenProcessPool())
            return future
        return super().submit(function, *arguments)


def test_task_that_fails_stops_no_other() -> None:
    ended = {d.key: (d.value, d.error) for d in run_tasks(double, by_key((3, -1, 4)), InlinePool())}
    assert ended == {"3": (2, ""), "-1": (None, "expected a number from 0"), "4": (2, "")}


def test_unexpected_error_is_told_in_one_sentence() -> None:
    (ended,) = run_tasks(double, by_key((0,)), InlinePool())
    assert "ZeroDivisionError" in ended.error and "\n" not in ended.error


def test_task_whose_process_died_is_tried_again() -> None:
    pool = DyingPool(deadly=5, deaths=DEATHS_MAX - 1)
    ended = {d.key: d.error for d in run_tasks(double, by_key((4, 5, 6)), pool)}
    assert ended == {"4": "", "5": "", "6": ""}


def test_task_whose_process_dies_again_and_again_is_given_up() -> None:
    pool = DyingPool(deadly=5, deaths=100)
    ended = {d.key: d.error for d in run_tasks(double, by_key((4, 5, 6)), pool)}
    assert (ended["4"], ended["6"]) == ("", "")
    assert "killed" in ended["5"]


def test_all_that_is_left_fails_when_the_cluster_is_lost() -> None:
    class LostPool(InlinePool):
        def check(self) -> None:
            raise WorkError("the scheduler was lost")

    ended = list(run_tasks(double, by_key((1, 2)), LostPool()))
    assert [d.error for d in ended] == ["the scheduler was lost"] * 2


def test_no_tasks_end_at_once() -> None:
    assert list(run_tasks(double, {}, InlinePool())) == []


@pytest.mark.parametrize("at_once", [1, 2, 9])
def test_every_task_comes_once(at_once: int) -> None:
    ended = run_tasks(double, by_key(range(1, 8)), InlinePool(at_once))
    assert sorted(d.key for d in ended) == [str(n) for n in range(1, 8)]
