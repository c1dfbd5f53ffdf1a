"""Edits of tracks that can be checked by eye: ten frames per second."""

from collections.abc import Sequence

import numpy as np
import pytest

from calib.errors import InputError
from planview.offline.edit import edited
from planview.trajectories.file import Region
from planview.trajectories.table import Trajectories, positions_table


def tracks(*parts: tuple[int, Sequence[int], float]) -> Trajectories:
    """Parts of (id, frames, x), who walk 0.1 m a frame along y."""
    rows = sorted((frame, i, x, 0.1 * frame) for i, frames, x in parts for frame in frames)
    frame, ids = np.array([row[:2] for row in rows], dtype=np.int64).T
    return positions_table(frame, ids, np.array([row[2:] for row in rows]), timestamp_s=frame / 10)


def frames_of(table: Trajectories) -> dict[int, tuple[int, int]]:
    """First and last frame of every id."""
    ids = np.unique(table.track_id).tolist()
    return {i: (int(table.frame[table.track_id == i][0]), int(table.frame[table.track_id == i][-1])) for i in ids}


TWO = tracks((1, range(10), 0.0), (2, range(12, 20), 0.0), (3, range(20), 5.0))


def test_join_makes_one_track_of_two() -> None:
    assert frames_of(edited(TWO, ["join 1 2"])) == {1: (0, 19), 3: (0, 19)}


def test_join_of_tracks_in_one_frame_is_refused() -> None:
    with pytest.raises(InputError, match=r"'join 1 3': expected tracks that are never in one frame, found both in 10"):
        edited(TWO, ["join 1 3"])


def test_split_gives_the_rest_an_id_that_no_track_ever_had() -> None:
    assert frames_of(edited(TWO, ["delete 3", "split 1 4"])) == {1: (0, 3), 2: (12, 19), 4: (4, 9)}


def test_split_before_the_track_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected a frame within the track \(13 to 19\), found 12"):
        edited(TWO, ["split 2 12"])


def test_delete_takes_a_track_or_some_of_its_frames() -> None:
    assert frames_of(edited(TWO, ["delete 1", "delete 3 0 9"])) == {2: (12, 19), 3: (10, 19)}


def test_rename_keeps_rows_sorted_and_refuses_an_id_in_use() -> None:
    renamed = edited(TWO, ["rename 1 9"])
    assert renamed.track_id[:2].tolist() == [3, 9]
    with pytest.raises(InputError, match="expected an id from 1 that no track has, found 2"):
        edited(TWO, ["rename 1 2"])


def test_gaps_are_joined_within_time_and_distance_in_chains() -> None:
    parts = tracks((1, range(10), 0.0), (2, range(12, 20), 0.1), (3, range(22, 30), 0.2), (4, range(12, 30), 3.0))
    assert frames_of(edited(parts, ["join-gaps 0.5 0.5"])) == {1: (0, 29), 4: (12, 29)}
    assert len(frames_of(edited(parts, ["join-gaps 0.2 0.5"]))) == 4
    assert len(frames_of(edited(parts, ["join-gaps 0.5 0.1"]))) == 4


def test_the_nearest_of_two_tracks_goes_on() -> None:
    parts = tracks((1, range(10), 0.0), (2, range(12, 20), 0.3), (3, range(12, 20), 0.1))
    assert frames_of(edited(parts, ["join-gaps 1 1"])) == {1: (0, 19), 2: (12, 19)}


def test_short_tracks_are_deleted() -> None:
    assert frames_of(edited(TWO, ["shorter 0.95"])) == {1: (0, 9), 3: (0, 19)}


def test_regions_keep_and_ignore_rows() -> None:
    around_one = "POLYGON ((-1 -1, 1 -1, 1 0.45, -1 0.45, -1 -1))"
    assert frames_of(edited(TWO, [f"region {around_one}"])) == {1: (0, 4)}
    assert frames_of(edited(TWO, [f"ignore {around_one}"])) == {1: (5, 9), 2: (12, 19), 3: (0, 19)}


def test_hole_of_a_polygon_is_outside() -> None:
    region = Region("POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 3 1, 3 3, 1 3, 1 1))", "test")
    assert region.contains(np.array([0.5, 2.0, 5.0]), np.array([0.5, 2.0, 2.0])).tolist() == [True, False, False]


@pytest.mark.parametrize(
    "line", ["", "fly 1", "join 1", "join 1 two", "split 1", "shorter", "shorter -1", "delete 1 2", "region x"]
)
def test_what_is_no_edit_is_refused_with_how_it_is_written(line: str) -> None:
    with pytest.raises(InputError, match="expected"):
        edited(TWO, [line])
