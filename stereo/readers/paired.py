"""Frames made of two decoded images, whatever the two are."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from calib.types import F64
from stereo.readers.prefetch import prefetch
from stereo.readers.source import Decoded, DecodedDepth, ItemSource
from stereo.recording import Skipped

DEFAULT_FPS = 30.0
"""Assumed for image folders that have no timestamps.csv."""

AnyFrame = TypeVar("AnyFrame")
Second = TypeVar("Second", bound=Decoded | DecodedDepth)


class PairedFrames(ABC, Generic[AnyFrame, Second]):
    """Frames of an image and its mate, decoded ahead in the background; each iteration starts at the first frame.

    A frame that one side lacks is passed over and noted in ``skipped``; indices and times keep the gap.

    Attributes:
        path: the folder or file it came from.
        n_frames: frames announced by the files.
        fps: nominal frames per second.
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None without a table of times.
        skipped: frames passed over so far while iterating.
        notes: what the reader assumed, mended or missed, a sentence each.
        even: frames are ``fps`` apart, whatever times the decoded frames hold.
    """

    sides: tuple[str, str]
    """Names of the two, for messages."""

    def __init__(
        self,
        path: Path,
        pairs: Callable[[Sequence[int] | None], Generator[tuple[Decoded, Second], None, None]],
        n_frames: int,
        fps: float,
        times_s: F64 | None,
    ) -> None:
        """Prepare.

        Args:
            pairs: decodes the pairs of ascending indices, or all.
        """
        self.path = path
        self.n_frames = n_frames
        self.fps = fps
        self.times_s = times_s
        self.skipped: list[Skipped] = []
        self.notes: list[str] = []
        self.even = False
        self._pairs = pairs

    @abstractmethod
    def _joined(self, first: Decoded, second: Second, timestamp_s: float) -> AnyFrame | None:
        """The frame of two decoded images; None when one of them is missing."""

    def __iter__(self) -> Iterator[AnyFrame]:
        self.skipped = skipped = []
        last = -1
        with closing(self._pairs(None)) as pairs:
            for first, second in pairs:
                last = first.index
                frame = self._frame(first, second)
                if isinstance(frame, Skipped):
                    skipped.append(frame)
                else:
                    yield frame
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def sample(self, count: int) -> list[AnyFrame]:
        """Up to ``count`` usable frames spread evenly over the recording; ``skipped`` is not touched.

        For what must be known before the first frame (row offset, floor, exposure) without decoding everything.
        """
        spread = np.unique(np.linspace(0, self.n_frames - 1, max(1, min(count, self.n_frames))).round().astype(int))
        return self.at([int(i) for i in spread])

    def at(self, indices: Sequence[int]) -> list[AnyFrame]:
        """The usable ones of these frames, whose indices ascend; ``skipped`` is not touched."""
        with closing(self._pairs(indices)) as pairs:
            frames = [self._frame(first, second) for first, second in pairs]
        return [frame for frame in frames if not isinstance(frame, Skipped)]

    def _frame(self, first: Decoded, second: Second) -> AnyFrame | Skipped:
        frame = self._joined(first, second, self._time(first))
        if frame is None:
            reasons = zip(self.sides, (first.why, second.why), strict=True)
            return Skipped(first.index, "; ".join(f"{side}: {why}" for side, why in reasons if why))
        return frame

    def _time(self, frame: Decoded) -> float:
        if self.times_s is not None:
            return time_at(self.times_s, frame.index, self.fps)
        return frame.index / self.fps if self.even or frame.timestamp_s is None else frame.timestamp_s


def both(
    first: ItemSource[Decoded], second: ItemSource[Second], indices: Sequence[int] | None
) -> Generator[tuple[Decoded, Second], None, None]:
    """Frames of two sources side by side, each decoded in its own thread; ends with the shorter one."""
    one, other = (first, second) if indices is None else (first.at(indices), second.at(indices))
    with closing(prefetch(one)) as a, closing(prefetch(other)) as b:
        yield from zip(a, b, strict=False)


def time_at(times_s: F64, index: int, fps: float) -> float:
    """Time of a frame; where the table has none, between its neighbours, beyond its end at the nominal rate."""
    if index < len(times_s) and math.isfinite(times_s[index]):
        return float(times_s[index])
    known = np.flatnonzero(np.isfinite(times_s))
    if index > known[-1]:
        return float(times_s[known[-1]] + (index - known[-1]) / fps)
    if index < known[0]:
        return float(times_s[known[0]] + (index - known[0]) / fps)
    return float(np.interp(index, known, times_s[known]))


def rate_of(times_s: F64) -> float:
    """Nominal frames per second of a table of times, ``DEFAULT_FPS`` when it holds fewer than two."""
    steps = np.diff(times_s)
    steps = steps[np.isfinite(steps)]
    return float(1.0 / np.median(steps)) if steps.size else DEFAULT_FPS
