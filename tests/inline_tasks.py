"""Jobs of a study in this process, at once."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from planview.sweep.work import Done, guarded


class InlineTasks:
    """``planview.sweep.work.Tasks``; ``submitted`` counts the jobs."""

    submitted = 0

    def __call__(self, function: Callable[..., Any], arguments: Mapping[str, object]) -> Iterator[Done]:
        for key, argument in arguments.items():
            self.submitted += 1
            yield guarded(function, key, argument)
