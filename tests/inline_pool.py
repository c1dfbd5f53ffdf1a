"""A pool that runs jobs in this process, at once."""

from collections.abc import Callable


class InlinePool:
    """A ``planview.sweep.work.Pool``; ``submitted`` counts the jobs."""

    at_once, submitted = 1, 0

    def call(self, function: Callable[..., object], argument: object) -> object:
        self.submitted += 1
        return function(argument)

    def __enter__(self) -> "InlinePool":
        return self

    def __exit__(self, *_: object) -> None: ...
