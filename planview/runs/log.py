"""Where a run shows or keeps itself besides its tables."""

from __future__ import annotations

from typing import Protocol

from planview.pipeline.engine import FrameResult


class RunLog(Protocol):
    """Takes every frame of a run."""

    def frame(self, result: FrameResult) -> None: ...

    def close(self) -> None: ...
