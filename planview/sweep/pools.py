"""Where jobs run: processes of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Protocol

from calib.errors import InputError, WorkError

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Set to 1 in processes: a job per core."""
CONNECT_S = 10.0
WORKERS_S = 60.0
"""A cluster may be without workers for so long [s]."""
PER_THREAD = 3
"""Jobs handed over per thread of a cluster: enough to keep it busy, and the scheduler's memory small."""


class Pool(Protocol):
    """Runs functions elsewhere.

    Attributes:
        at_once: jobs handed over at the same time; None for all of them.
    """

    @property
    def at_once(self) -> int | None: ...

    def submit(self, function: Callable[..., Any], *arguments: object) -> Future[Any]: ...

    def restart(self) -> None:
        """After a process died: be ready again."""

    def check(self) -> None:
        """Raises WorkError when nothing can be expected any more."""

    def close(self) -> None: ...


class ProcessPool:
    """Processes of this machine (joblib's loky: fresh ones, since forked ones would share OpenCV's threads)."""

    def __init__(self, processes: int) -> None:
        """Start nothing yet.

        Raises:
            InputError: fewer than one process.
        """
        if processes < 1:
            raise InputError(f"--jobs: expected at least 1, found {processes}")
        self.at_once: int | None = processes
        self._executor: Any = None

    def submit(self, function: Callable[..., Any], *arguments: object) -> Future[Any]:
        if self._executor is None:
            from joblib.externals.loky import ProcessPoolExecutor

            limits = dict.fromkeys(THREAD_LIMITS, "1")
            self._executor = ProcessPoolExecutor(self.at_once, env=limits)
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def restart(self) -> None:
        self.close()

    def check(self) -> None:
        """A pool of processes can always be restarted."""

    def close(self) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=True, kill_workers=True)
            self._executor = None


class ClusterPool:
    """Workers of a Dask cluster that share the file system with this machine.

    Dask gives the job of a worker that died to another one, up to three times (``allowed-failures``).
    """

    def __init__(self, address: str) -> None:
        """Connect to a scheduler.

        Raises:
            InputError: ``distributed`` is not installed, no scheduler at the address, or none of its workers comes.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise InputError("--cluster: expected the package distributed; install planview[cluster]") from error
        try:
            self._client = Client(address, timeout=CONNECT_S)
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise InputError(f"--cluster: expected a worker at {address}, found none in {WORKERS_S:.0f} s") from error
        except (OSError, ValueError) as error:
            raise InputError(f"--cluster: expected a Dask scheduler at {address}, found none ({error})") from error
        self._executor = self._client.get_executor(pure=False)
        self._with_workers_s = time.monotonic()
        self.at_once: int | None = PER_THREAD

    def submit(self, function: Callable[..., Any], *arguments: object) -> Future[Any]:
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def restart(self) -> None:
        """Dask starts over by itself."""

    def check(self) -> None:
        """Raises WorkError when the scheduler is lost or no worker came for WORKERS_S; follows the cluster's size."""
        now = time.monotonic()
        if self._client.status in ("closed", "closing"):
            raise WorkError("the scheduler of the cluster was lost")
        threads = sum(self._client.ncores().values())
        self.at_once = PER_THREAD * max(1, threads)
        if threads:
            self._with_workers_s = now
        elif now - self._with_workers_s > WORKERS_S:
            raise WorkError(f"all workers of the cluster were lost {now - self._with_workers_s:.0f} s ago")

    def close(self) -> None:
        self._executor.shutdown(wait=False)
        self._client.close()


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
