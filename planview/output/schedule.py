"""What a run does from time to time."""

from __future__ import annotations

import time


class Schedule:
    """When something that is done from time to time is due again."""

    def __init__(self, every_s: float) -> None:
        self._every_s, self._last_s = every_s, time.monotonic()

    def due(self, stopping: bool = False) -> bool:
        """Whether it is time, or the run is about to stop; never when ``every_s`` is 0."""
        now_s = time.monotonic()
        if not self._every_s or (now_s - self._last_s < self._every_s and not stopping):
            return False
        self._last_s = now_s
        return True

    def stop(self) -> None:
        """Never due any more."""
        self._every_s = 0.0
