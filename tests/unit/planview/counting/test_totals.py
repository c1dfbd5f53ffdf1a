"""A jump of the clock: cost follows rows and not seconds, and the jump is told."""

import numpy as np
import pytest

from planview.counting.events import Direction, Event
from planview.counting.passages import Stay
from planview.counting.scoring import crossing_scores, occupancy_groups
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


def crossing(moment: float, direction: Direction = "left_to_right") -> Event:
    return Event(round(moment * 10), moment, "door", "crossing", 1, direction)


def test_matching_is_by_time_and_direction() -> None:
    true = [crossing(1.0), crossing(2.0), crossing(10.0, "right_to_left")]
    found = [crossing(2.3), crossing(1.2), crossing(10.1, "right_to_left")]
    scores = crossing_scores(true, found, 1.0)
    assert (scores.matched, scores.precision, scores.recall, scores.accuracy) == (3, 1.0, 1.0, 1.0)
    assert scores.timing_mean_s == pytest.approx(0.2)
    assert scores.timing_std_s == pytest.approx(np.std([0.2, 0.3, 0.1]))


def test_as_many_crossings_match_as_can() -> None:
    # The nearest pair (2.0, 2.1) would leave 1.2 and 2.9 without partners in the window.
    scores = crossing_scores([crossing(1.2), crossing(2.0)], [crossing(2.1), crossing(2.9)], 0.95)
    assert scores.matched == 2


def test_misses_and_extras_cancel_in_the_total_but_not_in_the_strict_accuracy() -> None:
    scores = crossing_scores([crossing(t) for t in (1, 2, 3, 4)], [crossing(t) for t in (1, 2, 3, 50)], 1.0)
    assert scores.accuracy == 1.0
    assert scores.strict_accuracy == 0.5
    assert (scores.precision, scores.recall) == (0.75, 0.75)


def test_wrong_direction_is_told_apart_from_a_miss() -> None:
    scores = crossing_scores([crossing(1.0)], [crossing(1.1, "right_to_left")], 1.0)
    assert (scores.matched, scores.wrong_direction) == (0, 1)
    assert (scores.true_left_to_right, scores.found_right_to_left) == (1, 1)


@pytest.mark.parametrize(
    ("true", "found", "accuracy"), [(16, 17, 0.938), (102, 98, 0.961), (54, 41, 0.759), (564, 597, 0.941)]
)
def test_accuracy_is_that_of_the_papers_table_3(true: int, found: int, accuracy: float) -> None:
    scores = crossing_scores([crossing(float(i)) for i in range(true)], [crossing(float(i)) for i in range(found)], 0.4)
    assert scores.accuracy == pytest.approx(accuracy, abs=0.001)


def test_scores_without_crossings_are_unknown() -> None:
    scores = crossing_scores([], [], 1.0)
    assert (scores.accuracy, scores.precision, scores.recall, scores.timing_mean_s) == (None, None, None, None)


def test_occupancy_is_grouped_by_the_true_number_as_in_table_4() -> None:
    true = np.array([0, 0, 1, 2, 4, 4, 12])
    found = np.array([0, 1, 1, 2, 3, 5, 10])
    groups = {group.people: group for group in occupancy_groups(true, found)}
    assert (groups["0"].right_percent, groups["0"].mean_difference) == (50.0, 0.5)
    assert groups["1-2"].right_percent == 100.0
    assert (groups["3-5"].mean_difference, groups["3-5"].mean_absolute_difference) == (0.0, 1.0)
    assert (groups["6-9"].frames, groups["6-9"].right_percent) == (0, None)
    assert groups["10+"].mean_difference == -2.0
