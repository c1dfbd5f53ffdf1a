"""A recording of one camera."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from calib.types import F64
from stereo.readers.pair import DEFAULT_FPS, rate_of, time_at
from stereo.readers.prefetch import prefetch
from stereo.readers.source import FrameSource
from stereo.recording import Skipped, VideoFrame


class SingleRecording:
    """Frames of one camera, decoded ahead in the background; what cannot be decoded is noted in ``skipped``."""

    def __init__(self, path: Path, source: FrameSource, times_s: F64 | None, notes: Sequence[str] = ()) -> None:
        self.path = path
        self.n_frames = source.n_frames
        self.size = source.size
        self.skipped: list[Skipped] = []
        self.notes = list(notes)
        nominal = source.fps if math.isfinite(source.fps) else DEFAULT_FPS
        self.fps = nominal if times_s is None else rate_of(times_s)
        self._source = source
        self._times_s = times_s

    def __iter__(self) -> Iterator[VideoFrame]:
        self.skipped = skipped = []
        last = -1
        with closing(prefetch(self._source)) as frames:
            for frame in frames:
                last = frame.index
                if frame.image is None:
                    skipped.append(Skipped(frame.index, frame.why))
                    continue
                yield VideoFrame(frame.index, self._time(frame.index, frame.timestamp_s), frame.image)
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def at(self, indices: Sequence[int]) -> list[VideoFrame]:
        """The usable ones of these frames, whose indices ascend; ``skipped`` is not touched."""
        return [
            VideoFrame(frame.index, self._time(frame.index, frame.timestamp_s), frame.image)
            for frame in self._source.at(indices)
            if frame.image is not None
        ]

    def _time(self, index: int, file_time_s: float | None) -> float:
        if self._times_s is not None:
            return time_at(self._times_s, index, self.fps)
        return index / self.fps if file_time_s is None else file_time_s
