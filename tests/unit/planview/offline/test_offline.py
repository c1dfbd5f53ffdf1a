"""Tracks refined and edited afterwards."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_tracks import positions_table

from calib.errors import InputError
from planview.offline.edit import edited
from planview.offline.refine import Refined, refine
from planview.trajectories.file import Region
from planview.trajectories.table import Trajectories, concatenate


def walk(
    frames: range, track_id: int = 1, y_m: float = 0.0, speed_mps: float = 1.0, height_m: float = 1.7
) -> Trajectories:
    """A person walking along x, at x = 0 in frame 0."""
    frame = np.array(frames, np.int64)
    xy = np.column_stack([0.1 * speed_mps * frame, np.full(len(frame), y_m)])
    table = positions_table(frame, np.full_like(frame, track_id), xy, np.full(len(frame), height_m), 0.1 * frame)
    return replace(table, velocity_mps=np.tile((speed_mps, 0.0), (len(frame), 1)))


def with_state(table: Trajectories, state: str, first: int, last: int) -> Trajectories:
    """The rows of frames first to last in another state."""
    inside = (table.frame >= first) & (table.frame <= last)
    return replace(table, state=np.where(inside, state, table.state))


def kinds(result: Refined) -> list[tuple[str, int, int, int]]:
    return [(c.kind, c.track_id, c.first_frame, c.last_frame) for c in result.changes if c.kind != "smooth"]


def test_rows_that_need_no_refinement_stay_as_they_are():
    walked = with_state(with_state(walk(range(5, 30)), "tentative", 5, 8), "lost", 15, 19)
    ghost = with_state(walk(range(5, 9), track_id=2, y_m=3.0), "tentative", 5, 8)
    tracks = concatenate([walked.where((walked.frame < 22) | (walked.frame > 24)), ghost])
    result = refine(tracks)
    assert result.tracks.state.tolist() == tracks.state.tolist()
    assert kinds(result) == []
    np.testing.assert_array_equal(result.tracks.frame, tracks.frame)
    np.testing.assert_array_equal(result.tracks.x_m[result.tracks.track_id == 2], ghost.x_m)


def test_predictions_within_a_track_lie_on_its_path():
    tracks = with_state(walk(range(30)), "lost", 10, 14)
    result = refine(replace(tracks, y_m=np.where(tracks.state == "lost", 0.8, 0.0))).tracks
    np.testing.assert_allclose(result.y_m, 0.0, atol=1e-9)
    np.testing.assert_allclose(result.x_m, 0.1 * np.arange(30), atol=0.02)


def test_predictions_after_the_last_confirmed_row_are_kept():
    tracks = with_state(walk(range(30)), "lost", 25, 29)
    result = refine(tracks)
    np.testing.assert_array_equal(result.tracks.x_m[25:], tracks.x_m[25:])
    assert result.tracks.state[25:].tolist() == ["lost"] * 5


def test_smoothing_keeps_a_straight_walk():
    np.testing.assert_allclose(refine(walk(range(100))).tracks.x_m, walk(range(100)).x_m, atol=0.02)


def test_smoothing_reduces_noise():
    noisy = replace(walk(range(100)), y_m=np.random.default_rng(0).normal(0, 0.05, 100))
    assert np.std(refine(noisy).tracks.y_m) < 0.6 * np.std(noisy.y_m)


def test_nobody_is_smoothed_across_the_end_of_a_track():
    elsewhere = replace(walk(range(30, 60)), y_m=np.full(30, 9.0))
    result = refine(concatenate([walk(range(30)), elsewhere])).tracks
    np.testing.assert_allclose(result.y_m, np.repeat([0.0, 9.0], 30), atol=1e-6)


def test_fragments_of_one_walk_are_joined_under_the_first_id():
    result = refine(concatenate([walk(range(30), 4), walk(range(33, 63), 9, y_m=0.2)]))
    assert np.unique(result.tracks.track_id).tolist() == [4]
    assert len(result.tracks) == 60
    assert kinds(result) == [("join", 4, 29, 33)]


def test_predictions_of_a_fragment_end_where_the_next_begins():
    first = with_state(walk(range(45), 4), "lost", 30, 44)
    result = refine(concatenate([first, walk(range(33, 63), 9)]))
    assert result.tracks.frame.tolist() == list(range(63))
    assert result.tracks.state.tolist() == ["confirmed"] * 30 + ["lost"] * 3 + ["confirmed"] * 30


@pytest.mark.parametrize(
    "later",
    [
        walk(range(33, 63), 9, y_m=0.2, height_m=1.2),
        walk(range(33, 63), 9, y_m=4.0),
        walk(range(49, 79), 9),
        walk(range(29, 60), 9),
    ],
    ids=["another height", "out of reach", "long after", "overlapping"],
)
def test_fragment_that_does_not_fit_is_another_person(later):
    assert np.unique(refine(concatenate([walk(range(30), 4), later])).tracks.track_id).tolist() == [4, 9]


def test_each_fragment_is_continued_by_the_one_that_fits_over_the_whole_recording():
    # Both starts are as near to the end of 2; that of 1 is nearer to 4, which therefore 2 must leave alone.
    ends = [walk(range(30), i, y_m, speed_mps=0.0) for i, y_m in ((1, 0.0), (2, 0.3))]
    starts = [walk(range(32, 62), i, y_m, speed_mps=0.0) for i, y_m in ((3, 0.4), (4, 0.2))]
    last = refine(concatenate([*ends, *starts])).tracks.where(np.array([-2, -1]))
    np.testing.assert_allclose(last.y_m[np.argsort(last.track_id)], [0.2, 0.4], atol=0.02)


def test_tracks_without_times_stay_without():
    tracks = replace(walk(range(20)), timestamp_s=np.full(20, math.nan))
    assert np.isnan(refine(tracks).tracks.timestamp_s).all()


def test_no_tracks_stay_none():
    assert len(refine(walk(range(0))).tracks) == 0


def test_tracks_without_places_are_refused():
    with pytest.raises(InputError, match="floor positions"):
        refine(replace(walk(range(5)), x_m=np.full(5, math.nan)))


_pieces = st.lists(
    st.tuples(st.integers(0, 40), st.integers(1, 25), st.floats(-2, 2), st.floats(-1.5, 1.5), st.integers(0, 4)),
    max_size=5,
)


@settings(max_examples=40)
@given(_pieces)
def test_refinement_keeps_the_table_whole(pieces):
    tables = [
        with_state(walk(range(a, a + n), i, y, v), "tentative", a, a + tentative - 1)
        for i, (a, n, y, v, tentative) in enumerate(pieces, start=1)
    ]
    tracks = concatenate([walk(range(0), 99), *tables])
    result = refine(tracks).tracks
    for track_id in np.unique(result.track_id):
        before = tracks.frame[tracks.track_id == track_id]
        assert track_id > 0
        assert result.frame[result.track_id == track_id].min() >= before.min()
    assert len({*zip(result.frame.tolist(), result.track_id.tolist(), strict=True)}) == len(result)
    assert len(result) <= len(tracks)
    assert set(result.track_id) <= set(tracks.track_id)
    assert np.isfinite(result.x_m).all()


def tracks(*parts: tuple[int, Sequence[int], float]) -> Trajectories:
    """Parts of (id, frames, x), who walk 0.1 m a frame along y."""
    rows = sorted((frame, i, x, 0.1 * frame) for i, frames, x in parts for frame in frames)
    frame, ids = np.array([row[:2] for row in rows], np.int64).T
    return positions_table(frame, ids, np.array([row[2:] for row in rows]), timestamp_s=frame / 10)


def frames_of(table: Trajectories) -> dict[int, tuple[int, int]]:
    """First and last frame of every id."""
    ids = np.unique(table.track_id).tolist()
    return {i: (int(table.frame[table.track_id == i][0]), int(table.frame[table.track_id == i][-1])) for i in ids}


TWO = tracks((1, range(10), 0.0), (2, range(12, 20), 0.0), (3, range(20), 5.0))


AROUND_ONE = "POLYGON ((-1 -1, 1 -1, 1 0.45, -1 0.45, -1 -1))"


@pytest.mark.parametrize(
    ("edits", "frames"),
    [
        (["join 1 2"], {1: (0, 19), 3: (0, 19)}),
        (["delete 3", "split 1 4"], {1: (0, 3), 2: (12, 19), 4: (4, 9)}),  # an id that no track ever had
        (["delete 1", "delete 3 0 9"], {2: (12, 19), 3: (10, 19)}),
        (["shorter 0.95"], {1: (0, 9), 3: (0, 19)}),
        ([f"region {AROUND_ONE}"], {1: (0, 4)}),
        ([f"ignore {AROUND_ONE}"], {1: (5, 9), 2: (12, 19), 3: (0, 19)}),
    ],
    ids=lambda value: value[0].split()[0] if isinstance(value, list) else "",
)
def test_edits_change_which_track_has_which_frames(edits, frames):
    assert frames_of(edited(TWO, edits)) == frames


@pytest.mark.parametrize(
    ("edit", "found"),
    [
        ("join 1 3", "'join 1 3': both tracks are in frame \\d+ \\(and 9 others\\)"),
        ("split 2 12", r"can be split from frame 13 to 19, not at 12"),
        ("rename 1 2", "the new id is from 1 and not in use: 2 is not"),
    ],
)
def test_edits_that_do_not_fit_the_tracks_are_refused(edit, found):
    with pytest.raises(InputError, match=found):
        edited(TWO, [edit])


def test_rename_keeps_rows_sorted():
    assert edited(TWO, ["rename 1 9"]).track_id[:2].tolist() == [3, 9]


def test_hole_of_a_polygon_is_outside():
    region = Region("POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (1 1, 3 1, 3 3, 1 3, 1 1))", "test")
    corners = positions_table(np.arange(3), np.ones(3, np.int64), np.array([[0.5, 0.5], [2.0, 2.0], [5.0, 2.0]]))
    assert region.contains(corners).tolist() == [True, False, False]


def test_gaps_are_joined_in_chains_by_the_nearest():
    parts = tracks((1, range(10), 0.0), (2, range(12, 20), 0.1), (3, range(22, 30), 0.2), (4, range(12, 30), 3.0))
    assert frames_of(edited(parts, ["join-gaps 0.5 0.5"])) == {1: (0, 29), 4: (12, 29)}
    assert len(frames_of(edited(parts, ["join-gaps 0.2 0.5"]))) == 4
    assert len(frames_of(edited(parts, ["join-gaps 0.5 0.1"]))) == 4
    parts = tracks((1, range(10), 0.0), (2, range(12, 20), 0.3), (3, range(12, 20), 0.1))
    assert frames_of(edited(parts, ["join-gaps 1 1"])) == {1: (0, 19), 2: (12, 19)}


def test_gaps_are_not_joined_with_a_flicker_that_ended_near_before():
    flicker = with_state(tracks((-7, range(5), 0.0)), "tentative", 0, 4)
    parts = concatenate([flicker, tracks((4, range(7, 20), 0.0), (5, range(22, 30), 0.0))])
    assert frames_of(edited(parts, ["join-gaps 1 1"])) == {-7: (0, 4), 4: (7, 29)}


def test_track_that_was_never_confirmed_is_not_joined():
    parts = tracks((4, range(7, 20), 0.0), (-7, range(22, 30), 0.0))
    with pytest.raises(InputError, match="never confirmed"):
        edited(parts, ["join -7 4"])


@pytest.mark.parametrize(
    "line", ["", "fly 1", "join 1", "join 1 two", "split 1", "shorter", "shorter -1", "delete 1 2", "region x"]
)
def test_what_is_no_edit_is_refused_with_how_it_is_written(line):
    with pytest.raises(InputError, match="expected"):
        edited(TWO, [line])
