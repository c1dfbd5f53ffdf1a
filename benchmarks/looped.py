"""A short recording that begins again without an end, as one long recording of images."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from calib.errors import WorkError
from calib.images import encode_image
from calib.pose import SE3
from calib.types import U8
from stereo.recording import Recording, Skipped, StereoFrame

QUALITY = 95
"""Of the JPEG files that the images are kept as."""


class _Encoded(NamedTuple):
    """A frame as two JPEG files."""

    timestamp_s: float
    left: bytes
    right: bytes


class LoopedRecording:
    """A ``Recording`` of so many frames, decoded from images in memory; frame numbers and times go on.

    Files are not opened again: a decoder of videos keeps some memory for each time it is opened, which a long recording
    does once.

    Args:
        recording: is read once.
        width_px: its images are reduced to.
        world_SE3_left: where the floor is.
    """

    def __init__(self, recording: Recording, n_frames: int, width_px: int, world_SE3_left: SE3) -> None:
        width, height = recording.rig.left.size
        self._size = width_px, round(width_px * height / width)
        self.path, self.rig, self.fps = recording.path, recording.rig.scaled(*self._size), recording.fps
        self.world_SE3_left: SE3 | None = world_SE3_left
        self.n_frames = n_frames
        self.skipped: list[Skipped] = []
        self._frames = [_Encoded(f.timestamp_s, self._encoded(f.left), self._encoded(f.right)) for f in recording]
        if not self._frames:
            raise WorkError(f"{recording.path}: none of {recording.n_frames} frames can be used")

    def __iter__(self) -> Iterator[StereoFrame]:
        turn_s = self._frames[-1].timestamp_s + 1 / self.fps
        for index in range(self.n_frames):
            turn, place = divmod(index, len(self._frames))
            yield self._frame(index, place, turn * turn_s)

    def sample(self, count: int) -> list[StereoFrame]:
        """Frames spread over one round."""
        places = np.unique(np.linspace(0, len(self._frames) - 1, count).astype(int))
        return [self._frame(int(place), int(place), 0.0) for place in places]

    def _frame(self, index: int, place: int, shift_s: float) -> StereoFrame:
        frame = self._frames[place]
        return StereoFrame(index, frame.timestamp_s + shift_s, _decoded(frame.left), _decoded(frame.right))

    def _encoded(self, image: U8) -> bytes:
        return bytes(encode_image(np.asarray(cv2.resize(image, self._size), np.uint8), quality=QUALITY))


def _decoded(jpeg: bytes) -> U8:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED), dtype=np.uint8)
