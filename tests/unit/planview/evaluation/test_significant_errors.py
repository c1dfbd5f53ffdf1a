"""The four kinds of significant error, at 10 frames per second."""

import numpy as np
import pytest

from planview.evaluation.significant import (
    PREDICTED,
    UNMATCHED,
    PersonHistory,
    PredictionHistory,
    SignificantError,
    SignificantParams,
    TrackHistory,
    grouped_events,
    poisson_upper,
    runs,
    significant_errors,
    split_visits,
    strict_identity_changes,
)

FRAME_S = 0.1


def person(truth_id: int, *parts: tuple[int, int], start: int = 0) -> PersonHistory:
    """A history of (track id, number of frames) parts."""
    ids = np.concatenate([np.full(n, track) for track, n in parts])
    return PersonHistory(truth_id, start + np.arange(len(ids)), ids)


def found(people: list[PersonHistory], tracks: list[TrackHistory] | None = None) -> list[SignificantError]:
    return significant_errors(people, tracks or [], FRAME_S, SignificantParams())


def kinds(people: list[PersonHistory], tracks: list[TrackHistory] | None = None) -> list[tuple[str, int]]:
    return [(error.kind, error.frame) for error in found(people, tracks)]


CASES: dict[str, tuple[list[PersonHistory], list[tuple[str, int]]]] = {
    "held throughout": ([person(1, (5, 100))], []),
    "never tracked": ([person(1, (UNMATCHED, 20))], [("missed", 0)]),
    "never tracked, but too short": ([person(1, (UNMATCHED, 19))], []),
    "tracked late": ([person(1, (UNMATCHED, 30), (5, 50))], []),
    "brush with another's track": ([person(1, (UNMATCHED, 20), (9, 4), (UNMATCHED, 20))], [("missed", 0)]),
    "alone for a second": ([person(1, (5, 30), (UNMATCHED, 10), (5, 30))], []),
    "lost until the end": ([person(1, (5, 30), (UNMATCHED, 15), (8, 2), (UNMATCHED, 15))], [("lost", 30)]),
    # 0.4 s without a track, 0.3 s with it, and so on for 3.5 s: never longer than a second at a stretch.
    "scattered misses": ([person(1, (5, 30), *[(UNMATCHED, 4), (5, 3)] * 5, (5, 30))], []),
    "prediction near": ([person(1, (5, 30), (PREDICTED, 25), (5, 30))], []),
    "new id after a long absence": (
        [PersonHistory(1, np.concatenate([np.arange(30), 80 + np.arange(30)]), np.repeat([5, 6], 30))], [],
    ),
    "long loss that ends in a new id": ([person(1, (5, 30), (UNMATCHED, 20), (6, 30))], [("lost", 30)]),
    "exchange and return": (
        [person(1, (5, 30), (6, 80), (5, 30)), person(2, (6, 30), (5, 80), (6, 30))],
        [("swapped", 30), ("swapped", 110)],
    ),
    "flicker between close people": (
        [person(1, (5, 30), (6, 4), (5, 30)), person(2, (6, 30), (5, 4), (6, 30))], [],
    ),
    "two people, by frame": (
        [person(1, (5, 50), (UNMATCHED, 20)), person(2, (UNMATCHED, 30), start=10)], [("missed", 10), ("lost", 50)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_errors_of_people(name: str) -> None:
    people, expected = CASES[name]
    assert kinds(people) == expected


def test_person_alone_for_more_than_a_second_is_lost_where_it_began() -> None:
    (error,) = found([person(1, (5, 30), (UNMATCHED, 11), (5, 30))])
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("lost", 30, 1, 5)


def test_loss_reports_the_time_at_a_stretch() -> None:
    (error,) = found([person(1, (5, 30), (UNMATCHED, 4), (5, 3), (UNMATCHED, 12), (5, 30))])
    assert (error.frame, error.duration_s) == (37, pytest.approx(1.2))
    assert error.note == "visible but without a track for 1.2 s at a stretch"


def test_scattered_misses_before_a_new_id_are_reported_as_the_change_of_id() -> None:
    (error,) = found([person(1, (5, 30), *[(UNMATCHED, 6), (9, 1)] * 3, (6, 30))])
    assert (error.kind, error.frame, error.track_id, error.note) == ("lost", 51, 5, "went on as a new track 6")


def test_person_tracked_for_a_moment_is_missed_with_the_time_it_was_tracked() -> None:
    (error,) = found([person(1, (UNMATCHED, 20), (9, 4), (UNMATCHED, 20))])
    assert error.note == "visible for 4.4 s and tracked for only 0.4 s of it"


def test_strict_count_takes_a_new_id_after_coming_back_and_both_sides_of_a_swap() -> None:
    params = SignificantParams()
    back = PersonHistory(1, np.concatenate([np.arange(30), 200 + np.arange(30)]), np.repeat([5, 6], 30))
    swap = [person(1, (5, 30), (6, 30)), person(2, (6, 31), (5, 29))]
    flicker = person(1, (5, 30), (6, 4), (5, 30))
    assert [strict_identity_changes(p, FRAME_S, params) for p in ([back], swap, [flicker])] == [1, 2, 0]


def test_person_back_after_a_short_absence_with_a_new_id_was_lost() -> None:
    frames = np.concatenate([np.arange(30), 60 + np.arange(30)])
    (error,) = found([PersonHistory(1, frames, np.repeat([5, 6], 30))])
    assert (error.kind, error.frame, error.track_id) == ("lost", 60, 5)


def test_exchange_of_identities_is_one_swap() -> None:
    people = [person(1, (5, 30), (6, 30)), person(2, (6, 31), (5, 29))]
    (error,) = found(people)
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("swapped", 30, 1, 6)


def test_taking_over_another_persons_track_is_a_swap() -> None:
    people = [person(1, (5, 30)), person(2, (6, 30), (5, 30))]
    (error,) = found(people)
    assert (error.kind, error.truth_id, error.track_id) == ("swapped", 2, 5)


def test_track_on_no_person_for_a_second_is_false_once() -> None:
    stray = np.array([True] * 10 + [False] * 10 + [True] * 30)
    (error,) = found([], [TrackHistory(9, 100 + np.arange(50), stray)])
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("false_track", 120, None, 9)


def test_track_on_no_person_for_less_is_no_error() -> None:
    assert found([], [TrackHistory(9, np.arange(9), np.ones(9, dtype=bool))]) == []


def test_moment_near_a_person_does_not_excuse_a_false_track() -> None:
    stray = np.array([True] * 8 + [False] * 3 + [True] * 8)
    (error,) = found([], [TrackHistory(9, np.arange(19), stray)])
    assert (error.kind, error.frame, error.note) == ("false_track", 0, "on no person for 1.6 s of 1.9 s")


def test_track_beside_a_person_most_of_the_time_is_not_false() -> None:
    stray = np.array([True, False, False, False] * 9)
    assert kinds([], [TrackHistory(9, np.arange(36), stray)]) == []


def predicted(n: int, off: slice, track_id: int = 5) -> PredictionHistory:
    """Predictions of person 1 in n frames from frame 100 on, some of them off."""
    strays = np.zeros(n, dtype=bool)
    strays[off] = True
    return PredictionHistory(track_id, 100 + np.arange(n), np.ones(n, dtype=np.int64), strays)


def of_predictions(*predictions: PredictionHistory, tracks: list[TrackHistory] | None = None) -> list[SignificantError]:
    return significant_errors([], tracks or [], FRAME_S, SignificantParams(), predictions)


def test_prediction_off_its_person_for_over_a_second_is_a_false_track() -> None:
    (error,) = of_predictions(predicted(20, slice(5, 16)))
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("false_track", 105, 1, 5)
    assert (error.duration_s, error.note) == (pytest.approx(1.1), "predicted away from person 1 for 1.1 s")
    assert of_predictions(predicted(20, slice(5, 15))) == []


def test_prediction_off_its_person_now_and_then_is_no_error() -> None:
    assert of_predictions(predicted(40, slice(None, None, 2))) == []


def test_track_is_false_once_for_confirmed_and_predicted_rows() -> None:
    stray = TrackHistory(5, np.arange(20), np.ones(20, dtype=bool))
    assert [error.frame for error in of_predictions(predicted(20, slice(0, 20)), tracks=[stray])] == [0]
    assert len(of_predictions(predicted(20, slice(0, 20), track_id=6), tracks=[stray])) == 2


def error(frame: int, truth_id: int | None, track_id: int | None) -> SignificantError:
    return SignificantError("lost", frame, truth_id, track_id, None, "")


def test_errors_of_one_person_or_track_within_two_seconds_are_one_event() -> None:
    # Person 1 and track 5; then track 5 of person 2; then person 2 again, 20 frames after the first.
    one = [error(10, 1, 5), error(20, 2, 5), error(30, 2, 7)]
    assert grouped_events(one, 20) == [one]
    # 21 frames after the first error, and another person and track.
    assert [len(event) for event in grouped_events([*one, error(31, 2, 7), error(31, 3, 8)], 20)] == [3, 1, 1]


def test_errors_without_a_common_person_or_track_are_events_of_their_own() -> None:
    assert len(grouped_events([error(10, 1, None), error(10, None, 1), error(10, None, None)], 20)) == 3


def test_upper_bound_of_a_poisson_count() -> None:
    # P(0; m) = exp(-m) = 5 % at m = ln 20; P(0 or 1; m) = (1 + m) exp(-m) = 5 % at 4.744.
    assert poisson_upper(0) == pytest.approx(np.log(20))
    assert poisson_upper(1) == pytest.approx(4.744, abs=1e-3)
    assert 10 * poisson_upper(1) / 12.8 == pytest.approx(3.7, abs=0.01)


def test_visits_split_at_long_gaps_only() -> None:
    frames = np.array([0, 1, 41, 42, 83])
    parts = split_visits(PersonHistory(1, frames, np.ones(5, dtype=np.int64)), FRAME_S, 4.0)
    assert [part.frame.tolist() for part in parts] == [[0, 1, 41, 42], [83]]


def test_runs_lists_stretches() -> None:
    assert runs(np.array([True, False, True, True])) == [(0, 1), (2, 4)]
    assert runs(np.zeros(0, dtype=bool)) == []
