"""Workers of runs: in processes of this machine, or on the workers of a Dask cluster."""

from __future__ import annotations

import logging
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from calib.errors import InputError, WorkError

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 10.0
WORKERS_S = 60.0
"""Time to wait for the first worker of a cluster, and for those that start again at the end [s]."""
NO_WORKER_S = 300.0
"""Without any worker for this long, what is left fails [s]: a process that died starts again, late under heavy load."""
LOCAL = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.deploy.lost-worker-timeout": "600 s",  # or a process that takes 15 s to start again is given up
    "distributed.worker.profile.enabled": False,
    # Without Dask's own limit of malloc, under which every image is new memory: a quarter of the time.
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1),
}
"""Settings of Dask for processes of this machine."""
TASKS_SENT = 500
"""Tasks in a message to the scheduler."""
KILLED = "its process was killed or crashed (out of memory?)"


class Done(NamedTuple):
    """Outcome of a task: with a value, or with an error in one sentence."""

    key: Any
    value: Any = None
    error: str = ""


@contextmanager
def workers(jobs: int, cluster: str | None = None) -> Iterator[Client]:
    """``jobs`` processes of this machine on one core each, or the workers at the address of a Dask scheduler, which
    share the file system with this machine. Raises InputError: no scheduler at the address, or no worker arrives."""
    import dask  # a third of a second
    from distributed import Client, LocalCluster

    if cluster is None:
        with (
            dask.config.set(LOCAL),
            # A worker near a limit of memory pauses, perhaps for ever; without one the system kills it.
            LocalCluster(
                n_workers=jobs, threads_per_worker=1, memory_limit=None, host="127.0.0.1", dashboard_address=None,
                silence_logs=logging.CRITICAL,
            ) as processes,
            Client(processes) as client,
        ):  # fmt: skip
            yield client
            with suppress(TimeoutError):  # Dask cannot end a process that is only starting again
                client.wait_for_workers(jobs, timeout=WORKERS_S)
        return
    try:
        client = Client(cluster, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"expected a Dask scheduler at {cluster}, found none ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise InputError(f"expected a worker at {cluster}, found none in {WORKERS_S:.0f} s") from error
        yield client


def on_workers(client: Client, function: Callable[..., Any], arguments: Mapping[Any, object]) -> Iterator[Done]:
    """Call a function on the workers with each of the arguments; each comes once, in the order in which they end.

    Dask blames the death of a worker on all tasks that it had been given. These run again one by one, and the one whose
    process dies again has failed.
    """
    from distributed import as_completed

    tasks = client.map(function, list(arguments.values()), pure=False, batch_size=TASKS_SENT)
    keys = dict(zip(tasks, arguments, strict=True))
    suspects = []
    with _cancelling_without_workers(client, tasks):
        for task in as_completed(tasks):
            done = _outcome(keys[task], task)
            if done.error == KILLED:
                suspects.append(task)
            else:
                yield done
                task.release()  # or it would run again when the worker that holds its result dies
        for task in suspects:
            task.retry()
            yield _outcome(keys[task], task)


@contextmanager
def _cancelling_without_workers(client: Client, tasks: Sequence[Future]) -> Iterator[None]:
    """Cancel tasks that are not done whenever there has been no worker for NO_WORKER_S: Dask itself waits for ever."""
    ended = threading.Event()

    def watch() -> None:
        last_seen_s = time.monotonic()
        while not ended.wait(1.0):
            if client.scheduler_info()["workers"]:
                last_seen_s = time.monotonic()
            elif time.monotonic() - last_seen_s > NO_WORKER_S:
                client.cancel([task for task in tasks if not task.done()])

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def _outcome(key: object, task: Future) -> Done:
    """Wait for a task."""
    from distributed import CancelledError, KilledWorker
    from distributed.scheduler import NoWorkerError

    try:
        return Done(key, task.result())
    except (InputError, WorkError) as error:
        return Done(key, error=str(error))
    except KilledWorker:
        return Done(key, error=KILLED)
    except (NoWorkerError, CancelledError):
        return Done(key, error="its worker or the scheduler was lost")
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())[:300]
        return Done(key, error=f"unexpected {type(error).__name__} in {where.name}, line {where.lineno}: {text}")
