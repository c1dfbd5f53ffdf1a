"""What the ids of a table stand for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from toy_tracks import positions_table

from calib.errors import InputError
from planview.trajectories.identities import judge_ids, recording_starts, split_paths
from planview.trajectories.table import Trajectories, concatenate, people_of, table_of

NEVER = np.empty(0, np.int64)


def walkers(ids: Sequence[int] = (1, 2, 3), first: int = 0, frames: int = 100, speed_mps: float = 1.0) -> Trajectories:
    """People 2 m apart who walk along y, 10 frames per second, from y = 0 in the first frame."""
    frame = np.repeat(np.arange(first, first + frames), len(ids))
    track_id = np.tile(ids, frames)
    y = 0.1 * speed_mps * (frame - first)
    return positions_table(frame, track_id, np.column_stack([2.0 * track_id, y]), timestamp_s=frame / 10)


def starts(table: Trajectories) -> list[int]:
    return recording_starts(table, NEVER)[0].tolist()


def test_people_who_all_jump_at_once_are_others():
    table, notes = judge_ids(concatenate([walkers(), walkers(first=100)]))
    assert np.unique(table.track_id).tolist() == [1, 2, 3, 5, 6, 7]
    assert "frame 100" in notes[0]


def test_people_who_walk_on_are_the_same():
    table = walkers(frames=200)
    assert judge_ids(table) == (table, ())


def test_tracks_that_exchange_their_people_are_no_other_recording():
    first = walkers((1, 2), frames=50)
    later = walkers((1, 2), first=50, frames=50)
    exchanged = replace(later, y_m=later.y_m + 5.0, track_id=3 - later.track_id)
    assert starts(concatenate([first, exchanged])) == []


def test_people_who_come_back_within_a_minute_are_asked_about():
    assert recording_starts(concatenate([walkers(), walkers(first=400)]), NEVER)[1].tolist() == [400]


def test_after_a_longer_time_with_nobody_ids_are_other_people():
    assert starts(concatenate([walkers((1,)), walkers((1,), first=800)])) == [800]


def test_frames_that_last_longer_than_people_are_remembered_begin_nothing():
    table = walkers((1,), frames=20, speed_mps=0.1)
    assert starts(replace(table, timestamp_s=70.0 * table.frame)) == []


def test_times_that_begin_again_begin_another_recording():
    later = walkers((1,), first=100)
    table, notes = judge_ids(concatenate([walkers((1,)), replace(later, timestamp_s=later.timestamp_s - 10.0)]))
    assert len(people_of(table)) == 2
    assert len(notes) == 2


def test_a_clock_that_was_set_back_while_people_walked_begins_none():
    table = walkers()
    table = replace(table, timestamp_s=np.where(table.frame < 50, table.timestamp_s, table.timestamp_s - 5.0))
    assert np.unique(judge_ids(table)[0].track_id).tolist() == [1, 2, 3]


def test_steps_of_another_unit_say_nothing_about_ids():
    table = walkers(speed_mps=100.0)
    assert judge_ids(table) == (table, ())


def test_one_id_that_jumps_is_named():
    table = walkers((1, 2))
    jumped = replace(table, x_m=table.x_m + 30.0 * ((table.track_id == 1) & (table.frame >= 50)))
    (note,) = judge_ids(jumped)[1]
    assert "id 1 by 30.0 m at frame 50" in note


def columns(frames: Sequence[int], ids: Sequence[int]) -> dict[str, Sequence[float]]:
    return {"frame": frames, "id": ids, "x_m": [0.0] * len(ids), "y_m": [0.0] * len(ids)}


@pytest.mark.parametrize(
    ("frames", "ids"),
    [([0, 0, 1, 1], [1, 2, 1, 2]), ([0, 1, 0, 1], [1, 1, 2, 2])],
    ids=["by frame", "by id"],
)
def test_frames_that_begin_again_are_another_recording(frames, ids):
    with pytest.warns(UserWarning, match="another recording"):
        table = table_of(columns(frames * 2, ids * 2), "t.csv")
    assert np.unique(table.frame).tolist() == [0, 1, 2, 3]
    assert np.unique(table.track_id).tolist() == [1, 2, 4, 5]


def test_every_track_of_an_id_has_its_own_where_an_id_is_one_walk():
    table, note = split_paths(concatenate([walkers((1, 4)), walkers((1,), first=150)]))
    assert np.unique(table.track_id).tolist() == [1, 4, 5]
    assert note


def test_people_are_tracks_confirmed_for_half_a_second():
    assert people_of(concatenate([walkers((1,), frames=5), walkers((2,), frames=4)])).tolist() == [1]


def test_a_row_of_every_nth_frame_stands_for_n():
    table = walkers((1,), frames=9)
    assert people_of(table.where(table.frame % 4 == 0)).tolist() == [1]


def test_a_table_tells_how_many_people_it_has():
    assert "5 rows of 1 people" in repr(walkers((1,), frames=5))
    assert "of 0 people" in repr(walkers((1,), frames=4))


def test_a_single_row_that_is_there_twice_is_refused():
    with pytest.raises(InputError, match="two for frame 5, id 2"):
        table_of(columns([*range(9), *range(9), 5], [1] * 9 + [2] * 10), "t.csv")
