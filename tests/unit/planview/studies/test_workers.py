"""Workers: tasks that fail, that kill their process, and clusters that are not there."""

import os
import signal
from collections.abc import Iterator

import pytest
from distributed import Client, LocalCluster

from calib.errors import InputError, WorkError
from planview.studies.workers import KILLED, on_workers, workers


@pytest.fixture(scope="module", params=[1, 2], ids=["one process", "two processes"])
def client(request) -> Iterator[Client]:
    with workers(request.param) as client:
        yield client


def test_processes_are_limited_to_one_thread_of_numerical_libraries(client):
    (done,) = on_workers(client, os.getenv, {"threads": "OMP_NUM_THREADS"})
    assert done.value == "1"


def test_task_that_fails_stops_no_other(client):
    def inverse(number):
        if number < 0:
            raise WorkError("expected a number from 0")
        return 1 / number

    found = {done.key: done for done in on_workers(client, inverse, {"4": 4, "-1": -1, "0": 0, "2": 2})}
    assert (found["4"].value, found["2"].value) == (0.25, 0.5)
    assert found["-1"].error == "expected a number from 0"
    assert found["0"].error.startswith("unexpected ZeroDivisionError in inverse, line ")


def test_task_that_kills_its_process_takes_no_other_with_it(client):
    def deadly(how):
        if isinstance(how, signal.Signals):
            os.kill(os.getpid(), how)
        if how == "exit":
            os._exit(0)
        return how

    tasks = {"a": 0, "b": signal.SIGKILL, "c": 0, "d": signal.SIGSEGV, "e": "exit", "f": 0}
    found = sorted((done.key, done.error) for done in on_workers(client, deadly, tasks))
    assert found == [("a", ""), ("b", KILLED), ("c", ""), ("d", KILLED), ("e", KILLED), ("f", "")]


def test_cluster_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr("planview.studies.workers.CONNECT_S", 0.2)
    with pytest.raises(InputError, match="expected a Dask scheduler"), workers(1, "tcp://127.0.0.1:9"):
        pass


def test_tasks_fail_when_no_worker_is_left(monkeypatch):
    monkeypatch.setattr("planview.studies.workers.NO_WORKER_S", 0.0)
    with LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster, Client(cluster) as client:
        done = list(on_workers(client, abs, {"a": -1, "b": -2}))
    assert {one.key: one.error for one in done} == dict.fromkeys("ab", "its worker or the scheduler was lost")
