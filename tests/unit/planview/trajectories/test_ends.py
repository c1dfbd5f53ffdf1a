"""Where a track ends."""

from dataclasses import replace

import numpy as np
import pytest
from toy_tracks import positions_table

from planview.trajectories.ends import HIDDEN_S, has_ended, track_numbers
from planview.trajectories.table import Trajectories


def person(frames: list[int], x_m: list[float], fps: float = 10.0) -> Trajectories:
    """One id in some frames, by x."""
    frame = np.array(frames)
    ids = np.ones(len(frames), np.int64)
    return positions_table(frame, ids, np.column_stack([x_m, np.zeros(len(frames))]), timestamp_s=frame / fps)


def numbers(table: Trajectories) -> list[int]:
    return track_numbers(table, table.timestamp_s).tolist()


def test_a_track_goes_on_while_somebody_is_hidden():
    assert not has_ended(HIDDEN_S)
    assert numbers(person([0, 40], [0.0, 1.0])) == [0, 0]


def test_a_track_ends_where_its_id_has_no_row_for_longer():
    assert has_ended(HIDDEN_S + 0.1)
    assert numbers(person([0, 41], [0.0, 0.0])) == [0, 1]


def test_predicted_rows_keep_a_track_alive():
    table = person(list(range(0, 91, 30)), [0.0, 0.5, 1.0, 1.5])
    assert numbers(replace(table, state=np.array(["confirmed", "lost", "lost", "confirmed"]))) == [0, 0, 0, 0]


def test_a_track_ends_where_nobody_could_have_walked():
    assert numbers(person([0, 1, 2], [0.0, 3.5, 3.6])) == [0, 1, 1]


@pytest.mark.parametrize(("step_m", "fps"), [(2.5, 10.0), (3.5, 2.0)], ids=["error of a tracker", "slow frames"])
def test_a_step_that_an_error_or_a_runner_makes_ends_nothing(step_m, fps):
    assert numbers(person([0, 1], [0.0, step_m], fps)) == [0, 0]


def test_a_jump_is_measured_from_where_somebody_was_seen_last():
    table = replace(person([0, 1, 2], [0.0, 2.0, 4.0]), state=np.array(["confirmed", "lost", "confirmed"]))
    assert numbers(table) == [0, 0, 1]


def test_boxes_jump_by_their_own_height():
    none = np.full((2, 2), np.nan)
    boxes = np.array([[0.0, 0.0, 40.0, 170.0], [400.0, 0.0, 40.0, 170.0]])  # 4 m at 100 px per metre
    frame = np.arange(2)
    table = positions_table(frame, np.ones(2, np.int64), none, timestamp_s=frame / 10, box_px=boxes)
    assert numbers(table) == [0, 1]


def test_tracks_are_numbered_by_id_before_time():
    frame = np.array([0, 0, 60, 60])
    ids = np.array([1, 2, 1, 2])
    table = positions_table(frame, ids, np.zeros((4, 2)), timestamp_s=frame / 10)
    assert numbers(table) == [0, 2, 1, 3]
