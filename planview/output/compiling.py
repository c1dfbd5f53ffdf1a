"""A word for people while kernels are compiled: the first run of an installation takes a minute longer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener
from rich.console import Console

EVERY_S = 5.0
"""Time between two lines [s] (our choice)."""


@contextmanager
def compile_notice(console: Console) -> Iterator[None]:
    """Print a line when the first kernel is compiled, and every EVERY_S while more are; none when all are cached."""
    with install_listener("numba:compile", _Lines(console)):
        yield


class _Lines(Listener):
    """Counts kernels as numba compiles them."""

    def __init__(self, console: Console) -> None:
        self._console, self._kernels, self._last_s = console, 0, 0.0

    def on_start(self, event: Event) -> None:
        """A kernel that no cache holds is about to be compiled."""
        if self._kernels == 0 and not self._last_s:
            self._print("compiling kernels, once per installation: about a minute")

    def on_end(self, event: Event) -> None:
        """It is compiled."""
        self._kernels += 1
        if time.monotonic() - self._last_s > EVERY_S:
            self._print(f"compiling kernels: {self._kernels} so far")

    def _print(self, text: str) -> None:
        self._console.print(text, highlight=False)
        self._last_s = time.monotonic()
