"""PETS S2-L1 view 1: its annotation and protocols, and both trackers of one camera."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from benchmarks.pets import TrackingErrors, score_pets, tracking_errors
from calib.ground_camera import save_ground_camera
from calib.people.calibration import calibrate_from_people
from calib.people.samples import read_image_size, read_samples
from planview.engine.open import open_engine
from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories, read_tracks, write_header, write_rows


@pytest.fixture
def truth(shared_data: Path) -> Trajectories:
    path = shared_data / "pets09-s2l1-view001" / "gt.txt"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return load_truth(path)


def test_annotation_has_its_rows_from_frame_zero_and_scores_full_marks_against_itself(truth):
    assert (len(truth), int(truth.frame[0]), int(truth.frame[-1])) == (2396, 0, 399)
    result = evaluate_tracks(truth, truth, EvaluationParams(match_on="boxes", fps=7.0)).to_json()
    assert (result["truth_rows"], result["mota"], result["idf1"]) == (2396, 1.0, 1.0)
    assert result["significant_errors"]["total"] == 0
    assert tracking_errors(truth, truth) == TrackingErrors(0, 0, 0)


def test_turned_and_shifted_world_is_aligned_on_the_floor(truth: Trajectories) -> None:
    rng = np.random.default_rng(0)
    turned = replace(
        truth,
        x_m=20.0 - truth.y_m + rng.normal(0, 0.2, len(truth)),
        y_m=-5.0 + truth.x_m + rng.normal(0, 0.2, len(truth)),
        box_px=np.full_like(truth.box_px, np.nan),
    )
    result = evaluate_tracks(turned, truth, EvaluationParams(gate_m=1.0, align=True, fps=7.0)).to_json()
    assert result["mota"] > 0.99 and result["position_error_mean_m"] == pytest.approx(0.25, abs=0.02)
    assert result["alignment"]["rotation_deg"] == pytest.approx(-90.0, abs=1.0)


FRAMES = 200


@pytest.mark.slow
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
    assert scores.clear.mota >= 0.68 and scores.identity.idf1 >= 0.70
    assert tracking_errors(truth, tracks).total <= 22


@pytest.mark.parametrize(("shift", "expected"), [(0, 0), (1, 1)])
def test_tracking_errors_count_a_switched_id_once(shared_data: Path, shift: int, expected: int) -> None:
    truth = load_truth(shared_data / "pets09-s2l1-view001" / "gt.txt")
    one = truth.where(truth.track_id == truth.track_id[0])
    later = np.arange(len(one)) >= len(one) // 2
    tracks = replace(one, track_id=one.track_id + 100 * shift * later)
    assert tracking_errors(one, tracks).switches == expected


PEOPLE = Path(__file__).resolve().parents[1] / "data" / "pets_people.json"


@pytest.fixture
def camera(tmp_path: Path) -> Path:
    path = tmp_path / "camera.toml"
    size = read_image_size(PEOPLE)
    save_ground_camera(calibrate_from_people(read_samples(PEOPLE), size, "pinhole").camera, path)
    return path


@pytest.mark.slow
def test_pets_boxes_reach_what_is_asked(shared_data: Path, camera: Path) -> None:
    (scores,) = score_pets("human-model", shared_data / "pets09-s2l1-view001", camera)
    assert scores.frames == 400 and scores.boxes.truth_rows == 2396 and scores.boxes.clear.mota >= 0.80
    assert scores.boxes.identity.idf1 >= 0.88 and scores.floor is not None
