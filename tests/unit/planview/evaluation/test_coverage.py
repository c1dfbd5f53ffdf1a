"""What a truth covers: rows of tracks outside of it are not judged."""

from dataclasses import replace

import numpy as np
import pytest
from toy_tracks import positions_table

from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.result import Evaluation
from planview.trajectories.table import Trajectories, concatenate

FRAMES = 300


def walkers() -> Trajectories:
    """Three people who walk to and fro along x, one behind the other, 15 frames per second."""
    frame = np.tile(np.arange(FRAMES), 3)
    who = np.repeat([1, 2, 3], FRAMES)
    x = 3.0 * np.sin(frame / 30.0 + who)
    return positions_table(frame, who, np.column_stack([x, 2.0 * who]), np.full(3 * FRAMES, 1.7), frame / 15.0)


TRACKS = walkers()


@pytest.mark.parametrize(
    ("keep", "said"),
    [
        (lambda t: t.frame < 150, "it ends with frame 149"),
        (lambda t: t.frame >= 200, "it begins with frame 200"),
        (lambda t: t.x_m < 0, "its places are a part of the floor only"),
        (lambda t: np.abs(t.x_m) < 1.5, "its places are a part of the floor only"),
        (lambda t: (t.frame + 3 * t.track_id) % 10 == 0, "each person has rows in about every 10th frame only"),
        (lambda t: t.frame % 5 == 2, "it has rows in about every 5th frame only"),
    ],
    ids=["beginning", "end", "half", "strip", "keyframes of each", "every fifth frame"],
)
def test_what_a_truth_does_not_cover_is_not_judged(keep, said):
    truth = TRACKS.where(keep(TRACKS))
    result = evaluate_tracks(TRACKS, truth)
    assert result.mota == 1.0
    assert result.judged_share == pytest.approx(len(truth) / len(TRACKS), abs=0.03)
    assert said in result.doubts


def test_a_truth_of_everything_judges_everything():
    result = evaluate_tracks(TRACKS, TRACKS)
    assert (result.judged_share, result.doubts) == (1.0, "")


def with_false(rows: np.ndarray, x_m: float) -> Evaluation:
    """Scores where a fourth track, of some frames, is where nobody ever is."""
    xy = np.column_stack([np.full(len(rows), x_m), np.full(len(rows), 9.0)])
    false = positions_table(rows, np.full(len(rows), 4), xy, np.full(len(rows), 1.7), rows / 15.0)
    return evaluate_tracks(concatenate([TRACKS, false]), TRACKS)


def test_a_false_track_beside_the_truth_counts_as_false():
    result = with_false(np.arange(100), 8.0)
    assert result.clear.false_positives == 100
    assert result.unjudged_rows == 0


def test_a_track_that_stays_a_moment_after_its_person_left_counts_as_false():
    truth = TRACKS.where((TRACKS.track_id > 1) | (TRACKS.frame < 200))
    tracks = TRACKS.where((TRACKS.track_id > 1) | (TRACKS.frame < 220))
    assert evaluate_tracks(tracks, truth).clear.false_positives == 20


def test_a_truth_of_some_people_is_asked_about():
    result = evaluate_tracks(TRACKS, TRACKS.where(TRACKS.track_id == 2))
    assert result.clear.false_positives == 2 * FRAMES
    assert "2 of 3 tracks walk where the truth has nobody" in result.doubts
    assert "Without them MOTA is 1.000" in result.doubts


def test_a_score_that_nothing_explains_says_so():
    order = np.random.default_rng(0).permutation(len(TRACKS))
    truth = replace(TRACKS, x_m=TRACKS.x_m[order] * 2.0, y_m=TRACKS.y_m[order[::-1]])
    assert "tried explains it" in evaluate_tracks(TRACKS, truth).doubts


def test_people_who_are_missing_say_nothing_about_the_unit_of_heights():
    child = replace(TRACKS, height_m=np.where(TRACKS.track_id == 1, 1.7, 0.9))
    result = evaluate_tracks(TRACKS.where(TRACKS.track_id == 1), child)
    assert result.height_ratio == 1.0
    assert "height" not in result.doubts
