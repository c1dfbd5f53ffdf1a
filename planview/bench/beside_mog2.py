"""A single-camera engine beside OpenCV's MOG2 on the same frames."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from calib.types import U8
from planview.pipeline.pipeline import SingleCameraPipeline
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


def beside_mog2(engine: SingleCameraPipeline, settled: int, name: str) -> tuple[float, dict[str, float]]:
    """Processor time of the engine's ``step`` over that of MOG2 alone, in turns on each frame of its recording.

    Args:
        settled: frames before anything counts: backgrounds are learned, people confirmed, kernels compiled.
        name: of the engine, for the details.
    Returns:
        the ratio of the medians; and times of both [ms] and the number of people tracked, medians.
    """
    mog2 = cv2.createBackgroundSubtractorMOG2()
    engine.reset()
    ours: list[float] = []
    theirs: list[float] = []
    people: list[int] = []
    for frame in engine.recording:
        start = time.process_time()
        mog2.apply(frame.image)
        between = time.process_time()
        result = engine.step(frame)
        ours.append(time.process_time() - between)
        theirs.append(between - start)
        people.append(sum(track.state == "confirmed" for track in result.tracks))
    ours_ms, mog2_ms = (1e3 * float(np.median(spent[settled:])) for spent in (ours, theirs))
    tracked = float(np.median(people[settled:]))
    return ours_ms / mog2_ms, {f"{name}_ms": ours_ms, f"{name}_mog2_ms": mog2_ms, f"{name}_people": tracked}
