"""Where a run shows itself: a seam for rerun, and its null twin."""

from __future__ import annotations

from typing import Protocol

from planview.pipeline.engine import FrameResult


class RunLog(Protocol):
    """Takes every frame of a run."""

    def frame(self, result: FrameResult) -> None: ...

    def close(self) -> None: ...


class NoLog:
    """Shows nothing."""

    def frame(self, result: FrameResult) -> None:
        """Ignore a frame."""

    def close(self) -> None:
        """Nothing to close."""
