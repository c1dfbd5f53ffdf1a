"""A recorded stereo pair, whatever its layout."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from calib.images import as_colour
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64
from stereo.readers.prefetch import prefetch
from stereo.readers.source import Decoded, FrameSource
from stereo.recording import Skipped, StereoFrame

DEFAULT_FPS = 30.0
"""Assumed for image folders that have no timestamps.csv."""

DecodedPair = tuple[Decoded, Decoded]
PairsOf = Callable[[Sequence[int] | None], Generator[DecodedPair, None, None]]
"""Decodes the pairs of these ascending indices, or all."""


class StereoRecording:
    """Frames of two cameras, decoded ahead in the background; each iteration starts at the first frame.

    A frame that one side lacks is passed over and noted in ``skipped``; indices and times keep the gap.

    Attributes:
        times_s: (n,) float64 [s] by frame index, NaN where unknown; None without a table of times.
        notes: what the reader assumed, mended or missed, a sentence each.
        even: frames are ``fps`` apart, whatever times the decoded frames hold.
    """

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        pairs: PairsOf,
        n_frames: int,
        fps: float,
        times_s: F64 | None,
        world_SE3_left: SE3 | None,
    ) -> None:
        self.path = path
        self.rig = rig
        self.world_SE3_left = world_SE3_left
        self.n_frames = n_frames
        self.fps = fps
        self.skipped: list[Skipped] = []
        self.notes: list[str] = []
        self.even = False
        self._pairs = pairs
        self.times_s = times_s

    def __iter__(self) -> Iterator[StereoFrame]:
        self.skipped = skipped = []
        last = -1
        with closing(self._pairs(None)) as pairs:
            for left, right in pairs:
                last = left.index
                frame = self._frame(left, right)
                if isinstance(frame, Skipped):
                    skipped.append(frame)
                else:
                    yield frame
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def sample(self, count: int) -> list[StereoFrame]:
        """Up to ``count`` usable frames spread evenly over the recording; ``skipped`` is not touched.

        For what must be known before the first frame (row offset, floor, exposure) without decoding everything.
        """
        spread = np.unique(np.linspace(0, self.n_frames - 1, max(1, min(count, self.n_frames))).round().astype(int))
        return self.at([int(i) for i in spread])

    def at(self, indices: Sequence[int]) -> list[StereoFrame]:
        """The usable ones of these frames, whose indices ascend; ``skipped`` is not touched."""
        with closing(self._pairs(indices)) as pairs:
            frames = [self._frame(left, right) for left, right in pairs]
        return [frame for frame in frames if isinstance(frame, StereoFrame)]

    def _frame(self, left: Decoded, right: Decoded) -> StereoFrame | Skipped:
        a, b = left.image, right.image
        if a is None or b is None:
            why = [f"{side}: {d.why}" for side, d in (("left", left), ("right", right)) if d.image is None]
            return Skipped(left.index, "; ".join(dict.fromkeys(why)))
        if a.ndim != b.ndim:
            a, b = as_colour(a), as_colour(b)
        return StereoFrame(left.index, self._time(left), a, b)

    def _time(self, frame: Decoded) -> float:
        if self.times_s is not None:
            return time_at(self.times_s, frame.index, self.fps)
        return frame.index / self.fps if self.even or frame.timestamp_s is None else frame.timestamp_s


def both(left: FrameSource, right: FrameSource, indices: Sequence[int] | None) -> Generator[DecodedPair, None, None]:
    """Frames of two sources side by side, each decoded in its own thread; ends with the shorter one."""
    streams = (side if indices is None else side.at(indices) for side in (left, right))
    with closing(prefetch(next(streams))) as a, closing(prefetch(next(streams))) as b:
        yield from zip(a, b, strict=False)


def halves(source: FrameSource, indices: Sequence[int] | None) -> Generator[DecodedPair, None, None]:
    """The left and the right half of every frame of a side-by-side source."""
    with closing(prefetch(source if indices is None else source.at(indices))) as frames:
        for frame in frames:
            if frame.image is None:
                yield frame, frame
                continue
            middle = frame.image.shape[1] // 2
            parts = (np.ascontiguousarray(p) for p in (frame.image[:, :middle], frame.image[:, middle:]))
            left, right = (Decoded(frame.index, frame.timestamp_s, part) for part in parts)
            yield left, right


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
