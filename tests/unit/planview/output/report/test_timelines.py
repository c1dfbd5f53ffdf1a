"""Bars of the timelines."""

import numpy as np

from planview.counting.totals import Clock
from planview.evaluation.significant import SignificantError
from planview.output.report.timelines import UNHELD, held_by, stretches, timelines
from planview.trajectories.table import Trajectories, positions_table


def table(rows: list[tuple[int, int, float]]) -> Trajectories:
    """Rows of (frame, id, x), 10 frames per second, y = 0."""
    frame, track_id, x = (np.array(column) for column in zip(*rows, strict=True))
    xy = np.column_stack([x, np.zeros(len(x))]).astype(np.float64)
    return positions_table(frame, track_id, xy, timestamp_s=frame / 10)


def test_stretches_end_at_gaps_and_changes_of_value() -> None:
    person, frame = np.array([1, 1, 1, 1, 2]), np.array([0, 1, 3, 4, 0])
    found = stretches(person, frame, np.array([0, 0, 0, 5, 0]))
    assert list(zip(found.person, found.first, found.last, found.value, strict=True)) == [
        (1, 0, 1, 0), (1, 3, 3, 0), (1, 4, 4, 5), (2, 0, 0, 0),
    ]  # fmt: skip


def test_truth_is_held_by_the_confirmed_track_within_the_gate() -> None:
    truth = table([(0, 7, 0.0), (0, 8, 5.0), (1, 7, 0.0)])
    tracks = table([(0, 3, 0.1), (1, 3, 2.0)])
    assert held_by(tracks, truth).tolist() == [3, UNHELD, UNHELD]


def test_bars_are_in_percent_of_the_run_and_errors_are_marked() -> None:
    tracks = table([(frame, 3, 0.0) for frame in range(5)])
    truth = table([(frame, 7, 0.0) for frame in range(10)])
    error = SignificantError("lost", 5, 7, 3, 0.5, "visible")
    found = timelines(tracks, truth, Clock(tracks, 10.0), 10, [error])
    (track,), (person,) = found.tracks, found.truth
    assert [(round(bar.left), round(bar.width)) for bar in track.bars] == [(0, 50)]
    assert [(round(bar.left), round(bar.width), bool(bar.colour)) for bar in person.bars] == [
        (0, 50, True), (50, 50, False),
    ]  # fmt: skip
    assert [round(mark.left) for mark in person.marks] == [50]
    assert track.link == "person-3"
