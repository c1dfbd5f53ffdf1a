"""A jump of the clock: cost follows rows and not seconds, and the jump is told."""

import numpy as np
import pytest

from planview.counting.passages import Stay
from planview.counting.totals import Clock, Span, occupancy_at, over_frames
from planview.trajectories.state import TrackState
from planview.trajectories.table import Trajectories, TrajectoryCollector

STAYS = [Stay(0.0, 1.0, True, True), Stay(0.55, 2.0, True), Stay(0.95, 1.2, False, True), Stay(7.0, 7.05, True, True)]


def test_maximum_and_mean_over_frames_are_those_of_the_series() -> None:
    span = Span(0.0, 8.0, 0.1)
    series = occupancy_at(STAYS, span.frame_times(), span.frame_s)
    found = over_frames(STAYS, span)
    assert found.max == series.max() == 2
    assert found.mean == pytest.approx(series.mean())


def test_half_a_century_of_frames_costs_nothing() -> None:
    assert over_frames(STAYS, Span(0.0, 1.6e9, 1 / 15)).max == 2


def test_intervals_of_a_jump_are_those_that_hold_something() -> None:
    starts = Span(0.0, 1.6e9, 0.1).interval_starts(60.0, [61.0, 1.5e9])
    assert starts.tolist() == [0.0, 60.0, 1.5e9, pytest.approx(1.6e9, abs=60.0)]


def tracks_at(times: list[float]) -> Trajectories:
    collector = TrajectoryCollector()
    for frame, time in enumerate(times):
        collector.add(frame, time, (TrackState(1, "confirmed", 0.0, 0.0, 0.0, 0.0, 1.7),))
    return collector.trajectories()


def test_a_jump_is_told_with_its_frames_and_size() -> None:
    assert "by 30.0 days from frame 1 to 2" in Clock(tracks_at([0.0, 0.1, 0.2 + 30 * 86400]), 10.0).jump()
    assert Clock(tracks_at([0.0, 0.1, 60.0]), 10.0).jump() == ""
    assert np.isfinite(Clock(tracks_at([0.0]), 10.0).frame_s)
