"""Refinement of whole recordings, on tracks at 10 frames per second that can be checked by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import InputError
from planview.offline.refine import Refined, RefineParams, refine
from planview.trajectories.table import Trajectories, concatenated, positions_table


def walk(
    frames: range, track_id: int = 1, y_m: float = 0.0, speed_mps: float = 1.0, height_m: float = 1.7
) -> Trajectories:
    """A person walking along x, at x = 0 in frame 0."""
    frame = np.arange(frames.start, frames.stop)
    xy = np.column_stack([0.1 * speed_mps * frame, np.full(len(frame), y_m)])
    return positions_table(frame, np.full(len(frame), track_id), xy, np.full(len(frame), height_m), 0.1 * frame)


def with_state(table: Trajectories, state: str, first: int, last: int) -> Trajectories:
    """The rows of frames first to last in another state."""
    inside = (table.frame >= first) & (table.frame <= last)
    return replace(table, state=np.where(inside, state, table.state))


def kinds(result: Refined) -> list[tuple[str, int, int, int]]:
    return [(c.kind, c.track_id, c.first_frame, c.last_frame) for c in result.changes if c.kind != "smooth"]


def test_tentative_rows_of_a_later_confirmed_track_become_confirmed() -> None:
    result = refine(with_state(walk(range(5, 30)), "tentative", 5, 8))
    assert (result.tracks.state == "confirmed").all()
    assert kinds(result) == [("begin", 1, 5, 8)]


def test_track_that_was_never_confirmed_stays_as_it_is() -> None:
    ghost = with_state(walk(range(5, 9), track_id=2, y_m=3.0), "tentative", 5, 8)
    result = refine(concatenated([walk(range(30)), ghost]))
    kept = result.tracks.where(result.tracks.track_id == 2)
    assert kept.state.tolist() == ["tentative"] * 4
    np.testing.assert_array_equal(kept.x_m, ghost.x_m)


def test_lost_rows_between_confirmed_ones_are_interpolated() -> None:
    tracks = with_state(walk(range(30)), "lost", 10, 14)
    wrong = replace(tracks, y_m=np.where(tracks.state == "lost", 0.8, 0.0))
    result = refine(wrong)
    assert kinds(result) == [("fill", 1, 10, 14)]
    assert (result.tracks.state == "confirmed").all()
    np.testing.assert_allclose(result.tracks.y_m, 0.0, atol=1e-9)
    np.testing.assert_allclose(result.tracks.x_m, 0.1 * np.arange(30), atol=0.02)


def test_missing_rows_in_a_gap_are_added_with_time_and_height() -> None:
    tracks = walk(range(30))
    result = refine(tracks.where((tracks.frame < 10) | (tracks.frame > 14)))
    assert result.tracks.frame.tolist() == list(range(30))
    np.testing.assert_allclose(result.tracks.timestamp_s, 0.1 * np.arange(30))
    np.testing.assert_allclose(result.tracks.height_m, 1.7)


def test_gap_longer_than_the_limit_keeps_its_lost_rows() -> None:
    result = refine(with_state(walk(range(60)), "lost", 20, 42), RefineParams(fill_s=2.0))
    assert (result.tracks.state == "lost").sum() == 23
    assert kinds(result) == []


def test_gap_passed_faster_than_a_person_is_not_filled() -> None:
    tracks = walk(range(30))
    jump = replace(tracks, x_m=tracks.x_m + np.where(tracks.frame > 14, 5.0, 0.0))
    assert kinds(refine(jump.where((tracks.frame < 10) | (tracks.frame > 14)))) == []


def test_predictions_after_the_last_confirmed_row_are_kept() -> None:
    tracks = with_state(walk(range(30)), "lost", 25, 29)
    result = refine(tracks)
    np.testing.assert_array_equal(result.tracks.x_m[25:], tracks.x_m[25:])
    assert result.tracks.state[25:].tolist() == ["lost"] * 5


def test_smoothing_reduces_noise_and_keeps_a_straight_walk() -> None:
    straight = walk(range(100))
    noisy = replace(straight, y_m=np.random.default_rng(0).normal(0, 0.05, 100))
    np.testing.assert_allclose(refine(straight).tracks.x_m, straight.x_m, atol=0.02)
    assert np.std(refine(noisy).tracks.y_m) < 0.6 * np.std(noisy.y_m)


def test_fragments_of_one_walk_are_joined_under_the_first_id() -> None:
    result = refine(concatenated([walk(range(30), 4), walk(range(40, 70), 9)]))
    assert np.unique(result.tracks.track_id).tolist() == [4]
    assert kinds(result) == [("join", 4, 29, 40), ("fill", 4, 30, 39)]
    assert result.changes[0].kind == "smooth"


def test_predictions_of_a_joined_fragment_end_where_the_next_begins() -> None:
    first = with_state(walk(range(45), 4), "lost", 30, 44)
    result = refine(concatenated([first, walk(range(40, 70), 9)]))
    assert result.tracks.frame.tolist() == list(range(70))
    assert (result.tracks.state == "confirmed").all()


def test_fragment_of_another_height_is_another_person() -> None:
    result = refine(concatenated([walk(range(30), 4), walk(range(40, 70), 9, height_m=1.2)]))
    assert np.unique(result.tracks.track_id).tolist() == [4, 9]


def test_fragment_too_far_or_too_late_is_another_person() -> None:
    for later in (walk(range(40, 70), 9, y_m=3.0), walk(range(61, 90), 9)):
        assert np.unique(refine(concatenated([walk(range(30), 4), later])).tracks.track_id).tolist() == [4, 9]


def test_each_fragment_is_continued_by_the_one_that_fits_over_the_whole_recording() -> None:
    # Both starts lie within reach of both ends; each alone would fit person 1 (y = 0), which only one can continue.
    ends = [walk(range(30), 1, y_m=0.0), walk(range(30), 2, y_m=0.5)]
    starts = [walk(range(40, 70), 3, y_m=0.1), walk(range(40, 70), 4, y_m=0.3)]
    tracks = refine(concatenated([*ends, *starts])).tracks
    last = tracks.where(tracks.frame == 69)
    np.testing.assert_allclose(last.y_m[np.argsort(last.track_id)], [0.1, 0.3], atol=0.02)


def test_appearance_decides_against_a_join() -> None:
    pieces = concatenated([walk(range(30), 4), walk(range(40, 70), 9)])
    assert len(np.unique(refine(pieces, similarity=lambda a, b: 1.0).tracks.track_id)) == 1
    assert len(np.unique(refine(pieces, similarity=lambda a, b: 0.0).tracks.track_id)) == 2


def test_tracks_without_floor_positions_are_refused() -> None:
    with pytest.raises(InputError, match="floor positions"):
        refine(replace(walk(range(5)), x_m=np.full(5, math.nan)))


_pieces = st.lists(
    st.tuples(st.integers(0, 40), st.integers(1, 25), st.floats(-2, 2), st.floats(-1.5, 1.5), st.integers(0, 4)),
    max_size=5,
)


@settings(max_examples=40, deadline=None)
@given(_pieces)
def test_refinement_adds_no_row_before_a_track_and_keeps_ids_unique(
    pieces: list[tuple[int, int, float, float, int]],
) -> None:
    tables = [
        with_state(walk(range(a, a + n), i, y, v), "tentative", a, a + tentative - 1)
        for i, (a, n, y, v, tentative) in enumerate(pieces, start=1)
    ]
    tracks = concatenated([walk(range(0), 99), *tables])
    result = refine(tracks).tracks
    for track_id in np.unique(result.track_id):
        before = tracks.frame[tracks.track_id == track_id]
        assert track_id > 0
        assert result.frame[result.track_id == track_id].min() >= before.min()
    assert len({*zip(result.frame.tolist(), result.track_id.tolist(), strict=True)}) == len(result)
    assert set(result.track_id) <= set(tracks.track_id)
    assert np.isfinite(result.x_m).all()


def test_mended_exchange_is_undone_from_the_contact_on() -> None:
    """Two people meet in frame 20 and part; their ids are exchanged there and mended in frame 30."""
    frame = np.arange(41)
    xy = [np.column_stack([0.1 * (frame - 20.0), np.full(41, y)]) * [sign, 1] for y, sign in ((0.0, 1), (0.3, -1))]
    between = (frame > 20) & (frame < 30)
    online = [
        positions_table(frame, np.where(between, 3 - track, track), at, np.full(41, 1.7), 0.1 * frame)
        for track, at in zip((1, 2), xy, strict=True)
    ]
    table = concatenated(online)
    result = refine(table.where(np.lexsort((table.track_id, table.frame))))
    assert [c[:4] for c in result.changes if c.kind == "exchange"] == [(1, 21, 29, "exchange")]
    first = result.tracks.where(result.tracks.track_id == 1)
    assert np.allclose(first.x_m, xy[0][:, 0], atol=0.05) and np.allclose(first.y_m, 0.0, atol=0.05)
