"""A single-camera engine beside OpenCV's MOG2 on the same frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calib.types import F64, U8
from planview.engine.single_camera_pipeline import SingleCameraPipeline
from stereo.recording import Skipped, VideoFrame


@dataclass(eq=False)
class PaintedVideo:
    """A ``Video`` of frames that are painted while it is read.

    Attributes:
        paint: gives (H, W, 3) uint8 frames for a number of frames.
        n_frames: that number.
        size: (width, height) of the frames [px].
        fps: frames per second.
    """

    paint: Callable[[int], Iterable[U8]]
    n_frames: int
    size: tuple[int, int]
    fps: float
    path: Path = Path("painted")
    skipped: list[Skipped] = field(default_factory=list)

    def __iter__(self) -> Iterator[VideoFrame]:
        for i, image in enumerate(self.paint(self.n_frames)):
            yield VideoFrame(i, i / self.fps, image)


class TimesBesideMog2(NamedTuple):
    """Processor times of an engine's frames and of MOG2's on the same images.

    Attributes:
        engine_ms, mog2_ms: (N,) of each frame [ms].
        people: (N,) confirmed people.
    """

    engine_ms: F64
    mog2_ms: F64
    people: F64

    @property
    def ratios(self) -> F64:
        """(N,) the engine's time over MOG2's."""
        return self.engine_ms / self.mog2_ms


def beside_mog2(engine: SingleCameraPipeline, settled: int) -> TimesBesideMog2:
    """Time the engine's ``step`` and MOG2 alone, in turns on each frame of the engine's recording.

    Args:
        settled: frames before anything counts: backgrounds are learned, people confirmed, kernels compiled.
    """
    mog2 = cv2.createBackgroundSubtractorMOG2()
    engine.reset()
    rows: list[tuple[float, float, int]] = []
    for frame in engine.recording:
        start = time.process_time()
        mog2.apply(frame.image)
        between = time.process_time()
        result = engine.step(frame)
        ours_ms, theirs_ms = 1e3 * (time.process_time() - between), 1e3 * (between - start)
        rows.append((ours_ms, theirs_ms, sum(track.state == "confirmed" for track in result.tracks)))
    return TimesBesideMog2(*np.array(rows[settled:], np.float64).T)
