"""Where a run shows or keeps itself besides its tables."""

from __future__ import annotations

from typing import Protocol

from planview.engine.engine import FrameResult


class RunLog(Protocol):
    """Takes every frame of a run."""

    def frame(self, result: FrameResult) -> None: ...

    def mark(self) -> dict[str, int]:
        """Bring all frames so far to the disk; the position from which a run can go on after a kill."""

    def close(self) -> None:
        """All frames are complete on the disk, whether the run finished or not; it may be resumed."""

    def finish(self) -> None:
        """After ``close`` of a run that finished: nothing is kept for going on."""
