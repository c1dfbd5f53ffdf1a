"""The engine beside OpenCV on the same frames, in turns, so that whatever else the machine does slows both."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.clip import Clip, PlainOpenCV
from benchmarks.yardstick import Yardstick
from calib.types import F64
from planview.engine.engine import FrameResult

SETTLED = 100
"""Frames before anything is timed: the background is learned, buffers are warm, kernels compiled."""
TURN = 4
"""Frames of the engine between two turns of OpenCV, which takes longer."""
PEOPLE = 4
"""People in the frames that count."""
ENOUGH = 10
"""Fewer frames with so many people are too few: then all frames with people count."""


class Figure(NamedTuple):
    """Median and quartiles of a figure, over so many frames."""

    median: float
    low: float
    high: float
    frames: int

    @staticmethod
    def of(values: F64) -> Figure:
        """Of measured values."""
        low, median, high = (round(float(q), 4) for q in np.quantile(values, (0.25, 0.5, 0.75)))
        return Figure(median, low, high, len(values))


class Turns(NamedTuple):
    """What was timed: frames of the engine, and after every TURN of them one of each rival.

    Attributes:
        engine_ms: (N,) float64, time of each frame.
        people: (N,) int64 people in view.
        rivals_ms: by name (N,) float64, the turn beside each frame.
        stages_ms: of each frame.
        matched: (N,) float64, share of the pixels that were matched.
    """

    engine_ms: F64
    people: np.ndarray
    rivals_ms: dict[str, F64]
    stages_ms: list[dict[str, float]]
    matched: F64

    @property
    def counted(self) -> np.ndarray:
        """(N,) bool, the frames that count: with four people; with some where there are too few of these."""
        return counted(self.people)

    def ratios(self, name: str) -> F64:
        """(M,) float64 the engine's time over a rival's, in the frames that count."""
        return np.asarray((self.engine_ms / self.rivals_ms[name])[self.counted], dtype=np.float64)


def counted(people: np.ndarray) -> np.ndarray:
    """Of (N,) people, (N,) bool: the frames that count."""
    four, anyone = people == PEOPLE, people > 0
    return four if four.sum() >= ENOUGH else anyone if anyone.sum() >= ENOUGH else people >= 0


def rivals_of(clip: Clip) -> dict[str, Callable[..., object]]:
    """OpenCV's stereo by name: the yardstick, and the same over the engine's own size and disparities."""
    rig, own = clip.recording.rig, PlainOpenCV(clip)
    return {
        "yardstick_grey": Yardstick(rig, grey=True),
        "yardstick_colour": Yardstick(rig, grey=False),
        "own_disparities_grey": lambda left, right: own(left, right, True),
        "own_disparities_colour": lambda left, right: own(left, right, False),
    }


def take_turns(clip: Clip, rivals: Mapping[str, Callable[..., object]], settled: int = SETTLED) -> Turns:
    """The engine over a clip's decoded frames, and after ``settled`` of them the rivals on every TURN-th."""
    engine = clip.pipeline
    engine.reset()
    if settled >= len(clip.frames):  # a clip that short is timed in its second half
        settled = len(clip.frames) // 2
    spent: list[float] = []
    results: list[tuple[int, dict[str, float], float]] = []
    theirs: dict[str, list[float]] = {name: [] for name in rivals}
    for n, frame in enumerate(clip.frames):
        start = time.perf_counter()
        result = engine.step(frame)
        spent.append(1e3 * (time.perf_counter() - start))
        results.append((people_in(result), result.stages_ms, result.matched_share))
        for name, rival in rivals.items():
            if n >= settled and (n % TURN == 0 or not theirs[name]):
                theirs[name].append(seconds(rival, frame.left, frame.right) * 1e3)
            elif theirs[name]:
                theirs[name].append(theirs[name][-1])
    timed = len(next(iter(theirs.values())))
    people, stages, matched = zip(*results[-timed:], strict=True)
    rival_ms = {name: np.array(times) for name, times in theirs.items()}
    return Turns(np.array(spent[-timed:]), np.array(people), rival_ms, list(stages), np.array(matched))


def people_in(result: FrameResult) -> int:
    """People in view: confirmed."""
    return sum(track.state == "confirmed" for track in result.tracks)


def seconds(run: Callable[..., object], *args: object) -> float:
    """Time that a call takes [s]."""
    start = time.perf_counter()
    run(*args)
    return time.perf_counter() - start
