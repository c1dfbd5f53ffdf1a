"""A recording at another size and rate, made while it is read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import overload

import cv2
import numpy as np

from calib.pose import SE3
from calib.types import U8
from stereo.recording import Recording, Skipped, StereoFrame


class ScaledFrames(Sequence[StereoFrame]):
    """Every n-th of some decoded frames, each resized when it is taken: all of them large would not fit in memory."""

    def __init__(self, frames: Sequence[StereoFrame], size: tuple[int, int], every: int = 1) -> None:
        self._frames, self._size = frames[::every], size

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> StereoFrame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[StereoFrame]: ...
    def __getitem__(self, index: int | slice) -> StereoFrame | Sequence[StereoFrame]:
        if isinstance(index, slice):
            return ScaledFrames(self._frames[index], self._size)
        frame = self._frames[index]
        return StereoFrame(index, frame.timestamp_s, self._resized(frame.left), self._resized(frame.right))

    def _resized(self, image: U8) -> U8:
        return np.asarray(cv2.resize(image, self._size), dtype=np.uint8)


class ScaledRecording:
    """A ``Recording`` of frames in memory at another size, its floor known."""

    def __init__(self, recording: Recording, frames: ScaledFrames, size: tuple[int, int], world_SE3_left: SE3) -> None:
        self.path: Path = recording.path
        self.rig = recording.rig.scaled(*size)
        self.world_SE3_left: SE3 | None = world_SE3_left
        self.n_frames, self.fps = len(frames), recording.fps
        self.skipped: list[Skipped] = []
        self._frames = frames

    def __iter__(self) -> Iterator[StereoFrame]:
        return iter(self._frames)

    def sample(self, count: int) -> list[StereoFrame]:
        """Frames spread over all."""
        chosen = np.unique(np.linspace(0, self.n_frames - 1, count).astype(int))
        return [self._frames[int(i)] for i in chosen]
