"""Scores of real recordings, on a few rows that can be counted by hand."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real import WALKER_PATH, recordings_with_truth, score_real, truth_of
from calib.errors import InputError
from planview.trajectories.table import Trajectories, positions_table


def table(*rows: tuple[int, int, float, float]) -> Trajectories:
    """Of frame, id, x [m] and visible."""
    frame, ids, x, visible = (np.array(column) for column in zip(*rows, strict=True))
    return positions_table(frame, ids, np.column_stack([x, 0 * x]), timestamp_s=frame / 10, visible=visible * 1.0)


def test_doubtful_people_are_neither_asked_for_nor_wrong() -> None:
    truth = table((0, 1, 0.0, 1), (1, 1, 0.0, 1), (1, 2, 3.0, 0), (2, 1, 0.0, 1), (2, 2, 3.0, 0))
    tracks = table((0, 7, 0.0, 1), (1, 7, 0.1, 1), (2, 7, 0.1, 1), (2, 8, 3.0, 1), (3, 7, 0.0, 1))
    score = score_real("room", "template", tracks, truth, np.arange(4))
    # Right in frames 0 to 2, in the last of which the doubtful one is found; nobody is there in frame 3.
    assert (score.count_accuracy, score.exact_count) == (0.75, 0.5)
    assert (score.ids, score.people) == (2, 1)
    assert (score.evaluation.clear.misses, score.evaluation.clear.false_positives) == (0, 1)


def test_only_judged_frames_count() -> None:
    score = score_real("room", "template", table((0, 7, 0.0, 1), (5, 9, 3.0, 1)), table((0, 1, 0.0, 1)), np.array([0]))
    assert (score.frames, score.count_accuracy, score.ids) == (1, 1.0, 1)


def test_walkers_path_has_a_second_person_to_the_right_once_both_stand(tmp_path: Path) -> None:
    (tmp_path / WALKER_PATH).write_text("frame,x_m,z_m,height_m\n0,0.5,1,1.7\n31,0.65,0.7,1.8\n31,0.0,0.6,1.7\n")
    truth = truth_of(tmp_path)
    assert list(zip(truth.frame, truth.track_id, truth.visible, strict=True)) == [(0, 1, 1), (31, 1, 0), (31, 2, 0)]
    assert truth.x_m.tolist() == [0.5, 0.0, 0.65]


def test_recordings_are_found_by_their_truth(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"truth\.csv"):
        recordings_with_truth(tmp_path)
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "truth.csv").touch()
    assert recordings_with_truth(tmp_path) == [tmp_path / "room"]
    with pytest.raises(InputError, match="found 'attic'"):
        recordings_with_truth(tmp_path, ["attic"])
