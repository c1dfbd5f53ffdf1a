"""A recorded stereo pair, whatever its layout."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64
from stereo.readers.prefetch import prefetch
from stereo.readers.source import Decoded, FrameSource, as_colour
from stereo.recording import Skipped, StereoFrame

DEFAULT_FPS = 30.0
"""Assumed for image folders that have no timestamps.csv."""

DecodedPair = tuple[Decoded, Decoded]


class StereoRecording:
    """Frames of two cameras, decoded ahead in the background; each iteration starts at the first frame.

    A frame that one side lacks is passed over and noted in ``skipped``; indices and times keep the gap.
    """

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        pairs: Callable[[], Generator[DecodedPair, None, None]],
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
        self._pairs = pairs
        self._times_s = times_s

    def __iter__(self) -> Iterator[StereoFrame]:
        self.skipped = skipped = []
        last, start = -1, math.nan
        with closing(self._pairs()) as pairs:
            for left, right in pairs:
                last = left.index
                why = [f"{side}: {d.why}" for side, d in (("left", left), ("right", right)) if d.image is None]
                if left.image is None or right.image is None:
                    skipped.append(Skipped(left.index, "; ".join(why)))
                    continue
                time = self._time(left)
                start = time if math.isnan(start) and left.index == 0 else start
                a, b = left.image, right.image
                if a.ndim != b.ndim:
                    a, b = as_colour(a), as_colour(b)
                yield StereoFrame(left.index, time - (0.0 if math.isnan(start) else start), a, b)
        skipped += [Skipped(i, "recording ends before this frame") for i in range(last + 1, self.n_frames)]

    def _time(self, frame: Decoded) -> float:
        if self._times_s is not None:
            return time_at(self._times_s, frame.index, self.fps)
        return frame.index / self.fps if frame.timestamp_s is None else frame.timestamp_s


def both(left: FrameSource, right: FrameSource) -> Generator[DecodedPair, None, None]:
    """Frames of two sources side by side, each decoded in its own thread; ends with the shorter one."""
    with closing(prefetch(left)) as a, closing(prefetch(right)) as b:
        yield from zip(a, b, strict=False)


def halves(source: FrameSource) -> Generator[DecodedPair, None, None]:
    """The left and the right half of every frame of a side-by-side source."""
    with closing(prefetch(source)) as frames:
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
