"""A pool that runs jobs in this process, at once."""

from collections.abc import Callable
from concurrent.futures import Future


class InlinePool:
    """A ``planview.sweep.work.Pool``; ``submitted`` counts the jobs."""

    submitted = 0

    def submit(self, function: Callable[..., object], *arguments: object) -> Future[object]:
        self.submitted += 1
        future: Future[object] = Future()
        try:
            future.set_result(function(*arguments))
        except BaseException as error:
            future.set_exception(error)
        return future

    def check(self) -> None: ...

    def close(self) -> None: ...
