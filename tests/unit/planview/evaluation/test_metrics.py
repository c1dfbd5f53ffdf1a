"""Metrics on sequences that can be counted by hand."""

import math

import numpy as np
import pytest
from toy_tracks import positions_table

from planview.evaluation.metrics import (
    Sequence,
    box_similarity,
    build_sequence,
    clear_scores,
    floor_similarity,
    hota_scores,
    idf1,
)
from planview.evaluation.significant import (
    PREDICTED,
    UNMATCHED,
    PersonHistory,
    PredictionHistory,
    SignificantError,
    TrackHistory,
    grouped_events,
    poisson_upper,
    significant_errors,
    strict_identity_changes,
)
from planview.trajectories.table import Trajectories


def table(rows: list[tuple[float, ...]]) -> Trajectories:
    """Rows of frame, id, x, y."""
    data = np.array(sorted(rows), np.float64).reshape(-1, 4)
    return positions_table(data[:, 0].astype(np.int64), data[:, 1].astype(np.int64), data[:, 2:])


def sequence(truth: list[tuple[float, ...]], tracks: list[tuple[float, ...]], gate_m: float = 0.5) -> Sequence:
    return build_sequence(table(truth), table(tracks), floor_similarity(gate_m))


def test_similarity_is_half_at_the_gate_on_the_floor():
    truth, tracks = table([(0, 1, 0, 0)]), table([(0, 1, 0, 0), (0, 2, 0.5, 0), (0, 3, 0, 1.0), (0, 4, 9, 9)])
    similarity = floor_similarity(0.5)(truth, np.zeros(4, np.int64), tracks, np.arange(4))
    np.testing.assert_allclose(similarity, [1.0, 0.5, 0.0, 0.0])


def test_similarity_of_boxes_is_their_overlap():
    truth, tracks = table([(0, 1, 0, 0), (1, 1, 0, 0)]), table([(0, 1, 0, 0), (0, 2, 0, 0)])
    truth.box_px[:], tracks.box_px[:] = (0, 0, 10, 20), [(5, 0, 10, 20), (20, 0, 10, 20)]
    np.testing.assert_allclose(box_similarity(truth, np.arange(2), tracks, np.arange(2)), [1 / 3, 0.0])


def test_a_perfect_sequence_counts_as_one():
    rows = [(t, i, 2.0 * i, 0.1 * t) for t in range(5) for i in (1, 2)]
    scores = clear_scores(sequence(rows, rows))
    assert (scores.mota, scores.misses, scores.false_positives, scores.switches) == (1.0, 0, 0, 0)
    assert len(scores.matches) == 10
    assert hota_scores(sequence(rows, rows)).hota == pytest.approx(1.0)


def test_scores_without_truth_are_unknown():
    scores = clear_scores(sequence([], [(0, 1, 0, 0)]))
    assert (scores.mota, scores.false_positives) == (None, 1)
    assert idf1(sequence([], [])) is None


def test_clear_counts_every_kind_of_error():
    # Person 1 stands at x = 0: frames 0-1 track 7, frame 2 none, frames 3-4 track 8. Track 9 is far away once.
    truth = [(t, 1, 0, 0) for t in range(5)]
    tracks = [(0, 7, 0, 0), (1, 7, 0, 0), (2, 9, 5, 5), (3, 8, 0.2, 0), (4, 8, 0.2, 0)]
    scores = clear_scores(sequence(truth, tracks))
    assert (scores.misses, scores.false_positives, scores.switches) == (1, 1, 1)
    assert scores.mota == pytest.approx(1 - 3 / 5)


@pytest.mark.parametrize(("x_m", "matches"), [(0.5, 1), (0.501, 0)])
def test_clear_matches_up_to_the_gate(x_m, matches):
    assert len(clear_scores(sequence([(0, 1, 0, 0)], [(0, 1, x_m, 0)])).matches) == matches


def test_clear_keeps_a_match_although_another_track_is_nearer():
    truth = [(0, 1, 0, 0), (1, 1, 0, 0)]
    tracks = [(0, 1, 0.0, 0), (1, 1, 0.4, 0), (1, 2, 0.0, 0)]
    scores = clear_scores(sequence(truth, tracks))
    assert (scores.switches, scores.false_positives) == (0, 1)


def test_clear_counts_how_much_of_each_person_is_tracked():
    # Person 1 is matched in 9 of 10 frames (one gap), person 2 in 5 of 10 (every other frame), person 3 in 1 of 10.
    truth = [(t, i, 5.0 * i, 0) for t in range(10) for i in (1, 2, 3)]
    found = {1: {0, 1, 2, 3, 5, 6, 7, 8, 9}, 2: {0, 2, 4, 6, 8}, 3: {0}}
    scores = clear_scores(sequence(truth, [row for row in truth if row[0] in found[int(row[1])]]))
    assert (scores.fragmentations, scores.mostly_tracked, scores.mostly_lost) == (1 + 4, 1, 1)


def test_joined_sequences_share_no_identity():
    truth = [(t, 1, 0, 0) for t in range(4)]
    one = sequence(truth, [(t, 1, 0, 0) for t in range(3)])
    two = sequence(truth, [(t, 1 if t < 2 else 2, 0, 0) for t in range(4)])
    joined = Sequence.joined([one, two])
    scores = clear_scores(joined)
    assert (joined.truth_rows, joined.track_rows, scores.misses, scores.switches) == (8, 7, 1, 1)
    assert idf1(joined) == pytest.approx(2 * (3 + 2) / (8 + 7))


def test_hota_of_a_split_track_is_the_root_of_its_association():
    # All detections perfect; each half holds 2 of 4 frames: A = 2 / (4 + 2 - 2) for every match.
    truth = [(t, 1, 0, 0) for t in range(4)]
    tracks = [(t, 1 if t < 2 else 2, 0, 0) for t in range(4)]
    scores = hota_scores(sequence(truth, tracks))
    assert scores.deta == pytest.approx(1.0)
    assert scores.assa == pytest.approx(0.5)
    assert scores.hota == pytest.approx(math.sqrt(0.5))


def test_hota_counts_a_match_up_to_its_localisation():
    # Distance 0.2 with gate 0.5 is a similarity of 0.8: 16 of 19 thresholds accept it.
    scores = hota_scores(sequence([(0, 1, 0, 0)], [(0, 1, 0.2, 0)]))
    assert scores.hota == pytest.approx(16 / 19)


def _wild_sequence(seed: int) -> Sequence:
    """Six wanderers with noise, misses, clutter, exchanged and renewed ids, and empty frames."""
    rng = np.random.default_rng(seed)
    place, step = rng.uniform(-2, 2, (6, 2)), rng.normal(0, 0.05, (6, 2))
    names, fresh = list(range(1, 7)), 7
    truth = []
    tracks = []
    for t in range(60):
        place += step
        for i in range(6):
            if 30 <= t < 33 or not 4 * i <= t < 60 - 2 * i:
                continue
            if not 20 <= t < 22:
                truth.append((t, i + 1, *place[i]))
            if rng.random() < 0.85 and not 40 <= t < 42:
                tracks.append((t, names[i], *(place[i] + rng.normal(0, 0.2, 2))))
        if rng.random() < 0.3:
            tracks.append((t, 1000, *rng.uniform(-2, 2, 2)))
        i, j = rng.integers(6, size=2)
        if rng.random() < 0.15:
            names[i], names[j] = names[j], names[i]
        if rng.random() < 0.1:
            names[i], fresh = fresh, fresh + 1
    return sequence(truth, tracks)


@pytest.mark.parametrize(
    ("seed", "counts", "scores"),
    [
        (0, (59, 36, 9, 1, 0, 40), (0.566667, 0.582057, 0.413471, 0.520028, 0.328871)),
        (3, (53, 33, 17, 2, 0, 35), (0.570833, 0.426087, 0.332976, 0.537853, 0.206589)),
    ],
)
def test_metrics_of_wild_sequences_are_those_of_trackeval(seed, counts, scores):
    """As TrackEval 1.3.0 gives them: misses, false positives, switches, mostly tracked and lost, fragmentations, and
    MOTA, IDF1, HOTA, DetA, AssA."""
    rows = _wild_sequence(seed)
    clear, hota = clear_scores(rows), hota_scores(rows)
    found = clear.misses, clear.false_positives, clear.switches
    assert (*found, clear.mostly_tracked, clear.mostly_lost, clear.fragmentations) == counts
    found = clear.mota, idf1(rows), hota.hota, hota.deta, hota.assa
    assert found == pytest.approx(scores, abs=1e-6)


FRAME_S = 0.1


def person(truth_id: int, *parts: tuple[int, int], start: int = 0) -> PersonHistory:
    """A history of (track id, number of frames) parts."""
    ids = np.concatenate([np.full(n, track) for track, n in parts])
    return PersonHistory(truth_id, start + np.arange(len(ids)), ids)


def found(people: list[PersonHistory], tracks: list[TrackHistory] | None = None) -> list[SignificantError]:
    return significant_errors(people, tracks or [], FRAME_S)


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
def test_errors_of_people(name):
    people, expected = CASES[name]
    assert kinds(people) == expected


AWAY = np.concatenate([np.arange(30), 60 + np.arange(30)])


@pytest.mark.parametrize(
    ("people", "expected"),
    [
        ([PersonHistory(1, AWAY, np.repeat([5, 6], 30))], ("lost", 60, 1, 5)),
        ([person(1, (5, 30), (6, 30)), person(2, (6, 31), (5, 29))], ("swapped", 30, 1, 6)),
        ([person(1, (5, 30)), person(2, (6, 30), (5, 30))], ("swapped", 30, 2, 5)),
        ([person(1, (5, 30)), person(2, (5, 30), start=35)], ("transferred", 35, 2, 5)),
    ],
    ids=[
        "back with a new id",
        "exchanged",
        "took over another's track",
        "an id passes on",
    ],
)
def test_error_says_where_it_happened(people, expected):
    (error,) = found(people)
    assert (error.kind, error.frame, error.truth_id, error.track_id) == expected


STRETCH = "visible but without a track for 1.2 s at a stretch"
MOMENT = "visible for 4.4 s and tracked for only 0.4 s of it"


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([(5, 30), (UNMATCHED, 4), (5, 3), (UNMATCHED, 12), (5, 30)], ("lost", 37, 5, STRETCH)),
        ([(5, 30), *[(UNMATCHED, 6), (9, 1)] * 3, (6, 30)], ("lost", 51, 5, "went on as a new track 6")),
        ([(UNMATCHED, 20), (9, 4), (UNMATCHED, 20)], ("missed", 0, None, MOMENT)),
    ],
    ids=["the time at a stretch", "scattered misses before a new id", "tracked for a moment"],
)
def test_note_of_an_error_says_what_happened(parts, expected):
    (error,) = found([person(1, *parts)])
    assert (error.kind, error.frame, error.track_id, error.note) == expected
    assert error.note != STRETCH or error.duration_s == pytest.approx(1.2)


def test_strict_count_leaves_out_flickers_only():
    back = PersonHistory(1, np.concatenate([np.arange(30), 200 + np.arange(30)]), np.repeat([5, 6], 30))
    swap = [person(1, (5, 30), (6, 30)), person(2, (6, 31), (5, 29))]
    flicker = person(1, (5, 30), (6, 4), (5, 30))
    assert [strict_identity_changes(p, FRAME_S) for p in ([back], swap, [flicker])] == [1, 2, 0]


def test_id_that_passes_on_counts_once():
    assert strict_identity_changes([person(1, (5, 30)), person(2, (5, 30), start=35)], FRAME_S) == 1


def test_id_that_comes_back_with_its_person_is_no_error():
    person_1 = PersonHistory(1, np.concatenate([np.arange(30), 100 + np.arange(30)]), np.full(60, 5))
    assert kinds([person_1, person(2, (UNMATCHED, 10), start=35)]) == []


def test_track_on_no_person_for_a_second_is_false_once():
    stray = np.array([True] * 10 + [False] * 10 + [True] * 30)
    (error,) = found([], [TrackHistory(9, 100 + np.arange(50), stray)])
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("false_track", 120, None, 9)


def test_track_on_no_person_for_less_than_a_second_is_no_error():
    assert found([], [TrackHistory(9, np.arange(9), np.ones(9, bool))]) == []


def test_moment_near_a_person_does_not_excuse_a_false_track():
    stray = np.array([True] * 8 + [False] * 3 + [True] * 8)
    (error,) = found([], [TrackHistory(9, np.arange(19), stray)])
    assert (error.kind, error.frame, error.note) == ("false_track", 0, "on no person for 1.6 s of 1.9 s")


def test_most_of_the_time_near_a_person_excuses_a_false_track():
    stray = np.array([True, False, False, False] * 9)
    assert kinds([], [TrackHistory(9, np.arange(36), stray)]) == []


def predicted(n: int, off: slice, track_id: int = 5) -> PredictionHistory:
    """Predictions of person 1 in n frames from frame 100 on, some of them off."""
    strays = np.zeros(n, bool)
    strays[off] = True
    return PredictionHistory(track_id, 100 + np.arange(n), np.ones(n, np.int64), strays)


def of_predictions(*predictions: PredictionHistory, tracks: list[TrackHistory] | None = None) -> list[SignificantError]:
    return significant_errors([], tracks or [], FRAME_S, predictions)


def test_prediction_off_its_person_for_over_a_second_is_a_false_track():
    (error,) = of_predictions(predicted(20, slice(5, 16)))
    assert (error.kind, error.frame, error.truth_id, error.track_id) == ("false_track", 105, 1, 5)
    assert error.duration_s == pytest.approx(1.1)


@pytest.mark.parametrize(("frames", "off"), [(20, slice(5, 15)), (40, slice(None, None, 2))], ids=["once", "again"])
def test_prediction_off_its_person_for_a_second_at_a_time_is_no_error(frames, off):
    assert of_predictions(predicted(frames, off)) == []


def test_track_is_false_once_however_its_rows_came_about():
    stray = TrackHistory(5, np.arange(20), np.ones(20, bool))
    assert [error.frame for error in of_predictions(predicted(20, slice(0, 20)), tracks=[stray])] == [0]
    assert len(of_predictions(predicted(20, slice(0, 20), track_id=6), tracks=[stray])) == 2


def error(frame: int, truth_id: int | None, track_id: int | None) -> SignificantError:
    return SignificantError("lost", frame, truth_id, track_id, None, "")


def test_errors_of_one_person_or_track_within_two_seconds_are_one_event():
    # Person 1 and track 5; then track 5 of person 2; then person 2 again, 20 frames after the first.
    one = [error(10, 1, 5), error(20, 2, 5), error(30, 2, 7)]
    assert grouped_events(one, 20) == [one]
    # 21 frames after the first error, and another person and track.
    assert [len(event) for event in grouped_events([*one, error(31, 2, 7), error(31, 3, 8)], 20)] == [3, 1, 1]
    assert len(grouped_events([error(10, 1, None), error(10, None, 1), error(10, None, None)], 20)) == 3


def test_upper_bound_of_a_poisson_count():
    # P(0; m) = exp(-m) = 5 % at m = ln 20; P(0 or 1; m) = (1 + m) exp(-m) = 5 % at 4.744.
    assert poisson_upper(0) == pytest.approx(np.log(20))
    assert poisson_upper(1) == pytest.approx(4.744, abs=1e-3)
