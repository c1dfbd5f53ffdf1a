"""Frames of several heads side by side in time."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from stereo.readers.multi_rig import MultiRigRecording, RigRecording
from stereo.recording import Skipped, StereoFrame, StereoRecording

BLACK = np.zeros((2, 2), dtype=np.uint8)


class Times:
    """A recording of which only the times matter."""

    def __init__(self, times_s: list[float], fps: float = 10.0) -> None:
        self.times_s, self.fps, self.n_frames = times_s, fps, len(times_s)
        self.skipped: list[Skipped] = []

    def __iter__(self) -> Iterator[StereoFrame]:
        return (StereoFrame(i, t, BLACK, BLACK) for i, t in enumerate(self.times_s))


def moments(*heads: tuple[Times, float]) -> list[tuple[float, list[int | None]]]:
    """Time of every moment, and the frame index of each head."""
    together = [
        RigRecording(f"{i}", cast(StereoRecording, cast(Any, times)), start) for i, (times, start) in enumerate(heads)
    ]
    recording = MultiRigRecording(Path("r"), together)
    return [(round(m.timestamp_s, 4), [f.index if f else None for f in m.frames]) for m in recording]


def test_frames_are_paired_after_the_offset_of_the_clocks() -> None:
    first, second = Times([0.0, 0.1, 0.2]), Times([0.0, 0.1, 0.2])
    assert moments((first, 0.0), (second, 0.12)) == [
        (0.0, [0, None]), (0.11, [1, 0]), (0.21, [2, 1]), (0.32, [None, 2]),
    ]  # fmt: skip


def test_a_head_without_a_frame_at_a_time_is_left_out() -> None:
    first, second = Times([0.0, 0.1, 0.2]), Times([0.0, 0.2])
    assert [frames for _, frames in moments((first, 0.0), (second, 0.0))] == [[0, 0], [1, None], [2, 1]]


def test_a_faster_head_gives_the_frames_of_the_slower_ones_times() -> None:
    slow, fast = Times([0.0, 0.1, 0.2], 10.0), Times([0.0, 0.05, 0.1, 0.15, 0.2], 20.0)
    assert [frames for _, frames in moments((fast, 0.0), (slow, 0.0))] == [[0, 0], [2, 1], [4, 2]]


def test_heads_half_a_period_apart_stay_together_when_their_clocks_jitter() -> None:
    jitter = 0.004 * np.array([0, 1, -1, 1, 0, -1])
    first, second = Times(list(np.arange(6) / 10)), Times(list(np.arange(6) / 10 + jitter))
    assert all(frames == [i, i] for i, (_, frames) in enumerate(moments((first, 0.0), (second, 0.05))))


def test_times_begin_with_the_earliest_head() -> None:
    assert moments((Times([0.0]), 0.0), (Times([0.0]), -3.0))[0] == (0.0, [None, 0])


def test_skipped_frames_name_their_head() -> None:
    times = Times([0.0])
    times.skipped.append(Skipped(4, "left: file is missing"))
    recording = MultiRigRecording(Path("r"), [RigRecording("north", cast(StereoRecording, cast(Any, times)), 0.0)])
    assert [(s.index, s.why) for s in recording.skipped] == [(4, "north: left: file is missing")]
    assert recording.fps == pytest.approx(10.0)
