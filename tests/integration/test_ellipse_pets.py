"""The ellipse-particle tracker on the real street scene, without any calibration."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pets import TrackingErrors, tracking_errors
from planview.engine.open import open_engine
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.trajectories.formats import load_truth
from planview.trajectories.table import read_tracks, write_header, write_rows

FRAMES = 200


def test_pets_view_1_is_tracked_without_calibration(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data / "pets09-s2l1-view001"
    path = tmp_path / "tracks.csv"
    with path.open("w", encoding="utf-8") as file:
        write_header(file)
        for result in islice(open_engine(folder / "view001.mp4", "ellipse-particle"), FRAMES):
            write_rows(file, result.frame, result.timestamp_s, result.tracks)
    truth = load_truth(folder / "gt.txt")
    truth = truth.where(truth.frame < FRAMES)
    tracks = read_tracks(path)
    scores = evaluate_tracks(tracks, truth, EvaluationParams(match_on="boxes"))
    assert scores.clear.mota is not None and scores.clear.mota >= 0.68
    assert scores.identity.idf1 is not None and scores.identity.idf1 >= 0.70
    assert tracking_errors(truth, tracks).total <= 22


def test_tracking_errors_of_perfect_tracks_are_none(shared_data: Path) -> None:
    truth = load_truth(shared_data / "pets09-s2l1-view001" / "gt.txt")
    assert tracking_errors(truth, truth) == TrackingErrors(0, 0, 0)


@pytest.mark.parametrize(("shift", "expected"), [(0, 0), (1, 1)])
def test_tracking_errors_count_a_switched_id_once(shared_data: Path, shift: int, expected: int) -> None:
    truth = load_truth(shared_data / "pets09-s2l1-view001" / "gt.txt")
    one = truth.where(truth.track_id == truth.track_id[0])
    later = np.arange(len(one)) >= len(one) // 2
    tracks = replace(one, track_id=one.track_id + 100 * shift * later)
    assert tracking_errors(one, tracks).switches == expected
