"""Ctrl-C, SIGTERM and SIGHUP: a run ends after the frame under way, with its files complete."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """While entered, the first signal is noted and the second raises KeyboardInterrupt.

    Signals that the process was started to ignore (``nohup``) stay ignored; outside of the main thread, where Python
    takes no signals, nothing is changed.
    """

    def __init__(self) -> None:
        self.noted = False
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._before = {}

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.noted:
            raise KeyboardInterrupt
        self.noted = True

    def check(self) -> None:
        """Raises KeyboardInterrupt after a signal; to be called where stopping loses nothing."""
        if self.noted:
            raise KeyboardInterrupt
