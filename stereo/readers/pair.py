"""A recorded stereo pair, whatever its layout."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path

from calib.images import as_colour
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64, U8
from stereo.readers.paired import DEFAULT_FPS, PairedFrames, both, rate_of, time_at
from stereo.readers.prefetch import prefetch
from stereo.readers.source import Decoded, ItemSource
from stereo.recording import Skipped, StereoFrame

__all__ = ["DEFAULT_FPS", "DecodedPair", "PairsOf", "StereoRecording", "both", "rate_of", "split_pairs", "time_at"]

SAMPLE_STEP_S = 0.25
"""Frames in which a live camera's floor is looked for are so far apart [s] (our choice: 12 take 3 s)."""

DecodedPair = tuple[Decoded, Decoded]
PairsOf = Callable[[Sequence[int] | None], Generator[DecodedPair, None, None]]
"""Decodes the pairs of these ascending indices, or all."""


class StereoRecording(PairedFrames[StereoFrame, Decoded]):
    """Frames of two cameras (a ``Recording``).

    Attributes:
        rig, world_SE3_left: see ``Recording``.
        is_live: frames come from cameras as they run.
    """

    sides = ("left", "right")
    is_live = False

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
        super().__init__(path, pairs, n_frames, fps, times_s)
        self.rig = rig
        self.world_SE3_left = world_SE3_left

    def _joined(self, first: Decoded, second: Decoded, timestamp_s: float) -> StereoFrame | None:
        a, b = first.image, second.image
        if a is None or b is None:
            return None
        if a.ndim != b.ndim:
            a, b = as_colour(a), as_colour(b)
        return StereoFrame(first.index, timestamp_s, a, b)


class LiveRecording(StereoRecording):
    """Frames of two cameras as they run; every iteration begins with the next frame that comes.

    Attributes:
        waits: the source waits until its frames are read (a file behind an address), as a device does not.
    """

    is_live = True
    waits = False

    def sample(self, count: int) -> list[StereoFrame]:
        """Up to ``count`` usable frames from now on, ``SAMPLE_STEP_S`` apart."""
        frames: list[StereoFrame] = []
        with closing(self._pairs(None)) as pairs:
            for left, right in pairs:
                frame = self._frame(left, right)
                if isinstance(frame, Skipped):
                    continue
                if not frames or frame.timestamp_s - frames[-1].timestamp_s >= SAMPLE_STEP_S:
                    frames.append(frame)
                if len(frames) >= count:
                    break
        return frames


def split_pairs(
    source: ItemSource[Decoded], split: Callable[[U8], tuple[U8, U8]], indices: Sequence[int] | None
) -> Generator[DecodedPair, None, None]:
    """The left and the right view in every frame of a source that holds both."""
    with closing(prefetch(source if indices is None else source.at(indices))) as frames:
        for frame in frames:
            if frame.image is None:
                yield frame, frame
                continue
            left, right = (Decoded(frame.index, frame.timestamp_s, view) for view in split(frame.image))
            yield left, right
