import os
import signal
from pathlib import Path

import pytest

from calib.errors import InputError
from planview.sweep.pools import ClusterPool, ProcessPool, Task, run_tasks


def test_processes_are_replaced_when_one_is_killed_and_its_task_is_tried_again(tmp_path: Path) -> None:
    killed = tmp_path / "killed"

    def die_once(argument: object) -> int:
        if argument == 2 and not killed.exists():
            killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()

    pool = ProcessPool(2)
    try:
        ended = list(run_tasks([Task(str(n), die_once, n) for n in range(4)], pool))
    finally:
        pool.close()
    assert killed.exists()
    assert sorted(d.key for d in ended) == ["0", "1", "2", "3"]
    assert all(not d.error and d.value != os.getpid() for d in ended)


def test_processes_are_limited_to_one_thread_of_numerical_libraries() -> None:
    pool = ProcessPool(1)
    try:
        (ended,) = run_tasks([Task("threads", os.getenv, "OMP_NUM_THREADS")], pool)
    finally:
        pool.close()
    assert ended.value == "1"


def test_no_process_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        ProcessPool(0)


def test_cluster_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planview.sweep.pools.CONNECT_S", 0.2)
    with pytest.raises(InputError, match="expected a Dask scheduler"):
        ClusterPool("tcp://127.0.0.1:9")
