"""Jobs in the order that their needs allow, on any pool; a job that fails stops no other."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from calib.errors import InputError, WorkError
from planview.sweep.pools import Pool

DEATHS_MAX = 3
"""A job during which the process died so often is given up."""
CHECK_S = 5.0


@dataclass(frozen=True)
class Task:
    """A call of a function in another process.

    Attributes:
        key: names it; all different.
        after: key of the task that must have succeeded before, or None.
    """

    key: str
    function: Callable[..., Any]
    argument: object
    after: str | None = None


@dataclass(frozen=True)
class Done:
    """How a task ended: with a value, or with an error in one sentence."""

    key: str
    value: Any = None
    error: str = ""


def run_tasks(tasks: Sequence[Task], pool: Pool) -> Iterator[Done]:
    """Run all tasks; each comes once, in the order in which they end."""
    yield from _Schedule(tasks, pool).run()


def guarded(function: Callable[..., Any], argument: object) -> tuple[Any, str]:
    """The value of a call and an empty text, or None and what went wrong; runs in the other process."""
    try:
        return function(argument), ""
    except (InputError, WorkError) as error:
        return None, str(error)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(str(error).split())[:300]
        return None, f"unexpected {type(error).__name__} in {where.name}, line {where.lineno}: {text}"


class _Schedule:
    def __init__(self, tasks: Sequence[Task], pool: Pool) -> None:
        self._pool = pool
        self._ready = deque(task for task in tasks if task.after is None)
        self._blocked: dict[str, list[Task]] = {}
        for task in tasks:
            if task.after is not None:
                self._blocked.setdefault(task.after, []).append(task)
        self._running: dict[Future[Any], Task] = {}
        self._deaths: dict[str, int] = {}

    def run(self) -> Iterator[Done]:
        while self._ready or self._running:
            self._submit()
            ended, _ = wait(self._running, timeout=CHECK_S, return_when=FIRST_COMPLETED)
            try:
                self._pool.check()
            except WorkError as error:
                yield from self._give_up(str(error))
                return
            for future in ended:
                yield from self._ended(future)

    def _submit(self) -> None:
        limit = self._pool.at_once or len(self._ready) + len(self._running)
        while self._ready and len(self._running) < limit:
            task = self._ready.popleft()
            try:
                self._running[self._pool.submit(guarded, task.function, task.argument)] = task
            except BrokenProcessPool:
                self._ready.appendleft(task)
                if self._running:
                    return
                self._pool.restart()

    def _ended(self, future: Future[Any]) -> Iterator[Done]:
        task = self._running.pop(future)
        try:
            value, error = future.result()
        except BrokenProcessPool:
            yield from self._died(task)
            return
        except (Exception, CancelledError) as failure:
            value, error = None, f"the worker was lost ({type(failure).__name__})"
        yield from self._close(Done(task.key, value, error))

    def _died(self, task: Task) -> Iterator[Done]:
        """The process was killed, of this task or of another that ran beside it: try again, but not for ever."""
        self._deaths[task.key] = self._deaths.get(task.key, 0) + 1
        if not self._running:
            self._pool.restart()
        if self._deaths[task.key] < DEATHS_MAX:
            self._ready.append(task)
        else:
            yield from self._close(Done(task.key, error=f"its process was killed {DEATHS_MAX} times"))

    def _close(self, done: Done) -> Iterator[Done]:
        yield done
        for task in self._blocked.pop(done.key, []):
            if done.error:
                yield from self._close(Done(task.key, error=done.error))
            else:
                self._ready.append(task)

    def _give_up(self, why: str) -> Iterator[Done]:
        open_tasks = [*self._running.values(), *self._ready]
        self._running, self._ready = {}, deque()
        for task in open_tasks:
            yield from self._close(Done(task.key, error=why))
