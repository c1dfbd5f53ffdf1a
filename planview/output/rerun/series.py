"""Curves of a rerun recording, sent in blocks: a chunk for every number takes a hundred times its room."""

from __future__ import annotations

import rerun as rr

BLOCK_FRAMES = 256
"""Frames whose numbers are sent together (our choice: 17 s at 15 Hz)."""


class SeriesBlocks:
    """Gathers numbers by path and sends them as columns."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, float, float]]] = {}  # frame, time [s], value
        self._frames = 0

    def add(self, stream: rr.RecordingStream, frame: int, time_s: float, values: dict[str, float]) -> None:
        """The numbers of a frame, by path."""
        for path, value in values.items():
            self._rows.setdefault(path, []).append((frame, time_s, value))
        self._frames += 1
        if self._frames >= BLOCK_FRAMES:
            self.flush(stream)

    def flush(self, stream: rr.RecordingStream) -> None:
        """Send what has been gathered."""
        for path, rows in self._rows.items():
            frames, times, values = zip(*rows, strict=True)
            indexes = [rr.TimeColumn("frame", sequence=frames), rr.TimeColumn("time", duration=times)]
            rr.send_columns(path, indexes, rr.Scalars.columns(scalars=values), recording=stream)
        self._rows, self._frames = {}, 0
