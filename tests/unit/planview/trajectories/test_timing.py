"""The time from frame to frame."""

import numpy as np
import pytest

from planview.trajectories.table import Trajectories, frame_period_s, positions_table


def table(frame: list[int], times: list[float]) -> Trajectories:
    ids = np.arange(1, len(frame) + 1)
    return positions_table(np.array(frame), ids, np.zeros((len(frame), 2)), timestamp_s=np.array(times))


def test_frame_period_is_the_median_over_gaps() -> None:
    frame = [0, 0, 1, 2, 12]
    assert frame_period_s(table(frame, [n / 25.0 for n in frame]), 1 / 30) == pytest.approx(0.04)


def test_frame_period_without_timestamps_is_the_fallback() -> None:
    assert frame_period_s(table([0, 1], [np.nan, np.nan]), 1 / 30) == 1 / 30
    assert frame_period_s(table([0, 1], [2.0, 2.0]), 1 / 30) == 1 / 30


def test_frame_period_of_mostly_repeated_timestamps_is_the_mean() -> None:
    assert frame_period_s(table([0, 1, 2, 3], [0.0, 0.0, 0.0, 0.3]), 1 / 30) == pytest.approx(0.1)
